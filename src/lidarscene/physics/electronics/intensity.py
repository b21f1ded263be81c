"""Intensity as makers report it: range-corrected power, and reflectivity on a scale of 0 to 255.

Makers solve the lidar equation (5) for the reflectivity, as if every surface were Lambertian and across the beam and
the air clear. The functions here are those steps.

Symbols: R range, rho reflectivity, P_r echo power, R_A coefficient of retro-reflection.
"""

from __future__ import annotations

import math

from ...maths.arrays import Lanes, xp

LARGEST = 255.0
"""Source: packets; largest value of the one byte in which makers send it."""

_DARKEST = 1e-9
"""Accuracy bought: least reflectivity of which a power is taken: it reads less than 1 on any scale with an exponent
above 0.27."""


def range_corrected_power_w(*, power_w: Lanes, range_m: Lanes, reference_m: Lanes) -> Lanes:
    """P_r (R / R_0)^2: the echo power of the same surface at R_0, by (5) without air."""
    ratio = range_m / reference_m
    return power_w * ratio * ratio


def white_echo_w_m2(*, peak_power_w: Lanes, aperture_m2: Lanes, efficiency: Lanes) -> Lanes:
    """P_r R^2 of a white Lambertian surface across the beam in clear air, P_t A eta_r / pi: (5) with rho = 1."""
    return peak_power_w * aperture_m2 * efficiency / math.pi


def reflectivity_estimate(*, power_w: Lanes, range_m: Lanes, white_w_m2: Lanes, overlap: Lanes) -> Lanes:
    """rho of the Lambertian surface across the beam that would give this echo: (5) solved for rho.

    A surface at an angle reads rho cos(theta). Air lowers the value by its transmittance squared. A retro-reflector
    reads pi R_A, far above one.

    Args:
        white_w_m2: `white_echo_w_m2`
        overlap: share of the spot in the field of view at this range, 0 to 1
    """
    return power_w * range_m * range_m / (white_w_m2 * overlap)


def on_scale(
    *,
    reflectivity: Lanes,
    white_value: Lanes,
    retro: str,
    retro_reflectivity: Lanes,
    exponent: Lanes | None = None,
    coarse_above: Lanes | None = None,
    coarse_step: Lanes | None = None,
) -> Lanes:
    """A reflectivity on the maker's scale: whole numbers from 0 to 255.

    Args:
        white_value: value of reflectivity one
        retro: scale above one: "linear" goes on as below it; "logarithmic" grows with ln(rho)
        retro_reflectivity: reflectivity that gets 255 on a logarithmic scale
        exponent: gamma of white_value rho^gamma, the scale below one (T46a); None: linear
        coarse_above: value above which only every ``coarse_step``-th is sent (T46b), and 255; None: all are
    """
    ops = xp(reflectivity, white_value, retro_reflectivity, exponent, coarse_above, coarse_step)
    value = white_value * reflectivity
    if exponent is not None:
        value = white_value * ops.exp(exponent * ops.log(ops.maximum(reflectivity, _DARKEST)))
    if retro == "logarithmic":
        above = ops.log(ops.maximum(reflectivity, 1.0)) / ops.log(retro_reflectivity + 0.0 * reflectivity)
        value = ops.where(reflectivity > 1.0, white_value + (LARGEST - white_value) * above, value)
    if coarse_above is not None and coarse_step is not None:
        steps = ops.rint((value - coarse_above) / coarse_step)
        value = ops.where(value > coarse_above, coarse_above + coarse_step * steps, value)
    return ops.rint(ops.minimum(ops.maximum(value, 0.0), LARGEST))
