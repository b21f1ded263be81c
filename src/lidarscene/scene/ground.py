"""Ground that is not a plane: sheets of a rough surface with crown and kerbs, and its height at any place.

All sheets of a scene show one random surface (`physics.road.roughness`), on which vehicles ride (`scene.ride`): what
wheels meet is what beams meet, but for the waves that are too short for a mesh.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..maths.arrays import Numbers
from ..maths.pose import Pose
from ..physics.road.roughness import RoughSurface
from .meshes.primitives import grid_faces

SPACING_M = 0.5
"""Choice: distance of a sheet's vertices if the file says nothing."""

SPACINGS_A_WAVE = 3.0
"""Accuracy bought: vertices that the shortest wave of a mesh has at least: shorter waves are left out."""

MOST_VERTICES = 4_000_000
"""Most vertices of a sheet: 100 MB of triangles."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sheet:
    """A rectangle of ground: its mesh, and where it lies.

    Attributes:
        pose: of its middle; level
        size_m: length along x, width along y
        crown_m: rise of the middle over the sides: a parabola over the width, which fades out over one width towards
            both ends
        height_m: (nx + 1, ny + 1) heights of the vertices over the middle of a plane sheet
    """

    pose: Pose
    size_m: tuple[float, float]
    crown_m: float
    height_m: Numbers

    @classmethod
    def lay(
        cls, pose: Pose, *, size_m: tuple[float, float], crown_m: float, spacing_m: float, surface: RoughSurface
    ) -> Sheet:
        """Lay a sheet over the surface, with vertices ``spacing_m`` apart."""
        x_m, y_m = (_ticks(length_m, spacing_m) for length_m in size_m)
        resolved = surface.without_short_waves(1.0 / (SPACINGS_A_WAVE * spacing_m))
        rough_m = resolved.grid_m(x_m, y_m, pose)
        height_m = rough_m + crown_rise_m(np.stack(np.meshgrid(x_m, y_m, indexing="ij"), axis=-1), size_m, crown_m)
        return cls(pose=pose, size_m=size_m, crown_m=crown_m, height_m=height_m)

    def mesh(self, kerb_m: float) -> tuple[Numbers, Numbers]:
        """Vertices (v, 3) and faces (f, 3) in its own frame, with faces of height ``kerb_m`` down from its edges."""
        nx, ny = (n - 1 for n in self.height_m.shape)
        x_m, y_m = np.linspace(-0.5, 0.5, nx + 1) * self.size_m[0], np.linspace(-0.5, 0.5, ny + 1) * self.size_m[1]
        gx, gy = np.meshgrid(x_m, y_m, indexing="ij")
        top = np.stack([gx.ravel(), gy.ravel(), self.height_m.ravel()], axis=1)
        faces = grid_faces(nx, ny)
        if kerb_m <= 0.0:
            return top, faces
        number = np.arange((nx + 1) * (ny + 1)).reshape(nx + 1, ny + 1)
        # Once around, counter-clockwise from above; the last vertex is the first.
        rim = np.concatenate([number[:, 0], number[-1, 1:], number[-2::-1, -1], number[0, -2::-1]])
        foot = len(top) + np.arange(len(rim))
        leading, following = rim[:-1], rim[1:]
        sides = [np.stack([leading, foot[:-1], following], axis=1), np.stack([following, foot[:-1], foot[1:]], axis=1)]
        return np.concatenate([top, top[rim] - [0.0, 0.0, kerb_m]]), np.concatenate([faces, *sides])

    def covers(self, place_m: Numbers) -> tuple[Numbers, Numbers]:
        """Which of (n, 2) places lie on the sheet, and all of them in its own frame."""
        local_m = (place_m - self.pose.position_m[:2]) @ self.pose.rotation[:2, :2]
        return (np.abs(local_m) <= 0.5 * np.array(self.size_m) + 1e-6).all(axis=1), local_m

    def mesh_height_m(self, local_m: Numbers) -> Numbers:
        """Height in the world [m] of the mesh at (n, 2) places of its own frame: triangle by triangle."""
        cells = np.array(self.height_m.shape) - 1
        place = (local_m / self.size_m + 0.5) * cells
        corner = np.clip(np.floor(place).astype(int), 0, cells - 1)
        (u, v), (i, j) = (place - corner).T, corner.T
        a, b, c, d = (self.height_m[i + di, j + dj] for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1)))
        # The faces of a cell are a b c, where u >= v, and a c d.
        rise_m = np.where(u >= v, a + u * (b - a) + v * (c - b), a + v * (d - a) + u * (c - d))
        return np.asarray(self.pose.position_m[2] + rise_m)

    def smooth_height_m(self, local_m: Numbers) -> Numbers:
        """Height in the world [m] of the sheet without roughness at (n, 2) places of its own frame."""
        return np.asarray(self.pose.position_m[2] + crown_rise_m(local_m, self.size_m, self.crown_m))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ground:
    """The ground of a scene: one rough surface, and the sheets that show it."""

    surface: RoughSurface
    sheets: Sequence[Sheet] = ()
    _around_m: Numbers = field(init=False)

    def __post_init__(self) -> None:
        """Compute the circle around each sheet, (s, 3): x, y and radius."""
        circles = [(*sheet.pose.position_m[:2], 0.5 * math.hypot(*sheet.size_m) + 1e-3) for sheet in self.sheets]
        object.__setattr__(self, "_around_m", np.array(circles).reshape(-1, 3))

    def _sheets_near(self, place_m: Numbers) -> list[Sheet]:
        """Sheets that may be below some of (n, 2) places: a long street has hundreds, few of them near a vehicle."""
        if not len(place_m):
            return []
        x_m, y_m, radius_m = self._around_m.T
        (low_x, low_y), (high_x, high_y) = place_m.min(axis=0), place_m.max(axis=0)
        near = (x_m + radius_m >= low_x) & (x_m - radius_m <= high_x)
        near &= (y_m + radius_m >= low_y) & (y_m - radius_m <= high_y)
        return [self.sheets[number] for number in np.flatnonzero(near).tolist()]

    def height_m(self, place_m: Numbers) -> Numbers:
        """Height [m] of the highest sheet's mesh at (n, 2) places; NaN where there is none."""
        highest = np.full(len(place_m), np.nan)
        for sheet in self._sheets_near(place_m):
            on_sheet, local_m = sheet.covers(place_m)
            highest[on_sheet] = np.fmax(highest[on_sheet], sheet.mesh_height_m(local_m[on_sheet]))
        return highest

    def wheel_height_m(self, place_m: Numbers) -> Numbers:
        """Height [m] below a wheel at (n, 2) places: the highest sheet's, at 0 where there is none, and all waves."""
        highest = np.full(len(place_m), np.nan)
        for sheet in self._sheets_near(place_m):
            on_sheet, local_m = sheet.covers(place_m)
            highest[on_sheet] = np.fmax(highest[on_sheet], sheet.smooth_height_m(local_m[on_sheet]))
        return np.asarray(np.nan_to_num(highest) + self.surface.height_m(place_m))


def crown_rise_m(local_m: Numbers, size_m: tuple[float, float], crown_m: float) -> Numbers:
    """Rise of a crown [m] at (..., 2) places of a sheet: c (1 - (2 y / w)^2) f, with f from 0 to 1 over one width."""
    length_m, width_m = size_m
    from_end = np.clip((0.5 * length_m - np.abs(local_m[..., 0])) / width_m, 0.0, 1.0)
    fade = from_end * from_end * (3.0 - 2.0 * from_end)
    return np.asarray(crown_m * fade * (1.0 - (2.0 * local_m[..., 1] / width_m) ** 2))


def vertices_of(size_m: tuple[float, float], spacing_m: float) -> int:
    """Number of vertices of a sheet."""
    nx, ny = (math.ceil(length_m / spacing_m - 1e-9) for length_m in size_m)
    return (nx + 1) * (ny + 1)


def _ticks(length_m: float, spacing_m: float) -> Numbers:
    """Places of vertices along one side, at most ``spacing_m`` apart."""
    return np.linspace(-0.5, 0.5, max(1, math.ceil(length_m / spacing_m - 1e-9)) + 1) * length_m
