"""Find the rays that come near a body that moves.

To intersect a ray with a moving body takes a lookup of the body's pose and a query of its scene. Few rays come near any
body, so each ray asks only those whose boxes it passes. A box holds the body for the whole frame: it
is the same for all rays, and is made of six numbers.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ...maths.arrays import Array, Lanes, Mask, xp
from ..device.backend import mitsuba
from ..device.types import Ray, components

_SMALLEST_COMPONENT = 1e-20
"""Smallest component of a direction to divide by; no ray is so long that it would matter."""

BOXES_PER_GROUP = 32
"""Largest number of boxes in a group, whose answers are the bits of one UInt32."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AxisBox:
    """A box along the axes of the traced frame: its lowest and its highest corner."""

    low: tuple[Lanes, ...]
    high: tuple[Lanes, ...]


def boxes_from_numbers(numbers: Array) -> tuple[AxisBox, ...]:
    """Return boxes, from six numbers for each, one after the other, on the device."""
    import drjit as dr

    mi = mitsuba()
    # Numbers by themselves, computed here: a kernel is given such a number once, and would look up an element of an
    # array for every ray.
    single = [dr.gather(mi.Float, numbers, mi.UInt32(place)) for place in range(dr.width(numbers))]
    dr.eval(single)
    return tuple(
        AxisBox(low=tuple(single[first : first + 3]), high=tuple(single[first + 3 : first + 6]))
        for first in range(0, len(single), 6)
    )


def enclosing_box(boxes: Sequence[AxisBox]) -> AxisBox:
    """Return the box around all of these boxes, on the device."""
    import drjit as dr

    ops = xp(boxes[0].low[0])
    low, high = (
        tuple(functools.reduce(shrink, corner) for corner in zip(*corners, strict=True))
        for corners, shrink in (([box.low for box in boxes], ops.minimum), ([box.high for box in boxes], ops.maximum))
    )
    dr.eval(low, high)
    return AxisBox(low=low, high=high)


def boxes_passed(ray: Ray, groups: Sequence[Sequence[AxisBox]], whole: AxisBox, active: Mask) -> tuple[Any, ...]:
    """Return, for each group of boxes, a UInt32 whose bit i is set where an active ray passes box i.

    groups  at most `BOXES_PER_GROUP` boxes in each
    whole   the box around them all: rays that do not pass it are not tested further
    """
    import drjit as dr

    mi = mitsuba()
    ops = xp(ray.maxt)
    origin = components(ray.o)
    inverse = [dr.rcp(dr.select(dr.abs(d) < _SMALLEST_COMPONENT, _SMALLEST_COMPONENT, d)) for d in components(ray.d)]
    rises = [i > 0.0 for i in inverse]

    def passes(box: AxisBox) -> Any:
        """The slab method: the ray is between the two planes of each axis from `near` to `far`.

        The direction decides which plane comes first, not the distances: so no ray passes a box that is `NOWHERE`.
        """
        near: Lanes = mi.Float(0.0)
        far: Lanes = ray.maxt
        for o, i, up, low, high in zip(origin, inverse, rises, box.low, box.high, strict=True):
            near = ops.maximum(near, (dr.select(up, low, high) - o) * i)
            far = ops.minimum(far, (dr.select(up, high, low) - o) * i)
        return near <= far

    def bits() -> tuple[Any, ...]:
        flags = [
            [dr.select(passes(box), mi.UInt32(1 << number), 0) for number, box in enumerate(group)] for group in groups
        ]
        return tuple(functools.reduce(operator.or_, group) for group in flags)

    no_bits = tuple(mi.UInt32(0) for _ in groups)
    return ops.where_any(active & passes(whole), bits, no_bits)
