"""Clearance: a sensor that stands on a surface, or within a body, is told of before anything is traced.

Its rays would meet that surface at no distance at all, where the lidar equation has no value.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import OptionError
from ..maths.arrays import Numbers
from ..maths.trajectory import pose_at
from .model import Ball, Body, Part, Scene

NARROWEST_ROOM_M = 1.0
"""A closed body that is thinner than this, along one of its own axes, is no room in which a sensor could stand."""

_ENCLOSED = 0.5
"""Share of all directions from which the outside of a body cannot be seen; 1 in a closed body, 0 beside it."""


@dataclass(frozen=True, slots=True, eq=False)
class Clearance:
    """Where the bodies of a scene are.

    bodies  those that have surfaces
    boxes   (b, 2, 3) lowest and highest corner of each in its own frame
    around  (b, 2, 3) the same in the world, of those that stand still; without bounds of those that move
    """

    bodies: tuple[Body, ...]
    boxes: Numbers
    around: Numbers

    @classmethod
    def of(cls, scene: Scene) -> Clearance:
        """Of a scene's own bodies; shapes of a Mitsuba base are not known here."""
        # Copies of a body share their parts.
        boxes = {
            key: _box(parts) for key, parts in {id(body.parts): body.parts for body in scene.bodies}.items()
        }
        found = [(body, box) for body in scene.bodies if (box := boxes[id(body.parts)]) is not None]
        return cls(
            bodies=tuple(body for body, _ in found),
            boxes=np.array([box for _, box in found]).reshape(-1, 2, 3),
            around=np.array([_around(body, box) for body, box in found]).reshape(-1, 2, 3),
        )

    def check(self, place_m: Numbers, *, radius_m: float, time_s: float, sensor: str) -> None:
        """Raise InputError unless a ball around this place is clear of all surfaces, and in no thin body.

        place_m   (3,) of the sensor in the world
        radius_m  of the ball
        time_s    by the clock of the scene's motions
        """
        low, high = self.around[:, 0] - radius_m, self.around[:, 1] + radius_m
        for number in np.flatnonzero(((low <= place_m) & (place_m <= high)).all(axis=1)):
            body, box = self.bodies[number], self.boxes[number]
            pose = body.pose if body.motion is None else pose_at(body.motion, time_s)
            point = pose.inverse_apply(place_m)
            if not ((box[0] - radius_m <= point) & (point <= box[1] + radius_m)).all():
                continue
            near = min(_distance_m(part, point, radius_m) for part in body.parts)
            at = ", ".join(f"{x:g}" for x in np.round(place_m, 3) + 0.0)
            must = f"sensor '{sensor}' at ({at}): must stand at least {1e3 * radius_m:g} mm off every surface"
            if near < radius_m:
                raise OptionError(_MOVED, must, f"{1e3 * near:.4g} mm off '{body.name}'")
            if float(np.ptp(box, axis=0).min()) < NARROWEST_ROOM_M and _enclosed(body.parts, point):
                raise OptionError(_MOVED, must, f"a place within '{body.name}'")


_MOVED = "{0}, got {1}; {pose} or position_m moves it"


def _box(parts: Sequence[Part | Ball]) -> Numbers | None:
    """(2, 3) lowest and highest corner of a body in its frame; None without surfaces."""
    corners = [
        np.outer([-part.radius_m, part.radius_m], np.ones(3))
        if isinstance(part, Ball)
        else np.stack([part.vertices_m.min(axis=0), part.vertices_m.max(axis=0)])
        for part in parts
        if isinstance(part, Ball) or len(part.vertices_m)
    ]
    if not corners:
        return None
    return np.stack([np.min(corners, axis=(0, 1)), np.max(corners, axis=(0, 1))])


def _around(body: Body, box: Numbers) -> Numbers:
    """(2, 3) the box's corners in the world; of a body that moves, all of it."""
    if body.motion is not None:
        return np.array([[-np.inf] * 3, [np.inf] * 3])
    corners = body.pose.apply(np.stack(np.meshgrid(*box.T), axis=-1).reshape(-1, 3))
    return np.stack([corners.min(axis=0), corners.max(axis=0)])


def _distance_m(part: Part | Ball, point: Numbers, radius_m: float) -> float:
    """Of a point to the nearest surface, in the body's frame; infinite beyond ``radius_m``."""
    if isinstance(part, Ball):
        return abs(float(np.linalg.norm(point)) - part.radius_m)
    corners = part.vertices_m[part.faces] - point
    near = (corners.min(axis=1) <= radius_m).all(axis=1) & (corners.max(axis=1) >= -radius_m).all(axis=1)
    return min((_of_triangle_m(one) for one in corners[near]), default=math.inf)


def _of_triangle_m(corners: Numbers) -> float:
    """Distance of the origin to a triangle, (3, 3) its corners."""
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    length = float(np.linalg.norm(normal))
    following = np.roll(corners, -1, axis=0)
    sides = following - corners
    # Above the triangle where the origin is on the inner side of each edge; else the nearest edge counts.
    if length > 0.0 and (np.cross(sides, -corners) @ normal >= 0.0).all():
        return abs(float(corners[0] @ normal)) / length
    square = np.maximum((sides * sides).sum(axis=1), 1e-300)
    along = np.clip(-(corners * sides).sum(axis=1) / square, 0.0, 1.0)
    return float(np.linalg.norm(corners + along[:, None] * sides, axis=1).min())


def _enclosed(parts: Sequence[Part | Ball], point: Numbers) -> bool:
    """Whether a body is all around a point of its frame: the solid angles of its triangles, van Oosterom and Strackee
    (IEEE Trans. Biomed. Eng. 30, 1983), add up to 4 pi in a closed mesh and to 0 outside of it.
    """
    total = 0.0
    for part in parts:
        if isinstance(part, Ball):
            total += 4.0 * math.pi * float(np.linalg.norm(point) < part.radius_m)
            continue
        a, b, c = np.moveaxis(part.vertices_m[part.faces] - point, 1, 0)
        la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        volume = (a * np.cross(b, c)).sum(axis=1)
        other = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
        total += 2.0 * float(np.arctan2(volume, other).sum())
    return abs(total) / (4.0 * math.pi) > _ENCLOSED
