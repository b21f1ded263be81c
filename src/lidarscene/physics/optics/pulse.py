"""The laser pulse in time: Gaussian, unit peak, given by its full width at half maximum.

Echo times are those of the leading edge at some level, and the walk correction needs the same edge, so both take it
from here.

Symbols: g(t) pulse shape, FWHM full width at half maximum.
"""

from __future__ import annotations

import math

from ...maths.arrays import Lanes, xp

_FOUR_LN2 = 4.0 * math.log(2.0)


def gaussian_pulse(*, time_s: Lanes, fwhm_s: Lanes) -> Lanes:
    """g(t) = exp(-4 ln2 (t / FWHM)^2), centred on zero."""
    ratio = time_s / fwhm_s
    return xp(ratio).exp(-_FOUR_LN2 * ratio * ratio)


def leading_edge_time_s(*, level: Lanes, fwhm_s: Lanes) -> Lanes:
    """Time (negative) at which g rises through ``level``, 0 < level <= 1. Levels above one count as one."""
    ops = xp(level, fwhm_s)
    return -fwhm_s * ops.sqrt(ops.maximum(-ops.log(level), 0.0) / _FOUR_LN2)


def pulse_energy_j(*, peak_power_w: Lanes, fwhm_s: Lanes) -> Lanes:
    """Energy of a Gaussian pulse, P_t FWHM sqrt(pi / (4 ln 2)) = 1.0645 P_t FWHM."""
    return peak_power_w * fwhm_s * math.sqrt(math.pi / _FOUR_LN2)
