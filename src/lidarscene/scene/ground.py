"""Ground that is not a plane: sheets of a rough surface along lines, with crown and kerbs, and its height at any place.

All sheets of a scene show one random surface (`physics.road.roughness`), on which vehicles ride (`scene.ride`): what
wheels meet is what beams meet, but for the waves that are too short for a mesh.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..maths.arrays import Numbers
from ..maths.pose import Pose
from ..maths.vectors import box_around, cross_in_plane
from ..physics.road.roughness import RoughSurface
from .ground_area import EDGE_M, Area, Outline
from .meshes.primitives import grid_faces

SPACING_M = 0.5
"""Choice: distance of a sheet's vertices if the file says nothing."""

SPACINGS_A_WAVE = 3.0
"""Accuracy bought: vertices that the shortest wave of a mesh has at least: shorter waves are left out."""

MOST_VERTICES = 4_000_000
"""Most vertices of a sheet: 100 MB of triangles."""

HEADROOM_M = 1.5
"""Choice: height over a wheel from which on ground is that of another storey."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Strip:
    """The plan of a sheet: places (s, v) along and across a line of straight segments.

    Rows of vertices lie across the line, at its corners along the bisectors, so that the strip's edges and those of
    strips beside it along the same line are parallel to it and meet without a gap. A rectangle is a strip along a line
    of one segment.

    Attributes:
        line_m: (k + 1, 3) points of the line
        width_m: of the strip
        offset_m: of its middle from the line, to the left
        spacing_m: largest distance of vertices along and across it
        heights_m: (a, b) heights over the line: a on even steps along it, b on even steps across, from right to left
    """

    line_m: Numbers
    width_m: float
    offset_m: float = 0.0
    spacing_m: float
    heights_m: Numbers | None = None
    _length_m: Numbers = field(init=False)
    _ahead: Numbers = field(init=False)
    _bisector: Numbers = field(init=False)
    _first_row: Numbers = field(init=False)
    _way_m: Numbers = field(init=False)
    _around_m: Numbers = field(init=False)
    _lean: Numbers = field(init=False)

    def __post_init__(self) -> None:
        """Compute what `locate` needs, which wheels ask a thousand times.

        That is length and direction of the segments, bisectors at the points, rows and way up to each point, the box
        around each segment's part of the strip, (2, k, 2), and how far the bisectors at its ends lean ahead, (2, k).
        """
        step = np.diff(self.line_m[:, :2], axis=0)
        length_m = np.hypot(*step.T)
        ahead = step / np.maximum(length_m, 1e-12)[:, None]
        left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
        before, after = np.concatenate([left[:1], left]), np.concatenate([left, left[-1:]])
        # Its share along both normals is 1: edges keep their distance from the line.
        bisector = (before + after) / np.maximum(1.0 + np.einsum("ij,ij->i", before, after), 1e-12)[:, None]
        rows = np.maximum(1, np.ceil(length_m / self.spacing_m - 1e-9)).astype(int)
        first_row = np.concatenate([[0], np.cumsum(rows)])
        way_m = np.concatenate([[0.0], np.cumsum(length_m)])
        half_m = float(np.hypot(*bisector.T).max()) * (abs(self.offset_m) + 0.5 * self.width_m) + EDGE_M
        begin_m, end_m = self.line_m[:-1, :2], self.line_m[1:, :2]
        computed = {
            "length_m": length_m,
            "ahead": ahead,
            "bisector": bisector,
            "first_row": first_row,
            "way_m": way_m,
            "around_m": np.stack([np.minimum(begin_m, end_m) - half_m, np.maximum(begin_m, end_m) + half_m]),
            "lean": np.stack([np.einsum("ij,ij->i", ahead, side) for side in (bisector[:-1], bisector[1:])]),
        }
        for name, values in computed.items():
            object.__setattr__(self, f"_{name}", values)

    @classmethod
    def rectangle(cls, size_m: tuple[float, float], spacing_m: float, heights_m: Numbers | None = None) -> Strip:
        """Return a strip along x, centred on the origin."""
        line_m = np.array([[-0.5 * size_m[0], 0.0, 0.0], [0.5 * size_m[0], 0.0, 0.0]])
        return cls(line_m=line_m, width_m=size_m[1], spacing_m=spacing_m, heights_m=heights_m)

    @property
    def cells(self) -> tuple[int, int]:
        """Number of cells along and across."""
        return int(self._first_row[-1]), max(1, math.ceil(self.width_m / self.spacing_m - 1e-9))

    @property
    def vertices(self) -> int:
        """Number of vertices."""
        return (self.cells[0] + 1) * (self.cells[1] + 1)

    def sharp_corner(self) -> Numbers | None:
        """Return the first point of the line at which it bends too sharply for the strip's width, None without one."""
        edges_m = self.offset_m + 0.5 * self.width_m * np.array([-1.0, 1.0])
        begin, end = self._lean
        folded = (self._length_m[:, None] + (end - begin)[:, None] * edges_m <= 0.0).any(axis=1)
        return self.line_m[np.argmax(folded)] if folded.any() else None

    def across_m(self) -> Numbers:
        """(ny + 1,) places of vertices across the strip, from its middle."""
        return np.linspace(-0.5, 0.5, self.cells[1] + 1) * self.width_m

    def rows(self) -> tuple[Numbers, Numbers]:
        """(nx + 1, 2) middles of rows on the line, and their directions to the left."""
        number, points = np.arange(self.cells[0] + 1), self._first_row
        middle_m, to_left = (
            np.stack([np.interp(number, points, column) for column in values.T], axis=1)
            for values in (self.line_m[:, :2], self._bisector)
        )
        return middle_m, to_left

    def rise_m(self, row: Numbers, across_m: Numbers) -> Numbers:
        """Height [m] at places counted in rows, and across from the strip's middle: the line's, and those over it."""
        line_m = self._line_rise_m(row)
        if self.heights_m is None:
            return line_m
        last = np.array(self.heights_m.shape) - 1
        place = np.broadcast_arrays(row / self.cells[0] * last[0], (across_m / self.width_m + 0.5) * last[1])
        i, j = (np.clip(np.floor(each).astype(int), 0, end - 1) for each, end in zip(place, last, strict=True))
        u, v = place[0] - i, place[1] - j
        low, high = ((1.0 - v) * self.heights_m[i + k, j] + v * self.heights_m[i + k, j + 1] for k in (0, 1))
        return np.asarray(line_m + (1.0 - u) * low + u * high)

    def _line_rise_m(self, row: Numbers) -> Numbers:
        """Height of the line: smooth, and between those of the points beside it."""
        z_m = self.line_m[:, 2]
        if np.ptp(z_m) == 0.0:
            return np.full(np.shape(row), z_m[0])
        from scipy.interpolate import PchipInterpolator

        return np.asarray(PchipInterpolator(self._way_m, z_m)(np.interp(row, self._first_row, self._way_m)))

    def crown_share(self, row: Numbers, across_m: Numbers) -> Numbers:
        """Rise of a crown of 1: (1 - (2 v / w)^2) f, with f from 0 to 1 over one width from both ends."""
        place_m = np.interp(row, self._first_row, self._way_m)
        from_end = np.clip(np.minimum(place_m, self._way_m[-1] - place_m) / self.width_m, 0.0, 1.0)
        return np.asarray(from_end**2 * (3.0 - 2.0 * from_end) * (1.0 - (2.0 * across_m / self.width_m) ** 2))

    def locate(self, place_m: Numbers) -> tuple[Numbers, Numbers, Numbers]:
        """Which of (n, 2) places lie on it; of all, the place along it, counted in rows, and across it [m]."""
        low_m, high_m = self._around_m
        on_strip, row, across_m = np.zeros(len(place_m), dtype=bool), np.zeros(len(place_m)), np.zeros(len(place_m))
        lowest_m, highest_m = box_around(place_m)
        near = (low_m <= highest_m).all(axis=1) & (high_m >= lowest_m).all(axis=1)
        segments, (x_m, y_m) = np.flatnonzero(near), place_m.T[:, :, None]
        # Few places are near more than two segments.
        (low_x, low_y), (high_x, high_y) = low_m[segments].T, high_m[segments].T
        near = (low_x <= x_m) & (x_m <= high_x) & (low_y <= y_m) & (y_m <= high_y)
        # Twice as fast as `numpy.nonzero` of two axes.
        place, segment = np.divmod(np.flatnonzero(near), max(len(segments), 1))
        segment = segments[segment]
        (ahead_x, ahead_y), length_m, (begin, end) = (
            self._ahead[segment].T,
            self._length_m[segment],
            self._lean[:, segment],
        )
        from_x, from_y = (place_m[place] - self.line_m[segment, :2]).T
        t_m = from_y * ahead_x - from_x * ahead_y
        along_m = from_x * ahead_x + from_y * ahead_y
        # The place is begin + u (end - begin) + t ((1 - u) b0 + u b1), with bisectors b0 and b1.
        row_m = length_m + t_m * (end - begin)
        share = (along_m - t_m * begin) / np.where(np.abs(row_m) < 1e-12, 1e-12, row_m)
        slack = EDGE_M / length_m
        inside = (share >= -slack) & (share <= 1.0 + slack)
        inside &= np.abs(t_m - self.offset_m) <= 0.5 * self.width_m + EDGE_M
        # Of each place the first segment, which comes last here.
        inside = np.flatnonzero(inside)[::-1]
        place, segment = place[inside], segment[inside]
        count = self._first_row[segment + 1] - self._first_row[segment]
        on_strip[place] = True
        row[place] = self._first_row[segment] + np.clip(share[inside], 0.0, 1.0) * count
        across_m[place] = t_m[inside] - self.offset_m
        return on_strip, row, across_m


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sheet:
    """A strip of ground: its mesh, and where it lies.

    Attributes:
        pose: of the strip's frame; level
        crown_m: rise of the middle over the sides: a parabola over the width, which fades out over one width towards
            both ends
        vertices_m: (nx + 1, ny + 1, 3) vertices in the strip's frame
    """

    pose: Pose
    strip: Strip
    crown_m: float
    vertices_m: Numbers

    @classmethod
    def lay(cls, pose: Pose, *, strip: Strip, crown_m: float, surface: RoughSurface) -> Sheet:
        """Lay a sheet over the surface, already without its short waves."""
        middle_m, to_left = strip.rows()
        across_m = strip.across_m()
        plan_m = middle_m[:, None] + to_left[:, None] * (strip.offset_m + across_m)[:, None]
        row = np.arange(len(middle_m))
        rise_m = strip.rise_m(row[:, None], across_m) + crown_m * strip.crown_share(row[:, None], across_m)
        turned = pose.rotation[:2, :2].T
        begin_m, step_m = plan_m[:, 0] @ turned + pose.position_m[:2], (plan_m[:, 1] - plan_m[:, 0]) @ turned
        rough_m = surface.rows_m(begin_m, step_m, len(across_m))
        return cls(
            pose=pose,
            strip=strip,
            crown_m=crown_m,
            vertices_m=np.concatenate([plan_m, (rise_m + rough_m)[..., None]], axis=2),
        )

    def mesh(self, kerb_m: float) -> tuple[Numbers, Numbers]:
        """Vertices (v, 3) and faces (f, 3) in its own frame, with faces of height ``kerb_m`` down from its edges."""
        nx, ny = self.strip.cells
        top, faces = self.vertices_m.reshape(-1, 3), grid_faces(nx, ny)
        if kerb_m <= 0.0:
            return top.copy(), faces
        number = np.arange((nx + 1) * (ny + 1)).reshape(nx + 1, ny + 1)
        # Once around, counter-clockwise from above; the last vertex is the first.
        rim = np.concatenate([number[:, 0], number[-1, 1:], number[-2::-1, -1], number[0, -2::-1]])
        foot = len(top) + np.arange(len(rim))
        leading, following = rim[:-1], rim[1:]
        sides = [np.stack([leading, foot[:-1], following], axis=1), np.stack([following, foot[:-1], foot[1:]], axis=1)]
        return np.concatenate([top, top[rim] - [0.0, 0.0, kerb_m]]), np.concatenate([faces, *sides])

    def mesh_height_m(self, place_m: Numbers) -> tuple[Numbers, Numbers]:
        """Which of (n, 2) places lie on the sheet, and the height in the world [m] of its mesh at these."""
        local_m = (place_m - self.pose.position_m[:2]) @ self.pose.rotation[:2, :2]
        on_sheet, row, across_m = self.strip.locate(local_m)
        row, across_m, local_m = row[on_sheet], across_m[on_sheet], local_m[on_sheet]
        cells = self.strip.cells
        i = np.clip(np.floor(row).astype(int), 0, cells[0] - 1)
        j = np.clip(np.floor((across_m / self.strip.width_m + 0.5) * cells[1]).astype(int), 0, cells[1] - 1)
        a, b, c, d = (self.vertices_m[i + di, j + dj] for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1)))
        # The faces of a cell are a b c, to the right of its diagonal, and a c d.
        to_place, diagonal = local_m - a[:, :2], c - a
        other = np.where((cross_in_plane(diagonal, to_place) <= 0.0)[:, None], b, d) - a
        area = cross_in_plane(diagonal, other)
        to_c = cross_in_plane(to_place, other) / area
        to_other = cross_in_plane(diagonal, to_place) / area
        return on_sheet, self.pose.position_m[2] + a[:, 2] + to_c * diagonal[:, 2] + to_other * other[:, 2]

    def smooth_height_m(self, place_m: Numbers) -> tuple[Numbers, Numbers]:
        """Which of (n, 2) places lie on the sheet, and the height in the world [m] at these without roughness."""
        local_m = (place_m - self.pose.position_m[:2]) @ self.pose.rotation[:2, :2]
        on_sheet, row, across_m = self.strip.locate(local_m)
        row, across_m = row[on_sheet], across_m[on_sheet]
        rise_m = self.strip.rise_m(row, across_m) + self.crown_m * self.strip.crown_share(row, across_m)
        return on_sheet, self.pose.position_m[2] + rise_m


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ground:
    """The ground of a scene: one rough surface, and the sheets that show it."""

    surface: RoughSurface
    sheets: Sequence[Sheet | Area] = ()
    _bounds_m: Numbers = field(init=False)

    def __post_init__(self) -> None:
        """Compute lowest and highest x and y of each sheet, (s, 2, 2)."""
        bounds = np.zeros((len(self.sheets), 2, 2))
        for row, sheet in enumerate(self.sheets):
            place_m = sheet.pose.apply(sheet.vertices_m.reshape(-1, 3))[:, :2]
            low_m, high_m = box_around(place_m)
            bounds[row] = low_m - EDGE_M, high_m + EDGE_M
        object.__setattr__(self, "_bounds_m", bounds)

    def _sheets_near(self, place_m: Numbers) -> Iterator[tuple[Sheet | Area, Numbers]]:
        """Yield the sheets that may be below some of (n, 2) places, and the numbers of these: of hundreds, few are."""
        if not len(place_m):
            return
        # NumPy is slow along axes of two.
        (low_x, low_y), (high_x, high_y), (x_m, y_m) = *np.moveaxis(self._bounds_m, 0, -1), place_m.T.copy()
        near = (high_x >= x_m.min()) & (high_y >= y_m.min()) & (low_x <= x_m.max()) & (low_y <= y_m.max())
        for number in np.flatnonzero(near).tolist():
            (low_x, low_y), (high_x, high_y) = self._bounds_m[number]
            rows = np.flatnonzero((x_m >= low_x) & (x_m <= high_x) & (y_m >= low_y) & (y_m <= high_y))
            if len(rows):
                yield self.sheets[number], rows

    def height_m(self, place_m: Numbers) -> Numbers:
        """Height [m] of the highest sheet's mesh at (n, 2) places; NaN where there is none."""
        highest = np.full(len(place_m), np.nan)
        for sheet, rows in self._sheets_near(place_m):
            on_sheet, height_m = sheet.mesh_height_m(place_m[rows])
            highest[rows[on_sheet]] = np.fmax(highest[rows[on_sheet]], height_m)
        return highest

    def wheel_height_m(self, place_m: Numbers, near_m: Numbers | None = None) -> Numbers:
        """Height [m] below a wheel at (n, 2) places: the highest sheet's, at 0 where there is none, and all waves.

        Args:
            near_m: (n,) heights of wheels, on which sheets that are `HEADROOM_M` higher are none; in place of 0, too
        """
        highest = np.full(len(place_m), np.nan)
        for sheet, rows in self._sheets_near(place_m):
            on_sheet, height_m = sheet.smooth_height_m(place_m[rows])
            rows = rows[on_sheet]
            if near_m is not None:
                height_m = np.where(height_m < near_m[rows] + HEADROOM_M, height_m, np.nan)
            highest[rows] = np.fmax(highest[rows], height_m)
        base_m = np.zeros(len(place_m)) if near_m is None else near_m
        return np.asarray(np.where(np.isnan(highest), base_m, highest) + self.surface.height_m(place_m))


def lay(pose: Pose, *, plan: Strip | Outline, crown_m: float, surface: RoughSurface) -> Sheet | Area:
    """Lay a ground over the surface, of which its mesh shows the waves that last `SPACINGS_A_WAVE` spacings or more."""
    resolved = surface.without_short_waves(1.0 / (SPACINGS_A_WAVE * plan.spacing_m))
    if isinstance(plan, Outline):
        return Area.lay(pose, outline=plan, surface=resolved)
    return Sheet.lay(pose, strip=plan, crown_m=crown_m, surface=resolved)
