"""The laser pulse in time: Gaussian, unit peak, given by its full width at half maximum.

Echo times are those of the leading edge at some level, and the walk correction needs the same edge, so both take it
from here.

Symbols: g(t) pulse shape, FWHM full width at half maximum, w angular radius of the spot (1/e^2), R range, beta angle of
incidence, sigma_p standard deviation of the pulse.
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


_LEAST_COSINE = 0.01
"""Accuracy bought: least cosine of a slope: flatter surfaces count as this flat."""


_LEAST_SQUARE = 1e-3
"""Accuracy bought: least square of a broadening, which is 1 or more of all cosines up to 1."""


def slope_broadening(*, spot_rad: Lanes, range_m: Lanes, cos_incidence: Lanes, unit_m: Lanes) -> Lanes:
    """Length of an echo from a plane that leans over that of the pulse, sqrt(1 + (R w tan(beta) / (2 u))^2), (T49b).

    The spot's near side answers first. Across a Gaussian spot the range has the deviation R (w / 2) tan(beta), so the
    echo of a Gaussian pulse is a longer Gaussian of the same energy: its peak is lower by this factor (C. S. Gardner,
    IEEE Trans. Geosci. Remote Sens. 30, 1061, 1992, without its terms of roughness and of wide beams).

    Args:
        spot_rad: angular radius w of the spot
        unit_m: u = c sigma_p / 2
    """
    ops = xp(range_m, cos_incidence)
    cos = ops.maximum(cos_incidence, _LEAST_COSINE)
    half = 0.5 * range_m * spot_rad / unit_m
    # Differences may step over a cosine of 1: there the square goes on as a straight line, as far as it has a root.
    return ops.sqrt(ops.maximum(1.0 + half * half * (1.0 / (cos * cos) - 1.0), _LEAST_SQUARE))


def pulse_energy_j(*, peak_power_w: Lanes, fwhm_s: Lanes) -> Lanes:
    """Energy of a Gaussian pulse, P_t FWHM sqrt(pi / (4 ln 2)) = 1.0645 P_t FWHM."""
    return peak_power_w * fwhm_s * math.sqrt(math.pi / _FOUR_LN2)
