"""The glory of small raindrops: light that a sphere sends almost straight back, averaged over the receiver's lens.

A sphere of water sends light back along its edge too, and all around its rim these rays interfere: straight back it is
tens of times as bright as its front and back face, within about lambda / D. A lens at a distance R sees angles up to
a / R, so the gain grows with distance until the lens is within the glory. Drops are spheres up to 0.5 mm; larger ones
are flattened by their fall, by 0.2 % at 0.5 mm and 2 % at 1 mm (K. V. Beard and C. Chuang, J. Atmos. Sci. 44, 1509,
1987), which shifts the rays around the rim by wavelengths. From 0.5 to 1 mm the gain fades to one, linearly.

Mie's series near the backward direction, theta from straight back, nu = n + 1/2 (H. C. van de Hulst, Light Scattering
by Small Particles (1957), 13.3):

    (|S_1|^2 + |S_2|^2) / 2 = |sum nu (-1)^n (a_n - b_n) J_0(nu theta)|^2 + |sum nu (-1)^n (a_n + b_n) J_2(nu theta)|^2

Symbols: D diameter, x size parameter pi D / lambda, u = x theta, a lens radius, a_n and b_n Mie coefficients.
"""

from __future__ import annotations

import functools
import math

import numpy as np

from ...maths.arrays import Numbers
from . import mie
from .precipitation import drop_backscatter_m2_sr

SPHERES_UP_TO_M, FLAT_FROM_M = 0.5e-3, 1e-3
"""Source: Beard and Chuang, J. Atmos. Sci. 44, 1509, 1987; diameters up to which drops are spheres, and from which they
have no glory."""

_SMALLEST_M = 0.1e-3
"""Accuracy bought: diameter below which drops have the gain of this one: they are 2 % of the backscatter of a
drizzle."""

_NODES, _OF_A_NODE = (12, 16)  # diameters of the table, and sizes between two over which the ripples are averaged

_STEP = 0.001
"""Accuracy bought: step of the table of Bessel functions, which are read at the nearest one."""

_PLACES = np.linspace(0.0, 40.0, 81)
"""Accuracy bought: u of the table; Bessel functions turn every pi."""


def gain(*, diameter_m: Numbers, wavelength_m: float, within_rad: Numbers, from_rad: Numbers | float = 0.0) -> Numbers:
    """Backscatter of a raindrop into a lens over that of its two faces, `precipitation.drop_backscatter_m2_sr`.

    All are broadcast. The table averages the sizes between two of its diameters: rain has no single size, with ripples.

    Args:
        diameter_m: D
        within_rad: largest angle from straight back that the lens sees, a / R
        from_rad: smallest one: of a lens beside the laser, as if it were the ring between both around it
    """
    diameter = np.asarray(diameter_m, dtype=float)
    outer, inner = np.asarray(within_rad, dtype=float), np.asarray(from_rad, dtype=float)
    power = outer**2 * _disc_brightness(diameter, outer, wavelength_m)
    if np.any(inner > 0.0):
        power = power - inner**2 * _disc_brightness(diameter, inner, wavelength_m)
    sphere = power / np.maximum(outer**2 - inner**2, 1e-300)
    round_share = np.clip((FLAT_FROM_M - diameter) / (FLAT_FROM_M - SPHERES_UP_TO_M), 0.0, 1.0)
    return np.asarray(1.0 + round_share * (sphere - 1.0))


def _disc_brightness(diameter: Numbers, angle: Numbers, wavelength_m: float) -> Numbers:
    """Mean brightness over all angles up to one, over that of the faces."""
    logs, table = _table(wavelength_m)
    u = math.pi * diameter / wavelength_m * angle
    # Bilinear interpolation: rows by ln D, columns by u.
    row = (np.log(np.maximum(diameter, _SMALLEST_M)) - logs[0]) / (logs[1] - logs[0])
    low = np.clip(np.floor(row).astype(int), 0, len(logs) - 2)
    part = np.clip(row - low, 0.0, 1.0)
    place = np.minimum(u, _PLACES[-1]) / _PLACES[1]
    column = np.minimum(place.astype(int), len(_PLACES) - 2)
    along = place - column
    within = sum(
        share * (table[node, column] * (1.0 - along) + table[node, column + 1] * along)
        for node, share in ((low, 1.0 - part), (low + 1, part))
    )
    # Beyond the table, the last brightness goes on: the mean over a lens of u is that within and that beyond.
    rim = _rim(wavelength_m)
    share = np.minimum(_PLACES[-1] / np.maximum(u, 1e-12), 1.0) ** 2
    return np.asarray(within * share + (rim[low] * (1.0 - part) + rim[low + 1] * part) * (1.0 - share))


def sphere_over_faces(*, diameter_m: Numbers, wavelength_m: float, places: Numbers) -> Numbers:
    """(n, m) brightness of n spheres at ``places`` u over that of their two faces, by Mie's series."""
    x = math.pi * np.asarray(diameter_m, dtype=float) / wavelength_m
    electric, magnetic = mie.coefficients(size_parameter=x, index=mie.water_index(wavelength_m=wavelength_m))
    nu = np.arange(1, electric.shape[0] + 1) + 0.5
    sign = nu * (-1.0) ** np.arange(1, electric.shape[0] + 1)
    j0, j2 = _bessel(1.2 * float(np.max(places)) + 20.0)
    brightness = []
    for number, size in enumerate(x):
        last = int(size + 4.05 * np.cbrt(size) + 2.0)
        index = np.rint(nu[:last, None] / size * (places / _STEP)).astype(np.int32)
        even, odd = j0[index], j2[index]
        a, b = electric[:last, number], magnetic[:last, number]
        # Real and imaginary parts as two rows: with a complex number in it the product would copy the table as complex.
        brightness.append(
            sum(
                np.sum((np.stack([weight.real, weight.imag]) @ bessel) ** 2, axis=0)
                for weight, bessel in ((sign[:last] * (a - b), even), (sign[:last] * (a + b), odd))
            )
        )
    per_sr = np.array(brightness) * (wavelength_m / (2.0 * math.pi)) ** 2
    faces = np.asarray(drop_backscatter_m2_sr(diameter_m=np.asarray(diameter_m), wavelength_m=wavelength_m))
    return np.asarray(per_sr / faces[:, None])


@functools.cache
def _brightness(wavelength_m: float) -> tuple[Numbers, Numbers]:
    """ln D of the table's diameters, and the brightness there over u, ripples averaged."""
    edges = np.linspace(math.log(_SMALLEST_M), math.log(FLAT_FROM_M), _NODES + 1)
    steps = (np.arange(_NODES * _OF_A_NODE) + 0.5) / _OF_A_NODE * (edges[1] - edges[0]) + edges[0]
    single = sphere_over_faces(diameter_m=np.exp(steps), wavelength_m=wavelength_m, places=_PLACES)
    averaged = single.reshape(_NODES, _OF_A_NODE, len(_PLACES)).mean(axis=1)
    return 0.5 * (edges[1:] + edges[:-1]), averaged


@functools.cache
def _table(wavelength_m: float) -> tuple[Numbers, Numbers]:
    """ln D, and the mean over a lens of u: 2 / u^2 int F u du."""
    logs, bright = _brightness(wavelength_m)
    weighed = bright * _PLACES
    steps = 0.5 * (weighed[:, 1:] + weighed[:, :-1]) * np.diff(_PLACES)
    mean = np.zeros_like(bright)
    mean[:, 1:] = 2.0 * np.cumsum(steps, axis=1) / _PLACES[1:] ** 2
    mean[:, 0] = bright[:, 0]
    return logs, mean


def _rim(wavelength_m: float) -> Numbers:
    """Brightness at the end of the table, of some turns of the Bessel functions."""
    return np.asarray(_brightness(wavelength_m)[1][:, -13:].mean(axis=1))


@functools.cache
def _bessel(largest: float) -> tuple[Numbers, Numbers]:
    """J_0 and J_2 in steps of `_STEP`."""
    from scipy.special import jv

    argument = np.arange(0.0, largest, _STEP)
    return jv(0, argument), jv(2, argument)
