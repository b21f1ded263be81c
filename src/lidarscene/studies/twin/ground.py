"""The ground around a sensor: its plane, and the points on it."""

from __future__ import annotations

import numpy as np

from ...maths.arrays import Numbers
from .tuning import LEAST_COS

GROUND_NEAR_M = 25.0
"""Choice: farthest points to which the ground's plane is fitted, so that a slope or a hill does not tilt it."""

LEAST_GROUND = 100
"""Fewest points that make a plane."""

GROUND_COS = 0.95
"""Choice: least cosine between the normals of a pixel's own plane and of the ground's, of a pixel on the ground."""


def farthest_ground_m(xyz_m: Numbers) -> float | None:
    """Range of the ground's farthest return (99.9 %) [m]; None without a plane.

    Points within 0.1 m of `ground_plane`, or within 0.3 % of their range, are on the ground.
    """
    plane = ground_plane(xyz_m)
    if plane is None:
        return None
    range_m = np.sqrt(np.sum(xyz_m**2, axis=1))
    on_ground = np.abs(height_above(plane, xyz_m)) < np.maximum(0.1, 0.003 * range_m)
    return float(np.percentile(range_m[on_ground], 99.9))


def ground_plane(xyz_m: Numbers) -> Numbers | None:
    """Fit the plane z = a + b x + c y to the ground near the sensor: (3,) a, b, c; None if there is no ground.

    The fit starts at the lowest well-filled 0.2 m of height below the sensor. It is repeated with the points within
    0.3, 0.15 and 0.1 m of the plane.
    """
    level_m = np.hypot(xyz_m[:, 0], xyz_m[:, 1])
    near = xyz_m[(level_m < GROUND_NEAR_M) & (xyz_m[:, 2] < -0.2)]
    if len(near) < LEAST_GROUND:
        return None
    # The lowest layer with at least 0.3 of the fullest one's points: stray points below the ground are too few for it.
    counts, edges = np.histogram(near[:, 2], bins=np.arange(near[:, 2].min(), 0.2, 0.2))
    start = int(np.argmax(counts >= 0.3 * counts.max()))
    plane: Numbers = np.array([0.5 * (edges[start] + edges[start + 1]), 0.0, 0.0])
    for within_m in (0.3, 0.15, 0.1):
        chosen = near[np.abs(height_above(plane, near)) < within_m]
        if len(chosen) < LEAST_GROUND:
            return None
        design = np.column_stack([np.ones(len(chosen)), chosen[:, :2]])
        plane = np.linalg.lstsq(design, chosen[:, 2], rcond=None)[0]
    return plane


def leaning_as_ground(plane: Numbers | None, normal: Numbers, direction: Numbers) -> Numbers:
    """Normals (..., 3), with the ground's own in place of all within `GROUND_COS` of it; None: there is no ground.

    Seen flat, a plane through a few rings leans by chance as much as the ground does: all of it leans as one.

    Args:
        direction: (..., 3) beams; one that runs along the ground or away from it keeps its normal
    """
    if plane is None:
        return normal
    upward = np.array([-plane[1], -plane[2], 1.0]) / np.linalg.norm([*plane[1:], 1.0])
    is_ground = (normal @ upward > GROUND_COS) & (-direction @ upward > LEAST_COS)
    return np.where(is_ground[..., None], upward, normal)


def height_above(plane: Numbers, xyz_m: Numbers) -> Numbers:
    """(n,) vertical distance of points above the plane."""
    return np.asarray(xyz_m[:, 2] - plane[0] - xyz_m[:, :2] @ plane[1:])
