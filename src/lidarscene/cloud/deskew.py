"""Deskewing: remove the sensor's own motion from a cloud, as if all points were measured at the frame's start.

A scanner measures its points one after the other while the vehicle drives: at 20 m/s a frame of 0.1 s is distorted by
2 m. With a known motion, each point is moved by the way that the sensor had come when its pulse left.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from ..errors import InputError
from ..files.arguments import checks_arguments
from ..maths.motion_table import MotionTable, Placement, Travel
from ..maths.pose import Pose
from ..maths.trajectory import Motion, poses_over
from ..maths.vectors import Vector
from .point_cloud import PointCloud

BLOCK_POINTS = 2**18

SHORTEST_S = 1e-9
"""Accuracy bought: length [s] of a frame whose pulses all leave at once: a table of motions has to have one."""

MOTION_KEPT, MOTION_REMOVED = "in the points", "removed"
"""Values of the metadata's `ego_motion` before and after deskewing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Deskewing:
    """Way of the points of one frame to where they are without the sensor's motion; in NumPy, or opaque on the device.

    Attributes:
        sensor: pose of the sensor at the start in the coordinates of the points
        paths: motion of the sensor from then on, in the traced frame
        traced_frame: its pose in the coordinates of the points
    """

    sensor: Placement
    paths: MotionTable
    traced_frame: Placement

    @classmethod
    def of_frames(
        cls, motion: Motion, sensors: Sequence[Pose], *, starts_s: Sequence[float], lengths_s: Sequence[float]
    ) -> list[Deskewing]:
        """Build for several frames, each as if alone.

        Args:
            motion: motion of the sensor in the world
            sensors: its poses at the starts in the coordinates of the points
            starts_s: start of each frame
            lengths_s: length of each
        """
        # The traced frame has its origin at the sensor's position at the start.
        at_starts = poses_over(motion, np.array(starts_s))
        frames = [
            Travel(motions=[motion], start_s=start_s, length_s=max(length_s, SHORTEST_S), centre_m=at_start.position_m)
            for start_s, length_s, at_start in zip(starts_s, lengths_s, at_starts, strict=True)
        ]
        traced_frames = [
            sensor @ Pose(rotation=at_start.rotation.T) for sensor, at_start in zip(sensors, at_starts, strict=True)
        ]
        return [
            cls(sensor=Placement.of_pose(sensor), paths=paths, traced_frame=Placement.of_pose(traced_frame))
            for sensor, paths, traced_frame in zip(sensors, MotionTable.of_frames(frames), traced_frames, strict=True)
        ]

    def points(self, points_m: Vector, pose: Placement) -> Vector:
        """Points of the sensor where ``pose`` has it, the motion's at the time of each; (n,) in double precision."""
        return self.traced_frame.point(pose.point(self.sensor.point_within(points_m)))


@checks_arguments
def deskewed(
    cloud: PointCloud, motion: Annotated[Motion, "a motion such as Simulator.motion"], *, length_s: float | None = None
) -> PointCloud:
    """Remove the sensor's motion; the points stay in their coordinates, those of the frame's start.

    Bodies that move stay distorted, since only the sensor's own motion is known.

    Args:
        cloud: one frame of one sensor, as `Simulator.render` returns it
        motion: motion of the sensor in the world, such as `Simulator.motion`
        length_s: duration of the frame, if the cloud is a piece of one; None: until the cloud's last point

    Raises:
        InputError: for a cloud of several sensors, one that is deskewed already, or one whose metadata do not say when
            it began
    """
    if length_s is not None and not 0.0 <= length_s < math.inf:
        raise InputError(f"deskewed: length_s: must be finite and not below 0 s, got {length_s}")
    if len(cloud.sensor_names) > 1:
        raise InputError("deskewed: must be a cloud of one sensor, deskew before merging")
    if cloud.metadata.get("ego_motion") == MOTION_REMOVED:
        raise InputError("deskewed: must be a raw cloud, got one that is deskewed")
    try:
        start_s = float(cloud.metadata["frame_start_s"])
        goal = _sensor_in_points_frame(cloud)
    except (KeyError, ValueError):
        raise InputError("deskewed: the cloud's metadata do not say when and where it was taken") from None
    removed = {**cloud.metadata, "ego_motion": MOTION_REMOVED}
    if not len(cloud):
        return replace(cloud, metadata=removed)
    length_s = float(cloud.time_s.max() if length_s is None else length_s)
    (deskewing,) = Deskewing.of_frames(motion, [goal], starts_s=[start_s], lengths_s=[length_s])
    turned_back = np.array(deskewing.traced_frame.rotation).reshape(3, 3)
    moved = np.zeros_like(cloud.xyz_m)
    turned_blocks = []
    for first in range(0, len(cloud), BLOCK_POINTS):
        block = slice(first, first + BLOCK_POINTS)
        x, y, z = cloud.xyz_m[block].T.astype(np.float64)
        pose = deskewing.paths.placement(cloud.time_s[block], 0)
        moved[block] = np.stack(deskewing.points((x, y, z), pose), axis=-1)
        if cloud.has_vectors:
            rotations = np.stack(np.broadcast_arrays(*pose.rotation), axis=-1).reshape(-1, 3, 3)
            turned_blocks.append(cloud.select(block).vectors_turned(turned_back @ rotations @ goal.rotation.T))
    vectors: dict[str, Any] = {
        name: np.concatenate([block_vectors[name] for block_vectors in turned_blocks])
        for name in (turned_blocks[0] if turned_blocks else ())
    }
    return replace(cloud, xyz_m=moved, metadata=removed, **vectors)


def _sensor_in_points_frame(cloud: PointCloud) -> Pose:
    """Pose of the sensor at the start, in the coordinates of the points."""
    if cloud.metadata["frame"] == "sensor":
        return Pose()
    rotation = np.array([float(word) for word in cloud.metadata["sensor_rotation"].split()]).reshape(3, 3)
    return Pose(position_m=cloud.sensor_position_m, rotation=rotation)
