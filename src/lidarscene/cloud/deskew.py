"""Deskew: a cloud of a sensor that moved in, the cloud that it would be had every point been taken at once out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import InputError
from ..maths.paths import Paths
from ..maths.pose import Pose
from ..maths.trajectory import Motion, pose_at
from .points import PointCloud

BLOCK_POINTS = 2**18
SHORTEST_S = 1e-9

REMOVED = "removed"
"""What the metadata's `ego_motion` says afterwards."""


def deskewed(cloud: PointCloud, motion: Motion, *, length_s: float | None = None) -> PointCloud:
    """The points where they are in the world, in the same frame as before: that of the frame's start.

    Each point is moved by how far the sensor has come since the frame began when its pulse left. What moves itself
    stays distorted, as it does for whoever knows his own motion only.

    cloud   of one frame, of one sensor, as `Simulator.render` gives it
    motion  of the sensor in the world, such as `Simulator.motion`
    length_s  of the frame, if the cloud is a piece of one: all are moved alike; None: until the cloud's last point
    Raises InputError for a cloud of several sensors, one that is deskewed, or one whose metadata do not tell when it
    began.
    """
    if len(cloud.sensor_names) > 1:
        raise InputError("deskewed: a cloud of one sensor was expected, deskew before merging")
    if cloud.metadata.get("ego_motion") == REMOVED:
        raise InputError("deskewed: this cloud is deskewed, a raw one was expected")
    try:
        start_s = float(cloud.metadata["frame_start_s"])
        goal = _goal(cloud)
    except (KeyError, ValueError):
        raise InputError("deskewed: the cloud's metadata do not say when and where it was taken") from None
    length_s = max(float(cloud.time_s.max(initial=0.0)) if length_s is None else length_s, SHORTEST_S)
    at_start = pose_at(motion, start_s)
    paths = Paths.of([motion], start_s=start_s, length_s=length_s, centre_m=at_start.position_m)
    # From the traced frame, whose origin is where the sensor was at the start, to that of the points.
    back = goal @ Pose(rotation=at_start.rotation.T)
    moved = np.zeros_like(cloud.xyz_m)
    for first in range(0, len(cloud), BLOCK_POINTS):
        block = slice(first, first + BLOCK_POINTS)
        own = goal.inverse_apply(cloud.xyz_m[block])
        x, y, z = paths.at(cloud.time_s[block], 0).point((own[:, 0], own[:, 1], own[:, 2]))
        moved[block] = back.apply(np.stack([x, y, z], axis=-1))
    return replace(cloud, xyz_m=moved, metadata={**cloud.metadata, "ego_motion": REMOVED})


def _goal(cloud: PointCloud) -> Pose:
    """Pose of the sensor at the start, in the coordinates of the points."""
    if cloud.metadata["frame"] == "sensor":
        return Pose()
    rotation = np.array([float(word) for word in cloud.metadata["sensor_rotation"].split()]).reshape(3, 3)
    return Pose(position_m=cloud.sensor_position_m, rotation=rotation)
