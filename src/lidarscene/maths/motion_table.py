"""Motion during a frame: trajectories as tables on the device, looked up at each pulse's own time.

A frame is a sweep in time, so every pulse has its own pose of the sensor and of each moving body. Rebuilding the
scene for each pulse would be far too slow; instead rays start where the sensor is when they leave, and are
transformed into the frame of each moving body at that moment (ARCHITECTURE.md, "Motion belongs to time").

Symbols: p point, o origin, v velocity [m/s], w angular velocity [rad/s].
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from .arrays import Lanes, Numbers, xp
from .box_tree import BoxTree
from .pose import Pose, rotation_numbers
from .rotations import quaternions
from .trajectory import Motion, States, fastest_turn_rad_s, held_ends, held_from_m_s, rows_by, states_of
from .vectors import Vector

STEP_S = 5e-3
"""Accuracy bought: longest step of the tables. Cubic curves that meet places and velocities at the instants are off by
h^4 / 384 of the fourth derivative: 7 pm on an arc at 30 m/s and 30 degrees/s. A jump of the acceleration by a is off by
up to a h^2 / 62, 4 um at 10 m/s2, and one of the speed by v by up to 4/27 v h, within that step. Velocities are on
straight lines between the instants: off by 0.03 mm/s on that arc."""

FASTEST_TURN_RAD_S = 8.0
"""Choice: rate of turn of a motion, anywhere on it, up to which steps are `STEP_S` long: the velocity of what turns so
fast is off by 0.02 %, its place 1 m from the axis by 7 nm. People turn more slowly, and vehicles much more."""

FINE_STEP_S = 5e-4
"""Accuracy bought: longest step where something turns faster, or where nobody knows how fast, such as a motion that
jumps from pose to pose: the velocity of an antenna that turns ten times a second is off by 0.012 %, its place 1 m from
the axis by 2.5 nm."""

FASTEST_HELD_M_S = 2.7
"""Choice: speed at which a motion may end, to be held there, in steps of `STEP_S`: it is off by 2 mm then. People walk
more slowly; what drives ends in steps of `FINE_STEP_S`, off by 2 mm at 30 m/s."""

NOWHERE = ((math.inf,) * 3, (-math.inf,) * 3)
"""Lowest and highest corner of a box that nothing is in, and that no ray passes."""

_TOGETHER = 32768
"""Accuracy bought: instants of motions that are computed together, of up to 1 kB each. By 4096, which a processor's
cache holds, the tables of `town` take 0.1 longer, since the ground below its walkers is asked more often."""

# Place, quaternion, velocity, angular velocity, phase and level of a stride, padding: four neighbours are one load.
_NUMBERS = 16


class Strides(Protocol):
    """Place of a walker in its stride over time (`scene.walking`)."""

    def __call__(self, time_s: Numbers, states: States | None = None) -> Numbers:
        """(n, 2) phase and level at (n,) times; ``states`` of its motion then, where they are known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StridePlace:
    """Place in the stride of a walker, for each of n rays; numpy or Dr.Jit.

    Attributes:
        phase: counted in strides
        level: how much of the stride it shows
        rate_hz: of the phase
        level_rate_hz: of the level
    """

    phase: Lanes
    level: Lanes
    rate_hz: Lanes
    level_rate_hz: Lanes


@dataclass(frozen=True, slots=True, kw_only=True)
class Placement:
    """Pose and velocity of a frame in the traced frame, for each of n rays or for all; numpy or Dr.Jit.

    Attributes:
        origin_m: (x, y, z) of its origin
        rotation: nine numbers, row by row: frame to traced frame
        velocity_m_s: (x, y, z) of its origin, or None: it does not move
        turning_rad_s: (x, y, z) angular velocity, or None
        stride: place in its stride, of a walker; None where nothing says it
    """

    origin_m: Vector
    rotation: tuple[Lanes, ...]
    velocity_m_s: Vector | None = None
    turning_rad_s: Vector | None = None
    stride: StridePlace | None = None

    @classmethod
    def of_pose(cls, pose: Pose) -> Placement:
        """Placement that a pose is, for all rays."""
        x, y, z = pose.position_m.tolist()
        return cls(origin_m=(x, y, z), rotation=tuple(pose.rotation.ravel().tolist()))

    def point(self, p: Vector) -> Vector:
        """A point of this frame, in coordinates of the traced frame."""
        x, y, z = (o + moved for o, moved in zip(self.origin_m, self.vector(p), strict=True))
        return x, y, z

    def vector(self, v: Vector) -> Vector:
        """A direction of this frame, in coordinates of the traced frame."""
        r = self.rotation
        x, y, z = (r[3 * i] * v[0] + r[3 * i + 1] * v[1] + r[3 * i + 2] * v[2] for i in range(3))
        return x, y, z

    def point_within(self, p: Vector) -> Vector:
        """A point of the traced frame, in coordinates of this frame."""
        x, y, z = (a - o for a, o in zip(p, self.origin_m, strict=True))
        return self.vector_within((x, y, z))

    def vector_within(self, v: Vector) -> Vector:
        """A direction of the traced frame, in coordinates of this frame."""
        r = self.rotation
        x, y, z = (r[i] * v[0] + r[3 + i] * v[1] + r[6 + i] * v[2] for i in range(3))
        return x, y, z

    def faster_by(self, v: Vector) -> Placement:
        """The same with a velocity [m/s] of this frame on top."""
        if self.velocity_m_s is None:
            return self
        x, y, z = (own + added for own, added in zip(self.velocity_m_s, self.vector(v), strict=True))
        return replace(self, velocity_m_s=(x, y, z))

    def velocity_at(self, p: Vector) -> Vector:
        """Velocity [m/s], v + w x (p - o), of a point that is fixed in this frame; p in the traced frame."""
        if self.velocity_m_s is None or self.turning_rad_s is None:
            return 0.0, 0.0, 0.0
        (vx, vy, vz), (wx, wy, wz) = self.velocity_m_s, self.turning_rad_s
        x, y, z = (a - o for a, o in zip(p, self.origin_m, strict=True))
        return vx + wy * z - wz * y, vy + wz * x - wx * z, vz + wx * y - wy * x


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Travel:
    """Motions of one frame.

    Attributes:
        motions: of the sensor, and of what moves
        start_s: time at which the frame begins
        length_s: its length
        centre_m: (3,) origin of the traced frame in the world
        carried_m: (m, 2, 3) lowest and highest corner of what each of the last m motions carries, in its frame;
            infinite where it carries nothing, whose box in the traced frame is `NOWHERE`
        walks: of the last motions, those of walkers
    """

    motions: Sequence[Motion]
    start_s: float
    length_s: float
    centre_m: Numbers
    carried_m: Numbers | None = None
    walks: Sequence[Strides | None] = ()


def _instants(frames: Sequence[Travel]) -> list[Numbers]:
    """Times (n,) of the table of each frame."""
    # What a motion says of all its time it is asked once, however many frames show it.
    facts = {
        motion: (motion.is_straight, fastest_turn_rad_s(motion), held_ends(motion))
        for motion in dict.fromkeys(motion for frame in frames for motion in frame.motions)
    }
    times = []
    for frame in frames:
        straight, turns, ends = zip(*(facts[motion] for motion in frame.motions), strict=True)
        held = held_from_m_s(itertools.chain.from_iterable(ends), frame.start_s, frame.start_s + frame.length_s)
        step_s = STEP_S if max(turns) <= FASTEST_TURN_RAD_S and held <= FASTEST_HELD_M_S else FINE_STEP_S
        # What goes straight on and never turns is exact between two instants.
        steps = 1 if all(straight) else max(math.ceil(frame.length_s / step_s), 1)
        times.append(frame.start_s + np.linspace(0.0, frame.length_s, steps + 1))
    return times


def _rows_together(frames: Sequence[Travel], times: Sequence[Numbers]) -> Numbers:
    """Rows of `MotionTable` of all motions of several frames, frame after frame, (motions, instants, 16).

    NumPy takes as long for a walker's strides, or the path of a ride, in one frame as in ten.

    Args:
        times: instants of each frame, as many each
    """
    instants = np.stack(times)
    # Each motion once, at the instants of all frames that have it: what a vehicle carries rides on it, and what a frame
    # does not show rests.
    frames_of: dict[Motion, list[int]] = {}
    for number, frame in enumerate(frames):
        for motion in dict.fromkeys(frame.motions):
            frames_of.setdefault(motion, []).append(number)
    parts: list[States] = []
    row_of: dict[tuple[Motion, int], int] = {}
    every = list(frames_of)
    for numbers, places in rows_by(list(map(tuple, frames_of.values()))).items():
        motions = [every[place] for place in places]
        row_of |= {each: len(row_of) + row for row, each in enumerate(itertools.product(motions, numbers))}
        times_s = instants[list(numbers)].ravel()
        many = max(_TOGETHER // len(times_s), 1)
        for first in range(0, len(motions), many):
            part = motions[first : first + many]
            states = states_of(part, np.broadcast_to(times_s, (len(part), len(times_s))))
            parts.append(states.regrouped(len(part) * len(numbers), instants.shape[1]))
    states = States.joined(parts)
    rows = [row_of[motion, number] for number, frame in enumerate(frames) for motion in frame.motions]
    numbers_of = np.repeat(np.arange(len(frames)), [len(frame.motions) for frame in frames])
    table = np.zeros((len(row_of), instants.shape[1], _NUMBERS))
    table[:, :, :3] = states.position_m
    table[:, :, 3:7] = _with_continuous_signs(quaternions(states.rotation))
    table[:, :, 7:10], table[:, :, 10:13] = states.velocity_m_s, states.turning_rad_s
    table = table[rows]
    table[:, :, :3] -= np.stack([frame.centre_m for frame in frames])[numbers_of, None]
    walks: list[Strides | None] = []
    for frame in frames:
        walks += [None] * (len(frame.motions) - len(frame.walks)) + [*frame.walks]
    for walk, walkers in rows_by(walks).items():
        if walk is not None:
            own_states = [states.taken(rows[walker]) for walker in walkers]
            strides = walk(instants[numbers_of[walkers]].ravel(), States.joined(own_states))
            table[walkers, :, 13:15] = strides.reshape(len(walkers), -1, 2)
            table[walkers, :, 13] -= np.floor(table[walkers, :1, 13])  # small, for single precision
    return table


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionTable:
    """Several motions over one frame, on an even grid of times; or over several frames (`joined`).

    Attributes:
        table: (motions, instants, 16), flat: place, quaternion (w, x, y, z), velocity, angular velocity, phase and
            level of a stride, padding
        rate_hz: instants per second
        last: number of the last instant
        count: of motions in a frame
        boxes: tree of m boxes along the axes of the traced frame [m], which hold all that the last m motions carry, all
            the time; None without any
        first: number of the frame's first motion, (n,) where each of n rays has its own frame
    """

    table: Lanes
    rate_hz: Lanes
    last: Lanes
    count: Lanes
    boxes: BoxTree | None = None
    first: Lanes = 0

    @classmethod
    def from_motions(cls, motions: Sequence[Motion], **travel: Any) -> MotionTable:
        """Tabulate the motions of one frame.

        Args:
            motions: those of `Travel`
            travel: the other fields of `Travel`
        """
        return cls.of_frames([Travel(motions=motions, **travel)])[0]

    @classmethod
    def of_frames(cls, frames: Sequence[Travel]) -> list[MotionTable]:
        """Tabulate the motions of several frames, each table as if alone."""
        tables = []
        planned = list(zip(frames, _instants(frames), strict=True))
        for instants, alike in itertools.groupby(planned, key=lambda plan: len(plan[1])):
            own, times = zip(*alike, strict=True)
            tables += cls._alike(own, _rows_together(own, times), steps=instants - 1)
        return tables

    @classmethod
    def _alike(cls, frames: Sequence[Travel], rows: Numbers, *, steps: int) -> list[MotionTable]:
        """Tables of frames with the same number of steps, from the rows of all."""
        boxes = _boxes_together(frames, rows, steps=steps)
        tables, end = [], 0
        for frame, own in zip(frames, boxes, strict=True):
            begin, end = end, end + len(frame.motions)
            tables.append(
                cls(
                    table=rows[begin:end].ravel(),
                    rate_hz=steps / frame.length_s,
                    last=float(steps),
                    count=end - begin,
                    boxes=None if own is None else BoxTree.from_boxes(own),
                )
            )
        return tables

    @classmethod
    def joined(cls, tables: Sequence[MotionTable]) -> MotionTable:
        """Join tables of which each `goes_with` the first."""
        boxes = [table.boxes for table in tables if table.boxes is not None]
        return replace(
            tables[0],
            table=np.concatenate([np.asarray(table.table) for table in tables]),
            boxes=BoxTree.joined(boxes) if boxes else None,
        )

    def at_start(self) -> tuple[Numbers, Numbers]:
        """(motions, 3) places in the traced frame and (motions, 3, 3) rotations, as the first frame begins; NumPy."""
        instants, table = int(np.asarray(self.last)) + 1, np.asarray(self.table)
        numbers = table.reshape(-1, instants, _NUMBERS)[: int(np.asarray(self.count)), 0, :7].T
        return numbers[:3].T, np.stack(rotation_numbers(*numbers[3:]), axis=-1).reshape(-1, 3, 3)

    def goes_with(self, other: MotionTable) -> bool:
        """Whether it has as many motions and instants as another one, of the same rate in single precision."""
        same = self.count == other.count and self.last == other.last
        return bool(same and np.float32(self.rate_hz) == np.float32(other.rate_hz))

    def of_frame(self, number: Lanes) -> MotionTable:
        """Return the table of which each of n rays has the frame of this number, (n,) counted from the first."""
        boxes = None if self.boxes is None else self.boxes.of_tree(number)
        return replace(self, first=number * self.count, boxes=boxes)

    def placement(self, time_s: Lanes, motion_index: Lanes) -> Placement:
        """Placement of motion number ``motion_index`` at (n,) seconds after the start; clipped to the table's ends.

        Args:
            motion_index: one number for all rays, or (n,) of them
        """
        ops = xp(time_s)
        place = ops.minimum(ops.maximum(time_s * self.rate_hz, 0.0), self.last)
        lower = ops.minimum(ops.floor(place), self.last - 1.0)
        share = place - lower
        # Rows of a motion follow each other, motion after motion; the row before this time, in fours.
        first = (ops.int32(lower) + (self.first + motion_index) * (ops.int32(self.last) + 1)) * (_NUMBERS // 4)

        def row(first: Lanes) -> list[Lanes]:
            return [number for four in range(_NUMBERS // 4) for number in ops.take_four(self.table, first + four)]

        before, after, step_s = row(first), row(first + _NUMBERS // 4), 1.0 / self.rate_hz
        vx, vy, vz, wx, wy, wz, phase, level = _straight(before[7:15], after[7:15], share)
        x, y, z = cubic(before[:3], after[:3], before[7:10], after[7:10], share, step_s)
        q0, q1 = before[3:7], after[3:7]
        # A mix of two unit quaternions is not one; normalised, it is a rotation again.
        qw, qx, qy, qz = cubic(q0, q1, _turning(q0, before[10:13]), _turning(q1, after[10:13]), share, step_s)
        length = ops.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
        rate_hz, level_rate_hz = (
            (end - start) * self.rate_hz for start, end in zip(before[13:15], after[13:15], strict=True)
        )
        return Placement(
            origin_m=(x, y, z),
            rotation=rotation_numbers(qw / length, qx / length, qy / length, qz / length),
            velocity_m_s=(vx, vy, vz),
            turning_rad_s=(wx, wy, wz),
            stride=StridePlace(phase=phase, level=level, rate_hz=rate_hz, level_rate_hz=level_rate_hz),
        )


def _straight(before: Sequence[Lanes], after: Sequence[Lanes], share: Lanes) -> list[Lanes]:
    """Return numbers on straight lines between two instants, at a share of the step."""
    return [start + share * (end - start) for start, end in zip(before, after, strict=True)]


def cubic(
    before: Sequence[Lanes],
    after: Sequence[Lanes],
    rate_before: Sequence[Lanes],
    rate_after: Sequence[Lanes],
    share: Lanes,
    step_s: Lanes,
) -> list[Lanes]:
    """Numbers on cubic curves between two instants, whose values and rates [1/s] there they meet (Hermite).

    Args:
        before: values at the instant before
        after: values at the instant after
        rate_before: their rates at the instant before
        rate_after: their rates at the instant after
        share: of the step that has passed, 0 to 1
        step_s: time from the one instant to the other
    """
    # As a straight line and what bulges from it: single precision keeps what is small.
    rest = 1.0 - share
    bulge = share * rest
    return [
        start
        + share * (end - start)
        + bulge * (rest * (step_s * u - (end - start)) - share * (step_s * v - (end - start)))
        for start, end, u, v in zip(before, after, rate_before, rate_after, strict=True)
    ]


def _turning(quaternion: Sequence[Lanes], turning_rad_s: Sequence[Lanes]) -> tuple[Lanes, Lanes, Lanes, Lanes]:
    """Rates [1/s] of a quaternion, (0, w) q / 2, of a frame that turns with w in its parent's axes."""
    w, x, y, z = quaternion
    a, b, c = (0.5 * rate for rate in turning_rad_s)
    return -a * x - b * y - c * z, a * w + b * z - c * y, b * w + c * x - a * z, c * w + a * y - b * x


@dataclass(frozen=True, slots=True, kw_only=True)
class MovingBodies:
    """Motions of several bodies, looked up at the times at which n rays leave.

    Attributes:
        motions: of the sensor (0) and of the bodies (1, ...), with the bodies' boxes
        time_s: (n,) when the rays leave, after the start of the table
    """

    motions: MotionTable
    time_s: Lanes

    def placement(self, body_index: Lanes) -> Placement:
        """Placement of a body; ``body_index`` counts from 0, one for all rays or (n,)."""
        return self.motions.placement(self.time_s, body_index + 1)


def _boxes_together(frames: Sequence[Travel], rows: Numbers, *, steps: int) -> list[Numbers | None]:
    """Boxes (m, 2, 3) of each of several frames, from the rows of all; None where nothing is carried."""
    carried_m = [np.zeros((0, 2, 3)) if frame.carried_m is None else frame.carried_m for frame in frames]
    counts = [len(own_m) for own_m in carried_m]
    ends = itertools.accumulate(len(frame.motions) for frame in frames)
    places = [place for end, count in zip(ends, counts, strict=True) for place in range(end - count, end)]
    step_s = np.repeat([frame.length_s / steps for frame in frames], counts)
    boxes = _swept_boxes(rows[places], np.concatenate(carried_m), step_s)
    return [own if len(own) else None for own in np.split(boxes, np.cumsum(counts)[:-1])]


def _swept_boxes(table: Numbers, carried_m: Numbers, step_s: Numbers) -> Numbers:
    """Return (m, 2, 3) boxes which hold what m motions carry, at all times.

    Args:
        table: (m, instants, 16) rows of `MotionTable`
        carried_m: as in `Travel`
        step_s: (m,) time between instants
    """
    carries = np.asarray(np.isfinite(carried_m).all(axis=(1, 2)))
    boxes = np.broadcast_to(NOWHERE, carried_m.shape).copy()
    if not carries.any():
        return boxes
    carried_m = carried_m[carries]
    # Numbers first: NumPy is slow along axes of three.
    numbers = np.moveaxis(table[carries, :, :13], -1, 0).copy()
    quaternion = numbers[3:7]
    rotation = np.stack(rotation_numbers(*quaternion)).reshape(3, 3, *numbers.shape[1:])
    centre, half = carried_m.mean(axis=1), np.ptp(carried_m, axis=1) / 2.0
    # A turned box reaches |R| times its half widths along the axes of the traced frame.
    middle, reach = numbers[:3] + _turned(rotation, centre), _turned(np.abs(rotation), half)
    low, high = (middle - reach).min(axis=2).T, (middle + reach).max(axis=2).T
    # A corner at r from the origin of its frame leaves the straight line between two instants by less than r times the
    # change of the rotation, twice as much where the quaternion's curve bulges, and as much as the origin's curve
    # bulges. The rest is for single precision: some ten roundings of a coordinate.
    corner_m = np.linalg.norm(np.abs(carried_m).max(axis=1), axis=1)
    a, b, c, d, e, f, g, h, i = np.square(np.diff(rotation, axis=3)).reshape(9, len(carried_m), -1)
    turned = np.sqrt((((a + b) + (c + d)) + ((e + f) + (g + h)) + i).max(axis=1))
    bulge_m = _bulge(numbers[:3], numbers[7:10], step_s[carries]).T
    rates = np.array(_turning([*quaternion], [*numbers[10:13]]))
    twist = np.linalg.norm(_bulge(quaternion, rates, step_s[carries]), axis=0)
    room = corner_m * (turned + 4.0 * twist) + 1e-4 + 2e-6 * np.abs([low, high]).max(axis=(0, 2))
    room = room[:, None] + bulge_m
    boxes[carries] = np.stack([low - room, high + room], axis=1)
    return boxes


def _bulge(values: Numbers, rates: Numbers, step_s: Numbers) -> Numbers:
    """Bound by which `cubic` leaves straight lines, (k, m), of (k, m, instants) values and rates [1/s], (m,) steps."""
    straight, step_s = np.diff(values, axis=2), step_s[:, None]
    apart = np.abs(step_s * rates[..., :-1] - straight) + np.abs(step_s * rates[..., 1:] - straight)
    return np.asarray(4.0 / 27.0 * apart.max(axis=2))


def _turned(matrix: Numbers, vector: Numbers) -> Numbers:
    """Return (3, 3, m, instants) matrices times (m, 3) vectors, (3, m, instants)."""
    x, y, z = vector.T[:, :, None]
    return np.asarray(matrix[:, 0] * x + matrix[:, 2] * z + matrix[:, 1] * y)


def _with_continuous_signs(quaternion: Numbers) -> Numbers:
    """Choose signs of (m, instants, 4) quaternions so that neighbours are close: q and -q are one rotation."""
    opposite = (quaternion[:, 1:] * quaternion[:, :-1]).sum(axis=2) < 0.0
    if not opposite.any():
        return quaternion
    flips = np.ones(quaternion.shape[:2])
    flips[:, 1:] = np.cumprod(np.where(opposite, -1.0, 1.0), axis=1)
    return np.asarray(quaternion * flips[:, :, None])
