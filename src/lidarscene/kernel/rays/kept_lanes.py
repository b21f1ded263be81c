"""Find the lanes that have a return or meet glass, and join several arrays of lanes into one.

A kernel cannot make a list that grows. So it flags lanes, the flags are counted, and the next kernel runs for the
flagged lanes only.

Symbols: n pulse lanes, k kept lanes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...detection.report import Detection
from ...maths.arrays import Array, Mask, xp
from ..device import transfer
from ..device.backend import mitsuba
from ..device.types import DeviceArray

NO_LANE = 2**32 - 1
"""Entry of a list of lanes that is no lane."""

NO_PULSE = 2**31
"""Number of a lane without a pulse: those of pulses are lower."""


def existing(pulse: Array) -> Any:
    """Return (n,) pulse numbers, 0 on a lane without a pulse: the tables of a scanner do not reach to `NO_PULSE`."""
    ops = xp(pulse)
    return ops.where(pulse < NO_PULSE, pulse, ops.uint32(0))


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


def in_packets(lanes: DeviceArray, frame_lanes: int, packet: int) -> Any:
    """Return the lanes of several frames with `NO_LANE` between them, so that each frame begins a packet of rays.

    Args:
        lanes: (k,) rising numbers
        frame_lanes: lanes of each frame
        packet: rays that are traced together: which of two triangles a ray at their edge meets depends on these
    """
    numbers = lanes.numpy()
    counts = np.bincount(numbers // frame_lanes)
    room = -(-counts // packet) * packet
    start = np.cumsum(room) - room
    packed = np.full(room.sum(), NO_LANE, np.uint32)
    packed[np.arange(len(numbers)) + np.repeat(start - np.cumsum(counts) + counts, counts)] = numbers
    single = start[counts == 1]  # there twice, as in a frame that is rendered alone (`more_than_one`)
    packed[single + 1] = packed[single]
    return transfer.unsigned_numbers(packed)


@dataclass(frozen=True, slots=True, eq=False)
class Retraced:
    """Which of n lanes are traced again, as m lanes of their own.

    Attributes:
        lanes: (m,) number of each lane that is traced again, or `NO_LANE`
        place: (n,) which of the m it is; 0 for a lane that is not traced again
        mask: (n,) whether a lane is traced again
    """

    lanes: Any
    place: Any
    mask: Any

    @classmethod
    def from_lanes(cls, lanes: Array, mask: Mask) -> Retraced:
        """Number the lanes that are traced again, in this order; ``place`` is computed with what reads it first."""
        import drjit as dr

        mi = mitsuba()
        place = dr.zeros(mi.UInt32, dr.width(mask))
        dr.scatter(place, dr.arange(mi.UInt32, dr.width(lanes)), lanes, lanes != NO_LANE)
        return cls(lanes, place, mask)

    def pulses(self, pulse: Array, others: Sequence[Array] = ()) -> tuple[Any, tuple[Any, ...]]:
        """Return pulse numbers and other values of these lanes, (m,) each, computed together with ``place``.

        Args:
            pulse: (n,) of all lanes
            others: (n,) each; 0 on `NO_LANE`
        """
        import drjit as dr

        is_lane = self.lanes != NO_LANE
        number, *values = (dr.gather(type(own), own, self.lanes, is_lane) for own in (pulse, *others))
        number = dr.select(is_lane, number, NO_PULSE)
        dr.eval(number, self.place, *values)
        return number, tuple(values)

    def replace(self, flag: Mask, values: Mask) -> Any:
        """Return (n,) flags with those of the lanes traced again, ``values`` (m,), in their places."""
        import drjit as dr

        # Flags of lanes that are traced again are not set (`rendering.chunk.drop_continuing`).
        return flag | dr.gather(mitsuba().Bool, values, self.place, self.mask)

    def among(self, lanes: Array, stop: Array, *, stops: int) -> tuple[Any, tuple[Any, Any]] | None:
        """Find the returns of lanes that are traced again among k: index there; which of the m lanes, stop number.

        Args:
            lanes: those of `reported_lanes`
            stop: those of `reported_lanes`, of this many stops to a pulse

        Returns:
            None without any. A single one is there twice (`more_than_one`).
        """
        import drjit as dr

        mi = mitsuba()
        # Lanes and stops are not computed for themselves: whoever reads them has the same kernel if none is found here.
        number = dr.gather(mi.UInt32, self.place, lanes) * stops + stop
        is_again = dr.gather(mi.Bool, self.mask, lanes)
        dr.eval(number, is_again)
        index = dr.compress(is_again)
        if dr.width(index) == 0:
            return None
        index = more_than_one(index)
        number = dr.gather(mi.UInt32, number, index)
        return index, (number // stops, number % stops)


def any_of_pulse(flag: Mask, rays: int) -> Any:
    """Return (n,) whether a flag of (n rays,) lanes is set for any ray of each pulse."""
    ops = xp(flag)
    is_set = ops.column(flag, 0, rays)
    for ray in range(1, rays):
        is_set = is_set | ops.column(flag, ray, rays)
    return is_set


def reported_lanes(
    detection: Detection, lane_of: Array | None = None, *, again: Sequence[tuple[Retraced, Detection]] = ()
) -> tuple[Any, Any, int]:
    """Return lane and stop number of every reported return, by pulse and then by stop, and their number k.

    Each is (k,), but (2,) if k is 1: a single return is there twice (see `more_than_one`). If k is 0 they are those of
    the first lane: its columns are computed and left out, so that a later frame with a point compiles nothing.

    Args:
        lane_of: (n,) lane of each pulse, in firing order; None: lane i has pulse i
        again: lanes that are traced again, and what was detected then: their returns are those
    """
    import drjit as dr

    mi = mitsuba()
    stops = len(detection.stops)
    reported: list[Any] = [stop.reported for stop in detection.stops]
    for retraced, later in again:
        pairs = zip(reported, later.stops, strict=True)
        reported = [retraced.replace(flag, stop.reported) for flag, stop in pairs]
    # Rays are traced tile by tile, because neighbours in angle meet the same triangles. The flags are put back into
    # firing order here, before anything is gathered: then the points come out in firing order by themselves.
    if lane_of is not None:
        reported = [dr.gather(mi.Bool, flag, lane_of) for flag in reported]
    index = dr.compress(interleave(reported))
    count = dr.width(index)
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
        # No two lanes write to the same place: one kernel writes all arrays.
        dr.scatter(together, array, place + number, mode=dr.ReduceMode.Permute)
    return together
