"""Intensity as makers report it: range-corrected power, and reflectivity on a scale of 0 to 255."""

from __future__ import annotations

import math

from ...maths.arrays import Lanes, xp

LARGEST = 255.0
"""Of one byte, in which makers send it."""


def range_corrected_power_w(*, power_w: Lanes, range_m: Lanes, reference_m: Lanes) -> Lanes:
    """P_r (R / R_0)^2: what the echo would have been at R_0, by (5) without its air."""
    ratio = range_m / reference_m
    return power_w * ratio * ratio


def white_echo_w_m2(*, peak_power_w: Lanes, aperture_m2: Lanes, efficiency: Lanes) -> Lanes:
    """P_r R^2 of a white Lambertian surface across the beam in clear air, P_t A eta_r / pi: (5) with rho = 1."""
    return peak_power_w * aperture_m2 * efficiency / math.pi


def reflectivity_estimate(*, power_w: Lanes, range_m: Lanes, white_w_m2: Lanes, overlap: Lanes) -> Lanes:
    """Reflectivity of the Lambertian surface across the beam that would give this echo: (5) solved for rho.

    white_w_m2  `white_echo_w_m2`
    overlap     share of the spot in the field of view at this range, 1 where all of it is

    A surface at an angle reads rho cos(theta), air takes its square off, a retro-reflector reads pi R_A: far above one.
    """
    return power_w * range_m * range_m / (white_w_m2 * overlap)


def on_scale(*, reflectivity: Lanes, white_value: Lanes, retro: str, retro_reflectivity: Lanes) -> Lanes:
    """A reflectivity on the maker's scale: whole numbers from 0 to 255.

    white_value         for a reflectivity of one; below it in proportion
    retro               above it: "linear" goes on alike; "logarithmic" in proportion to ln(rho)
    retro_reflectivity  that has 255 on a logarithmic scale
    """
    ops = xp(reflectivity, white_value, retro_reflectivity)
    value = white_value * reflectivity
    if retro == "logarithmic":
        above = ops.log(ops.maximum(reflectivity, 1.0)) / ops.log(retro_reflectivity + 0.0 * reflectivity)
        value = ops.where(reflectivity > 1.0, white_value + (LARGEST - white_value) * above, value)
    return ops.rint(ops.minimum(ops.maximum(value, 0.0), LARGEST))
