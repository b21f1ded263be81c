"""Measuring a pulse: its height from its width, sampled values, and how well its time can be known."""

from __future__ import annotations

import math

from ...maths.arrays import Lanes, xp
from .pulse_sums import SIGMAS_PER_FWHM


def quantised(*, signal: Lanes, step: Lanes, full_scale: Lanes) -> Lanes:
    """Nearest multiple of the converter's step, at most full scale; the error has the deviation step / sqrt(12)."""
    ops = xp(signal, step, full_scale)
    return ops.minimum(ops.rint(signal / step) * step, full_scale)


def quantisation_noise(*, step: Lanes) -> Lanes:
    """step / sqrt(12): of an error that is evenly spread over one step (Bennett, Bell Syst. Tech. J. 27, 446, 1948)."""
    return step / math.sqrt(12.0)


def least_time_deviation_s(*, snr: Lanes, rate_hz: Lanes, pulse_fwhm_s: Lanes) -> Lanes:
    """Cramer-Rao bound of the time of a Gaussian pulse in white noise, its height not known.

    snr      peak over the standard deviation of one sample
    rate_hz  samples per second, several in a pulse

    The information is sum_k (dg/dt)^2 snr^2 = snr^2 rate sqrt(pi) / (2 sigma_p): S. M. Kay, Fundamentals of
    Statistical Signal Processing I, section 3.5, for samples in a row. Height and time are not correlated, since the
    pulse is even and its slope odd.
    """
    ops = xp(snr, rate_hz, pulse_fwhm_s)
    sigma_s = pulse_fwhm_s / SIGMAS_PER_FWHM
    return ops.sqrt(2.0 * sigma_s / (math.sqrt(math.pi) * rate_hz)) / snr
