"""Walking: which pose of its stride a walker has at a time, from the speed of its motion.

A mesh has one stride, on the spot, at the speed at which it was recorded or made. A walker plays it by its way: as its
body goes on by the length of a stride, one stride passes, so that a foot that bears stands still. The wheels of a
vehicle walk, too: their stride is a part of a turn after which they look the same. At another speed v
its steps have another length: those who may choose it take steps whose length goes with v^0.42 (A. D. Kuo, J. Biomech.
Eng. 123 (2001), 264). The *level* says how much of the stride a walker shows: 0 as it stands, 1 as the mesh has it.
Vertices go straight from the one to the other, p = s + level (w(phase) - s), so that a foot stays on the ground at any
level.

Symbols: n instants, k instants of a stride, v vertices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..maths.arrays import Numbers
from ..maths.motion_table import cubic
from ..maths.trajectory import ALWAYS, GoingOn, HeldAtEnds, Motion, Repeated, Riding, States, clipped
from .ride import Ride

STEP_EXPONENT = 0.42
"""Source: A. D. Kuo, J. Biomech. Eng. 123 (2001), 264: length of the steps that people choose, by the power of their
speed."""

LARGEST_LEVEL = 1.25
"""Choice: largest level; at 1.7 times its speed a stride is no longer, and steps only follow faster."""

NODE_S = 0.05
"""Accuracy bought: time between the nodes of the way of a motion, an eleventh of a step."""

NODES = 256
"""Choice: nodes by which a way grows: those of the first frames are few."""

LONGEST_STRIDE = 5.0
"""Choice: length of a stride, over the size of the body, beyond which an animation is taken for more than a stride:
those who run or gallop have less."""

_SOLE_SHARE = 0.002
"""Choice: share of the height of a walker within which a sole bears on the ground."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Gait:
    """How a body walks.

    Attributes:
        stride_m: length of the stride that its parts have, from a foot's contact to its next
        speed_m_s: at which it is so long
        stands: whether its parts also have the pose in which it stands; if not its level is 1 at any speed
        ahead: unit vector (x, y) of its frame along which it goes; a body that goes the other way plays the stride
            backwards
        strides: that it has made before its motion starts
    """

    stride_m: float
    speed_m_s: float
    stands: bool = True
    ahead: tuple[float, float] = (1.0, 0.0)
    strides: float = 0.0
    _ways: dict[tuple[int, tuple[float, float]], _Way] = field(repr=False, default_factory=dict)

    @classmethod
    def of_strides(cls, strides_m: Sequence[Numbers], *, period_s: float, stands: bool) -> Gait | None:
        """Measure the gait of a mesh by the foot that bears: it goes back as far as the body goes on.

        Args:
            strides_m: (k + 1, v, 3) vertices of each part over a stride, z up
            period_s: time of the stride

        Returns:
            None where nothing bears: no vertex near the ground moves
        """
        heights_m = [stride_m[:, :, 2] for stride_m in strides_m]
        ground_m = min(float(each.min()) for each in heights_m)
        low_m = ground_m + _SOLE_SHARE * (max(float(each.max()) for each in heights_m) - ground_m)
        # Few vertices ever bear.
        soles_m = np.concatenate(
            [stride_m[:, (each <= low_m).any(axis=0)] for stride_m, each in zip(strides_m, heights_m, strict=True)],
            axis=1,
        )
        bears = soles_m[:, :, 2] <= low_m
        bears = bears[:-1] & bears[1:]
        gone_m = np.diff(soles_m, axis=0)[:, :, :2]
        steps_m = [np.median(way_m[flags], axis=0) for way_m, flags in zip(gone_m, bears, strict=True) if flags.any()]
        back_m = len(gone_m) * np.median(steps_m, axis=0) if steps_m else np.zeros(2)
        stride_m = float(np.hypot(*back_m))
        if stride_m < 1e-3:
            return None
        x, y = -back_m / stride_m
        return cls(stride_m=stride_m, speed_m_s=stride_m / period_s, stands=stands, ahead=(float(x), float(y)))

    def at(self, motion: Motion, time_s: Numbers, states: States | None = None) -> Numbers:
        """(n, 2) phase, counted in strides, and level at (n,) times [s] of a motion.

        The phase counts from the start of a motion with an end. One without goes at a constant speed.

        Args:
            states: of the motion at these times, where they are known
        """
        speed_m_s = self._speed_m_s(motion.at(time_s) if states is None else states)
        return np.stack([self.strides + self._phase(motion, time_s), self._level(speed_m_s)], axis=1)

    def continued(self, before: Motion, motion: Motion, time_s: float) -> Gait:
        """Return the gait on another motion from a time on, at which its legs are as on the one before."""
        at = np.array([time_s])
        anew = replace(self, strides=0.0, _ways={})
        return replace(anew, strides=float(self.at(before, at)[0, 0] - anew.at(motion, at)[0, 0]) % 1.0)

    def _speed_m_s(self, states: States) -> Numbers:
        """Speed in (n,) states, negative for what goes backwards."""
        velocity_m_s = states.velocity_m_s[:, :2]
        speed_m_s = np.hypot(*velocity_m_s.T)
        ahead_m_s = np.sum(velocity_m_s * (states.rotation[:, :2, :2] @ np.array(self.ahead)), axis=1)
        return np.asarray(np.where(ahead_m_s < -0.5 * speed_m_s, -speed_m_s, speed_m_s))

    def _level(self, speed_m_s: Numbers) -> Numbers:
        """Level at (n,) speeds."""
        if not self.stands:
            return np.ones_like(speed_m_s)
        return np.asarray(np.minimum((np.abs(speed_m_s) / self.speed_m_s) ** STEP_EXPONENT, LARGEST_LEVEL))

    def _rate_hz(self, states: States) -> Numbers:
        """Strides per second in (n,) states: the way over the length of a stride."""
        speed_m_s = self._speed_m_s(states)
        stride_m = self.stride_m * self._level(speed_m_s)
        return np.asarray(np.divide(speed_m_s, stride_m, out=np.zeros_like(speed_m_s), where=stride_m > 0.0))

    def _phase(self, motion: Motion, time_s: Numbers) -> Numbers:
        """Strides since the start of a motion at (n,) times."""
        if isinstance(motion, Ride):
            return self._phase(motion.path, time_s)
        if isinstance(motion, Riding) and motion.span_s == ALWAYS:
            # The wheels of a vehicle that carries the sensor: their way is that of its origin.
            x, y = (motion.pose.rotation[:2, :2] @ np.array(self.ahead)).tolist()
            return replace(self, ahead=(x, y))._phase(motion.carrier, time_s)
        if isinstance(motion, HeldAtEnds):
            return self._phase(*motion.carrier_at(time_s))
        if isinstance(motion, GoingOn):
            carrier, within_s = motion.carrier_at(time_s)
            beyond = (time_s - within_s) * self._rate_hz(motion.at(within_s))
            return np.asarray(self._phase(carrier, within_s) + beyond)
        if isinstance(motion, Repeated):
            first_s, last_s = motion.motion.span_s
            rounds, within_s = np.divmod(time_s - first_s, last_s - first_s)
            phase = self._phase(motion.motion, first_s + within_s)
            if rounds.any():
                phase += rounds * self._phase(motion.motion, np.array([last_s]))
            return phase
        if motion.span_s == ALWAYS:
            return np.asarray(time_s * self._rate_hz(motion.at(np.zeros(1))))
        # Gaits with another way ahead share the ways.
        key = id(motion), self.ahead
        if key not in self._ways:
            self._ways[key] = _Way(gait=self, motion=motion)
        return self._ways[key](clipped(time_s, motion))


@dataclass(slots=True, kw_only=True, eq=False)
class _Way:
    """Strides from the start of a motion on: a curve, cubic between nodes, with the rate at each; as far as was asked.

    Attributes:
        nodes: times of the nodes so far, and strides and rate at each
    """

    gait: Gait
    motion: Motion
    nodes: tuple[Numbers, Numbers, Numbers] = (np.zeros(0), np.zeros(1), np.zeros(0))

    def __call__(self, time_s: Numbers) -> Numbers:
        """(n,) strides at (n,) times in the motion's span."""
        first_s, last_s = self.motion.span_s
        steps = max(int(np.ceil((last_s - first_s) / NODE_S)), 1)
        share = (float(np.fmax.reduce(time_s, initial=first_s)) - first_s) / (last_s - first_s)
        needed = min(int(share * steps) + 2, steps + 1)
        # Other threads ask, too: each goes by what it has seen.
        nodes = self.nodes
        if needed > len(nodes[0]):
            nodes = self.nodes = self._grown(nodes, np.linspace(first_s, last_s, steps + 1), needed)
        return _curve(*nodes, time_s)

    def _grown(
        self, nodes: tuple[Numbers, Numbers, Numbers], all_s: Numbers, needed: int
    ) -> tuple[Numbers, Numbers, Numbers]:
        before_s, strides, rate = nodes
        nodes_s = all_s[max(len(before_s) - 1, 0) : NODES * -(-needed // NODES)]
        # One question for all: a motion takes a hundred calls of NumPy, however many instants there are.
        times_s = np.concatenate([nodes_s, 0.5 * (nodes_s[1:] + nodes_s[:-1])])
        rates, between = np.split(self.gait._rate_hz(self.motion.at(times_s)), [len(nodes_s)])
        # Simpson's rule.
        passed = np.diff(nodes_s) / 6.0 * (rates[:-1] + 4.0 * between + rates[1:])
        sums = np.cumsum(np.concatenate([strides[-1:], passed]))
        new = slice(1 if len(before_s) else 0, None)
        return (
            np.concatenate([before_s, nodes_s[new]]),
            np.concatenate([strides, sums[1:]]),
            np.concatenate([rate, rates[new]]),
        )


@dataclass(frozen=True, slots=True)
class GaitOnMotion:
    """A gait on a motion; alike if both are the same.

    Attributes:
        gait: how the body walks
        motion: where it goes
    """

    gait: Gait
    motion: Motion

    def __call__(self, time_s: Numbers, states: States | None = None) -> Numbers:
        """Return `Gait.at`."""
        return self.gait.at(self.motion, time_s, states)


def _curve(node_s: Numbers, value: Numbers, rate: Numbers, time_s: Numbers) -> Numbers:
    """Values at (n,) times within of the cubics that have these values and rates at nodes.

    `scipy.interpolate` has this, too, but takes 0.4 s to import.
    """
    number = np.clip(np.searchsorted(node_s, time_s, side="right") - 1, 0, len(node_s) - 2)
    step_s = node_s[number + 1] - node_s[number]
    share = (time_s - node_s[number]) / step_s
    (values,) = cubic([value[number]], [value[number + 1]], [rate[number]], [rate[number + 1]], share, step_s)
    return np.asarray(values)
