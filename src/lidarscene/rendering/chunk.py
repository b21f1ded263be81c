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
from ..kernel.rays.point_columns import LARGEST_FLOAT32_M, PulsePlaces, Staged, with_nan_outcomes
from ..light.beams import Beams
from ..light.echoes import Echoes
from ..light.hits import Hits
from ..maths.arrays import Array, Mask, Numbers, flatten, is_drjit, xp
from ..maths.pose import Pose
from ..scan.clock import PulseClock
from .frame import Frame
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
    detection = without_pulses(part.detection, goes_on)
    # The kernel that reads these would otherwise compute them in an order that is another in the second frame.
    transfer.start([goes_on, detection.outcome, *(stop.reported for stop in detection.stops)])
    return dataclasses.replace(part, detection=detection, goes_on=goes_on)


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
    arrays: list[Any] = [light.has_surface, light.range_m, light.peak_power_w, light.background_power_w]
    arrays += [light.white_w_m2, *(interference.peak_power_w for interference in light.interference)]
    if light.fluctuation is not None:
        arrays += [light.fluctuation.variance, light.fluctuation.relative_power]
    arrays += [light.broadening, light.row_slope]
    return [array for array in arrays if is_drjit(array)]


def truth_arrays(hits: Hits) -> list[Any]:
    """Device arrays of hits that the truth columns of points need."""
    needed = [hits.range_m, hits.cos_incidence, hits.reflectivity, hits.cos_sun, hits.lit, hits.face]
    # Plain numbers are the same for all lanes (nothing moves, no glass): there is nothing to compute.
    optional = (hits.radial_velocity_m_s, hits.interactions, hits.mirrored)
    needed += [*(hits.normal or ()), *(hits.velocity_m_s or ())]
    return [*needed, *(values for values in optional if is_drjit(values))]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Placing:
    """Places, times and bodies of the points of several frames that follow each other, on the device.

    All points of a frame are placed from where the sensor stood at its start: a real sensor does not correct for its
    own motion either (`cloud.deskew` does).

    Attributes:
        first: number of the first pulse
        pulses: pulses of each frame
        numbers: rotation, nine numbers, row by row, and translation [m], three. Where the sensor moves those of each
            frame, one behind the other
        moves: whether it does
        added_m: translation of each frame, three numbers, that is added in double precision; None: `is_far` of none
        clock: the scanner's
        before: `Frame.before`
        starts_s: start of each frame by the scanner's clock
        bodies: `Frame.bodies` of each frame; None: each body is itself
        body_count: entries of it for each frame
        rings: ring of each channel; None: rings are channels
    """

    first: Any
    pulses: Any
    numbers: Any
    moves: bool
    added_m: Any
    clock: PulseClock
    before: Any
    starts_s: Any
    bodies: Any
    body_count: Any
    rings: Array | None

    @classmethod
    def of_frames(
        cls, frames: Sequence[Frame], coordinates: str, pulses: int, *, clock: PulseClock, rings: Array | None
    ) -> Placing:
        """Build for frames of so many pulses each that are all far, or all near."""
        # Far from the origin, as in map coordinates, float32 would round points to metres. Points are then computed
        # relative to the sensor, and its position is added in float64.
        goals = [frame.goal(coordinates) for frame in frames]
        positions_m = np.stack([goal.position_m for goal in goals])
        far = is_far(goals[0])
        near_m = np.zeros_like(positions_m) if far else positions_m
        rows = np.concatenate([np.stack([goal.rotation.ravel() for goal in goals]), near_m], axis=1)
        moves, bodies = frames[0].moves, [frame.bodies for frame in frames if frame.bodies is not None]
        return cls(
            first=transfer.opaque(frames[0].first_pulse),
            pulses=transfer.opaque(pulses),
            numbers=transfer.from_numpy(rows.ravel()) if moves else transfer.opaque(plain_numbers(rows[0])),
            moves=moves,
            added_m=transfer.opaque(positions_m.ravel(), double=True) if far else None,
            clock=clock,
            before=transfer.opaque(frames[0].before, double=True),
            starts_s=transfer.opaque(np.array([frame.scanner_s for frame in frames]), double=True),
            bodies=transfer.whole_numbers(np.concatenate(bodies)) if bodies else None,
            body_count=transfer.opaque(len(bodies[0])) if bodies else None,
            rings=rings,
        )

    def of_pulses(self, pulse: Array) -> PulsePlaces:
        """What the points of (n,) pulses get."""
        ops = xp(pulse)
        row = ops.divmod(ops.int32(pulse) - self.first, self.pulses)[0]
        numbers = self.numbers
        if self.moves:
            fours = range(_NUMBERS // 4)
            numbers = tuple(x for four in fours for x in ops.take_four(self.numbers, row * (_NUMBERS // 4) + four))
        x, y, z = numbers[9:]
        added_m = None if self.added_m is None else [ops.take(self.added_m, row * 3 + axis) for axis in range(3)]
        return PulsePlaces(
            turn=numbers[:9],
            shift=(x, y, z),
            added_m=None if added_m is None else tuple(added_m),
            time_s=self.clock.time_s(pulse, earlier=self.before) - ops.take(self.starts_s, row),
            bodies=self.bodies,
            first_body=0 if self.bodies is None else row * self.body_count,
            rings=self.rings,
        )


_NUMBERS = 12  # rotation and translation


def is_far(goal: Pose) -> bool:
    """Whether points at the sensor's place in their coordinates need double precision."""
    return bool(np.abs(goal.position_m).max() >= LARGEST_FLOAT32_M)


def plain_numbers(values: Numbers) -> tuple[Any, ...]:
    """Python floats of an array, row by row."""
    return tuple(float(x) for x in values.ravel())
