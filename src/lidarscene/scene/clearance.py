"""Clearance: distance of a sensor to the surfaces around it, computed before anything is traced.

A sensor on a surface, or within a thin body, is refused: its rays would meet that surface at no distance at all, where
the lidar equation has no value. `rendering.surroundings` warns of other odd places.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from ..errors import OptionError
from ..maths.arrays import Numbers
from ..maths.trajectory import Motion, pose_at, poses_at
from ..maths.vectors import box_around, cross_in_plane
from .scene import Ball, Body, Part, Scene, box_of

NARROWEST_ROOM_M = 1.0
"""Choice: least extent of a room. A sensor inside a closed body that is thinner along one of its axes is refused."""

_ENCLOSED = 0.5
"""Choice: least share of directions that a body blocks around a point inside it; it is 1 in a closed body, 0 beside
it."""

_SHUT = 0.9
"""Choice: least share of directions blocked in a room that is closed but for gaps; a room with an open side has
less."""


_NEAR_M = 10.0
"""Choice: margin beyond the nearest bounding box within which boxes are refined in the body's own frame."""


class NearSurface(NamedTuple):
    """Distance to a surface and the name of its body; inf and "" if there is none."""

    distance_m: float = math.inf
    body: str = ""


@dataclass(frozen=True, slots=True)
class Surrounding:
    """Surfaces around a place.

    Attributes:
        nearest: in any direction
        below: straight down, among bodies that stand still
        above: straight up, among bodies that stand still
        within: name of a body that encloses the place, or None
    """

    nearest: NearSurface
    below: NearSurface
    above: NearSurface
    within: str | None


@dataclass(frozen=True, slots=True, eq=False)
class Clearance:
    """Bounding boxes of the bodies of a scene.

    Attributes:
        bodies: bodies that have surfaces
        boxes: (b, 2, 3) lowest and highest corner of each in its own frame
        around: (b, 2, 3) the same in the world; infinite for bodies that move
        blocks: id of a part -> the part and the boxes of its triangles in blocks of 512; filled on demand
    """

    bodies: tuple[Body, ...]
    boxes: Numbers
    around: Numbers
    blocks: dict[int, tuple[Part, Numbers]] = field(default_factory=dict)

    @classmethod
    def of_scene(cls, scene: Scene) -> Clearance:
        """Build from a scene's own bodies. Shapes of a Mitsuba base are left out."""
        bodies = [body for body in scene.bodies if not body.away]
        # Copies of a body share their parts.
        box_of_parts = {key: box_of(parts) for key, parts in {id(body.parts): body.parts for body in bodies}.items()}
        bodies = [body for body in bodies if box_of_parts[id(body.parts)] is not None]
        boxes = np.array([box_of_parts[id(body.parts)] for body in bodies]).reshape(-1, 2, 3)
        place_m = np.array([body.pose.position_m for body in bodies]).reshape(-1, 1, 3)
        rotation = np.array([body.pose.rotation for body in bodies]).reshape(-1, 3, 3)
        corners = _corners(boxes) @ rotation.transpose(0, 2, 1) + place_m
        around = np.stack([corners.min(axis=1), corners.max(axis=1)], axis=1)
        around[[body.motion is not None for body in bodies]] = [[-np.inf], [np.inf]]
        return cls(bodies=tuple(bodies), boxes=boxes, around=around)

    def check(
        self,
        place_m: Numbers,
        *,
        radius_m: float,
        time_s: float,
        sensor: str,
        standing: Mapping[Motion, tuple[Numbers, Numbers]] = MappingProxyType({}),
    ) -> None:
        """Raise InputError unless a ball around this place is clear of all surfaces, and in no thin body.

        Args:
            place_m: (3,) position of the sensor in the world
            radius_m: radius of the ball
            time_s: time by the clock of the scene's motions
            standing: places and rotations at this time that are known, by motion
        """
        low, high = self.around[:, 0] - radius_m, self.around[:, 1] + radius_m
        near_boxes = np.flatnonzero(((low <= place_m) & (place_m <= high)).all(axis=1)).tolist()
        nearby = [body_index for body_index in near_boxes if self.bodies[body_index].is_present(time_s)]
        if not nearby:
            return
        bodies = [self.bodies[body_index] for body_index in nearby]
        known = [None if body.motion is None else standing.get(body.motion) for body in bodies]
        unknown = [body.motion if place is None else None for body, place in zip(bodies, known, strict=True)]
        poses = [then or body.pose for body, then in zip(bodies, poses_at(unknown, time_s), strict=True)]
        placed = [place or (pose.position_m, pose.rotation) for place, pose in zip(known, poses, strict=True)]
        places_m, turns = map(np.stack, zip(*placed, strict=True))
        points = np.einsum("bji,bj->bi", turns, place_m - places_m)
        boxes = self.boxes[nearby]
        within = ((boxes[:, 0] - radius_m <= points) & (points <= boxes[:, 1] + radius_m)).all(axis=1)
        for row in np.flatnonzero(within).tolist():
            body, box, point = bodies[row], boxes[row], points[row]
            near = min(self._distance_m(part, point, radius_m) for part in body.parts)
            place_text = ", ".join(f"{coordinate:g}" for coordinate in np.round(place_m, 3) + 0.0)
            must = f"sensor '{sensor}' at ({place_text}): must stand at least {1e3 * radius_m:g} mm off every surface"
            if near < radius_m:
                raise OptionError(_MOVED, must, f"{1e3 * near:.4g} mm off '{body.name}'")
            if float(np.ptp(box, axis=0).min()) < NARROWEST_ROOM_M and _enclosed_share(body.parts, point) > _ENCLOSED:
                raise OptionError(_MOVED, must, f"a place within '{body.name}'")

    def corners(self, *, time_s: float) -> Numbers:
        """(k, 3) points in the world whose box holds all bodies, as they stand at a time."""
        still = self.around[np.isfinite(self.around).all(axis=(1, 2))].reshape(-1, 3)
        moving = [
            pose_at(body.motion, time_s).apply(_corners(box))
            for body, box in zip(self.bodies, self.boxes, strict=True)
            if body.motion is not None and body.is_present(time_s)
        ]
        return np.concatenate([still, *moving])

    def over_ground(self, place_m: Numbers) -> Numbers:
        """(n,) whether a body that stands still is above or below (n, 3) places, by its box."""
        low, high = (corner[np.isfinite(self.around).all(axis=(1, 2)), :2] for corner in np.moveaxis(self.around, 1, 0))
        flags = [((low <= place) & (place <= high)).all(axis=1).any() for place in place_m[:, :2]]
        return np.array(flags, dtype=bool)

    def around_place(self, place_m: Numbers, *, time_s: float) -> Surrounding:
        """Find the surfaces around a place in the world, and the body that encloses it.

        Boxes come first, so that the triangles of only a few bodies are searched.
        """
        gaps_m = np.linalg.norm(
            np.maximum(np.maximum(self.around[:, 0] - place_m, place_m - self.around[:, 1]), 0.0), axis=1
        )
        points = {}
        # In the body's own frame its box is tighter, and a moving body has a bounded box there only.
        for body_index in np.flatnonzero(gaps_m <= gaps_m.min(initial=math.inf) + _NEAR_M):
            body, box = self.bodies[body_index], self.boxes[body_index]
            pose = body.pose if body.motion is None else pose_at(body.motion, time_s)
            points[body_index] = point = pose.inverse_apply(place_m)
            gaps_m[body_index] = np.linalg.norm(np.maximum(np.maximum(box[0] - point, point - box[1]), 0.0))
        nearest, within = NearSurface(), None
        for body_index in np.argsort(gaps_m, kind="stable"):
            # A box is never farther than its body: beyond the nearest surface so far none can be nearer.
            if gaps_m[body_index] >= nearest.distance_m:
                break
            body = self.bodies[body_index]
            point = points.get(body_index, body.pose.inverse_apply(place_m))
            for part in body.parts:
                if (distance_m := self._distance_m(part, point, nearest.distance_m)) < nearest.distance_m:
                    nearest = NearSurface(distance_m, body.name)
            if within is None and gaps_m[body_index] == 0.0 and _enclosed_share(body.parts, point) > _SHUT:
                within = body.name
        below, above = self._below_and_above(place_m)
        return Surrounding(nearest, below, above, within)

    def _below_and_above(self, place_m: Numbers) -> tuple[NearSurface, NearSurface]:
        """Nearest surfaces straight below and above a place, of bodies that stand still: a moving body is no ground."""
        nearest = [NearSurface(), NearSurface()]
        low, high = self.around[:, 0, :2], self.around[:, 1, :2]
        in_column = np.isfinite(low).all(axis=1) & ((low <= place_m[:2]) & (place_m[:2] <= high)).all(axis=1)
        for body_index in np.flatnonzero(in_column):
            body = self.bodies[body_index]
            point, up = body.pose.inverse_apply(place_m), body.pose.rotation[2]
            along_m = np.concatenate([self._along_m(part, point, up) for part in body.parts])
            for side, apart_m in enumerate((-along_m, along_m)):
                least_m = float(apart_m[apart_m >= 0.0].min(initial=math.inf))
                if least_m < nearest[side].distance_m:
                    nearest[side] = NearSurface(least_m, body.name)
        return nearest[0], nearest[1]

    def _distance_m(self, part: Part | Ball, point: Numbers, most_m: float) -> float:
        """Distance from a point to the nearest surface of a part, in the body's frame; inf beyond ``most_m``."""
        if isinstance(part, Ball):
            return abs(float(np.linalg.norm(point)) - part.radius_m)
        boxes = self._blocks_of(part)
        gap = np.maximum(np.maximum(boxes[:, 0] - point, point - boxes[:, 1]), 0.0)
        # The nearest surface is no farther than a corner of any triangle, and no nearer than its block's box.
        corners = part.vertices_m[part.faces[::_BLOCK, 0]] - point
        most = min(most_m, math.sqrt(float(np.einsum("bi,bi->b", corners, corners).min(initial=math.inf))))
        near = np.einsum("bi,bi->b", gap, gap) <= (most * (1.0 + 1e-9)) ** 2
        return _distance_m(part.vertices_m[_faces_of_blocks(part.faces, near)] - point, most_m)

    def _along_m(self, part: Part | Ball, point: Numbers, up: Numbers) -> Numbers:
        """(k,) positions along the unit vector ``up`` where the line through a point meets the part; body's frame."""
        if isinstance(part, Ball):
            middle = -float(point @ up)
            square = part.radius_m**2 - (float(point @ point) - middle**2)
            return middle + np.array([-1.0, 1.0]) * math.sqrt(square) if square >= 0.0 else np.zeros(0)
        # Project onto the plane normal to the line: triangles that it meets contain the origin there.
        across = np.linalg.svd(up[None])[2][1:].T
        boxes = self._blocks_of(part) - point
        middle_m, half_m = boxes.mean(axis=1), 0.5 * (boxes[:, 1] - boxes[:, 0])
        near = (np.abs(middle_m @ across) <= half_m @ np.abs(across) + 1e-9).all(axis=1)
        return _along_m(part.vertices_m[_faces_of_blocks(part.faces, near)] - point, up, across)

    def _blocks_of(self, part: Part) -> Numbers:
        """(b, 2, 3) boxes of the part's triangles in blocks of `_BLOCK`, computed once.

        A search through a ground of ten million triangles takes seconds. Triangles that follow each other in a file
        are mostly neighbours, so boxes of blocks are small and exclude most of them.
        """
        if id(part) not in self.blocks:
            boxes = [
                box_around(part.vertices_m[part.faces[first : first + _BLOCK].ravel()])
                for first in range(0, len(part.faces), _BLOCK)
            ]
            self.blocks[id(part)] = part, np.array(boxes).reshape(-1, 2, 3)
        return self.blocks[id(part)][1]


_BLOCK = 512
"""Triangles that share a box."""


def _faces_of_blocks(faces: Numbers, flags: Numbers) -> Numbers:
    """Faces of the flagged blocks."""
    if flags.all():
        return faces
    blocks = [faces[block * _BLOCK : (block + 1) * _BLOCK] for block in np.flatnonzero(flags)]
    return np.concatenate(blocks) if blocks else faces[:0]


_MOVED = "{0}, got {1}; {pose} or position_m moves it"


def _corners(boxes: Numbers) -> Numbers:
    """(..., 8, 3) corners of (..., 2, 3) boxes."""
    return np.asarray(boxes[..., np.indices((2, 2, 2)).reshape(3, 8).T, range(3)])


def _distance_m(corners: Numbers, most_m: float) -> float:
    """Distance from the origin to the nearest triangle; inf beyond ``most_m``.

    Args:
        corners: (t, 3, 3) of the triangles
    """
    if not len(corners):
        return math.inf
    # No triangle is farther than its corners, nor nearer than the box around it.
    nearest_corner_m = math.sqrt(float(np.einsum("tci,tci->tc", corners, corners).min()))
    gap = np.maximum(np.maximum(corners.min(axis=1), -corners.max(axis=1)), 0.0)
    near = np.einsum("ti,ti->t", gap, gap) <= min(most_m, nearest_corner_m * (1.0 + 1e-9)) ** 2
    distance_m = float(_distances_m(corners[near]).min(initial=math.inf))
    return distance_m if distance_m <= most_m else math.inf


def _distances_m(corners: Numbers) -> Numbers:
    """(t,) distances from the origin to triangles with corners (t, 3, 3)."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    sides = np.roll(corners, -1, axis=1) - corners
    # If the origin projects into the triangle (inner side of each edge), the height over its plane is the distance;
    # else that to the nearest edge.
    inner = np.einsum("tei,ti->te", np.cross(sides, -corners), normal) >= 0.0
    projects_inside = (length > 0.0) & inner.all(axis=1)
    square = np.maximum((sides * sides).sum(axis=2), 1e-300)
    along = np.clip(-(corners * sides).sum(axis=2) / square, 0.0, 1.0)
    edge = np.linalg.norm(corners + along[..., None] * sides, axis=2).min(axis=1)
    height = np.abs(np.einsum("ti,ti->t", corners[:, 0], normal))  # times the normal's length
    return np.asarray(np.where(projects_inside, height / np.maximum(length, 1e-300), edge))


def _along_m(corners: Numbers, up: Numbers, across: Numbers) -> Numbers:
    """(k,) positions along ``up`` at which the line through the origin meets triangles with corners (t, 3, 3).

    Args:
        across: (3, 2) two unit vectors normal to the line
    """
    flat = corners @ across
    near = np.flatnonzero((flat.min(axis=1) <= 0.0).all(axis=1) & (flat.max(axis=1) >= 0.0).all(axis=1))
    a, b, c = np.moveaxis(flat[near], 1, 0)
    # The origin of the plane is inside the triangle if all three signed areas have one sign, whatever the winding.
    # These areas are the barycentric weights, not yet normalised.
    weights = np.stack([cross_in_plane(b, c), cross_in_plane(c, a), cross_in_plane(a, b)], axis=1)
    total = weights.sum(axis=1)
    crosses = (total != 0.0) & (((weights >= 0.0).all(axis=1)) | ((weights <= 0.0).all(axis=1)))
    heights = corners[near[crosses]] @ up
    return np.asarray((heights * weights[crosses]).sum(axis=1) / total[crosses])


def _enclosed_share(parts: Sequence[Part | Ball], point: Numbers) -> float:
    """Share of all directions in which a body surrounds a point of its frame.

    The solid angles of its triangles (van Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30, 1983) add up to 4 pi
    inside a closed mesh and to 0 outside.
    """
    total = 0.0
    for part in parts:
        if isinstance(part, Ball):
            total += 4.0 * math.pi * float(np.linalg.norm(point) < part.radius_m)
            continue
        a, b, c = np.moveaxis(part.vertices_m[part.faces] - point, 1, 0)
        la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        volume = (a * np.cross(b, c)).sum(axis=1)
        denominator = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
        total += 2.0 * float(np.arctan2(volume, denominator).sum())
    return abs(total) / (4.0 * math.pi)
