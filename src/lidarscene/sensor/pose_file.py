"""Poses in files: a position in metres, and yaw, pitch and roll in degrees."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from ..files.table_model import Number
from ..files.toml import FileModel
from ..maths.pose import Pose

LARGEST_COORDINATE_M = 1e8
"""No position is farther off: enough for any map projection, and far from what single precision can hold."""

Coordinate = Annotated[float, Field(ge=-LARGEST_COORDINATE_M, le=LARGEST_COORDINATE_M)]
Vector = tuple[Coordinate, Coordinate, Coordinate]
Turned = Annotated[float, Number("deg", ge=-36e3, le=36e3)]


class PoseFile(FileModel):
    """A pose as people write it: yaw about z, then pitch (positive looks up), then roll."""

    position_m: Vector = (0.0, 0.0, 0.0)
    yaw_deg: Turned = 0.0
    pitch_deg: Turned = 0.0
    roll_deg: Turned = 0.0

    def pose(self) -> Pose:
        """Convert to a rotation and a position."""
        return Pose.from_degrees(
            position_m=self.position_m, yaw_deg=self.yaw_deg, pitch_deg=self.pitch_deg, roll_deg=self.roll_deg
        )
