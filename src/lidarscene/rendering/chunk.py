"""Chunk: the pulses of a chunk of a frame on the device, after all stages.

Pulses that end at the first surface and pulses that continue through glass are traced in separate launches. Each launch
gives a `Chunk`; the functions here join the parts of one chunk of the frame.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..detection.report import Detection, without_pulses
from ..kernel.device import transfer
from ..kernel.rays.kept_lanes import NO_LANE, Retraced
from ..kernel.rays.point_columns import Staged, with_nan_outcomes
from ..light.beams import Beams
from ..light.echoes import Echoes
from ..light.hits import Hits
from ..maths.arrays import Array, Lanes, Mask, Numbers, flatten, is_drjit, xp
from .frame import LARGEST_FLOAT32_M, Frame
from .tiles import Order


@dataclass(frozen=True, slots=True, eq=False)
class Chunk:
    """Pulses after all stages, on the device; lanes are in the order of pulse numbers unless ``order`` is given.

    Attributes:
        pulse: (n,) pulse numbers
        paths: `Hits` of each path of the rays
        detection: `Detection` of the pulses
        goes_on: (n,) mask of pulses that are traced again, for glass, mirrors or since they leak; None: no survey
        leaks: (n,) mask of pulses whose light other channels notice; None: they do not see it, or no survey
        order: permutation between pulses and lanes, or None
        retraced: lanes of the surveyed chunk that these lanes are; None: these are not traced again
        twice: the two lanes are one and the same pulse (`kept_lanes.more_than_one`)
    """

    pulse: Any
    paths: Sequence[Hits]
    detection: Detection
    goes_on: Any = None
    leaks: Any = None
    order: Order | None = None
    retraced: Retraced | None = None
    twice: bool = False

    def staged(self, rays: int) -> Staged:
        """Input of `kernel.rays.point_columns`, with this many rays to a pulse."""
        return Staged(pulse=self.pulse, paths=self.paths, rays=rays, detection=self.detection)

    def arrays(self) -> list[Any]:
        """Device arrays that the columns of points need: the outputs of the stages' kernel."""
        masks = [mask for mask in (self.goes_on, self.leaks) if mask is not None]
        truth = (array for hits in self.paths for array in truth_arrays(hits))
        return [self.pulse, *masks, *truth, *flatten(self.detection)]


def drop_continuing(
    pulse: Array, paths: Sequence[Hits], detection: Detection, goes_on: Mask | None, leaks: Mask | None = None
) -> Chunk:
    """Chunk whose pulses that are traced again count as without a surface: their full trace replaces them."""
    if leaks is not None:
        goes_on = leaks if goes_on is None else goes_on | leaks
    if goes_on is None:
        return Chunk(pulse, paths, with_nan_outcomes(detection))
    return Chunk(pulse, paths, with_nan_outcomes(without_pulses(detection, goes_on)), goes_on, leaks)


def without_lanes(part: Chunk, dropped: Numbers) -> Chunk:
    """Return a chunk in which these lanes, (n,) bool, count as without a surface, as in `drop_continuing`."""
    goes_on = transfer.unsigned_numbers(dropped) != 0
    return dataclasses.replace(part, detection=without_pulses(part.detection, goes_on), goes_on=goes_on)


def detection_values(parts: Sequence[Chunk], name: str) -> Numbers:
    """Field ``name`` of the detections, (n,) for the lanes of the first part; later parts replace it."""
    # A later part is the full trace of pulses that the first part only surveyed, so its values replace those.
    values: Numbers = getattr(parts[0].detection, name).numpy()
    if len(parts) > 1:
        values = values.copy()
    for part in parts[1:]:
        if part.retraced is not None:
            lanes = part.retraced.lanes.numpy()
            is_lane = lanes != NO_LANE
            values[lanes[is_lane]] = getattr(part.detection, name).numpy()[is_lane]
    return values


def join_columns(parts: Sequence[Mapping[str, Numbers]]) -> dict[str, Numbers]:
    """Concatenate the columns of several parts and sort the rows by pulse."""
    filled = [part for part in parts if part]
    if not filled:
        return {}
    # Stable: returns of one pulse keep their order.
    order = np.argsort(np.concatenate([part["pulse"] for part in filled]), kind="stable")
    return {name: np.concatenate([part[name] for part in filled])[order] for name in filled[0]}


@dataclass(frozen=True, slots=True, eq=False)
class OpticalChunk:
    """Pulses after the optical stages: before any detector.

    Attributes:
        pulse: (n,) pulse numbers
        rays: beams of the rays, rays of one pulse side by side
        paths: what the rays met, for each path
        light: what comes back along each path, aligned with ``paths``
        goes_on: mask of rays that continue through glass or mirrors, or None
        leaks: mask of rays whose light other channels notice, or None
    """

    pulse: Any
    rays: Beams
    paths: Sequence[Hits]
    light: Sequence[Echoes]
    goes_on: Any
    leaks: Any = None


def light_arrays(light: Echoes) -> list[Any]:
    """Device arrays of the echoes of rays, which `light.pulse_train.join_echoes` joins by pulse."""
    arrays = [light.has_surface, light.range_m, light.peak_power_w, light.background_power_w, light.white_w_m2]
    arrays += [interference.peak_power_w for interference in light.interference]
    if light.fluctuation is not None:
        arrays += [light.fluctuation.variance, light.fluctuation.relative_power]
    return [array for array in arrays if is_drjit(array)]


def truth_arrays(hits: Hits) -> list[Any]:
    """Device arrays of hits that the truth columns of points need."""
    needed = [hits.range_m, hits.cos_incidence, hits.reflectivity, hits.cos_sun, hits.lit, hits.face]
    # Plain numbers are the same for all lanes (nothing moves, no glass): there is nothing to compute.
    optional = (hits.radial_velocity_m_s, hits.interactions, hits.mirrored)
    needed += [*(hits.normal or ()), *(hits.velocity_m_s or ())]
    return [*needed, *(values for values in optional if is_drjit(values))]


@dataclass(frozen=True, slots=True, eq=False)
class Placing:
    """Transform from the sensor's coordinates to those of the points, one for each frame.

    All points of a frame are placed from where the sensor stood at its start: a real sensor does not correct for its
    own motion either (`cloud.deskew` does).

    Attributes:
        numbers: rotation, nine numbers, row by row, and translation [m], three, on the device. Where the sensor moves
            those of each frame, one behind the other
        added_m: for each frame (3,) translation that NumPy adds in float64; None near the origin, where float32 is
            good to 0.1 mm
        frames: number of the first pulse, and pulses of each frame, on the device; None: the sensor does not move
    """

    numbers: Any
    added_m: tuple[Numbers | None, ...]
    frames: tuple[Any, Any] | None

    @classmethod
    def of_frames(cls, frames: Sequence[Frame], coordinates: str, pulses: int) -> Placing:
        """Build for frames that follow each other, of so many pulses each."""
        # Far from the origin, as in map coordinates, float32 would round points to metres. The device then computes
        # relative to the sensor, and NumPy adds the position in float64.
        goals = [frame.goal(coordinates) for frame in frames]
        near = [np.abs(goal.position_m).max() < LARGEST_FLOAT32_M for goal in goals]
        added_m = tuple(None if is_near else goal.position_m for goal, is_near in zip(goals, near, strict=True))
        rows = [
            np.append(goal.rotation.ravel(), goal.position_m if is_near else np.zeros(3))
            for goal, is_near in zip(goals, near, strict=True)
        ]
        if not frames[0].moves:
            return cls(transfer.opaque(plain_numbers(rows[0])), added_m, None)
        table = transfer.from_numpy(np.concatenate(rows))
        return cls(table, added_m, (transfer.opaque(frames[0].first_pulse), transfer.opaque(pulses)))

    def of_pulses(self, pulse: Lanes) -> tuple[tuple[Lanes, ...], tuple[Lanes, Lanes, Lanes]]:
        """Rotation and translation of the frame of each of (n,) pulses."""
        numbers = self.numbers
        if self.frames is not None:
            ops, (first, pulses) = xp(pulse), self.frames
            row = ops.divmod(ops.int32(pulse) - first, pulses)[0] * (_NUMBERS // 4)
            numbers = tuple(x for four in range(_NUMBERS // 4) for x in ops.take_four(self.numbers, row + four))
        x, y, z = numbers[9:]
        return numbers[:9], (x, y, z)


_NUMBERS = 12  # rotation and translation


def plain_numbers(values: Numbers) -> tuple[Any, ...]:
    """Python floats of an array, row by row."""
    return tuple(float(x) for x in values.ravel())
