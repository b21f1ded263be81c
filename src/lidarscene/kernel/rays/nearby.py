"""Find the rays that come near a body that moves.

To ask a moving body whether a ray meets it takes a look at where the body is then, and a query. Few rays come near any,
so each ray asks only those bodies whose boxes it passes. A box holds the body's way through the whole frame: it is the
same for all rays, and is made of six numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ...maths.arrays import Array, Lanes
from ..device.backend import mitsuba
from ..device.types import Ray, components

_LEAST = 1e-20
"""Smallest component of a direction that is divided by; no ray is so long that it would matter."""

MOST = 32
"""Boxes whose answers are the bits of one number."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Box:
    """A box along the axes of the traced frame: its lowest and its highest corner."""

    low: tuple[Lanes, ...]
    high: tuple[Lanes, ...]


def boxes_of(numbers: Array) -> tuple[Box, ...]:
    """Return boxes, from six numbers for each, one after the other, on the device."""
    import drjit as dr

    mi = mitsuba()
    # Numbers by themselves, computed here: a kernel is given such a number once, and would look up an element of an
    # array for every ray.
    single = [dr.gather(mi.Float, numbers, mi.UInt32(place)) for place in range(dr.width(numbers))]
    dr.eval(single)
    return tuple(
        Box(low=tuple(single[first : first + 3]), high=tuple(single[first + 3 : first + 6]))
        for first in range(0, len(single), 6)
    )


def passed(ray: Ray, boxes: Sequence[Box]) -> Any:
    """Return UInt32 whose bit i says whether the ray passes box i; at most `MOST` boxes."""
    import drjit as dr

    mi = mitsuba()
    met = mi.UInt32(0)
    origin = components(ray.o)
    # The slab method: the ray is between the two planes of each axis from `near` to `far`.
    inverse = [dr.rcp(dr.select(dr.abs(d) < _LEAST, _LEAST, d)) for d in components(ray.d)]
    for number, box in enumerate(boxes):
        near: Lanes = mi.Float(0.0)
        far: Lanes = ray.maxt
        for o, i, low, high in zip(origin, inverse, box.low, box.high, strict=True):
            one, other = (low - o) * i, (high - o) * i
            near, far = dr.maximum(near, dr.minimum(one, other)), dr.minimum(far, dr.maximum(one, other))
        met |= dr.select(near <= far, mi.UInt32(1 << number), 0)
    return met
