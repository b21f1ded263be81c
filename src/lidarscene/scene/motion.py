"""Motion in scene files: the pydantic models of [ego] and of a body's motion.

A file gives a motion by poses, or by velocity and yaw rate. Either form becomes a `maths.trajectory.Motion`, the only
type that the rest of the program handles.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from ..errors import InputError
from ..files.table_model import Number, Table
from ..maths.pose import Pose, is_near
from ..maths.trajectory import ALWAYS, Course, GoingOn, HeldAtEnds, Motion, Repeated, Riding, Spline
from ..physics.road.suspension import Suspension
from ..sensor.pose_file import PoseFile
from .poses import read_poses, spline
from .ride import Height, Ride


class TimedPoseFile(PoseFile):
    """A pose at a time."""

    time_s: Annotated[float, Number(ge=-1e12, le=1e12)] = Field(description="rising from pose to pose")


class RideFile(Table[Suspension]):
    """[ego.ride], [bodies.motion.ride]: the vehicle's springs, on which it rides over the scene's ground."""

    active: bool = Field(default=True, description="`false`: the path as it is, without heave, pitch and roll")


class MotionFile(Table[Course]):
    """A motion: constant speed and yaw rate, or poses with times."""

    poses: Annotated[tuple[TimedPoseFile, ...], Field(min_length=2)] | None = Field(
        default=None, description="poses with times, as below, two or more; smoothly from one to the next"
    )
    poses_file: Annotated[str, Field(min_length=1)] | None = Field(
        default=None, description="the same from a file beside the scene file, CSV or TUM"
    )

    at_end: Literal["hold", "repeat", "hide", "leave"] | None = Field(
        default=None,
        description=(
            "behaviour before the first and after the last pose; without it frames there are "
            "refused, see docs/motion.md"
        ),
    )
    ride: RideFile | None = Field(default=None, description="suspension on the ground; steady if left out")
    storeys: bool = Field(
        default=False,
        description="poses have the height of the ground, of which several may be above each other, as at bridges",
    )

    @model_validator(mode="after")
    def _check_single_way(self) -> MotionFile:
        keys_by_way = [
            sorted(self.model_fields_set & keys)
            for keys in ({"speed_m_s", "yaw_rate_deg_s", "velocity_m_s"}, {"poses"}, {"poses_file"})
        ]
        ways_given = [keys[0] for keys in keys_by_way if keys]
        if len(ways_given) > 1:
            raise ValueError(f"must have only one of speeds, poses and poses_file, got {' and '.join(ways_given)}")
        if self.at_end and self.poses is None and self.poses_file is None:
            raise ValueError("at_end must go with poses or poses_file in the same table, got neither")
        return self

    def motion(self, pose: Pose, *, height_m: Height, on_ground: bool, folder: Path, where: str) -> Motion:
        """Motion in the world of a body that rides at ``pose``.

        Args:
            pose: pose at time 0 of a motion by speeds; with poses, the body's in the moving frame that they describe
            height_m: height of the scene's ground at (n, 2) places; near others, (n,), with `storeys`
            on_ground: whether it follows that height without a ride, too

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        course = self._spline(folder=folder, where=where)
        path = self.in_si(start=pose) if course is None else self._unending(course, pose)
        if self.ride is not None and self.ride.active:
            path = Ride(path=path, height_m=height_m, suspension=self.ride.in_si(), storeys=self.storeys)
        elif on_ground:
            path = Ride(path=path, height_m=height_m, storeys=self.storeys)
        # What stops at once would dive on its springs: it rides up to its end, and rests as it is then.
        if self.at_end in ("hold", "hide"):
            return HeldAtEnds(motion=path)
        if self.at_end == "repeat" and path.span_s != ALWAYS:
            return Repeated(motion=path)
        return path

    def present_s(self, motion: Motion) -> tuple[float, float]:
        """First and last time at which a frame may begin that shows the body of this ``motion``."""
        return motion.motion.span_s if self.at_end == "hide" and isinstance(motion, HeldAtEnds) else ALWAYS

    def _unending(self, course: Spline, pose: Pose) -> Motion:
        """Motion of a body on a course by poses; without end if it leaves there, or goes round on a loop."""
        if self.at_end == "repeat" and is_near(course.poses[0], course.poses[-1]):
            loop = Spline(time_s=course.time_s, poses=course.poses, closed=True)
            return Repeated(motion=Riding(carrier=loop, pose=pose))
        riding = Riding(carrier=course, pose=pose)
        return GoingOn(motion=riding) if self.at_end == "leave" else riding

    def _spline(self, *, folder: Path, where: str) -> Spline | None:
        """Course through the poses; None for a motion by speeds.

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        if self.poses is not None:
            times = np.array([timed_pose.time_s for timed_pose in self.poses])
            return spline(times, [timed_pose.pose() for timed_pose in self.poses], f"{where}.poses")
        if self.poses_file is not None:
            try:
                return read_poses(folder / self.poses_file)
            except InputError as error:
                raise InputError(f"{where}.poses_file: {error}") from None
        return None


class EgoFile(MotionFile, PoseFile):
    """[ego]: the vehicle that carries the sensor."""

    on_ground: bool = Field(default=False, description="its height counts from the ground below, also without a ride")
    mesh: Annotated[str, Field(min_length=1)] | None = Field(
        default=None, description="mesh file of the vehicle, in place of the meshes that are fixed to it"
    )

    @model_validator(mode="after")
    def _check_end(self) -> EgoFile:
        if self.at_end == "hide":
            raise ValueError("at_end must be hold, repeat or leave: the vehicle that carries the sensor cannot hide")
        return self

    def motion(self, pose: Pose, *, height_m: Height, on_ground: bool, folder: Path, where: str) -> Motion:
        """Motion of the vehicle, as `MotionFile.motion`.

        Raises:
            InputError: for one that jumps back to its beginning
        """
        motion = super().motion(pose, height_m=height_m, on_ground=on_ground, folder=folder, where=where)
        if self.at_end == "repeat" and isinstance(motion, Repeated) and motion.jumps:
            raise InputError(f"{where}.at_end: repeat must have a last pose that is the first: the sensor cannot jump")
        return motion


class BodyMotionFile(MotionFile):
    """[bodies.motion]: as [ego], or the ego vehicle's own."""

    with_ego: bool = Field(default=False, description="fixed to the ego vehicle, at the body's own pose there")

    @model_validator(mode="after")
    def _check_alone(self) -> BodyMotionFile:
        other_keys = sorted(self.model_fields_set - {"with_ego"})
        if self.with_ego and other_keys:
            raise ValueError(f"must have with_ego alone, got with_ego and {other_keys[0]}")
        return self
