"""Find the lanes that have a return or meet glass, and join several arrays of lanes into one.

A kernel cannot make a list that grows. So it flags lanes, the flags are counted, and the next kernel runs for the
flagged lanes only.

Symbols: n pulse lanes, k kept lanes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...detection.returns import Detection
from ...maths.arrays import Array, Mask, xp
from ..device import transfer
from ..device.backend import mitsuba
from ..device.types import DeviceArray


def lanes_where(flag: Mask) -> Any:
    """Return the (k,) lanes at which a flag is set, UInt32; None if k is 0."""
    import drjit as dr

    lanes = dr.compress(flag)
    return None if dr.width(lanes) == 0 else lanes


def more_than_one(lanes: DeviceArray) -> Any:
    """Return at least two lanes: the given ones, or a single one twice."""
    import drjit as dr

    # Dr.Jit treats an array of one element as a scalar that is broadcast, and would compile all that follows again for
    # it. The copy is made by NumPy, because on the device it would be a kernel, too.
    return lanes if dr.width(lanes) > 1 else transfer.unsigned_numbers(lanes.numpy().repeat(2))


def gather_lanes(values: Array, lanes: Array) -> Any:
    """Return the entries of these lanes, computed."""
    import drjit as dr

    entries = dr.gather(type(values), values, lanes)
    dr.eval(entries)
    return entries


def any_of_pulse(flag: Mask, rays: int) -> Any:
    """Return (n,) whether a flag of (n rays,) lanes is set for any ray of each pulse."""
    ops = xp(flag)
    is_set = ops.column(flag, 0, rays)
    for ray in range(1, rays):
        is_set = is_set | ops.column(flag, ray, rays)
    return is_set


def reported_lanes(detection: Detection, lane_of: Array | None = None, *, twice: bool = False) -> tuple[Any, Any, int]:
    """Return lane and stop number of every reported return, by pulse and then by stop, and their number k.

    Each is (k,), but (2,) if k is 1: a single return is there twice (see `more_than_one`). If k is 0 they are those of
    the first lane: its columns are computed and left out, so that a later frame with a point compiles nothing.

    lane_of  (n,) lane of each pulse, in firing order; None: lane i has pulse i
    twice    the two lanes are one pulse: its returns are there twice
    """
    import drjit as dr

    mi = mitsuba()
    stops = len(detection.stops)
    reported = [stop.reported for stop in detection.stops]
    # Rays are traced tile by tile, because neighbours in angle meet the same triangles. The flags are put back into
    # firing order here, before anything is gathered: then the points come out in firing order by themselves.
    if lane_of is not None:
        reported = [dr.gather(mi.Bool, flag, lane_of) for flag in reported]
    index = dr.compress(interleave(reported))
    count = dr.width(index) // (2 if twice else 1)
    index = more_than_one(index) if count else transfer.unsigned_numbers(np.zeros(2, np.uint32))
    place, stop = (index, mi.UInt32(0)) if stops == 1 else (index // stops, index % stops)
    # `place` counts pulses in firing order; the lane at which the stages left a pulse's numbers is looked up.
    return (place if lane_of is None else dr.gather(mi.UInt32, lane_of, place)), stop, count


def interleave(arrays: Sequence[object]) -> Any:
    """Join a arrays of n lanes into one of n a: the entry of array i at lane j becomes number j a + i."""
    import drjit as dr

    mi = mitsuba()
    if len(arrays) == 1:
        return arrays[0]
    count, lanes = len(arrays), max(dr.width(array) for array in arrays)
    place = dr.arange(mi.UInt32, lanes) * count
    together = dr.zeros(type(arrays[0]), lanes * count)
    for number, array in enumerate(arrays):
        dr.scatter(together, array, place + number)
    return together
