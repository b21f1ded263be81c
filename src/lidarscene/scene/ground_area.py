"""Ground within an outline, such as a junction: a sheet of the rough surface that is no strip along a line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..maths.arrays import Numbers
from ..maths.pose import Pose
from ..maths.vectors import cross_in_plane
from ..physics.road.roughness import RoughSurface

EDGE_M = 1e-6
"""Accuracy bought: places as near as this to the edge of a ground are on it."""

SPACINGS_INSIDE = 0.55
"""Choice: least distance of vertices within from the outline, in spacings. Beyond 0.5 every piece of the outline is an
edge of the triangulation, since the circle over it has no other vertex (Gabriel's condition)."""

THINNEST_M = 0.01
"""Choice: least area of an outline over its length."""

AREA_SHARE = 0.02
"""Accuracy bought: by how much the triangles may miss the area of the outline, which must not cross itself."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outline:
    """The plan of a ground within a closed line.

    Attributes:
        corner_m: (k, 3) corners, once around; the height within is that of the plane through the outline by least
            squares, and the mean by inverse squares of the distances of what the outline is above that
        spacing_m: largest distance of vertices
    """

    corner_m: Numbers
    spacing_m: float

    @property
    def vertices(self) -> int:
        """Number of vertices, at most."""
        extent_m = np.ptp(self.corner_m[:, :2], axis=0)
        around_m = np.hypot(*(np.roll(self.corner_m, -1, axis=0) - self.corner_m)[:, :2].T).sum()
        return int(np.prod(extent_m / self.spacing_m + 1.0) + around_m / self.spacing_m + len(self.corner_m))

    def area_m2(self) -> float:
        """Area within, above 0 where the corners go counter-clockwise."""
        x_m, y_m, _ = self.corner_m.T
        return 0.5 * float((x_m * np.roll(y_m, -1) - np.roll(x_m, -1) * y_m).sum())

    def is_usable(self) -> bool:
        """Return whether it neither crosses itself nor is as thin as a line."""
        around_m = np.hypot(*(np.roll(self.corner_m, -1, axis=0) - self.corner_m)[:, :2].T).sum()
        return bool(abs(self.area_m2()) > THINNEST_M * around_m) and not self._crosses_itself()

    def rim_m(self) -> Numbers:
        """(n, 3) vertices of the outline, counter-clockwise from above."""
        corner_m = self.corner_m if self.area_m2() > 0.0 else self.corner_m[::-1]
        following_m = np.roll(corner_m, -1, axis=0)
        pieces = []
        for begin_m, end_m in zip(corner_m, following_m, strict=True):
            count = max(1, int(np.ceil(np.hypot(*(end_m - begin_m)[:2]) / self.spacing_m - 1e-9)))
            pieces.append(begin_m + (end_m - begin_m) * (np.arange(count) / count)[:, None])
        return np.concatenate(pieces)

    def contains(self, place_m: Numbers) -> Numbers:
        """(n,) whether (n, 2) places are within: a ray to +x crosses the outline an odd number of times."""
        x_m, y_m = place_m[:, :1], place_m[:, 1:]
        (ax, ay, _), (bx, by, _) = self.corner_m.T, np.roll(self.corner_m, -1, axis=0).T
        with np.errstate(divide="ignore", invalid="ignore"):
            crosses = ((ay > y_m) != (by > y_m)) & (x_m < ax + (y_m - ay) * (bx - ax) / (by - ay))
        return np.asarray(crosses.sum(axis=1) % 2 == 1)

    def triangulated(self) -> tuple[Numbers, Numbers]:
        """(v, 3) vertices, those of the outline first, and (f, 3) triangles within."""
        from scipy.spatial import Delaunay

        rim_m = self.rim_m()
        low_m, high_m = rim_m[:, :2].min(axis=0), rim_m[:, :2].max(axis=0)
        ticks = [np.arange(low, high, self.spacing_m) for low, high in zip(low_m, high_m, strict=True)]
        inner_m = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 2)
        inner_m = inner_m[self.contains(inner_m)]
        square_m2 = ((inner_m[:, None] - rim_m[:, :2]) ** 2).sum(axis=-1)
        inside = square_m2.min(axis=1, initial=np.inf) > (SPACINGS_INSIDE * self.spacing_m) ** 2
        weight = 1.0 / square_m2[inside]
        plane = np.linalg.lstsq(np.pad(rim_m[:, :2], ((0, 0), (0, 1)), constant_values=1.0), rim_m[:, 2])[0]
        over_m = weight @ (rim_m[:, 2] - rim_m[:, :2] @ plane[:2] - plane[2]) / weight.sum(axis=1)
        height_m = inner_m[inside] @ plane[:2] + plane[2] + over_m
        vertices_m = np.concatenate([rim_m, np.column_stack([inner_m[inside], height_m])])
        faces = Delaunay(vertices_m[:, :2]).simplices.astype(np.int64)
        return vertices_m, faces[self.contains(vertices_m[faces, :2].mean(axis=1))]

    def _crosses_itself(self) -> bool:
        """Return whether the triangles within do not fill it."""
        vertices_m, faces = self.triangulated()
        a, b, c = vertices_m[faces, :2].transpose(1, 0, 2)
        filled_m2 = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum()
        return bool(abs(filled_m2 - abs(self.area_m2())) > AREA_SHARE * abs(self.area_m2()))


@dataclass(frozen=True, slots=True, eq=False)
class FaceGrid:
    """Triangles in the plane, listed by the squares of a grid that they touch.

    Attributes:
        corner_m: (f, 3, 2) corners, counter-clockwise
        low_m: lowest x and y
        step_m: side of a square
        shape: numbers of squares along x and y
    """

    corner_m: Numbers
    low_m: Numbers
    step_m: float
    shape: Numbers
    _face: Numbers
    _begin: Numbers

    @classmethod
    def over(cls, corner_m: Numbers, step_m: float) -> FaceGrid:
        """List triangles by squares of a side."""
        low_m = corner_m.min(axis=(0, 1)) - EDGE_M
        first = np.floor((corner_m.min(axis=1) - EDGE_M - low_m) / step_m).astype(int)
        size = np.floor((corner_m.max(axis=1) + EDGE_M - low_m) / step_m).astype(int) - first + 1
        shape = (first + size).max(axis=0)
        face, number = _listed(size.prod(axis=1))
        square = (first[face, 0] + number // size[face, 1]) * shape[1] + first[face, 1] + number % size[face, 1]
        order = np.argsort(square, kind="stable")
        begin = np.searchsorted(square[order], np.arange(shape.prod() + 1))
        return cls(corner_m, low_m, step_m, shape, face[order], begin)

    def locate(self, place_m: Numbers) -> tuple[Numbers, Numbers]:
        """(n,) triangles that (n, 2) places are in, -1 for none; (n, 3) weights of its corners there."""
        square = np.floor((place_m - self.low_m) / self.step_m).astype(int)
        near = np.flatnonzero(((square >= 0) & (square < self.shape)).all(axis=1))
        square = square[near, 0] * self.shape[1] + square[near, 1]
        row, number = _listed(self._begin[square + 1] - self._begin[square])
        face, place = self._face[self._begin[square][row] + number], near[row]
        a, b, c = self.corner_m[face].transpose(1, 0, 2) - place_m[place]
        twice_m2 = np.stack([cross_in_plane(b, c), cross_in_plane(c, a), cross_in_plane(a, b)], axis=1)
        longest_m = np.sqrt(np.max([((one - other) ** 2).sum(axis=1) for one, other in ((a, b), (b, c), (c, a))], 0))
        # The last of those that share an edge.
        inside = np.flatnonzero((twice_m2.min(axis=1) >= -EDGE_M * longest_m) & (twice_m2.sum(axis=1) > 0.0))
        triangle, weight = np.full(len(place_m), -1), np.zeros((len(place_m), 3))
        triangle[place[inside]] = face[inside]
        weight[place[inside]] = twice_m2[inside] / twice_m2[inside].sum(axis=1, keepdims=True)
        return triangle, weight


def _listed(count: Numbers) -> tuple[Numbers, Numbers]:
    """Rows, each as often as its count, and the numbers 0, 1, ... within each."""
    row = np.repeat(np.arange(len(count)), count)
    return row, np.arange(len(row)) - (np.cumsum(count) - count)[row]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Area:
    """A ground within an outline: its mesh, and where it lies.

    Attributes:
        pose: of the outline's frame; level
        vertices_m: (v, 3) vertices in that frame, those of the outline first
        smooth_m: (v,) their heights without roughness
        faces: (f, 3)
    """

    pose: Pose
    outline: Outline
    vertices_m: Numbers
    smooth_m: Numbers
    faces: Numbers
    _grid: FaceGrid

    @classmethod
    def lay(cls, pose: Pose, *, outline: Outline, surface: RoughSurface) -> Area:
        """Lay an area over the surface, already without its short waves."""
        vertices_m, faces = outline.triangulated()
        grid = FaceGrid.over(vertices_m[faces, :2], outline.spacing_m)
        rough_m = surface.height_m(pose.apply(np.pad(vertices_m[:, :2], ((0, 0), (0, 1))))[:, :2])
        laid_m = vertices_m + np.pad(rough_m[:, None], ((0, 0), (2, 0)))
        return cls(pose=pose, outline=outline, vertices_m=laid_m, smooth_m=vertices_m[:, 2], faces=faces, _grid=grid)

    def mesh(self, kerb_m: float) -> tuple[Numbers, Numbers]:
        """Vertices (v, 3) and faces (f, 3) in its own frame, with faces of height ``kerb_m`` down from its outline."""
        if kerb_m <= 0.0:
            return self.vertices_m.copy(), self.faces
        rim = np.arange(len(self.outline.rim_m()))
        foot, following = len(self.vertices_m) + rim, np.roll(rim, -1)
        sides = [
            np.stack([rim, foot, following], axis=1),
            np.stack([following, foot, len(self.vertices_m) + following], axis=1),
        ]
        below_m = self.vertices_m[rim] - [0.0, 0.0, kerb_m]
        return np.concatenate([self.vertices_m, below_m]), np.concatenate([self.faces, *sides])

    def mesh_height_m(self, place_m: Numbers) -> tuple[Numbers, Numbers]:
        """Which of (n, 2) places lie on it, and the height in the world [m] of its mesh at these."""
        return self._height_m(place_m, self.vertices_m[:, 2])

    def smooth_height_m(self, place_m: Numbers) -> tuple[Numbers, Numbers]:
        """Which of (n, 2) places lie on it, and the height in the world [m] at these without roughness."""
        return self._height_m(place_m, self.smooth_m)

    def _height_m(self, place_m: Numbers, height_m: Numbers) -> tuple[Numbers, Numbers]:
        local_m = (place_m - self.pose.position_m[:2]) @ self.pose.rotation[:2, :2]
        triangle, weight = self._grid.locate(local_m)
        on_area = triangle >= 0
        corner = self.faces[triangle[on_area]]
        return on_area, self.pose.position_m[2] + (weight[on_area] * height_m[corner]).sum(axis=1)
