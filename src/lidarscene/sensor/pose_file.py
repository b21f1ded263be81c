"""Poses in files: a position in metres, and yaw, pitch and roll in degrees."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from numbers import Real
from typing import Annotated, Any, cast

import numpy as np
from pydantic import Field

from ..errors import OptionError, one_line
from ..files.table_model import Number
from ..files.toml import FileModel
from ..maths.arrays import Numbers
from ..maths.pose import Pose
from ..maths.rotations import yaw_pitch_roll_rad

LARGEST_COORDINATE_M = 1e8
"""Choice: farthest position: enough for any map projection, and far from what single precision can hold."""

Coordinate = Annotated[float, Field(ge=-LARGEST_COORDINATE_M, le=LARGEST_COORDINATE_M)]
Vector = tuple[Coordinate, Coordinate, Coordinate]
Turned = Annotated[float, Number("deg", ge=-36e3, le=36e3)]


class PoseFile(FileModel):
    """A pose as people write it: yaw about z, then pitch (positive looks up), then roll."""

    position_m: Vector = Field(default=(0.0, 0.0, 0.0), description="origin in the parent frame")
    yaw_deg: Turned = Field(default=0.0, description="turn to the left")
    pitch_deg: Turned = Field(default=0.0, description="look up")
    roll_deg: Turned = Field(default=0.0, description="right side down")

    def pose(self) -> Pose:
        """Convert to a rotation and a position."""
        return Pose.from_degrees(
            position_m=self.position_m, yaw_deg=self.yaw_deg, pitch_deg=self.pitch_deg, roll_deg=self.roll_deg
        )


def angles_deg(pose: Pose) -> tuple[float, float, float]:
    """Yaw, pitch and roll of a pose as a `PoseFile` has them [deg]."""
    yaw_rad, down_rad, roll_rad = yaw_pitch_roll_rad(pose.rotation)
    return math.degrees(yaw_rad), math.degrees(-down_rad), math.degrees(roll_rad)


def pose_keys(pose: Pose) -> dict[str, Any]:
    """Keys of a `PoseFile` that give this pose: its rotation exactly where some angles do, else to rounding."""
    exact_deg = angles_deg(pose)
    tries = [[float(f"{angle:.{digits}f}") for angle in exact_deg] for digits in range(16)]
    position_m = tuple(pose.position_m.tolist())
    for yaw_deg, pitch_deg, roll_deg in [*tries, exact_deg]:
        turned = Pose.from_degrees(yaw_deg=yaw_deg, pitch_deg=pitch_deg, roll_deg=roll_deg)
        if np.array_equal(turned.rotation, pose.rotation):
            break
    keys = {"position_m": position_m, "yaw_deg": yaw_deg, "pitch_deg": pitch_deg, "roll_deg": roll_deg}
    return {key: value for key, value in keys.items() if value}


WORDS = "a Pose, a (4, 4) matrix, or x, y, z in metres with or without yaw, pitch, roll in degrees"

Placed = Annotated[Pose | Sequence[float] | Numbers, WORDS]
"""Pose of a sensor: a `Pose`, x, y, z in metres, with or without yaw, pitch, roll in degrees, or a matrix."""

RIGID = 1e-4
"""Accuracy bought: largest error of a rotation's rows, as matrices in single precision have it."""


def finite_numbers(values: object) -> list[float]:
    """Numbers of a sequence, as floats; none for anything but finite numbers."""
    try:
        numbers = [float(n) if isinstance(n, Real) else math.nan for n in cast(Iterable[object], values)]
    except (TypeError, OverflowError):  # no sequence, nor is an array without axes; a whole number beyond floats
        return []
    return numbers if all(map(math.isfinite, numbers)) else []


def to_pose(pose: object, *, name: str = "pose") -> Pose:
    """Convert a `Pose`, three to six numbers, or a (4, 4) or (3, 4) matrix that turns and moves (see `Placed`).

    Args:
        name: of the argument, for the message

    Raises:
        OptionError: for anything else
    """
    if isinstance(pose, Pose):
        return pose
    numbers = finite_numbers(pose)
    if 3 <= len(numbers) <= 6:
        x, y, z, yaw, pitch, roll = numbers + [0.0] * (6 - len(numbers))
        return Pose.from_degrees(position_m=(x, y, z), yaw_deg=yaw, pitch_deg=pitch, roll_deg=roll)
    has_rows = pose.ndim > 0 if isinstance(pose, np.ndarray) else isinstance(pose, Sequence)
    rows = [finite_numbers(row) for row in cast(Iterable[object], pose)] if has_rows else []
    if [len(row) for row in rows] in ([4] * 3, [4] * 4) and rows[3:] in ([], [[0.0, 0.0, 0.0, 1.0]]):
        matrix = np.array(rows[:3])
        turn = matrix[:, :3]
        if np.allclose(turn @ turn.T, np.eye(3), atol=RIGID) and np.linalg.det(turn) > 0.0:
            return Pose(position_m=matrix[:, 3], rotation=turn)
    raise OptionError(f"{{{name}}}: must be {WORDS}, got {{0}}", one_line(pose))
