"""A vehicle that rides: heave, pitch and roll on top of a path, from the ground below its wheels and its accelerations.

The ground's heights below the wheels and the accelerations of the path drive the linear model of
`physics.road.suspension` along the path, whatever it is: a line, an arc, poses with times. So a vehicle rides on the
same surface that the ground's meshes show.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..maths.arrays import Numbers
from ..maths.trajectory import Motion, OneOfKind, States, cross, fastest_turn_rad_s, rows_by, states_of
from ..physics.road.suspension import Suspension

STEP_S = 0.005
"""Accuracy bought: time between nodes of the response. Heights are straight lines between nodes, which takes 0.02 % off
the motion of a car's body at 1.5 Hz and 1.2 % off that of its wheels at 12 Hz, (2 pi f h)^2 / 12. The shortest waves of
a road, 0.35 m, last two nodes up to 35 m/s."""

BLOCK_NODES = 200
"""Nodes of one block, 1 s: what is computed at a time."""

_LEAD_BLOCKS = 8
"""Blocks before a block in which the vehicle starts to ride: free motion decays by exp(-2.1 t / s), to 4e-8 in 8 s."""

FOLLOW_S = 0.1
"""Choice: time between the heights that what has no wheels follows, each the mean of the ground over that time: it goes
up a step within four of them, about the time of a human step, at up to 7.5 times the step's height per second."""

_SAMPLES = 4
"""Accuracy bought: heights in a mean, 25 ms apart: 4 cm of a walker's way."""

_FOLLOWED = round(BLOCK_NODES * STEP_S / FOLLOW_S)
_MOST_BLOCKS = 256
_COMPUTING = threading.RLock()

Height = Callable[..., Numbers]
"""Height of the ground [m] at (n, 2) places in the world; of `Ride.storeys` with (n,) heights near which it is."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ride(OneOfKind):
    """A motion along a path that rides over the ground below it.

    The pose is T(t) = path(t) (heave along z, Ry(-pitch) Rx(roll)), pitch about the centre of mass and roll about the
    ground below it (T143). Heave, pitch and roll are polynomials of the fifth degree between nodes `STEP_S` apart that
    meet the values, first and second derivatives there: accelerations are continuous where those of the path are. A
    block of nodes is computed when a time in it is first asked for, always from the same instant on, so that the order
    in which times are asked for changes nothing.

    Attributes:
        path: motion of the vehicle on flat ground at its own height, which the ground's height is added to. Its origin
            is below the body's centre of mass
        height_m: height of the ground at (n, 2) places
        suspension: the vehicle; None: what has no wheels, and follows the height of the ground below its origin, as
            `FOLLOW_S` says, upright
        storeys: whether the path has the height of one of several grounds above each other, on which it rides
    """

    path: Motion
    height_m: Height
    suspension: Suspension | None = None
    storeys: bool = False
    _inputs: dict[int, Numbers] = field(init=False, default_factory=dict)
    _nodes: dict[int, Numbers] = field(init=False, default_factory=dict)

    @property
    def span_s(self) -> tuple[float, float]:
        """The path's span."""
        return self.path.span_s

    @property
    def fastest_turn_rad_s(self) -> float:
        """That of the path, beside which heave, pitch and roll are slow."""
        return fastest_turn_rad_s(self.path)

    @staticmethod
    def together(motions: Sequence[Ride], time_s: Numbers) -> States:
        """States of m rides at their own (m, n) times, as `at` of each."""
        spans = np.array([motion.span_s for motion in motions])
        time_s = np.clip(time_s, spans[:, :1], spans[:, 1:])
        base = states_of([motion.path for motion in motions], time_s)
        (heave, pitch, roll), (climbing, pitching, rolling) = Ride._bodies_at(motions, time_s)
        cp, sp, cr, sr = np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)
        zero = np.zeros_like(pitch)
        tilt = np.stack([cp, -sp * sr, -sp * cr, zero, cr, -sr, sp, cp * sr, cp * cr], axis=-1).reshape(
            *pitch.shape, 3, 3
        )
        # In the path's frame: the origin swings ahead below the centre of mass as the nose lifts.
        suspensions = [motion.suspension for motion in motions]
        centre_m = np.array([[0.0 if each is None else each.height_m] for each in suspensions])
        shift = np.stack([centre_m * sp, zero, heave + centre_m * (1.0 - cp)], axis=-1)
        drift = np.stack([centre_m * cp * pitching, zero, climbing + centre_m * sp * pitching], axis=-1)
        shift, drift = (np.einsum("mnij,mnj->mni", base.rotation, vector) for vector in (shift, drift))
        # Rates in the path's frame: -pitch about y, then roll about the x axis that pitch has turned.
        turning = np.stack([cp * rolling, -pitching, sp * rolling], axis=-1)
        return States(
            position_m=base.position_m + shift,
            rotation=base.rotation @ tilt,
            velocity_m_s=base.velocity_m_s + drift + cross(base.turning_rad_s, shift),
            turning_rad_s=base.turning_rad_s + np.einsum("mnij,mnj->mni", base.rotation, turning),
        )

    def body_at(self, time_s: Numbers) -> tuple[Numbers, Numbers]:
        """Heave [m], pitch and roll [rad] of the body against the path, (n, 3), and their rates, at (n,) times."""
        body, rate = Ride._bodies_at([self], time_s[None])
        return body[:, 0].T, rate[:, 0].T

    @staticmethod
    def _bodies_at(motions: Sequence[Ride], time_s: Numbers) -> tuple[Numbers, Numbers]:
        """`body_at` of m rides at their own (m, n) times, (3, m, n)."""
        place = time_s / STEP_S
        node = np.floor(place).astype(np.int64)
        block = node // BLOCK_NODES
        within = node - block * BLOCK_NODES
        rows = rows_by(motions)
        numbers = {motion: np.unique(block[own]) for motion, own in rows.items()}
        # The threads that write frames ask, too, and one would take away the blocks that another one has computed.
        with _COMPUTING:
            Ride._compute({motion: set(own.tolist()) for motion, own in numbers.items()})
            known = [motion._nodes[number] for motion, own in numbers.items() for number in own.tolist()]
        # The blocks of all rides are one list of nodes.
        nodes = np.concatenate(known)
        first = 0
        for motion, own in rows.items():
            within[own] += (first + np.searchsorted(numbers[motion], block[own])) * (BLOCK_NODES + 1)
            first += len(numbers[motion])
        before, after = nodes[within], nodes[within + 1]
        # Numbers first: NumPy is slow along axes of three.
        before, after = (np.moveaxis(nodes, (2, 3), (0, 1)).copy() for nodes in (before, after))
        return _quintic(before, after, place - node)

    @staticmethod
    def _compute(asked: Mapping[Ride, set[int]]) -> None:
        """Compute those of the blocks of these rides that are not known: `_nodes`.

        A block is (`BLOCK_NODES` + 1, 3, 3): heave, pitch and roll at its nodes, with first and second derivatives.
        Those of all rides are computed together: NumPy takes as long for the path of one as for those of ten.
        """
        missing: list[tuple[Ride, int]] = []
        for ride, numbers in asked.items():
            if len(ride._nodes) >= _MOST_BLOCKS and not numbers <= ride._nodes.keys():
                ride._nodes.clear()
                ride._inputs.clear()
            missing += [(ride, number) for number in sorted(numbers - ride._nodes.keys())]
        Ride._follow([block for block in missing if block[0].suspension is None])
        Ride._swing([(ride, ride.suspension, number) for ride, number in missing if ride.suspension is not None])

    @staticmethod
    def _follow(blocks: Sequence[tuple[Ride, int]]) -> None:
        """Compute blocks without a suspension: legs carry a body evenly over what its feet step on.

        Means of heights below the origin, `FOLLOW_S` apart, are the control points of a cubic B-spline. It is a sum of
        truncated powers here: `scipy.interpolate` takes 0.4 s to import.
        """
        if not blocks:
            return
        within = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
        points = np.arange(-1, _FOLLOWED + 2)
        times_s = FOLLOW_S * np.add.outer(points, within).ravel() + np.array(
            [[number * BLOCK_NODES * STEP_S] for _, number in blocks]
        )
        paths = states_of([ride.path for ride, _ in blocks], times_s)
        rises_m = Ride._rises_m([ride for ride, _ in blocks], paths.position_m)
        means_m = rises_m.reshape(len(blocks), -1, _SAMPLES).mean(axis=2)
        # Of truncated powers; those of a point count for two points before and behind it.
        place = np.minimum(np.arange(BLOCK_NODES + 1)[:, None] * (STEP_S / FOLLOW_S) - points, 2.0)
        ramps, signs = np.maximum(place[:, :, None] + np.arange(2, -3, -1), 0.0), np.array([1.0, -4.0, 6.0, -4.0, 1.0])
        weights = np.stack([(ramps ** (3 - k) @ signs) / math.factorial(3 - k) / FOLLOW_S**k for k in range(3)], axis=1)
        for (ride, number), mean_m in zip(blocks, means_m, strict=True):
            nodes = np.zeros((BLOCK_NODES + 1, 3, 3))
            nodes[:, :, 0] = weights @ mean_m
            ride._nodes[number] = nodes

    @staticmethod
    def _swing(blocks: Sequence[tuple[Ride, Suspension, int]]) -> None:
        """Compute blocks on a suspension, which starts to ride some blocks before."""
        if not blocks:
            return
        lead = [(ride, own, number + back) for ride, own, number in blocks for back in range(-_LEAD_BLOCKS, 1)]
        new = list(dict.fromkeys(block for block in lead if block[2] not in block[0]._inputs))
        nodes = [np.arange(BLOCK_NODES) + number * BLOCK_NODES for _, _, number in new]
        if new:
            for (ride, _, number), inputs in zip(new, Ride._inputs_at(new, nodes), strict=True):
                ride._inputs[number] = inputs
        # The first node of the next block closes this one.
        ends = Ride._inputs_at(blocks, [np.array([(number + 1) * BLOCK_NODES]) for _, _, number in blocks])
        for (ride, suspension, number), end in zip(blocks, ends, strict=True):
            inputs = [ride._inputs[number + back] for back in range(-_LEAD_BLOCKS, 1)]
            swung = suspension.ride(np.concatenate([*inputs, end]), STEP_S)
            ride._nodes[number] = swung[_LEAD_BLOCKS * BLOCK_NODES :]

    @staticmethod
    def _inputs_at(rides: Sequence[tuple[Ride, Suspension, int]], nodes: Sequence[Numbers]) -> Numbers:
        """(m, n, 6) inputs of m suspensions at their own (m, n) nodes.

        They are the heights below the wheels [m], and the accelerations ahead and to the left [m/s2].
        """
        time_s, half = np.stack(nodes) * STEP_S, 0.5 * STEP_S
        paths = states_of(
            [ride.path for ride, _, _ in rides] * 3, np.concatenate([time_s, time_s + half, time_s - half])
        )
        rotation, place_m = paths.rotation[: len(rides)], paths.position_m[: len(rides), :, None]
        wheels = np.stack([np.pad(suspension.wheels_m, ((0, 0), (0, 1))) for _, suspension, _ in rides])
        place_m = place_m + np.einsum("mnij,mwj->mnwi", rotation, wheels)
        heights_m = Ride._rises_m([ride for ride, _, _ in rides], place_m.reshape(len(rides), -1, 3))
        later, earlier = paths.velocity_m_s[len(rides) :].reshape(2, *rotation.shape[:3])
        ahead_and_left = np.einsum("mnij,mni->mnj", rotation[..., :2], (later - earlier) / STEP_S)
        return np.concatenate([heights_m.reshape(*time_s.shape, 4), ahead_and_left], axis=2)

    @staticmethod
    def _rises_m(rides: Sequence[Ride], place_m: Numbers) -> Numbers:
        """What the ground adds to the heights of the paths of m rides at their own (m, n, 3) places, (m, n)."""
        rises_m = np.zeros(place_m.shape[:2])
        # All that ride on one ground ask it together.
        for (height_m, storeys), rows in rows_by([(ride.height_m, ride.storeys) for ride in rides]).items():
            own_m = place_m[rows].reshape(-1, 3)
            heights_m = height_m(own_m[:, :2], own_m[:, 2]) - own_m[:, 2] if storeys else height_m(own_m[:, :2])
            rises_m[rows] = heights_m.reshape(len(rows), -1)
        return rises_m


def _quintic(before: Numbers, after: Numbers, share: Numbers) -> tuple[Numbers, Numbers]:
    """Values and rates between two nodes, of polynomials that meet values and two derivatives at both.

    Args:
        before: (3, ...) values, first and second derivatives
        after: (3, ...) values, first and second derivatives
        share: (...) of the step from the node before
    """
    u, h = share, STEP_S
    y, v, a = before[0], h * before[1], 0.5 * h * h * before[2]
    # What the parabola of the node before misses at the node after: in value, first and second derivative.
    miss = after[0] - y - v - a
    miss_v = h * after[1] - v - 2.0 * a
    miss_a = 0.5 * h * h * after[2] - a
    third = 10.0 * miss - 4.0 * miss_v + miss_a
    fourth = -15.0 * miss + 7.0 * miss_v - 2.0 * miss_a
    fifth = 6.0 * miss - 3.0 * miss_v + miss_a
    value = y + u * (v + u * (a + u * (third + u * (fourth + u * fifth))))
    rate = v + u * (2.0 * a + u * (3.0 * third + u * (4.0 * fourth + u * 5.0 * fifth)))
    return value, rate / h
