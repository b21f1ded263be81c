"""Timing and sampling a pulse: how well its time can be known, and what samples of it are worth.

A fixed threshold sees the foot of a strong pulse and the top of a weak one. A fraction of the peak, the peak, and the
peak behind a matched filter are the same place of every pulse, and their noise falls with the SNR
(docs/theory_receivers.md 6). There noise is white up to the bandwidth B, as the shot noise of (13) counts it; it
grows with the signal s as sigma(s)^2 = sigma_0^2 + kappa_1 s + kappa_2 s^2. The Cramer-Rao bound is the standard
against which estimators of a sampled receiver are measured.

Symbols: g pulse shape, sigma_p its standard deviation, f fraction of the peak, x = 2 pi B sigma_p, curvature -P'' / P
of the waveform at its peak in units of sigma_p (1 of a lone pulse).
"""

from __future__ import annotations

import math

from ...maths.arrays import Lanes, xp
from ...maths.special import normal_tail
from .pulse_sums import SIGMAS_PER_FWHM

SHOT_SHARE = math.sqrt(2.0 / 3.0)
"""int g^3 / int g^2: of noise that grows as the signal, what counts behind a matched filter, over that at the peak."""

SQUARE_SHARE = math.sqrt(0.5)
"""int g^4 / int g^2: the same of noise that grows as its square."""


LASTING_GAIN = math.sqrt(2.0)
"""int g / int g^2: gain of a matched filter for lasting light, over that for a lone pulse."""


def widths(*, bandwidth_hz: Lanes, pulse_fwhm_s: Lanes) -> Lanes:
    """x = 2 pi B sigma_p: how far the noise reaches beyond the pulse's own spectrum, whose deviation is x = 1."""
    return (2.0 * math.pi / SIGMAS_PER_FWHM) * bandwidth_hz * pulse_fwhm_s


def matched_noise_share(*, x: Lanes) -> Lanes:
    """Variance behind the filter that fits the pulse over that before it, if both pass a pulse's height as it is.

    erf(x) sqrt(pi) / x: what a filter of the frequency response exp(-(2 pi f sigma_p)^2 / 2) leaves of noise that is
    white up to B, (T78). Above 1 where the noise is narrower than the pulse: white noise is what this filter is for.
    """
    return math.sqrt(math.pi) * _erf(x) / x


def matched_slope_noise(*, x: Lanes) -> Lanes:
    """Deviation of the filtered noise's derivative over that of the filtered noise, per sigma_p, (T79).

    sqrt(1/2 - x exp(-x^2) / (sqrt(pi) erf(x))), from the second moment of its spectrum.
    """
    ops = xp(x)
    cut = x * ops.exp(-x * x) / (math.sqrt(math.pi) * _erf(x))
    return ops.sqrt(ops.maximum(0.5 - cut, 0.0))


def slope_noise(*, x: Lanes) -> Lanes:
    """The same without a filter: x / sqrt(3), of an ideal low pass (S. O. Rice, 1945), (T77)."""
    return x / math.sqrt(3.0)


def matched_gain(*, curvature: Lanes) -> Lanes:
    """Gain of the filter for the height of a pulse of another width, sqrt(2 / (1 + curvature)), (T80).

    A pulse of width sigma has the curvature (sigma_p / sigma)^2. Light that lasts gains sqrt(2).
    """
    ops = xp(curvature)
    return ops.sqrt(2.0 / (1.0 + ops.maximum(curvature, 0.0)))


def matched_curvature(*, curvature: Lanes) -> Lanes:
    """Curvature behind the filter: variances add, 1 / (1 + 1 / curvature)."""
    return curvature / (1.0 + curvature)


def peak_deviation(*, noise_share: Lanes, slope_noise: Lanes, curvature: Lanes) -> Lanes:
    """Deviation of the place of a peak in noise, in sigma_p, (T77) and (T79).

    A maximum moves by n'(t) / s'': noise_share slope_noise / curvature, as long as the pulse is a parabola over that
    way. On a broad top it moves no farther than where the light has fallen by the noise, and from a peak that is lower
    than the noise, a shoulder of another, no farther than where that light ends.

    Args:
        noise_share: deviation of the noise over the peak's height; beyond 1 it counts as 1
        slope_noise: deviation of its derivative over its own, per sigma_p
    """
    ops = xp(noise_share, curvature)
    curved, share = ops.maximum(curvature, 1e-6), ops.minimum(noise_share, 1.0)
    return ops.minimum(share * slope_noise / curved, ops.sqrt(2.0 * share / curved))


def quantise(*, signal: Lanes, step: Lanes, full_scale: Lanes) -> Lanes:
    """Nearest multiple of the converter's step, at most full scale. The error has the deviation step / sqrt(12)."""
    ops = xp(signal, step, full_scale)
    return ops.minimum(ops.rint(signal / step) * step, full_scale)


def _erf(x: Lanes) -> Lanes:
    return 1.0 - 2.0 * normal_tail(x * math.sqrt(2.0))
