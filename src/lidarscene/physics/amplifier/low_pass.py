"""Low pass of the amplifier: one filter for pulse and noise, Gaussian or single pole; docs/theory_receivers.md 5.

A filter that passes constant light whole keeps the area of a pulse. So the received pulse is taken as the Gaussian of
the filtered pulse's peak and area: its width is that of the light over the share of the peak that passes. Of a Gaussian
filter this is exact. Behind a single pole the peak is exact and the edge is steeper than that Gaussian's: by 3, 7 and
20 % at f FWHM = 1, 0.64 and 0.35 (at a fifth of the peak). The delay of the filter is the same for every echo and
calibrated away.

Symbols: f cutoff (-3 dB), h impulse response, of unit area, B noise-equivalent bandwidth int |H|^2 df, sigma_p standard
deviation of the pulse, sigma_h that of a Gaussian filter's h, tau time constant of a single pole.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

from ...maths.arrays import Lanes, xp
from ...maths.special import normal_tail, scaled_normal_tail
from ..electronics.pulse_sums import SIGMAS_PER_FWHM

_ROOT_2PI = math.sqrt(2.0 * math.pi)
_NEWTON_STEPS = 4
"""Newton steps to the peak behind a single pole: good to 1e-12 from the start that `_mills_inverse` takes."""

_WIDEST = 1e3
"""Accuracy bought: largest sigma_p / tau in the formula: there the filter lowers the peak by 5e-7 only."""


class LowPass(ABC):
    """A filter by its cutoff f; each method for numpy and Dr.Jit.

    Attributes:
        noise_ratio: B / f
        crossing_ratio: rate at which white noise crosses a level behind it, over that behind an ideal low-pass of this
            B
    """

    noise_ratio: float
    crossing_ratio: float

    @abstractmethod
    def peak_share(self, *, fwhm_s: Lanes, cutoff_hz: Lanes) -> Lanes:
        """Highest value of a Gaussian pulse of unit peak behind the filter, (T70) or (T71)."""

    @abstractmethod
    def echo_noise_share(self, *, fwhm_s: Lanes, cutoff_hz: Lanes) -> Lanes:
        """Shot noise of such a pulse at its peak, as a variance over that of constant light of its peak.

        The variance is the light filtered by h^2 instead of h, which is a filter of the same kind and wider.
        """

    @abstractmethod
    def correlation(self, *, lag_s: Lanes, cutoff_hz: Lanes) -> Lanes:
        """Autocorrelation of white noise behind the filter at a lag: that of h, over its largest value."""

    @abstractmethod
    def box_peak_share(self, *, duration_s: Lanes, cutoff_hz: Lanes) -> Lanes:
        """Highest value of a rectangle of unit height behind the filter: of a SiPM's cell, from firing to revival."""

    @abstractmethod
    def box_noise_share(self, *, duration_s: Lanes, cutoff_hz: Lanes) -> Lanes:
        """Variance of a sum of such rectangles at random times, over that without the filter, (T73).

        A rectangle of length T has the triangle max(0, 1 - |t| / T) as its autocorrelation; the share is its mean
        over the filter's own, which has unit area.
        """


class Gaussian(LowPass):
    """|H| = 2^(-(nu / f)^2 / 2): what many stages in a row come to, without overshoot."""

    noise_ratio = 0.5 * math.sqrt(math.pi / math.log(2.0))  # 1.0645
    crossing_ratio = math.sqrt(6.0 / math.pi)  # f_rms = f / sqrt(2 ln 2) over B / sqrt(3)

    def peak_share(self, *, fwhm_s: Lanes, cutoff_hz: Lanes) -> Lanes:
        """1 / sqrt(1 + (sigma_h / sigma_p)^2), (T70)."""
        ratio = SIGMAS_PER_FWHM * _sigma_s(cutoff_hz) / fwhm_s
        return 1.0 / xp(ratio).sqrt(1.0 + ratio * ratio)

    def echo_noise_share(self, *, fwhm_s: Lanes, cutoff_hz: Lanes) -> Lanes:
        """h^2 is narrower by sqrt(2)."""
        return self.peak_share(fwhm_s=fwhm_s, cutoff_hz=math.sqrt(2.0) * cutoff_hz)

    def correlation(self, *, lag_s: Lanes, cutoff_hz: Lanes) -> Lanes:
        """exp(-(t / (2 sigma_h))^2)."""
        ratio = 0.5 * lag_s / _sigma_s(cutoff_hz)
        return xp(ratio).exp(-ratio * ratio)

    def box_peak_share(self, *, duration_s: Lanes, cutoff_hz: Lanes) -> Lanes:
        """1 - 2 Q(T / (2 sigma_h)): the filter's middle fits into the rectangle."""
        return 1.0 - 2.0 * normal_tail(0.5 * duration_s / _sigma_s(cutoff_hz))

    def box_noise_share(self, *, duration_s: Lanes, cutoff_hz: Lanes) -> Lanes:
        """Mean of 1 - |t| / T over |t| < T, of a normal t of deviation sqrt(2) sigma_h."""
        ratio = math.sqrt(0.5) * duration_s / _sigma_s(cutoff_hz)
        cut = (1.0 - xp(ratio).exp(-0.5 * ratio * ratio)) * 2.0 / (_ROOT_2PI * ratio)
        return 1.0 - 2.0 * normal_tail(ratio) - cut


class SinglePole(LowPass):
    """H = 1 / (1 + i nu / f), h = exp(-t / tau) / tau, tau = 1 / (2 pi f): a load with a capacitance."""

    noise_ratio = 0.5 * math.pi
    crossing_ratio = 1.0  # f_rms is infinite: later stages limit it, at an unknown frequency

    def peak_share(self, *, fwhm_s: Lanes, cutoff_hz: Lanes) -> Lanes:
        """exp(-u^2 / 2) at the peak's place u = w - z, with w = sigma_p / tau and m(z) = 1 / w, (T71).

        A Gaussian behind a single pole is exp(-u^2 / 2) w m(w - u), m the Mills ratio Q / phi. Its slope is (light -
        output) / tau, so the peak lies on the light's falling edge.
        """
        w = (2.0 * math.pi / SIGMAS_PER_FWHM) * fwhm_s * cutoff_hz
        w = xp(w).minimum(w, _WIDEST)
        u = w - _mills_inverse(w)
        return xp(u).exp(-0.5 * u * u)

    def echo_noise_share(self, *, fwhm_s: Lanes, cutoff_hz: Lanes) -> Lanes:
        """h^2 decays twice as fast; its peak comes before that of the pulse: up to 3.5 % too much there."""
        return self.peak_share(fwhm_s=fwhm_s, cutoff_hz=2.0 * cutoff_hz)

    def correlation(self, *, lag_s: Lanes, cutoff_hz: Lanes) -> Lanes:
        """exp(-|t| / tau)."""
        ops = xp(lag_s, cutoff_hz)
        return ops.exp(-2.0 * math.pi * cutoff_hz * ops.abs(lag_s))

    def box_peak_share(self, *, duration_s: Lanes, cutoff_hz: Lanes) -> Lanes:
        """1 - exp(-T / tau): at the rectangle's end."""
        return 1.0 - self.correlation(lag_s=duration_s, cutoff_hz=cutoff_hz)

    def box_noise_share(self, *, duration_s: Lanes, cutoff_hz: Lanes) -> Lanes:
        """1 - (tau / T) (1 - exp(-T / tau))."""
        ratio = 2.0 * math.pi * cutoff_hz * duration_s
        return 1.0 - self.box_peak_share(duration_s=duration_s, cutoff_hz=cutoff_hz) / ratio


LOW_PASSES: dict[str, LowPass] = {"gaussian": Gaussian(), "single_pole": SinglePole()}
"""Low passes by their names in sensor files."""


def _sigma_s(cutoff_hz: Lanes) -> Lanes:
    """Standard deviation of the Gaussian filter's impulse response, sqrt(ln 2) / (2 pi f)."""
    return math.sqrt(math.log(2.0)) / (2.0 * math.pi) / cutoff_hz


def _mills_inverse(w: Lanes) -> Lanes:
    """The z with m(z) = 1 / w, m(z) = Q(z) / phi(z), by Newton's method on log m."""
    ops = xp(w)
    # m(z) lies near 2 / (z + sqrt(z^2 + 8 / pi)), with the right value at 0 and the right limit above it, and near
    # 1 / phi(z) far below: both solved for z.
    z = ops.maximum(w - (2.0 / math.pi) / w, -ops.sqrt(2.0 * ops.maximum(0.5 - ops.log(w), 0.0)))
    for _ in range(_NEWTON_STEPS):
        mills = _ROOT_2PI * _scaled_tail(z)
        z = z - ops.log(mills * w) / (z - 1.0 / mills)
    return z


def _scaled_tail(z: Lanes) -> Lanes:
    """Q(z) exp(z^2 / 2) for z of either sign; z below -13 are taken as -13."""
    ops = xp(z)
    below, tail = ops.minimum(ops.maximum(z, -13.0), 0.0), scaled_normal_tail(z)
    return ops.where(z < 0.0, ops.exp(0.5 * below * below) - tail, tail)
