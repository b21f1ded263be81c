"""AC coupling: a high pass that takes the mean out of the signal, and leaves an undershoot behind each echo.

A capacitor in the signal's path passes s - k * s, k = omega exp(-omega t): what it takes off has the area of the echo.
So the baseline is low by omega times that area and recovers with 1 / omega, and a later, weaker echo has that much less
height (docs/theory_receivers.md 5). Steady background does not pass at all.

Symbols: f_c coupling frequency (-3 dB), omega 2 pi f_c, sigma_p standard deviation of the pulse, u time in sigma_p from
the pulse's peak, w = omega sigma_p.
"""

from __future__ import annotations

import math

from ...maths.arrays import Lanes, Numbers, xp
from ..electronics.pulse_sums import SIGMAS_PER_FWHM, Shape

WIDEST_RATE = 0.1
"""Accuracy bought: largest w for which the forms here hold: the pulse keeps its shape but for some per cent."""


def rate(*, coupling_hz: Lanes, fwhm_s: Lanes) -> Lanes:
    """w = omega sigma_p."""
    return (2.0 * math.pi / SIGMAS_PER_FWHM) * coupling_hz * fwhm_s


def undershoot(*, place: Lanes, rate: Lanes) -> Shape:
    """Undershoot K(u) subtracted from a Gaussian pulse of unit peak, and its first two derivatives, (T74).

    K = w sqrt(2 pi) exp(w^2 / 2 - w u) Phi(u - w), which solves K' = w (g - K), g the pulse. Phi is taken as
    1 / (1 + exp(-1.5976 v - 0.07056 v^3)), to 1.4e-4 (S. R. Bowling et al., J. Ind. Eng. Manag. 2, 114, 2009): it is
    evaluated for every sub-echo wherever the waveform is.
    """
    ops = xp(place, rate)
    fading = ops.exp(ops.minimum(rate * (0.5 * rate - place), 2.0))  # no pulse has arrived where this is cut
    ahead = rate - place
    late = ahead * (1.5976 + 0.07056 * ahead * ahead)
    arrived = 1.0 / (1.0 + ops.exp(ops.minimum(late, 80.0)))
    value = math.sqrt(2.0 * math.pi) * rate * fading * arrived
    pulse = ops.exp(-0.5 * place * place)
    slope = rate * (pulse - value)
    bend = -rate * (ops.maximum(ops.minimum(place, 1e15), -1e15) * pulse + slope)
    return value, slope, bend


def peak_share(*, rate: Lanes) -> Lanes:
    """Highest value of g - K: at u = -w to first order in w, 1 - 1.25 w there."""
    return xp(rate).exp(-0.5 * rate * rate) - undershoot(place=-rate, rate=rate)[0]


def filter_samples(*, values: Numbers, step_s: float, coupling_hz: float) -> Numbers:
    """Pass a sampled signal through the high pass, (n,); at rest before the first sample, linear between samples."""
    omega = 2.0 * math.pi * coupling_hz
    decay = math.exp(-omega * step_s)
    # Exact for straight lines: of the change over a step, the mean of the decay over the step is left at its end.
    fresh = -math.expm1(-omega * step_s) / (omega * step_s)
    output, level, previous = values.astype(float), 0.0, 0.0
    for number, value in enumerate(values):
        level = decay * level + fresh * (float(value) - previous)
        previous = float(value)
        output[number] = level
    return output
