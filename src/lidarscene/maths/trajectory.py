"""Trajectories: pose and velocity of a rigid frame at any time. Plain numpy in double precision.

Vehicles and bodies move on arcs or through given poses; sensors are fixed to vehicles. Each is
a `Motion`. The parent of a vehicle or body is the world.

Symbols: T pose in SE(3), x twist (velocity and angular velocity), u time within a segment from 0 to 1, h its length.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Any, Protocol, TypeVar

import numpy as np

from .arrays import Numbers, frozen
from .pose import Pose, is_near
from .units import Quantity

SMALL_ANGLE_RAD = 1e-4
"""Accuracy bought: below it the series of sin(x)/x and similar functions, cut after x^2, are good to 1e-17."""

CLOCK_ROUNDING_S = 1e-6
"""Accuracy bought: times this close are one: those of a clock that began in 1970 have steps of 0.24 us."""

LARGEST_STEP_RAD = math.radians(170.0)
"""Choice: largest turn between two poses of a spline: at 180 degrees the direction of the turn is not defined."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class States:
    """States of a frame at n instants.

    Attributes:
        position_m: (n, 3) of its origin
        rotation: (n, 3, 3) frame to parent
        velocity_m_s: (n, 3) of its origin, in the parent's axes
        turning_rad_s: (n, 3) angular velocity, in the parent's axes
    """

    position_m: Numbers
    rotation: Numbers
    velocity_m_s: Numbers
    turning_rad_s: Numbers

    def taken(self, index: int | slice | Sequence[int] | Numbers) -> States:
        """The states of one motion, or of several, of those that were computed together: (m, n, ...) arrays."""
        return States(**{name: getattr(self, name)[index] for name in _STATE_NAMES})

    @classmethod
    def joined(cls, parts: Sequence[States]) -> States:
        """States of several groups of motions, one after the other."""
        return cls(**{name: np.concatenate([getattr(each, name) for each in parts]) for name in _STATE_NAMES})

    def regrouped(self, motions: int, instants: int) -> States:
        """The same states, of m n instants in all, as those of m motions at n instants each: (m, n, ...) arrays."""
        entries = {"rotation": (3, 3)}
        return States(
            **{name: getattr(self, name).reshape(motions, instants, *entries.get(name, (3,))) for name in _STATE_NAMES}
        )

    def pose(self, index: int = 0) -> Pose:
        """The pose at one instant."""
        return Pose(position_m=self.position_m[index], rotation=self.rotation[index])


_STATE_NAMES = tuple(state.name for state in fields(States))


class Motion(Protocol):
    """A frame's states over time."""

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time at which the motion is defined."""

    @property
    def is_straight(self) -> bool:
        """True if the velocity is constant and the frame never turns."""

    def at(self, time_s: Numbers) -> States:
        """States at (n,) times [s] in the span; beyond it, those at its end.

        Velocities are the derivatives of the poses: places between the instants of a table follow from both.
        """


def pose_at(motion: Motion, time_s: float = 0.0) -> Pose:
    """Pose of a motion at a time, or at the nearest end of its span."""
    return poses_over(motion, np.array([time_s]))[0]


def poses_over(motion: Motion, time_s: Numbers) -> list[Pose]:
    """Poses of a motion at (n,) times, as `pose_at` bit for bit."""
    # Each time as if alone: NumPy rounds a product of one row of a matrix otherwise than that of many.
    states = states_of([motion] * len(time_s), clipped(time_s, motion)[:, None])
    return [states.taken(row).pose() for row in range(len(time_s))]


def clipped(time_s: Numbers, motion: Motion) -> Numbers:
    """Clip (n,) times to the span of a motion; `numpy.clip` takes three times as long for some fifty."""
    first_s, last_s = motion.span_s
    return np.minimum(np.maximum(time_s, first_s), last_s)


def poses_at(motions: Sequence[Motion | None], time_s: float) -> list[Pose | None]:
    """Poses of several motions at a time, as `pose_at`; None for None."""
    moving = [motion for motion in motions if motion is not None]
    if not moving:
        return [None] * len(motions)
    spans = np.array([motion.span_s for motion in moving])
    states = states_of(moving, np.clip(time_s, spans[:, :1], spans[:, 1:]))
    poses = iter([states.taken(row).pose() for row in range(len(moving))])
    return [None if motion is None else next(poses) for motion in motions]


LARGEST_SPEED_M_S = 1e4
"""Choice: largest speed in each direction: faster than anything on a road."""

LARGEST_YAW_RATE_DEG_S = 36_000.0
"""Choice: largest rate of turn, a hundred turns a second: 18 degrees from one instant of the tables
(`motion_table.FINE_STEP_S`) to the next."""

ALWAYS = (-math.inf, math.inf)
"""Span of a motion without end."""


class OneOfKind(ABC):
    """A motion whose states `states_of` computes in one go with those of others of its kind."""

    __slots__ = ()

    @property
    @abstractmethod
    def span_s(self) -> tuple[float, float]:
        """First and last time at which the motion is defined."""

    @property
    def is_straight(self) -> bool:
        """False, unless a kind knows it: even equal steps between poses are not compared."""
        return False

    def at(self, time_s: Numbers) -> States:
        """States at (n,) times; beyond the span, those at its end."""
        return states_of([self], np.asarray(time_s, dtype=np.float64)[None]).taken(0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Course(OneOfKind):
    """Constant speed and yaw rate: an arc, or a straight line.

    Attributes:
        start: pose at the time ``since_s``
        speed_m_s: along the frame's own x axis, which turns with it
        yaw_rate_rad_s: about its own z axis, positive to the left
        velocity_m_s: (x, y, z), a constant velocity on top, in the parent's axes
    """

    start: Pose = field(default_factory=Pose)
    speed_m_s: Annotated[float, Quantity(ge=-LARGEST_SPEED_M_S, le=LARGEST_SPEED_M_S, about="along its own x axis")] = (
        0.0
    )
    yaw_rate_rad_s: Annotated[
        float,
        Quantity(
            "deg_s",
            ge=-LARGEST_YAW_RATE_DEG_S,
            le=LARGEST_YAW_RATE_DEG_S,
            about="about its own z axis, positive to the left",
        ),
    ] = 0.0
    velocity_m_s: Annotated[
        tuple[float, float, float],
        Quantity(ge=-LARGEST_SPEED_M_S, le=LARGEST_SPEED_M_S, about="added to it, in the axes of the world"),
    ] = (0.0, 0.0, 0.0)
    since_s: float = 0.0

    @property
    def span_s(self) -> tuple[float, float]:
        """Unbounded: defined at every time."""
        return ALWAYS

    @property
    def is_straight(self) -> bool:
        """True without a yaw rate."""
        return self.yaw_rate_rad_s == 0.0

    @property
    def fastest_turn_rad_s(self) -> float:
        """The yaw rate, without its sign."""
        return abs(self.yaw_rate_rad_s)

    @property
    def rests(self) -> bool:
        """True if the frame never moves."""
        return not any((self.speed_m_s, self.yaw_rate_rad_s, *self.velocity_m_s))

    @staticmethod
    def together(motions: Sequence[Course], time_s: Numbers) -> States:
        """States of m courses at their own (m, n) times, as `at` of each.

        x = (v / w) sin(w t), y = (v / w) (1 - cos(w t)) in the frame of the start.
        """
        speed, yaw_rate, since = (
            np.array([[getattr(motion, name)] for motion in motions], dtype=np.float64)
            for name in ("speed_m_s", "yaw_rate_rad_s", "since_s")
        )
        added = np.array([[motion.velocity_m_s] for motion in motions], dtype=np.float64)
        fixed = np.stack([motion.start.rotation for motion in motions])
        start_m = np.stack([motion.start.position_m for motion in motions])[:, None]
        time_s = time_s - since
        yaw = yaw_rate * time_s
        cos, sin = np.cos(yaw), np.sin(yaw)
        # sin(x)/x and (1 - cos(x))/x = sin(x/2) sinc(x/2): no division by the yaw rate, exact at 0.
        ahead = time_s * np.sinc(yaw / np.pi)
        aside = time_s * np.sin(yaw / 2.0) * np.sinc(yaw / (2.0 * np.pi))
        turn, way = np.zeros((*yaw.shape, 3, 3)), np.zeros((*yaw.shape, 3))
        turn[..., 0, 0], turn[..., 0, 1], turn[..., 1, 0], turn[..., 1, 1], turn[..., 2, 2] = cos, -sin, sin, cos, 1.0
        way[..., 0], way[..., 1] = speed * ahead, speed * aside
        heading, across = turn[..., 0], fixed.transpose(0, 2, 1)
        return States(
            position_m=start_m + way @ across + time_s[..., None] * added,
            rotation=fixed[:, None] @ turn,
            velocity_m_s=speed[..., None] * heading @ across + added,
            turning_rad_s=np.broadcast_to((yaw_rate * fixed[:, :, 2])[:, None], way.shape),
        )


class _Carried(OneOfKind):
    """A motion that follows from another one, its carrier.

    `states_of` computes the carriers of all motions first, and so those of one kind in one go, whatever they carry.
    """

    __slots__ = ()

    @abstractmethod
    def carrier_at(self, time_s: Numbers) -> tuple[Motion, Numbers]:
        """The carrier, and its (n,) times at these times."""

    @staticmethod
    @abstractmethod
    def carried(motions: Sequence[Any], states: States, time_s: Numbers) -> States:
        """States of m motions of this kind at their own (m, n) times, from those of their carriers."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Riding(_Carried):
    """A frame that is fixed in a moving one: a sensor on a vehicle."""

    carrier: Motion
    pose: Pose

    @property
    def span_s(self) -> tuple[float, float]:
        """The carrier's span."""
        return self.carrier.span_s

    @property
    def is_straight(self) -> bool:
        """True if the carrier's motion is straight."""
        return self.carrier.is_straight

    @property
    def fastest_turn_rad_s(self) -> float:
        """The carrier's."""
        return fastest_turn_rad_s(self.carrier)

    def carrier_at(self, time_s: Numbers) -> tuple[Motion, Numbers]:
        """The carrier, at the same times."""
        return self.carrier, time_s

    @staticmethod
    def carried(motions: Sequence[Riding], states: States, time_s: Numbers) -> States:
        """States of m poses, each carried along: a point at r moves with v + w x r."""
        position_m = np.stack([motion.pose.position_m for motion in motions])
        arm = (states.rotation @ position_m[:, None, :, None])[..., 0]
        return States(
            position_m=states.position_m + arm,
            rotation=states.rotation @ np.stack([motion.pose.rotation for motion in motions])[:, None],
            velocity_m_s=states.velocity_m_s + cross(states.turning_rad_s, arm),
            turning_rad_s=states.turning_rad_s,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spline(OneOfKind):
    """A smooth motion through given poses: cubic on SE(3), with continuous velocities.

    Between two poses T_i and T_(i+1) with twists x_i and x_(i+1) in their own frames, over the time h,

        T(u) = T_i exp(b1 x_i h/3) exp(b2 y) exp(b3 x_(i+1) h/3),
        y = log(exp(-x_i h/3) T_i^-1 T_(i+1) exp(-x_(i+1) h/3)),

    with the cumulative Bernstein polynomials b1 = 1 - (1 - u)^3, b2 = 3 u^2 - 2 u^3, b3 = u^3 (Kim, Kim and Shin,
    SIGGRAPH 1995, for quaternions). The twist at a pose is the mean of the twists before and after it, each weighted
    by the other's duration, as for a cubic through points (Catmull and Rom). A constant twist, so an arc at constant
    speed, is exact.

    Attributes:
        time_s: (k,) rising, k >= 2
        poses: (k,) at these times
        smooth: whether the velocity is continuous; else it is constant from one pose to the next, in the body's frame
        closed: whether the velocity goes on from the last pose to the first, as on a loop
        fastest_turn_rad_s: bound of the rate of turn; infinite if the velocity jumps at poses
    """

    time_s: Numbers
    poses: tuple[Pose, ...]
    smooth: bool = True
    closed: bool = False
    fastest_turn_rad_s: float = field(init=False)
    _segments: _Segments = field(init=False)

    def __post_init__(self) -> None:
        """Check the times and compute the twists.

        Raises:
            ValueError: if a value is not allowed
        """
        object.__setattr__(self, "time_s", frozen(self.time_s, np.float64, (None,)))
        if len(self.time_s) != len(self.poses) or len(self.poses) < 2 or not (np.diff(self.time_s) > 0.0).all():
            raise ValueError("must be two poses or more, at rising times")
        segments = _Segments.through(self.time_s, self.poses, self.smooth, self.closed)
        # The twist in a segment is a mean of its three, with weights that add up to 3 / h.
        turns_rad_s = 3.0 * np.linalg.norm(segments.twists[:, 3:], axis=1).max(axis=0) / segments.length_s
        object.__setattr__(self, "_segments", segments)
        object.__setattr__(self, "fastest_turn_rad_s", float(turns_rad_s.max()) if self.smooth else math.inf)

    @property
    def span_s(self) -> tuple[float, float]:
        """Times of the first and of the last pose."""
        return float(self.time_s[0]), float(self.time_s[-1])

    @staticmethod
    def together(motions: Sequence[Spline], time_s: Numbers) -> States:
        """States of m splines at their own (m, n) times, as `at` of each."""
        segments = np.zeros(time_s.shape, dtype=np.int64)
        since_s, first = np.zeros(time_s.shape), 0
        rows = rows_by(motions)
        for motion, own in rows.items():
            times = clipped(time_s[own], motion)
            segment = np.clip(np.searchsorted(motion.time_s, times, side="right") - 1, 0, len(motion.poses) - 2)
            since_s[own], segments[own] = times - motion.time_s[segment], first + segment
            first += len(motion.poses) - 1
        # The segments of all splines are one list.
        joined = _Segments.joined([motion._segments for motion in rows])
        return joined.at(segments.ravel(), since_s.ravel()).regrouped(*time_s.shape)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _BeyondEnds(_Carried):
    """A motion extended beyond its span."""

    motion: Motion

    @property
    def span_s(self) -> tuple[float, float]:
        """Unbounded: defined at every time."""
        return ALWAYS

    @property
    def fastest_turn_rad_s(self) -> float:
        """The motion's."""
        return fastest_turn_rad_s(self.motion)

    def carrier_at(self, time_s: Numbers) -> tuple[Motion, Numbers]:
        """The motion, at times clipped to its span."""
        return self.motion, clipped(time_s, self.motion)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldAtEnds(_BeyondEnds):
    """A motion extended beyond its span: at rest in its first pose before, in its last pose after.

    Attributes:
        delay_s: time by which all of it is later
    """

    delay_s: float = 0.0

    def carrier_at(self, time_s: Numbers) -> tuple[Motion, Numbers]:
        """The motion, at times clipped to its span."""
        return _BeyondEnds.carrier_at(self, time_s - self.delay_s)

    @staticmethod
    def carried(motions: Sequence[HeldAtEnds], states: States, time_s: Numbers) -> States:
        """States of the motions, clipped to their spans; beyond them both velocities are zero."""
        time_s = time_s - np.array([[motion.delay_s] for motion in motions])
        moves = (_clipped_to_spans(motions, time_s) == time_s)[..., None]
        if moves.all():
            return states
        return replace(
            states,
            velocity_m_s=np.where(moves, states.velocity_m_s, 0.0),
            turning_rad_s=np.where(moves, states.turning_rad_s, 0.0),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GoingOn(_BeyondEnds):
    """A motion extended beyond its span: straight on, with its first velocity before and its last velocity after."""

    @staticmethod
    def carried(motions: Sequence[GoingOn], states: States, time_s: Numbers) -> States:
        """States of the motions; beyond their spans the velocity is that at the end, and they turn no more."""
        beyond_s = (time_s - _clipped_to_spans(motions, time_s))[..., None]
        return replace(
            states,
            position_m=states.position_m + beyond_s * states.velocity_m_s,
            turning_rad_s=np.where(beyond_s == 0.0, states.turning_rad_s, 0.0),
        )


_MOST_ROUNDS = 8
"""Choice: rounds of a motion that are kept: frames that follow each other are in one or two."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Repeated(_BeyondEnds):
    """A motion with an end that begins again there, over and over, and did so before its start.

    Where its last pose is not its first it jumps. No frame shows it on the way: `in_frame` waits for the next frame.
    """

    _jumps: list[bool] = field(init=False, default_factory=list)
    _rounds: dict[int, HeldAtEnds] = field(init=False, default_factory=dict)

    @property
    def jumps(self) -> bool:
        """True unless the last pose is the first."""
        if not self._jumps:
            # The path takes a tenth of the time. A vehicle on its springs is less than a metre from it, at both ends.
            path = getattr(self.motion, "path", self.motion)
            first, last = (pose_at(path, time_s).position_m for time_s in self.motion.span_s)
            ends = (pose_at(self.motion, time_s) for time_s in self.motion.span_s)
            self._jumps.append(float(np.linalg.norm(last - first)) > 2.0 or not is_near(*ends))
        return self._jumps[0]

    def in_frame(self, start_s: float) -> Motion:
        """Return the motion as a frame that begins at this time shows it: if it jumps, then after the frame.

        Frames of one round have the same one.
        """
        if not self.jumps:
            return self
        first_s, last_s = self.motion.span_s
        period_s = last_s - first_s
        number = math.floor((start_s - first_s) / period_s)
        if (held := self._rounds.get(number)) is not None:
            return held
        if len(self._rounds) >= _MOST_ROUNDS:
            self._rounds.clear()
        return self._rounds.setdefault(number, HeldAtEnds(motion=self.motion, delay_s=number * period_s))

    def carrier_at(self, time_s: Numbers) -> tuple[Motion, Numbers]:
        """The motion, at the times of the round that runs."""
        first_s, last_s = self.motion.span_s
        return self.motion, first_s + np.mod(time_s - first_s, last_s - first_s)

    @staticmethod
    def carried(motions: Sequence[Repeated], states: States, time_s: Numbers) -> States:
        """States of the rounds that run."""
        return states


def held_ends(motion: Motion) -> list[tuple[float, Motion, float]]:
    """Times at which a motion, or one that it follows, is held at an end; that one, and the end of its own span."""
    carried: Motion | None = motion
    ends, delay_s = [], 0.0
    while carried is not None:
        if isinstance(carried, HeldAtEnds):
            delay_s += carried.delay_s
            ends += [(delay_s + end_s, carried.motion, end_s) for end_s in carried.motion.span_s]
        carried = next((getattr(carried, name) for name in _CARRIERS if hasattr(carried, name)), None)
    return ends


def held_from_m_s(ends: Iterable[tuple[float, Motion, float]], first_s: float, last_s: float) -> float:
    """Largest speed [m/s] at those of the `held_ends` of motions that lie within these times."""
    within = (
        float(np.linalg.norm(motion.at(np.array([end_s])).velocity_m_s))
        for time_s, motion, end_s in ends
        if first_s - CLOCK_ROUNDING_S <= time_s <= last_s + CLOCK_ROUNDING_S
    )
    return max(within, default=0.0)


_CARRIERS = "motion", "carrier", "path"
"""Names of the attribute in which a motion has another one that it follows."""


def fastest_turn_rad_s(motion: Motion) -> float:
    """Bound of the rate of turn of a motion [rad/s]; infinite where the motion does not say it."""
    return float(getattr(motion, "fastest_turn_rad_s", math.inf))


def states_of(motions: Sequence[Motion], time_s: Numbers) -> States:
    """States of m motions at their own (m, n) times, with arrays (m, n, ...): those of `Motion.at`, bit for bit.

    A motion alone takes NumPy a hundred calls, a millisecond for a spline: those of one kind, with a function
    `together`, are computed in one go, and one that several others follow from, once.
    """
    keys = [(id(motion), times.tobytes()) for motion, times in zip(motions, time_s, strict=True)]
    number_of = {key: number for number, key in enumerate(dict.fromkeys(keys))}
    if len(number_of) < len(keys):
        first = [keys.index(key) for key in number_of]
        return states_of([motions[row] for row in first], time_s[first]).taken([number_of[key] for key in keys])
    carriers, carrier_times = list(motions), np.array(time_s)
    for row, motion in enumerate(motions):
        if isinstance(motion, _Carried):
            carriers[row], carrier_times[row] = motion.carrier_at(time_s[row])
    below = None if carriers == list(motions) else states_of(carriers, carrier_times)
    kinds: list[Any] = [
        getattr(type(motion), "together", None) if below is None else type(motion) for motion in motions
    ]
    rows, groups = rows_by(kinds), []
    for kind, indices in rows.items():
        members, times = [motions[row] for row in indices], time_s[indices]
        if below is not None:
            states = below.taken(indices) if len(rows) > 1 else below
            groups.append(kind.carried(members, states, times) if issubclass(kind, _Carried) else states)
        elif kind is None:
            groups.append(_stacked([motion.at(row) for motion, row in zip(members, times, strict=True)]))
        else:
            groups.append(kind(members, times))
    if len(groups) == 1:
        return groups[0]
    return States.joined(groups).taken(np.argsort([row for indices in rows.values() for row in indices]))


Key = TypeVar("Key")


def rows_by(keys: Sequence[Key]) -> dict[Key, list[int]]:
    """Places of each of some keys in their list."""
    rows: dict[Key, list[int]] = {}
    for row, key in enumerate(keys):
        rows.setdefault(key, []).append(row)
    return rows


def _clipped_to_spans(motions: Sequence[_BeyondEnds], time_s: Numbers) -> Numbers:
    """Clip (m, n) times to the spans of the motions that are extended."""
    spans = np.array([motion.motion.span_s for motion in motions])
    return np.asarray(np.clip(time_s, spans[:, :1], spans[:, 1:]))


def _stacked(states: Sequence[States]) -> States:
    """States of several motions at n instants each, as (m, n, ...)."""
    return States(**{name: np.stack([getattr(each, name) for each in states]) for name in _STATE_NAMES})


def motion_in_frame(motion: Motion, start_s: float) -> Motion:
    """Return a motion as a frame shows it that begins at this time: it jumps between frames only."""
    return motion.in_frame(start_s) if isinstance(motion, Repeated) else motion


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Segments:
    """The k segments of a spline: durations (k,), start rotations (3, 3, k) and positions (3, k), twists (3, 6, k)."""

    length_s: Numbers
    rotation: Numbers
    place: Numbers
    twists: Numbers

    @classmethod
    def joined(cls, splines: Sequence[_Segments]) -> _Segments:
        """One list of the segments of several splines."""
        if len(splines) == 1:
            return splines[0]
        names = [each.name for each in fields(cls)]
        return cls(**{name: np.concatenate([getattr(s, name) for s in splines], axis=-1) for name in names})

    @classmethod
    def through(cls, time_s: Numbers, poses: tuple[Pose, ...], smooth: bool, closed: bool) -> _Segments:
        length = np.diff(time_s)
        rotation = np.stack([pose.rotation for pose in poses], axis=-1)
        place = np.stack([pose.position_m for pose in poses], axis=-1)
        steps = _relative_pose(rotation[..., :-1], place[:, :-1], rotation[..., 1:], place[:, 1:])
        logs = _log(*steps)
        widest = float(_norm(logs[3:]).max())
        if widest > LARGEST_STEP_RAD:
            raise ValueError(
                f"the turn between two poses must be <= {math.degrees(LARGEST_STEP_RAD):.0f} degrees, "
                f"got {math.degrees(widest):.0f}"
            )
        rates = logs / length
        # A constant twist is the same in the frame at its start and at its end, so that the twists before and after a
        # pose can be averaged in that pose's frame.
        # On a loop the last segment comes before the first.
        first, last = (slice(-1, None), slice(0, 1)) if closed else (slice(0, 1), slice(-1, None))
        before, after = np.hstack([rates[:, first], rates]), np.hstack([rates, rates[:, last]])
        h_before, h_after = np.concatenate([length[first], length]), np.concatenate([length, length[last]])
        share = h_after / (h_before + h_after)
        at_poses = share * before + (1.0 - share) * after
        starts, ends = (at_poses[:, :-1], at_poses[:, 1:]) if smooth else (rates, rates)
        leaving = starts * length / 3.0
        arriving = ends * length / 3.0
        middle = _log(*_product(_product(_exp(-leaving), steps), _exp(-arriving)))
        return cls(
            length_s=length,
            rotation=rotation[..., :-1],
            place=place[:, :-1],
            twists=np.stack([leaving, middle, arriving]),
        )

    def at(self, segment: Numbers, since_s: Numbers) -> States:
        length = self.length_s[segment]
        u = since_s / length
        weights = (1.0 - (1.0 - u) ** 3, u * u * (3.0 - 2.0 * u), u**3)
        rates = (3.0 * (1.0 - u) ** 2, 6.0 * u * (1.0 - u), 3.0 * u * u)
        pose = self.rotation[..., segment], self.place[:, segment]
        twist = np.zeros((6, len(u)))
        for factor_twist, weight, rate in zip(self.twists[..., segment], weights, rates, strict=True):
            # Multiply the next factor on; its twist adds to those of the factors before, as seen behind it.
            step = _exp(weight * factor_twist)
            pose = _product(pose, step)
            twist = _twist_after_step(step, twist) + rate / length * factor_twist
        turned, place = pose
        vectors = place, _apply(turned, twist[:3]), _apply(turned, twist[3:])
        position_m, velocity_m_s, turning_rad_s = (np.ascontiguousarray(vector.T) for vector in vectors)
        return States(
            position_m=position_m,
            rotation=np.ascontiguousarray(np.moveaxis(turned, -1, 0)),
            velocity_m_s=velocity_m_s,
            turning_rad_s=turning_rad_s,
        )


def cross(a: Numbers, b: Numbers, axis: int = -1) -> Numbers:
    """Cross product of vectors along an axis; NumPy's own takes three times as long for some hundred."""
    (ax, ay, az), (bx, by, bz) = np.moveaxis(a, axis, 0), np.moveaxis(b, axis, 0)
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=axis)


# Elements of SE(3) are pairs (rotation (3, 3, n), position (3, n)); twists are (6, n): velocity, then angular velocity.
# Instants come last: NumPy is slow along axes of three.
_Rigid = tuple[Numbers, Numbers]


def _apply(rotation: Numbers, vector: Numbers) -> Numbers:
    x, y, z = vector
    return np.asarray(rotation[:, 0] * x + rotation[:, 2] * z + rotation[:, 1] * y)


def _apply_inverse(rotation: Numbers, vector: Numbers) -> Numbers:
    x, y, z = vector
    return np.asarray(rotation[0] * x + rotation[1] * y + rotation[2] * z)


def _matmul(a: Numbers, b: Numbers) -> Numbers:
    return np.matmul(a, b, out=np.zeros(b.shape), axes=[(0, 1)] * 3)


def _product(a: _Rigid, b: _Rigid) -> _Rigid:
    return _matmul(a[0], b[0]), a[1] + _apply(a[0], b[1])


def _relative_pose(rotation: Numbers, place: Numbers, later_rotation: Numbers, later_place: Numbers) -> _Rigid:
    """The later pose in the frame of the earlier one, T_i^-1 T_(i+1)."""
    return _matmul(rotation.transpose(1, 0, 2), later_rotation), _apply_inverse(rotation, later_place - place)


def _twist_after_step(step: _Rigid, twist: Numbers) -> Numbers:
    """A twist given in the frame before the step, in the frame after it: Ad(step^-1) twist."""
    rotation, place = step
    velocity, turning = twist[:3], twist[3:]
    moved = velocity + cross(turning, place, axis=0)
    return np.concatenate([_apply_inverse(rotation, moved), _apply_inverse(rotation, turning)])


def _norm(vector: Numbers) -> Numbers:
    x, y, z = vector
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def _skew(vector: Numbers) -> Numbers:
    x, y, z = vector
    skew = np.zeros((3, 3, len(x)))
    skew[2, 1], skew[0, 2], skew[1, 0] = x, y, z
    skew[1, 2], skew[2, 0], skew[0, 1] = -x, -y, -z
    return skew


def _coefficients(angle: Numbers) -> tuple[Numbers, Numbers, Numbers]:
    """sin(a)/a, (1 - cos a)/a^2 and (a - sin a)/a^3."""
    small = angle < SMALL_ANGLE_RAD
    safe = np.where(small, 1.0, angle)
    sin = np.sin(safe)
    # 1 - cos(a) = 2 sin(a/2)^2, which does not cancel. Below SMALL_ANGLE_RAD: the series.
    return (
        np.where(small, 1.0 - angle * angle / 6.0, sin / safe),
        np.where(small, 0.5 - angle * angle / 24.0, 2.0 * (np.sin(safe / 2.0) / safe) ** 2),
        np.where(small, 1.0 / 6.0 - angle * angle / 120.0, (safe - sin) / safe**3),
    )


def _exp(twist: Numbers) -> _Rigid:
    """Exponential map: Rodrigues' formula for the rotation, its integral for the position."""
    turn = _skew(twist[3:])
    first, second, third = _coefficients(_norm(twist[3:]))
    square = _matmul(turn, turn)
    one = np.eye(3)[:, :, None]
    rotation = one + first * turn + second * square
    # Integral of the rotation along the way, V = I + (1 - cos a)/a^2 W + (a - sin a)/a^3 W^2 with W = a [axis]_x: the
    # position is V v (Murray, Li and Sastry, "A mathematical introduction to robotic manipulation", 1994, 2.3).
    along = one + second * turn + third * square
    return rotation, _apply(along, twist[:3])


def _log(rotation: Numbers, place: Numbers) -> Numbers:
    """Logarithm: the twist whose exponential this is, for turns below 180 degrees."""
    cos = np.clip((np.trace(rotation) - 1.0) / 2.0, -1.0, 1.0)
    # The antisymmetric part of a rotation is sin(a) [axis]_x, its trace 1 + 2 cos(a).
    odd = rotation - rotation.transpose(1, 0, 2)
    axis_sin = 0.5 * np.stack([odd[2, 1], odd[0, 2], odd[1, 0]])
    sin = _norm(axis_sin)
    angle = np.arctan2(sin, cos)
    small = angle < SMALL_ANGLE_RAD
    stretch = np.where(small, 1.0 + angle * angle / 6.0, angle / np.where(small, 1.0, sin))
    turning = stretch * axis_sin
    turn = _skew(turning)
    _, second, third = _coefficients(angle)
    # Solve V v = position, with V as in `_exp`.
    along = np.eye(3)[:, :, None] + second * turn + third * _matmul(turn, turn)
    return np.concatenate([np.linalg.solve(along.transpose(2, 0, 1), place.T[:, :, None])[:, :, 0].T, turning])
