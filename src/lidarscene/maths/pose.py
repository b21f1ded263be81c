"""Poses and directions. Frames are right-handed: x forward, y left, z up; metres and radians.

A pose is the position of a frame's origin in its parent and the rotation that turns the frame's vectors into the
parent's: ``R = Rz(yaw) Ry(-pitch) Rx(roll)``, so that a positive pitch looks up.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from .arrays import Lanes, Numbers, frozen, xp
from .attributes import HintedAttributes, answers_calls


def rotation_matrix(*, yaw_rad: float, pitch_rad: float, roll_rad: float) -> Numbers:
    """(3, 3) rotation Rz(yaw) Ry(-pitch) Rx(roll)."""
    cy, sy = math.cos(yaw_rad), math.sin(yaw_rad)
    cp, sp = math.cos(pitch_rad), math.sin(pitch_rad)
    cr, sr = math.cos(roll_rad), math.sin(roll_rad)
    about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    about_y = np.array([[cp, 0.0, -sp], [0.0, 1.0, 0.0], [sp, 0.0, cp]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return np.asarray(about_z @ about_y @ about_x)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pose(HintedAttributes):
    """Position and rotation of a frame in its parent.

    Attributes:
        position_m: (3,) float64
        rotation: (3, 3) float64, frame to parent
    """

    MADE_BY: ClassVar[str] = "Pose.from_degrees(position_m=(0, 0, 1.8), yaw_deg=90) makes one"
    CHANGED_BY: ClassVar[str] = "dataclasses.replace(pose, position_m=(0, 0, 1.8)) is another pose"
    FOREIGN_NAMES: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("x", "y", "z", "xyz", "translation", "location", "t"), "pose.position_m"),
        **dict.fromkeys(
            ("yaw", "pitch", "roll", "heading", "R", "rot", "quaternion", "quat", "euler", "orientation"),
            "pose.rotation has the (3, 3) matrix",
        ),
        **dict.fromkeys(("matrix", "as_matrix", "T", "__getitem__"), "pose.position_m, pose.rotation"),
        **dict.fromkeys(("inv", "invert"), "pose.inverse()"),
        **dict.fromkeys(("transform", "transform_points"), "pose.apply(points_m)"),
    }

    position_m: Numbers = field(default_factory=lambda: np.zeros(3))
    rotation: Numbers = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        """Check shapes and freeze the arrays."""
        object.__setattr__(self, "position_m", frozen(self.position_m, np.float64, (3,), name="Pose.position_m"))
        object.__setattr__(self, "rotation", frozen(self.rotation, np.float64, (3, 3), name="Pose.rotation"))

    @classmethod
    @answers_calls
    def from_degrees(
        cls,
        *,
        position_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
        yaw_deg: float = 0.0,
        pitch_deg: float = 0.0,
        roll_deg: float = 0.0,
    ) -> Pose:
        """Build from position and angles, as scene and sensor files give them."""
        yaw, pitch, roll = (math.radians(angle_deg) for angle_deg in (yaw_deg, pitch_deg, roll_deg))
        return cls(
            position_m=np.asarray(position_m, dtype=np.float64),
            rotation=rotation_matrix(yaw_rad=yaw, pitch_rad=pitch, roll_rad=roll),
        )

    def __matmul__(self, child: Pose) -> Pose:
        """Pose in this frame's parent of a ``child`` given in this frame."""
        return Pose(
            position_m=self.position_m + self.rotation @ child.position_m, rotation=self.rotation @ child.rotation
        )

    def inverse(self) -> Pose:
        """The parent's pose in this frame."""
        return Pose(position_m=-self.rotation.T @ self.position_m, rotation=self.rotation.T)

    def apply(self, points_m: Numbers) -> Numbers:
        """(n, 3) points of this frame, in the parent's coordinates."""
        moved = _turned(points_m, self.rotation)
        moved += self.position_m
        return moved

    def inverse_apply(self, points_m: Numbers) -> Numbers:
        """(n, 3) points of the parent, in this frame's coordinates."""
        return _turned(points_m, self.rotation.T, about_m=self.position_m)


def _turned(points_m: Numbers, rotation: Numbers, *, about_m: Lanes = 0.0) -> Numbers:
    """(..., 3) points from a place, turned; column by column, since NumPy is slow at products of (n, 3) and (3, 3)."""
    columns = np.array(np.asarray(points_m).T, dtype=np.float64, order="C")
    columns.T[...] -= about_m
    x, y, z = columns
    turned = np.zeros(columns.shape)
    for number, (along_x, along_y, along_z) in enumerate(rotation.tolist()):
        # In place: pages that are new to a process take longer than to compute what fills them.
        column = turned[number, ...]
        np.multiply(along_x, x, out=column)
        column += along_y * y
        column += along_z * z
    return turned.T


def direction_from_angles(*, azimuth_rad: Lanes, elevation_rad: Lanes) -> tuple[Lanes, Lanes, Lanes]:
    """Unit vector (x, y, z). Azimuth: counter-clockwise from x seen from above; elevation: up from the horizon."""
    ops = xp(azimuth_rad, elevation_rad)
    horizontal = ops.cos(elevation_rad)
    return horizontal * ops.cos(azimuth_rad), horizontal * ops.sin(azimuth_rad), ops.sin(elevation_rad)


def rotation_numbers(w: Lanes, x: Lanes, y: Lanes, z: Lanes) -> tuple[Lanes, ...]:
    """Rotation matrix of a unit quaternion as nine numbers, row by row."""
    return (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )


NEAR_M, NEAR_ENTRY = 1e-3, 1e-3
"""Choice: distance, and difference of a rotation's entries, up to which two poses are taken for one."""


def is_near(pose: Pose, other: Pose) -> bool:
    """Whether two poses are the same but for what nobody places better: a loop closes, a mounting is the one before."""
    apart_m = float(np.linalg.norm(other.position_m - pose.position_m))
    return apart_m <= NEAR_M and bool(np.allclose(pose.rotation, other.rotation, rtol=0.0, atol=NEAR_ENTRY))
