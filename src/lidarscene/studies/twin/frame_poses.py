"""Pose of the sensor in each frame of a recording: its own poses, or frames registered to each other."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ...errors import OptionWarning, warn
from ...files.open3d import open3d
from ...maths.arrays import Numbers
from ...maths.pose import Pose
from ...recordings.sweep import Sweep
from .tuning import (
    CLIP_SIGMAS,
    LARGEST_CHANGE_M,
    LARGEST_PAIR_DISTANCE_M,
    LARGEST_SHIFT_M,
    LEAST_FIT,
    REGISTRATION_VOXEL_M,
)

LEAST_SHARED = 1000
"""Least number of pixels with a return in both frames that tell rest from motion."""


def place_frames(sweeps: Mapping[int, Sweep], first: int) -> dict[int, Pose]:
    """Pose of every frame in the axes of frame ``first``.

    Without poses in the recording each frame is registered to its neighbour towards ``first`` (point-to-plane ICP,
    Open3D), unless the sensor stood still (`is_at_rest`).
    """
    if len(sweeps) == 1:
        return {first: Pose()}
    if all(sweep.pose is not None for sweep in sweeps.values()):
        first_from_world = _pose(sweeps[first]).inverse()
        return {number: first_from_world @ _pose(sweep) for number, sweep in sweeps.items()}
    cloud_of = functools.cache(lambda number: _thin(sweeps[number]))
    places = {first: Pose()}
    for order in (sorted(n for n in sweeps if n > first), sorted((n for n in sweeps if n < first), reverse=True)):
        previous = first
        for number in order:
            places[number] = places[previous]
            if not is_at_rest(sweeps[number], sweeps[previous]):
                places[number] = places[previous] @ _register(cloud_of, number, previous)
            previous = number
    return places


def _pose(sweep: Sweep) -> Pose:
    assert sweep.pose is not None
    return sweep.pose


def is_at_rest(sweep: Sweep, other: Sweep) -> bool:
    """Compare two frames of rows and columns pixel by pixel: True if the sensor neither moved nor turned between them.

    A shift by d changes ranges by -d times the beam's direction, so d follows by least squares; a turn by a column
    leaves ranges that differ more than those of the same column. Noise alone shifts a frame of few pixels, too.
    """
    if len(sweep.shape) != 2 or sweep.shape != other.shape:
        return False

    def changes_m(columns: int) -> Numbers:
        change_m = sweep.range_m - np.roll(other.range_m, columns, axis=1)
        return np.where(np.isfinite(change_m), change_m, np.inf)

    change_m = changes_m(0)
    shared = np.abs(change_m) < LARGEST_CHANGE_M
    if shared.sum() < LEAST_SHARED:
        return False
    direction = sweep.direction[shared]
    inverse = np.linalg.pinv(direction)
    shift_m = inverse @ -change_m[shared]
    noise_m = float(np.std(change_m[shared] + direction @ shift_m) * np.linalg.norm(inverse))
    agreeing = [int((np.abs(changes_m(columns)) < LARGEST_SHIFT_M).sum()) for columns in (-1, 0, 1)]
    is_same_place = np.linalg.norm(shift_m) < math.hypot(LARGEST_SHIFT_M, CLIP_SIGMAS * noise_m)
    return bool(is_same_place and agreeing[1] > max(agreeing[0], agreeing[2]))


def _thin(sweep: Sweep) -> Any:
    """Thinned Open3D cloud of the first returns, with normals."""
    o3d = open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(sweep.xyz_m[sweep.has_return])).voxel_down_sample(
        REGISTRATION_VOXEL_M
    )
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(20))
    return cloud


def _register(cloud_of: Callable[[int], Any], number: int, reference: int) -> Pose:
    """Pose of one frame in the axes of another that it overlaps, by point-to-plane ICP; warns if it does not fit."""
    registration = open3d().pipelines.registration
    cloud, target = cloud_of(number), cloud_of(reference)
    by_planes = registration.TransformationEstimationPointToPlane()
    matrix = np.eye(4)
    for within_m in LARGEST_PAIR_DISTANCE_M:
        fit = registration.registration_icp(cloud, target, within_m, matrix, by_planes)
        matrix = fit.transformation
    if fit.fitness < LEAST_FIT:
        near = "frame {0} does not fit frame {1}: {2} of its points are near one of that; "
        must = "frames must follow each other, up to 8 m apart, or have poses"
        warn(OptionWarning(near + must, number, reference, f"{fit.fitness:.0%}"))
    return Pose(position_m=np.array(matrix[:3, 3]), rotation=np.array(matrix[:3, :3]))
