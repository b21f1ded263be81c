"""Sampling a pulse: quantisation of its samples, and how well its time can be known.

The Cramer-Rao bound is the standard against which the estimators of a sampled receiver are measured.

Symbols: g pulse shape, sigma_p its standard deviation.
"""

from __future__ import annotations

import math

from ...maths.arrays import Lanes, xp
from .pulse_sums import SIGMAS_PER_FWHM


def quantised(*, signal: Lanes, step: Lanes, full_scale: Lanes) -> Lanes:
    """Nearest multiple of the converter's step, at most full scale. The error has the deviation step / sqrt(12)."""
    ops = xp(signal, step, full_scale)
    return ops.minimum(ops.rint(signal / step) * step, full_scale)


def quantisation_noise(*, step: Lanes) -> Lanes:
    """step / sqrt(12): deviation of an error even over one step (Bennett, Bell Syst. Tech. J. 27, 446, 1948)."""
    return step / math.sqrt(12.0)


def least_time_deviation_s(*, snr: Lanes, rate_hz: Lanes, pulse_fwhm_s: Lanes) -> Lanes:
    """Cramer-Rao bound of the time of a Gaussian pulse in white noise, with unknown height.

    snr      peak over the standard deviation of one sample
    rate_hz  samples per second, several in a pulse

    The information is sum_k (dg/dt)^2 snr^2 = snr^2 rate sqrt(pi) / (2 sigma_p): S. M. Kay, Fundamentals of
    Statistical Signal Processing I, section 3.5. Errors of height and time are not correlated, because the pulse is
    even and its slope odd.
    """
    ops = xp(snr, rate_hz, pulse_fwhm_s)
    sigma_s = pulse_fwhm_s / SIGMAS_PER_FWHM
    return ops.sqrt(2.0 * sigma_s / (math.sqrt(math.pi) * rate_hz)) / snr
