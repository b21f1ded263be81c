"""Motion during a frame: trajectories as tables on the device, looked up at each pulse's own time.

A frame is a sweep in time, so every pulse has its own pose of the sensor and of each moving body. Rebuilding the
scene for each pulse would be far too slow; instead rays start where the sensor is when they leave, and are
transformed into the frame of each moving body at that moment (docs/architecture.md, "Motion belongs to time").

Symbols: p point, o origin, v velocity [m/s], w angular velocity [rad/s].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .arrays import Lanes, Numbers, xp
from .pose import rotation_numbers
from .trajectory import Motion
from .vectors import Vector

STEP_S = 5e-4
"""Longest step of the tables. Linear interpolation is off by 0.3 um at 10 m/s2, 0.3 urad at 10 rad/s2, and 0.5 um on an
arc at 30 m/s and 30 degrees/s."""

_NUMBERS = 13  # place, quaternion, velocity, angular velocity


@dataclass(frozen=True, slots=True, kw_only=True)
class Placement:
    """Pose and velocity of a frame in the traced frame, for each of n rays or for all; numpy or Dr.Jit.

    origin_m       (x, y, z) of its origin
    rotation       nine numbers, row by row: frame to traced frame
    velocity_m_s   (x, y, z) of its origin, or None: it does not move
    turning_rad_s  (x, y, z) angular velocity, or None
    """

    origin_m: Vector
    rotation: tuple[Lanes, ...]
    velocity_m_s: Vector | None = None
    turning_rad_s: Vector | None = None

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

    def velocity_at(self, p: Vector) -> Vector:
        """Velocity [m/s], v + w x (p - o), of a point that is fixed in this frame; p in the traced frame."""
        if self.velocity_m_s is None or self.turning_rad_s is None:
            return 0.0, 0.0, 0.0
        (vx, vy, vz), (wx, wy, wz) = self.velocity_m_s, self.turning_rad_s
        x, y, z = (a - o for a, o in zip(p, self.origin_m, strict=True))
        return vx + wy * z - wz * y, vy + wz * x - wx * z, vz + wx * y - wy * x


@dataclass(frozen=True, slots=True, kw_only=True)
class Paths:
    """Several motions over one frame, on an even grid of times.

    table    (motions, instants, 13), flat: place, quaternion (w, x, y, z), velocity, angular velocity
    rate_hz  instants per second
    last     number of the last instant
    count    of motions
    """

    table: Lanes
    rate_hz: Lanes
    last: Lanes
    count: int

    @classmethod
    def of(cls, motions: Sequence[Motion], *, start_s: float, length_s: float, centre_m: Numbers) -> Paths:
        """Tables from ``start_s``, for ``length_s``.

        centre_m  (3,) origin of the traced frame in the world
        """
        steps = max(math.ceil(length_s / STEP_S), 1)
        times = start_s + np.linspace(0.0, length_s, steps + 1)
        rows = []
        for motion in motions:
            states = motion.at(times)
            turns = _continuous(_quaternion(states.rotation))
            rows.append(
                np.concatenate(
                    [states.position_m - centre_m, turns, states.velocity_m_s, states.turning_rad_s], axis=1
                )
            )
        return cls(
            table=np.stack(rows).ravel(), rate_hz=steps / length_s, last=float(steps), count=len(motions)
        )

    def at(self, time_s: Lanes, which: int) -> Placement:
        """Placement of motion number ``which`` at (n,) seconds after the start; clipped to the table's ends."""
        ops = xp(time_s)
        place = ops.minimum(ops.maximum(time_s * self.rate_hz, 0.0), self.last)
        lower = ops.minimum(ops.floor(place), self.last - 1.0)
        share = place - lower
        first = (ops.int32(lower) + which * (ops.int32(self.last) + 1)) * _NUMBERS

        def number(column: int) -> Lanes:
            before = ops.take(self.table, first + column)
            return before + share * (ops.take(self.table, first + (column + _NUMBERS)) - before)

        x, y, z, qw, qx, qy, qz, vx, vy, vz, wx, wy, wz = (number(column) for column in range(_NUMBERS))
        # A linear mix of two unit quaternions is shorter than one; normalised, it is a rotation again.
        length = ops.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
        return Placement(
            origin_m=(x, y, z),
            rotation=rotation_numbers(qw / length, qx / length, qy / length, qz / length),
            velocity_m_s=(vx, vy, vz),
            turning_rad_s=(wx, wy, wz),
        )


def _quaternion(rotation: Numbers) -> Numbers:
    """(n, 4) unit quaternions (w, x, y, z) of (n, 3, 3) rotations, by Bar-Itzhack's method.

    The quaternion is the eigenvector for the largest eigenvalue (1) of a 4 x 4 matrix: no cases, precise at every
    angle. J. Guidance, Control, and Dynamics 23 (2000), 1085.
    """
    r = rotation
    k = np.zeros((len(r), 4, 4))
    k[:, 0, 0] = r[:, 0, 0] + r[:, 1, 1] + r[:, 2, 2]
    for i, j, m in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        k[:, 1 + i, 1 + i] = r[:, i, i] - r[:, j, j] - r[:, m, m]
        k[:, 1 + i, 1 + j] = k[:, 1 + j, 1 + i] = r[:, i, j] + r[:, j, i]
        k[:, 0, 1 + i] = k[:, 1 + i, 0] = r[:, m, j] - r[:, j, m]
    return np.asarray(np.linalg.eigh(k)[1][:, :, -1])


def _continuous(quaternion: Numbers) -> Numbers:
    """The same rotations with signs chosen so that neighbours are close: q and -q are one rotation."""
    signs = np.sign((quaternion[1:] * quaternion[:-1]).sum(axis=1))
    flips = np.concatenate([[1.0], np.cumprod(np.where(signs < 0.0, -1.0, 1.0))])
    return np.asarray(quaternion * flips[:, None])
