"""Shared faces: places at which two bodies have one and the same surface.

Which of the two a point names is a matter of rounding there. Faces that look the same way, towards the sensor, count:
a marking at the height of its road, two roofs in one plane. Those that look at each other are a contact, such as of a
box and its ground, and no beam comes between.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..maths.arrays import Numbers
from .scene import Body, Part, Scene

MOST_TRIANGLES = 4_096
"""Choice: largest number of triangles of a body that is examined: finer meshes are curved, and would take seconds."""

PLANE_STEP_M = 1.37e-4
"""Choice: distance up to which planes count as one, metres. No round number, so that planes at round distances, which
people write, are not at the border between two steps."""

NORMAL_STEP = 1.37e-4
"""Choice: the same for the components of unit normals: 1 mm in 7 m."""

LEAST_OVERLAP_M = 1e-3
"""Choice: least width of a shared place, metres: bodies that touch along an edge share nothing."""

_MIXED = np.array([0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D, 0x27D4EB2F], dtype=np.int64)

BLOCK = 64
"""Triangles of one body that meet those of another at once, so that two sheets of `MOST_TRIANGLES` take 15 MiB."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SharedFaces:
    """Two bodies that share faces, and differ in class or material.

    Attributes:
        names: of the bodies
        place_m: (x, y, z) of one such place in the world
    """

    names: tuple[str, str]
    place_m: tuple[float, float, float]


def shared_faces(scene: Scene, sensor_m: Numbers) -> list[SharedFaces]:
    """Find the pairs of bodies that stand still and share faces, each once, in the order of the scene.

    Spheres, bodies of more than `MOST_TRIANGLES` triangles and those of a Mitsuba base are left out.

    Args:
        sensor_m: (3,) place towards which the faces look
    """
    bodies = [body for body in scene.bodies if body.motion is None and not body.away and _is_examined(body)]
    if len(bodies) < 2:
        return []
    corners = [_corners(body) for body in bodies]
    owner = np.repeat(np.arange(len(bodies)), [len(triangles) for triangles in corners])
    triangles = np.concatenate(corners)
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(normal, axis=1)
    looks_there = np.einsum("ij,ij->i", normal, sensor_m - triangles[:, 0]) > 0.0
    kept = looks_there & (area > LEAST_OVERLAP_M**2)
    owner, triangles, normal = owner[kept], triangles[kept], normal[kept] / area[kept, None]
    if not len(owner):
        return []
    # From the middle of the bodies: a normal's rounding counts by the distance.
    along = np.einsum("ij,ij->i", triangles[:, 0] - triangles.mean(axis=(0, 1)), normal)
    steps = np.column_stack([np.rint(normal / NORMAL_STEP), np.rint(along / PLANE_STEP_M)]).astype(np.int64)
    # Leaves, of which there are most, have planes of their own: one sum, all but unique, sorts them out.
    _, plane, count = np.unique(steps @ _MIXED, return_inverse=True, return_counts=True)
    kept = count[plane] > 1
    owner, triangles, normal, steps = owner[kept], triangles[kept], normal[kept], steps[kept]
    if not len(owner):
        return []
    order = np.lexsort((owner, *steps.T))
    begins = np.flatnonzero((np.diff(steps[order], axis=0, prepend=-1) != 0).any(axis=1))
    ends = np.append(begins[1:], len(order))
    of_several = owner[order[begins]] != owner[order[ends - 1]]
    found: dict[tuple[int, int], tuple[float, float, float]] = {}
    for begin, end in zip(begins[of_several], ends[of_several], strict=True):
        plane = order[begin:end]
        found |= dict(_overlaps(owner[plane], triangles[plane], normal[plane[0]]))
    looks = [(body.class_name, {part.material for part in body.parts}) for body in bodies]
    return [
        SharedFaces(names=(bodies[first].name, bodies[second].name), place_m=found[first, second])
        for first, second in sorted(found)
        if looks[first] != looks[second]
    ]


def _is_examined(body: Body) -> bool:
    parts = [part for part in body.parts if isinstance(part, Part)]
    return 0 < sum(len(part.faces) for part in parts) <= MOST_TRIANGLES


def _corners(body: Body) -> Numbers:
    """(n, 3, 3) corners of a body's triangles in the world."""
    parts = [part for part in body.parts if isinstance(part, Part)]
    corners: Numbers = np.concatenate([body.pose.apply(part.vertices_m)[part.faces] for part in parts])
    return corners


def _overlaps(
    owner: Numbers, triangles: Numbers, normal: Numbers
) -> Iterator[tuple[tuple[int, int], tuple[float, float, float]]]:
    """Yield the pairs of bodies whose triangles in one plane overlap, and about where.

    Args:
        owner: (n,) rising numbers of the bodies
        triangles: (n, 3, 3) corners
        normal: (3,) of the plane
    """
    # First the two coordinates along which the plane is least foreshortened: lengths are 0.58 of their own at least.
    along = int(np.argmax(np.abs(normal)))
    axes = [axis for axis in range(3) if axis != along]
    turned = triangles[:, :, [*axes, along]]
    begins = np.flatnonzero(np.diff(owner, prepend=-1))
    flat = turned[:, :, :2]
    low, high = np.minimum.reduceat(flat.min(axis=1), begins), np.maximum.reduceat(flat.max(axis=1), begins)
    of_body = np.split(turned, begins[1:])
    for number in range(len(begins) - 1):
        near = (low[number] + LEAST_OVERLAP_M < high[number + 1 :]) & (
            low[number + 1 :] + LEAST_OVERLAP_M < high[number]
        )
        for other in np.flatnonzero(near.all(axis=1)) + number + 1:
            bounds = np.maximum(low[number], low[other]), np.minimum(high[number], high[other])
            place = _overlap(*(_within(of_body[body], *bounds) for body in (number, other)))
            if place is not None:
                x, y, z = np.insert(place[:2], along, place[2]).tolist()
                yield (int(owner[begins[number]]), int(owner[begins[other]])), (x, y, z)


def _within(triangles: Numbers, low: Numbers, high: Numbers) -> Numbers:
    """Triangles, (n, 3, 3), whose boxes in the plane reach into a box."""
    flat = triangles[:, :, :2]
    near: Numbers = triangles[((flat.min(axis=1) < high) & (flat.max(axis=1) > low)).all(axis=1)]
    return near


def _overlap(first: Numbers, second: Numbers) -> Numbers | None:
    """(3,) place at which triangles (n, 3, 3) and (m, 3, 3) meet, to the size of the triangles; None: nowhere."""
    for begin in range(0, len(first), BLOCK):
        block = first[begin : begin + BLOCK]
        pairs = np.argwhere(_overlaps_in_plane(block[:, :, :2], second[:, :, :2]))
        a, b = block[pairs[:, 0]], second[pairs[:, 1]]
        low, high = np.maximum(a.min(axis=1), b.min(axis=1)), np.minimum(a.max(axis=1), b.max(axis=1))
        place = 0.5 * (low + high)[:, :2]
        # Far from the middle of the bodies planes of one step may be apart here, as two slopes are that meet elsewhere.
        height, other = _height(a, place), _height(b, place)
        met = np.flatnonzero(np.abs(other - height) < 2.0 * PLANE_STEP_M)
        if len(met):
            return np.append(place[met[0]], height[met[0]])
    return None


def _height(triangles: Numbers, place: Numbers) -> Numbers:
    """(n,) third coordinates of the planes of (n, 3, 3) triangles at (n, 2) places."""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    rise = (normal[:, :2] * (place - triangles[:, 0, :2])).sum(axis=1) / normal[:, 2]
    return np.asarray(triangles[:, 0, 2] - rise)


def _overlaps_in_plane(first: Numbers, second: Numbers) -> Numbers:
    """(n, m) whether two triangles overlap: no edge of one has the other on its far side (separating axes)."""
    overlap = np.ones((len(first), len(second)), dtype=bool)
    for one, side in ((first, 1), (second, 0)):
        for corner in range(3):
            edge = np.roll(one, -1, axis=1)[:, corner] - one[:, corner]
            across = np.stack([-edge[:, 1], edge[:, 0]], axis=-1) / np.linalg.norm(edge, axis=-1)[:, None]
            across = np.expand_dims(across, (side, 2))
            a, b = ((across * corners).sum(axis=-1) for corners in (first[:, None], second[None]))
            depth = np.minimum(a.max(axis=-1), b.max(axis=-1)) - np.maximum(a.min(axis=-1), b.min(axis=-1))
            overlap &= depth > LEAST_OVERLAP_M
    return overlap
