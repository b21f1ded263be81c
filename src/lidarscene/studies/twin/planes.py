"""Plane through each pixel of a sweep, from its neighbours on ring and column.

Symbols: p points of a window, w their weights, m normal over distance from the origin, so that m p = 1 on the plane.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...errors import InputError
from ...maths.arrays import Numbers, map_arrays
from ...recordings.sweep import Sweep
from .tuning import LEAST_COS, LEAST_SHARE, MOST_OFF_M, MOST_TURNS, NEAR_SHARE, REACH_RAD, SCALES_M, SMOOTH_COS

LARGEST_REACH = 3
"""Largest number of rings or columns to each side."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Grid:
    """Sweep whose columns have one azimuth in all rows. Arrays are (rows, columns) or (rows, columns, 3).

    Attributes:
        sweep: the pixels in the order of the grid
        step_rad: azimuth from one column to the next, with its sign
        above_rad: (rows,) half the angle to the row above
        below_rad: (rows,) half the angle to the row below
    """

    sweep: Sweep
    step_rad: float
    above_rad: Numbers
    below_rad: Numbers


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Planes:
    """Plane at each pixel; the fields have the grid's shape.

    Attributes:
        range_m: range along the beam to the plane; NaN where there is none
        normal: (..., 3) unit normal towards the sensor
    """

    range_m: Numbers
    normal: Numbers

    @property
    def has_plane(self) -> Numbers:
        """Mask of the pixels that have a plane."""
        return np.isfinite(self.range_m)

    def smooth(self, least: float = 1.0) -> Numbers:
        """Mask of the pixels where the planes of a pixel and its neighbours agree: no leaves, no edges.

        Each pixel's own range has a small share in it, so its noise is not cut off.

        Args:
            least: least share of the pixels around it that have a plane
        """
        around = [(row, column) for row in (-1, 0, 1) for column in (-2, -1, 0, 1, 2)]
        own = self.has_plane[..., None]
        # The fourth component counts the planes.
        vector = np.concatenate([np.where(own, self.normal, 0.0), own.astype(float)], axis=-1)
        total = np.sum([np.nan_to_num(shifted(vector, *offset)) for offset in around], axis=0)
        count = total[..., 3]
        return np.asarray(
            (count >= least * len(around))
            & (np.linalg.norm(total[..., :3], axis=-1) > SMOOTH_COS * np.maximum(count, 1.0))
        )


def select_columns(sweep: Sweep, columns: slice) -> Sweep:
    """Select columns of a sweep."""
    return map_sweep(lambda values: values[:, columns], sweep)


def map_sweep(take: Callable[[Numbers], Numbers], sweep: Sweep) -> Sweep:
    """Apply ``take`` to every array of a sweep."""
    changed = map_arrays(take, replace(sweep, second=None))
    return changed if sweep.second is None else replace(changed, second=map_arrays(take, sweep.second))


def has_grid(sweep: Sweep) -> bool:
    """True if a sweep has rows and columns, and the directions of lost pulses, too.

    A list that a file has in rows is none: a laser's row keeps its elevation, and goes around once.
    """
    if len(sweep.shape) != 2 or min(sweep.shape) < 2 or np.isnan(sweep.direction).any():
        return False
    azimuth, elevation = angles_from(sweep.direction)
    turned = np.abs(np.unwrap(azimuth, axis=1)[:, -1] - azimuth[:, 0])
    once = np.median(turned) < MOST_TURNS * 2.0 * math.pi
    return bool(once and elevation.std(axis=1).mean() <= elevation.std(axis=0).mean())


def align_columns(sweep: Sweep) -> Grid:
    """Order rows by elevation, and shift each until its columns agree.

    Raises:
        InputError: for a list of points
    """
    if not has_grid(sweep):
        raise InputError("must be a sweep of rows and columns with all directions, got a list of points")
    azimuth, elevations = angles_from(sweep.direction)
    step_rad = float(np.median(wrapped(np.diff(azimuth, axis=1))))
    elevation = np.median(elevations, axis=1)
    rows = np.argsort(-elevation, kind="stable")
    columns_n = sweep.shape[1]
    shift = np.rint(wrapped(azimuth[:, 0] - azimuth[rows[0], 0]) / step_rad).astype(int)
    columns = (np.arange(columns_n)[None, :] - shift[rows, None]) % columns_n
    half = 0.5 * np.abs(np.diff(elevation[rows]))
    return Grid(
        sweep=map_sweep(lambda values: values[rows[:, None], columns], sweep),
        step_rad=step_rad,
        above_rad=np.r_[half[:1], half],
        below_rad=np.r_[half, half[-1:]],
    )


def fit_planes(grid: Grid) -> Planes:
    """Fit a plane at every pixel, at lost ones too if enough of their neighbours are on one.

    Least squares of m p = 1 with Cauchy weights, whose width falls step by step, so that points before or behind the
    plane drop out. The point where the beam meets the plane has less noise than the pixel's own.
    """
    sweep = grid.sweep
    origin_m = np.zeros((*sweep.shape, 3)) if sweep.origin_m is None else sweep.origin_m
    direction, range_m = sweep.direction, np.array(sweep.range_m)
    offsets = _window(grid)
    neighbour_range_m = np.stack([shifted(range_m, *offset) for offset in offsets])
    guess_m = np.where(np.isfinite(range_m), range_m, finite_median(neighbour_range_m))
    points = origin_m + range_m[..., None] * direction
    neighbours = [shifted(points, *offset) for offset in offsets]
    nearby_masks = [
        np.abs(shifted(range_m, *offset) - guess_m) < NEAR_SHARE * guess_m + SCALES_M[0] for offset in offsets
    ]
    normal, plane_range_m, unusable = _fit(origin_m, direction, neighbours, nearby_masks, -direction, guess_m)
    # From a plane square to the beam the fit of flat ground may end on the line of its ring. Over many rings, between
    # which there are metres, ground is no plane.
    leaning = _leaning_normal(points, direction)
    again = unusable & np.isfinite(leaning).all(axis=-1) & np.isfinite(guess_m)
    beside = [number for number, (row, _) in enumerate(offsets) if abs(row) <= 1]
    found = _fit(
        origin_m[again],
        direction[again],
        [neighbours[number][again] for number in beside],
        [nearby_masks[number][again] for number in beside],
        leaning[again],
        guess_m[again],
    )
    normal[again], plane_range_m[again], unusable[again] = found
    with np.errstate(invalid="ignore"):
        off_m = np.abs(plane_range_m - range_m) * -np.einsum("...i,...i", normal, direction)
    valid = ~unusable & ~(off_m > MOST_OFF_M) & np.isfinite(plane_range_m)
    planes = Planes(
        range_m=np.where(valid, plane_range_m, np.nan), normal=np.where(valid[..., None], normal, -direction)
    )
    alone = again & ~planes.smooth(0.5)  # leaves and edges have a plane of three rings now and then
    # Rings lie beside the plane by the errors of their elevations, which move flat ground by decimetres.
    beyond_m = np.stack([shifted(range_m - planes.range_m, 0, column) for column in range(-3, 4)])
    planes.range_m[again] += np.nan_to_num(finite_median(beyond_m))[again]
    return Planes(
        range_m=np.where(alone, np.nan, planes.range_m), normal=np.where(alone[..., None], -direction, planes.normal)
    )


def _fit(
    origin_m: Numbers,
    direction: Numbers,
    neighbours: Sequence[Numbers],
    nearby_masks: Sequence[Numbers],
    first: Numbers,
    guess_m: Numbers,
) -> tuple[Numbers, Numbers, Numbers]:
    """Fit planes step by step; returns normal, range, and where there is no plane.

    Args:
        origin_m: (..., 3) origins of the beams
        direction: (..., 3) their directions
        neighbours: (..., 3) each, points of the window
        nearby_masks: (...) each, points that count in the first step
        first: (..., 3) normals of the first planes, to which the fit goes back where too few points are on one
        guess_m: (...) ranges of the first planes
    """
    unit, normal, plane_range_m = np.eye(3), first, guess_m
    for scale_m in SCALES_M:
        sums = np.zeros((10, *guess_m.shape))
        start_m = np.einsum("...i,...i", origin_m + plane_range_m[..., None] * direction, normal)
        for point, nearby_mask in zip(neighbours, nearby_masks, strict=True):
            off_m = np.einsum("...i,...i", point, normal) - start_m
            weight = 1.0 / (1.0 + (off_m / scale_m) ** 2)
            weight = np.where(np.isfinite(weight) & (nearby_mask | (scale_m < SCALES_M[0])), weight, 0.0)
            x, y, z = (np.nan_to_num(point[..., axis]) for axis in range(3))
            for index, product in enumerate((1.0, x, y, z, x * x, x * y, x * z, y * y, y * z, z * z)):
                sums[index] += weight * product
        # Normal equations of m p = 1: (sum w p p^T) m = sum w p.
        total, vector = sums[0], np.moveaxis(sums[1:4], 0, -1)
        matrix = np.moveaxis(sums[4:][_SYMMETRIC], 0, -1).reshape(*guess_m.shape, 3, 3)
        # Regularise towards a plane square to the beam: one point, or points on a line, determine no plane.
        matrix = matrix + (1e-9 * np.trace(matrix, axis1=-2, axis2=-1) + 1e-12)[..., None, None] * unit
        slope = np.linalg.solve(matrix, vector[..., None])[..., 0]
        length = np.linalg.norm(slope, axis=-1)
        with np.errstate(invalid="ignore", divide="ignore"):
            normal = -slope / length[..., None]
            cos = -np.einsum("...i,...i", normal, direction)
            plane_range_m = (1.0 - np.einsum("...i,...i", slope, origin_m)) / np.einsum("...i,...i", slope, direction)
            unusable = (total < LEAST_SHARE * len(neighbours)) | ~(cos > LEAST_COS) | ~(plane_range_m > 0.0)
        normal = np.where(unusable[..., None], first, normal)
        plane_range_m = np.where(unusable, guess_m, plane_range_m)
    return normal, plane_range_m, unusable


def _leaning_normal(points: Numbers, direction: Numbers) -> Numbers:
    """Unit normals towards the sensor of the planes through the neighbours on ring and column; NaN without them."""

    def difference(row: int, column: int) -> Numbers:
        ahead, behind = (np.array(shifted(points, sign * row, sign * column)) for sign in (1, -1))
        for side in (ahead, behind):  # beside a lost neighbour the pixel itself stands for it
            np.copyto(side, points, where=~np.isfinite(side))
        return np.asarray(ahead - behind)

    with np.errstate(invalid="ignore", divide="ignore"):
        normal = np.cross(difference(0, 1), difference(1, 0))
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        return np.asarray(-np.sign(np.einsum("...i,...i", normal, direction))[..., None] * normal)


_SYMMETRIC = [0, 1, 2, 1, 3, 4, 2, 4, 5]
"""Index of each of the nine elements of a symmetric 3 x 3 matrix among its six distinct ones."""


def _window(grid: Grid) -> list[tuple[int, int]]:
    """Offsets (rows, columns) from a pixel to its neighbours, itself included."""
    rows = int(np.clip(round(REACH_RAD / float(np.median(2.0 * grid.above_rad))), 1, LARGEST_REACH))
    columns = int(np.clip(round(REACH_RAD / abs(grid.step_rad)), 2, LARGEST_REACH))
    return [(row, column) for row in range(-rows, rows + 1) for column in range(-columns, columns + 1)]


def shifted(values: Numbers, row: int, column: int) -> Numbers:
    """Values of the neighbour ``row`` rows below and ``column`` columns on; NaN beyond the first and the last row."""
    rolled = np.roll(values, (-row, -column), axis=(0, 1))
    if row > 0:
        rolled[-row:] = np.nan
    elif row < 0:
        rolled[:-row] = np.nan
    return rolled


def median_around(grid: Grid, values: Numbers) -> Numbers:
    """Median of the finite (rows, columns) values over each pixel's window.

    It is finite wherever a pixel has a plane and the values of all kept pixels are finite.
    """
    return finite_median(np.stack([shifted(values, *offset) for offset in _window(grid)]))


def finite_median(values: Numbers) -> Numbers:
    """Upper median of the finite values over the first axis; NaN where there are none."""
    ordered = np.sort(values, axis=0)
    count = np.isfinite(values).sum(axis=0)
    return np.asarray(np.take_along_axis(ordered, (np.maximum(count, 1) // 2)[None], axis=0)[0])


def angles_from(direction: Numbers) -> tuple[Numbers, Numbers]:
    """Azimuth and elevation of (..., 3) unit vectors [rad]."""
    x, y, z = np.moveaxis(direction, -1, 0)
    return np.arctan2(y, x), np.arcsin(z.clip(-1.0, 1.0))


def wrapped(angle_rad: Numbers) -> Numbers:
    """Angle between -pi and pi."""
    return np.asarray((angle_rad + math.pi) % (2.0 * math.pi) - math.pi)
