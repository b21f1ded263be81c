"""Pile-up within an echo: SPADs that fire on the leading edge are blind for the rest, so strong echoes look too near.

Symbols: Lambda detections of an echo that one free SPAD would make without dead time, sigma width of the echo.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from ...maths.arrays import Lanes, LookupTable, xp
from .matched_filter import TEMPLATE

_MOST = 1e4
"""Largest Lambda of the table: all SPADs fire 4 sigmas before the peak."""

_SAMPLES = 128


def shift(*, detections: Lanes) -> Lanes:
    """Shift of the peak that the matched filter finds, in sigmas of the echo: 0 for weak ones, else negative (T92a).

    Firings follow the density Lambda g(t) exp(-Lambda G(t)), with g the pulse and G its integral.
    """
    ops = xp(detections)
    return _table().at(ops.log(1.0 + ops.maximum(detections, 0.0)) * (1.0 / np.log1p(_MOST).item()))


def shadow_s(*, rate_hz: Lanes, sigma_s: Lanes) -> Lanes:
    """Time by which the matched filter finds an echo early because its shadow holds less background, s (T92b).

    SPADs that the echo fired do not count the background after it. The background falls by the share that fired, as the
    echo is that share: whatever its strength, the peak moves by lambda sigma^2 (1 + w^2), if the dead time is longer
    than the pulse.

    rate_hz  lambda of the background
    """
    return rate_hz * sigma_s * sigma_s * (1.0 + TEMPLATE**2)


def shade(*, rate_hz: Lanes, sigma_s: Lanes) -> Lanes:
    """Value of the filter at an echo over its photons, exp(-lambda sigma sqrt(pi / 2 (1 + w^2))) (T92c).

    Half of the template lies in the echo's shadow. A SPAD that the echo fired does not count the background there,
    which it would have counted with one minus this probability.
    """
    shadowed = rate_hz * sigma_s * math.sqrt(0.5 * math.pi * (1.0 + TEMPLATE**2))
    return xp(shadowed).exp(-shadowed)


def shade_of_box(*, rate_hz: Lanes, sigma_s: Lanes, half_width: float) -> Lanes:
    """Counts above the background within so many sigmas of an echo over its photons, as `shade`."""
    shadowed = rate_hz * sigma_s * half_width
    return xp(shadowed).exp(-shadowed)


@lru_cache(maxsize=1)
def _table() -> LookupTable:
    """`shift` over log(1 + Lambda)."""
    from math import erf

    t = np.linspace(-8.0, 8.0, 1601)
    pulse = np.exp(-0.5 * t * t) / np.sqrt(2.0 * np.pi)
    arrived = np.array([0.5 * (1.0 + erf(x / 2.0**0.5)) for x in t])
    places = []
    for light in np.expm1(np.linspace(0.0, np.log1p(_MOST), _SAMPLES)):
        fired = pulse * np.exp(-light * arrived)  # density of firings, g exp(-Lambda G)
        place = float(np.sum(t * fired) / np.sum(fired))
        for _ in range(50):  # Newton's method on the filter's slope, from the centroid
            offset = t - place
            weighted = fired * np.exp(-0.5 * (offset / TEMPLATE) ** 2)
            slope, bend = np.sum(weighted * offset), np.sum(weighted * ((offset / TEMPLATE) ** 2 - 1.0))
            place -= float(slope / bend)
        places.append(place)
    return LookupTable(np.array(places))
