"""Vector optics on tuples (x, y, z) of numbers or arrays: mirrors, refraction, angles; boxes and hulls of points.

A tuple of three arrays works on numpy and Dr.Jit alike and needs no vector type.

Symbols: d direction, n normal, theta_i and theta_t angles before and behind a face.
"""

from __future__ import annotations

import numpy as np

from .arrays import Lanes, Numbers, xp

Vector = tuple[Lanes, Lanes, Lanes]

FORWARD: Vector = (1.0, 0.0, 0.0)
"""Choice: axis x of the coordinates (docs/conventions.md)."""

LEFT: Vector = (0.0, 1.0, 0.0)
"""Choice: axis y of the coordinates."""

UP: Vector = (0.0, 0.0, 1.0)
"""Choice: axis z of the coordinates."""


def dot(a: Vector, b: Vector) -> Lanes:
    """a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def cross_in_plane(a: Numbers, b: Numbers) -> Numbers:
    """(...) a x b of vectors (..., 2) in a plane; further coordinates do not count."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def weighted_sum(a: Lanes, u: Vector, b: Lanes, v: Vector) -> Vector:
    """a u + b v."""
    return a * u[0] + b * v[0], a * u[1] + b * v[1], a * u[2] + b * v[2]


def unit(a: Vector) -> Vector:
    """a / |a|."""
    length = xp(*a).sqrt(dot(a, a))
    return a[0] / length, a[1] / length, a[2] / length


def reflected(direction: Vector, normal: Vector) -> Vector:
    """d - 2 (d . n) n: a ray reflected by a mirror. The sign of the unit normal does not matter."""
    return weighted_sum(1.0, direction, -2.0 * dot(direction, normal), normal)


def refracted(direction: Vector, normal: Vector, index_ratio: Lanes) -> tuple[Vector, Lanes]:
    """A ray through a face, by Snell's law in vector form, and cos(theta_t) / cos(theta_i).

    The ratio of cosines is the factor by which a beam widens, since both beams cover the same part of the face. Under
    total reflection the direction is undefined and the ratio 0.

    Args:
        normal: unit, along the light (d . n > 0)
        index_ratio: index before the face over index behind it
    """
    cos_in = dot(direction, normal)
    inside = 1.0 - index_ratio * index_ratio * (1.0 - cos_in * cos_in)
    ops = xp(inside)
    cos_out = ops.sqrt(ops.maximum(inside, 0.0))
    bent = weighted_sum(index_ratio, direction, cos_out - index_ratio * cos_in, normal)
    return bent, cos_out / cos_in


def angles_of(direction: Vector) -> tuple[Lanes, Lanes]:
    """Azimuth and elevation [rad] of a direction: the inverse of `maths.pose.direction_from_angles`."""
    x, y, z = direction
    ops = xp(x, y, z)
    return ops.atan2(y, x), ops.atan2(z, ops.sqrt(x * x + y * y))


def perpendicular_pair(direction: Vector) -> tuple[Vector, Vector]:
    """Two unit vectors perpendicular to a unit direction and to each other (Duff et al., JCGT 6(1), 2017)."""
    x, y, z = direction
    ops = xp(z)
    sign = ops.where(z >= 0.0, 1.0, -1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    return (1.0 + sign * x * x * a, sign * b, -sign * x), (b, sign + y * y * a, -y)


def box_around(points: Numbers) -> Numbers:
    """Lowest and highest of each coordinate of (n, d) points, n > 0: (2, d)."""
    # Column by column: along rows of three NumPy takes twenty times as long.
    return np.array([[column.min() for column in points.T], [column.max() for column in points.T]])


def convex_hull(points: Numbers) -> Numbers:
    """Corners (k, 2) of the convex hull of (n, 2) points, counter-clockwise; the two ends where they lie on a line."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:  # all on a line, or fewer than three
        along = points[:, np.ptp(points, axis=0).argmax()]
        return np.asarray(points[[along.argmin(), along.argmax()]])
