"""A list of points as quads: what can be done where rows, columns and lost pulses are not known.

Planes come from the nearest points (Open3D), quads are as wide as these are apart, and the ground is one plane.
"""

from __future__ import annotations

import numpy as np

from ...files.open3d import open3d
from ...maths.arrays import Numbers
from ...recordings.sweep import Sweep
from .planes import LEAST_COS
from .reflect import Gauge, largest_reflectivity, scattering_law
from .surfels import BRIGHT, GROUND, ROUGH, SMOOTH, Surfels, join_surfels

NEIGHBOURS = 20
"""Of a point, which its plane is fitted to."""

SPACING_OF = 5
"""Quads reach half way to the neighbour of this number."""

SMOOTH_CURVATURE = 0.01
"""Least over all variance of the neighbours, below which a surface is called smooth."""

CELL_M = 2.0
"""Edge of the ground's quads."""

BELOW_M = 0.1
"""The completed ground lies so much below its plane, under what was measured of it."""


def surfels_of_points(sweep: Sweep, gauge: Gauge | None, ground: Numbers | None) -> Surfels:
    """Quads of the points, in the sensor's frame; ``ground`` as of `surfels.surfels_of`."""
    points = sweep.xyz_m[sweep.kept]
    range_m, direction = sweep.range_m[sweep.kept], sweep.direction[sweep.kept]
    o3d = open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.estimate_covariances(o3d.geometry.KDTreeSearchParamKNN(NEIGHBOURS))
    spread, axes = np.linalg.eigh(np.asarray(cloud.covariances))
    normal = axes[..., 0]
    facing = np.einsum("ni,ni->n", normal, direction)
    normal = np.where(facing[:, None] > 0.0, -normal, normal)
    flat = np.abs(facing) < LEAST_COS
    normal = np.where(flat[:, None], -direction, normal)
    smooth = (spread[:, 0] < SMOOTH_CURVATURE * spread.sum(axis=1)) & ~flat
    apparent = np.full(len(points), 0.2) if gauge is None else gauge.apparent(sweep, sweep.range_m)[sweep.kept]
    reflectivity = apparent / scattering_law(-np.einsum("ni,ni->n", normal, direction))
    bright = reflectivity > largest_reflectivity()
    kind = np.where(bright, BRIGHT, np.where(smooth, SMOOTH, ROUGH))
    half_m = 0.5 * _spacing_m(points)
    quads = Surfels(
        corners_m=_squares(points, np.where(bright[:, None], -direction, normal), half_m),
        reflectivity=np.where(bright, apparent, reflectivity),
        kind=kind,
    )
    if ground is None:
        return quads
    on_ground = np.abs(points[:, 2] - ground[0] - points[:, :2] @ ground[1:]) < 0.1
    return join_surfels([quads, _plane(ground, float(np.percentile(range_m[on_ground], 99.0)), reflectivity[on_ground])])


def _spacing_m(points: Numbers) -> Numbers:
    """Distance to a near neighbour of each point."""
    search = open3d().core.nns.NearestNeighborSearch(open3d().core.Tensor(points))
    search.knn_index()
    _, squares = search.knn_search(open3d().core.Tensor(points), min(SPACING_OF + 1, len(points)))
    return np.asarray(np.sqrt(squares.numpy()[:, -1]))


def _squares(points: Numbers, normal: Numbers, half_m: Numbers) -> Numbers:
    """(n, 4, 3) corners of squares about the points, across the normals."""
    helper_axis = np.where(np.abs(normal[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    u = np.cross(helper_axis, normal)
    u = u / np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(normal, u)
    u, v = half_m[:, None] * u, half_m[:, None] * v
    return np.asarray(points[:, None] + np.stack([u + v, v - u, -u - v, u - v], axis=1))


def _plane(ground: Numbers, reach_m: float, reflectivity: Numbers) -> Surfels:
    steps = np.arange(-reach_m, reach_m, CELL_M) + 0.5 * CELL_M
    x, y = (coordinates.ravel() for coordinates in np.meshgrid(steps, steps))
    inside = np.hypot(x, y) < reach_m
    corners = []
    for right, up in ((0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)):
        a, b = x[inside] + right * CELL_M, y[inside] + up * CELL_M
        corners.append(np.stack([a, b, ground[0] + ground[1] * a + ground[2] * b - BELOW_M], axis=-1))
    n = int(inside.sum())
    level = min(float(np.median(reflectivity)), largest_reflectivity())
    return Surfels(corners_m=np.stack(corners, axis=1), reflectivity=np.full(n, level), kind=np.full(n, GROUND))
