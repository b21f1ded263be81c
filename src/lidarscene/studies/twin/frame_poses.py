"""Pose of the sensor in each frame of a recording: its own poses, or frames registered to each other."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...files.open3d import open3d
from ...maths.pose import Pose
from ...recordings.sweep import Sweep

VOXEL_M = 0.3
"""Edge of the cubes in which points are thinned to one before registration."""

LARGEST_PAIR_DISTANCE_M = (2.0, 0.5)
"""Largest distance of paired points in the first and the second round of registration."""


def place_frames(sweeps: Mapping[int, Sweep], first: int) -> dict[int, Pose]:
    """Pose of every frame in the axes of frame ``first``.

    Without poses in the recording each frame is registered to its neighbour towards ``first`` (point-to-plane ICP,
    Open3D).
    """
    if len(sweeps) == 1:
        return {first: Pose()}
    if all(sweep.pose is not None for sweep in sweeps.values()):
        first_from_world = _pose(sweeps[first]).inverse()
        return {number: first_from_world @ _pose(sweep) for number, sweep in sweeps.items()}
    clouds = {number: _thin(sweep) for number, sweep in sweeps.items()}
    places = {first: Pose()}
    for order in (sorted(n for n in sweeps if n > first), sorted((n for n in sweeps if n < first), reverse=True)):
        previous = first
        for number in order:
            places[number] = places[previous] @ _register(clouds[number], clouds[previous])
            previous = number
    return places


def angles_deg(pose: Pose) -> tuple[float, float, float]:
    """Yaw, pitch and roll of a pose [deg]."""
    rotation = pose.rotation
    yaw, roll = math.atan2(rotation[1, 0], rotation[0, 0]), math.atan2(rotation[2, 1], rotation[2, 2])
    return math.degrees(yaw), math.degrees(math.asin(max(-1.0, min(1.0, rotation[2, 0])))), math.degrees(roll)


def _pose(sweep: Sweep) -> Pose:
    assert sweep.pose is not None
    return sweep.pose


def _thin(sweep: Sweep) -> Any:
    """Thinned Open3D cloud of the first returns, with normals."""
    o3d = open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(sweep.xyz_m[sweep.has_return])).voxel_down_sample(
        VOXEL_M
    )
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(20))
    return cloud


def _register(cloud: Any, reference: Any) -> Pose:
    """Pose of one cloud in the axes of another that it overlaps, by point-to-plane ICP."""
    registration = open3d().pipelines.registration
    matrix = np.eye(4)
    for within_m in LARGEST_PAIR_DISTANCE_M:
        matrix = registration.registration_icp(
            cloud, reference, within_m, matrix, registration.TransformationEstimationPointToPlane()
        ).transformation
    return Pose(position_m=np.array(matrix[:3, 3]), rotation=np.array(matrix[:3, :3]))
