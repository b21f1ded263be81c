"""Quads of a sweep: each pixel in its tangent plane, the ground completed by its plane.

Symbols: n quads.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...maths.arrays import Numbers, map_arrays
from ...maths.pose import Pose
from ...recordings.sweep import Sweep
from ...sensor.sensor_model import Sensor
from ..ranging.plane import detection_probability
from .apparent_reflectivity import (
    ReflectivityGauge,
    board,
    largest_reflectivity,
    scattering_law,
    threshold_of,
    white_signal,
    withheld_mask,
)
from .ground import leaning_as_ground
from .planes import Grid, Planes, angles_from, finite_median, fit_planes, median_around
from .reading_noise import surface_without_noise
from .tuning import (
    ASSUMED_MEDIAN,
    BEAM_SHARE,
    BEHIND_M,
    EDGE,
    GROUND_BEYOND,
    LARGEST_STRETCH,
    LEAST_REFLECTIVITY,
    LOST_SHARE,
    ON_GROUND_M,
    OVERLAP,
    QUAD_OVERLAP,
    RANGES_M,
    STEEPEST_SLOPE,
    SURE,
)

SMOOTH, ROUGH, FILLED, GROUND, BRIGHT = range(5)
KINDS = ("smooth", "rough", "filled", "ground", "bright")
"""Kinds of quads: measured on a smooth surface, or on a rough one; hole in a plane; completed ground; brighter than
matt white."""

BORDER_SEED = 0
"""Seed of the borders, so that a recording always gives the same twin."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surfels:
    """Quads with their reflectivities.

    Attributes:
        corners_m: (n, 4, 3) corners
        reflectivity: (n,) reflectivity at normal incidence; of bright quads the apparent one, above that of matt white
        kind: (n,) index in `KINDS`
    """

    corners_m: Numbers
    reflectivity: Numbers
    kind: Numbers

    def __len__(self) -> int:
        return len(self.kind)

    def placed(self, pose: Pose) -> Surfels:
        """Transform the quads from the sensor's frame by its pose."""
        return Surfels(
            corners_m=self.corners_m @ pose.rotation.T + pose.position_m, reflectivity=self.reflectivity, kind=self.kind
        )


def join_surfels(parts: Sequence[Surfels]) -> Surfels:
    """Join several sets of quads into one."""
    return map_arrays(lambda *values: np.concatenate(values), *parts)


def surfels_of_grid(
    grid: Grid,
    gauge: ReflectivityGauge | None,
    ground: Numbers | None,
    border: float = 0.0,
    sensor: Sensor | None = None,
) -> Surfels:
    """Make the quads of a sweep of rows and columns, in the sensor's frame.

    In a twin of every second column a return has a quad to either side of its middle. Where the next one is on the same
    surface both lean to the line between the two (`_leaning`), so that a held-out beam meets what is between them.

    Args:
        gauge: conversion of strengths; None: all reflectivities are `ASSUMED_MEDIAN`
        ground: (3,) coefficients of the ground's plane, z = a + b x + c y [m]; None: no ground
        border: largest distance, in half widths of a pixel, of the border between two returns from half way; not 0: the
            twin is of every second column
        sensor: sensor whose noise ranges and strengths lack; None: ranges are those of the planes, where there are any
    """
    sweep, planes = grid.sweep, fit_planes(grid)
    returned, smooth = sweep.has_return, planes.smooth()
    leaning = leaning_as_ground(ground, planes.normal, sweep.direction)
    apparent = _apparent(grid, gauge, planes)
    range_m = np.where(planes.has_plane, planes.range_m, sweep.range_m)
    if sensor is not None:
        range_m, apparent, smooth = surface_without_noise(sensor, grid, planes, apparent)
    two_returns = _two_returns(grid)
    ends_left, ends_right = (_surface_ends(grid, side) & returned & ~two_returns for side in (1, -1))
    borders = _borders(grid, border)
    ends = np.where(ends_left, EDGE, borders[0]), np.where(ends_right, -EDGE, borders[1])
    filled = sweep.lost & planes.has_plane & ~withheld_mask(sweep)
    parts = [_quads(grid, filled, range_m, leaning, apparent, FILLED)]
    sides: list[tuple[Numbers, tuple[Numbers | float, Numbers | float]]] = [(leaning, ends)]
    if border > 0.0:
        left, right = (_leaning(grid, range_m, leaning, side) for side in (1, -1))
        sides = [(left, (ends[0], -OVERLAP)), (right, (OVERLAP, ends[1]))]
    for (normal, span), (mask, kind) in itertools.product(sides, ((smooth, SMOOTH), (~smooth, ROUGH))):
        parts.append(_quads(grid, returned & mask & ~two_returns, range_m, normal, apparent, kind, span=span))
    for side, end in ((1, ends_left), (-1, ends_right)):
        faded = 0.5 * (apparent + np.fmin(apparent, _neighbour_bound(grid, gauge, range_m, side)))
        beyond_span = (2.0 - EDGE, EDGE) if side > 0 else (-EDGE, EDGE - 2.0)
        parts.append(_quads(grid, end, range_m, leaning, faded, ROUGH, span=beyond_span))
    if two_returns.any():
        parts += _two_return_quads(grid, two_returns, range_m, leaning, gauge, borders)
    if ground is not None:
        parts.append(_ground(grid, planes, apparent, ground, gauge))
    return join_surfels(parts)


def _apparent(grid: Grid, gauge: ReflectivityGauge | None, planes: Planes) -> Numbers:
    """Apparent reflectivity of every pixel.

    A lost pixel has the median of its row's neighbours, or in a wider hole the median of the pixels that its plane was
    fitted to, limited by its own strength (`_reflectivity_bound`).
    """
    sweep = grid.sweep
    if gauge is None:
        return np.full(sweep.shape, ASSUMED_MEDIAN)
    apparent = gauge.apparent(sweep, np.where(sweep.has_return, sweep.range_m, 1.0))
    lost_mask = ~sweep.has_return & planes.has_plane
    if lost_mask.any():
        measured = np.where(sweep.has_return, apparent, np.nan)
        medians = finite_median(np.stack([np.roll(measured, shift, axis=1)[lost_mask] for shift in range(-4, 5)]))
        if np.isnan(medians).any():
            medians = np.where(np.isnan(medians), median_around(grid, measured)[lost_mask], medians)
        apparent[lost_mask] = np.fmin(medians, _reflectivity_bound(grid, gauge, planes.range_m)[lost_mask])
    return np.maximum(apparent, LEAST_REFLECTIVITY)


def _reflectivity_bound(grid: Grid, gauge: ReflectivityGauge, range_m: Numbers) -> Numbers:
    """Largest apparent reflectivity that the strength of a lost pulse allows; inf where nothing is known of it.

    Ousters report the highest peak of a pulse even if they lost it. Where SIGNAL is 0 or not recorded, the threshold of
    their NEAR_IR stands for it.
    """
    sweep = grid.sweep
    if not sweep.includes_lost:
        return np.full(sweep.shape, np.inf)
    # No echo of the surface is stronger than the threshold that lost it: a higher peak is other light.
    threshold = threshold_of(sweep, gauge.sensor)
    if gauge.field == "signal" and sweep.signal is not None:
        peak = np.fmin(np.where(sweep.signal > 0.0, sweep.signal, np.inf), threshold)
        allowed = gauge.apparent(replace(sweep, signal=peak), np.nan_to_num(range_m, nan=1.0))
        allowed[np.isinf(peak)] = np.inf
    elif gauge.field == "reflectivity" and gauge.sensor is not None:
        allowed = threshold / white_signal(gauge.sensor, np.nan_to_num(range_m, nan=1.0).clip(*RANGES_M))
    else:
        return np.full(sweep.shape, np.inf)
    return np.asarray(LOST_SHARE * _threshold_share(sweep) * allowed)


def _threshold_share(sweep: Sweep) -> Numbers:
    """Threshold that a pulse will meet in the twin over the recorded one, at most 1.

    Thresholds go with the root of the background, and the twin's is that of the median return, in light that is the
    same everywhere. So what was lost before a bright sky is lost in the twin, too.
    """
    if sweep.near_ir is None or not sweep.has_return.any():
        return np.ones(sweep.shape)
    median = float(np.nanmedian(sweep.near_ir[sweep.has_return]))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.nan_to_num(np.sqrt(np.minimum(median / sweep.near_ir, 1.0)), nan=1.0))


def _two_returns(grid: Grid) -> Numbers:
    second = grid.sweep.second
    if second is None:
        return np.zeros(grid.sweep.shape, bool)
    return np.asarray(grid.sweep.has_return & np.isfinite(second.range_m))


def _borders(grid: Grid, border: float) -> tuple[Numbers, Numbers]:
    """Left and right end of each pixel's quad [half widths]; drawn evenly between two returns, else half way."""
    returned = grid.sweep.has_return
    shift = np.random.default_rng(BORDER_SEED).uniform(-border, border, returned.shape)
    shift = np.where(returned & _neighbour(grid, returned, 1), shift, 0.0)
    return 1.0 + shift, _neighbour(grid, shift, -1) - 1.0


def _leaning(grid: Grid, range_m: Numbers, normal: Numbers, side: int) -> Numbers:
    """Unit normals towards the sensor of planes through each return and the one to the left (side 1) or right (-1).

    They keep the rise of the plane of ``normal`` along the column. Where the way to the neighbour is steeper than
    `STEEPEST_SLOPE`, it is on another surface, and the normals are the given ones.
    """
    sweep = grid.sweep
    direction = sweep.direction
    point = range_m[..., None] * direction + (0.0 if sweep.origin_m is None else sweep.origin_m)
    # Up along the plane, in the vertical plane of the beam.
    steepness = normal[..., 2] / np.einsum("...i,...i", normal, direction)
    leaning = np.cross(_neighbour(grid, point, side) - point, (0.0, 0.0, 1.0) - steepness[..., None] * direction)
    with np.errstate(invalid="ignore", divide="ignore"):
        towards = -np.sign(np.einsum("...i,...i", leaning, direction)) / np.linalg.norm(leaning, axis=-1)
        change_m = np.abs(_neighbour(grid, range_m, side) - range_m)
        joins = (change_m < STEEPEST_SLOPE * abs(grid.step_rad) * range_m) & np.isfinite(towards)
    joins &= sweep.has_return & _neighbour(grid, sweep.has_return, side)
    return np.where(joins[..., None], towards[..., None] * leaning, normal)


def _surface_ends(grid: Grid, side: int) -> Numbers:
    """Mask of the pixels whose neighbour to the left (side 1) or right (-1) was lost without a withheld echo."""
    sweep = grid.sweep
    return _neighbour(grid, sweep.lost & ~withheld_mask(sweep), side)


def _neighbour_bound(grid: Grid, gauge: ReflectivityGauge | None, range_m: Numbers, side: int) -> Numbers:
    """Largest apparent reflectivity that the lost neighbour's strength allows at this pixel's range."""
    if gauge is None:
        return np.full(grid.sweep.shape, np.inf)
    neighbour_range_m = _neighbour(grid, range_m, -side)
    return _neighbour(grid, _reflectivity_bound(grid, gauge, neighbour_range_m), side)


def _neighbour(grid: Grid, values: Numbers, side: int) -> Numbers:
    """Values of the pixel to the left of each (side 1), or to the right (-1)."""
    return np.roll(values, -side if grid.step_rad > 0.0 else side, axis=1)


def _two_return_quads(
    grid: Grid,
    two_returns: Numbers,
    range_m: Numbers,
    normal: Numbers,
    gauge: ReflectivityGauge | None,
    borders: tuple[Numbers, Numbers],
) -> list[Surfels]:
    """Quads of pixels with two returns: the nearer quad covers half of the pixel, the farther one shows beside it.

    Each gets its apparent reflectivity over `BEAM_SHARE`, since only that share of the beam meets it.

    Args:
        borders: left and right ends (`_borders`)
    """
    sweep = grid.sweep
    assert sweep.second is not None
    second = sweep.second
    facing = -sweep.direction
    first_apparent = gauge.apparent(sweep, sweep.range_m) if gauge else np.full(sweep.shape, ASSUMED_MEDIAN)
    second_apparent = gauge.apparent(second, second.range_m) if gauge else np.full(sweep.shape, ASSUMED_MEDIAN)
    first_nearer = sweep.range_m < second.range_m
    quads = []
    for nearer in (True, False):
        of_first = two_returns & (first_nearer == nearer)
        of_second = two_returns & (first_nearer != nearer)
        span = (borders[0], 1.0 - 2.0 * BEAM_SHARE) if nearer else borders
        quads.append(_quads(grid, of_first, range_m, normal, first_apparent / BEAM_SHARE, ROUGH, span=span))
        quads.append(_quads(grid, of_second, second.range_m, facing, second_apparent / BEAM_SHARE, ROUGH, span=span))
    return quads


def _ground(grid: Grid, planes: Planes, apparent: Numbers, ground: Numbers, gauge: ReflectivityGauge | None) -> Surfels:
    """Quads of the ground's plane behind returns, and where a lost pulse would have met it in sight.

    Ground that the sensor of an intensity could not have lost is not there: the vehicle that carries it, water or a
    mirror is.
    """
    sweep = grid.sweep
    up = np.array([-ground[1], -ground[2], 1.0])
    normal = up / np.linalg.norm(up)
    origin_m = np.zeros((*sweep.shape, 3)) if sweep.origin_m is None else sweep.origin_m
    with np.errstate(divide="ignore", invalid="ignore"):
        # Range at which each beam meets z = a + b x + c y.
        meets_m = (ground[0] - origin_m @ up) / (sweep.direction @ up)
        on_ground = sweep.has_return & (np.abs((sweep.range_m - meets_m) * (sweep.direction @ normal)) < ON_GROUND_M)
    if not on_ground.any():
        return _quads(grid, on_ground, meets_m, np.broadcast_to(normal, (*sweep.shape, 3)), apparent, GROUND)
    farthest_m = GROUND_BEYOND * float(np.percentile(sweep.range_m[on_ground], 99.0))
    with np.errstate(invalid="ignore"):
        in_sight = (
            ~planes.has_plane & ~withheld_mask(sweep) & _in_sight(sweep.has_return, on_ground, sweep.range_m, meets_m)
        )
        completes = np.where(sweep.has_return, sweep.range_m + BEHIND_M < meets_m, in_sight)
        chosen = (meets_m > 0.0) & (meets_m < farthest_m) & completes & sweep.recorded
    strength = np.full(sweep.shape, float(np.median(apparent[on_ground])))
    octave = np.floor(2.0 * np.log2(np.maximum(np.nan_to_num(meets_m), 1e-3))).astype(int)
    # The ground is as bright as measured in the same half octave of the range.
    for number in np.unique(octave[chosen]):
        ground_octave = on_ground & (octave == number)
        if ground_octave.sum() >= 10:
            strength[octave == number] = np.median(apparent[ground_octave])
    if gauge is not None:
        strength = np.where(sweep.has_return, strength, np.fmin(strength, _reflectivity_bound(grid, gauge, meets_m)))
        if gauge.field == "intensity" and gauge.sensor is not None:
            missed = np.flatnonzero(chosen & ~sweep.has_return)
            cosine = -(sweep.direction.reshape(-1, 3)[missed] @ normal)
            met_m, ground_boards = meets_m.flat[missed], board(strength.flat[missed], cosine)
            chosen.flat[missed] = detection_probability(gauge.sensor, ground_boards, met_m) < SURE
    return _quads(grid, chosen, meets_m, np.broadcast_to(normal, (*sweep.shape, 3)), strength, GROUND)


def _in_sight(returned: Numbers, on_ground: Numbers, range_m: Numbers, meets_m: Numbers) -> Numbers:
    """Mask of the pixels where ground may show: the next return below is ground, and the next above is not nearer.

    Lost pulses below the return of a roof are windows and dark paint, not ground.
    """
    rows = np.broadcast_to(np.arange(returned.shape[0])[:, None], returned.shape)
    row_above = np.maximum.accumulate(np.where(returned, rows, -1), axis=0)
    row_below = np.minimum.accumulate(np.where(returned, rows, len(returned))[::-1], axis=0)[::-1]
    columns = np.arange(returned.shape[1])[None, :]
    on_below = (row_below == len(returned)) | on_ground[np.minimum(row_below, len(returned) - 1), columns]
    nearer = (row_above >= 0) & (range_m[np.maximum(row_above, 0), columns] < meets_m)
    return np.asarray(on_below & ~nearer)


def _quads(
    grid: Grid,
    chosen: Numbers,
    range_m: Numbers,
    normal: Numbers,
    apparent: Numbers,
    kind: int,
    *,
    span: tuple[Numbers | float, Numbers | float] = (1.0, -1.0),
) -> Surfels:
    """Make the quads of chosen pixels: the four corners of a pixel, seen from its exit, projected onto its plane.

    Args:
        span: left and right end of the quad, from the pixel's middle to the left, in half widths of the pixel
    """
    sweep = grid.sweep
    direction = sweep.direction[chosen]
    origin_m = np.zeros_like(direction) if sweep.origin_m is None else sweep.origin_m[chosen]
    middle_m, facing = range_m[chosen], normal[chosen]
    cos = -np.einsum("ni,ni->n", facing, direction)
    reflectivity = apparent[chosen] / scattering_law(cos)
    # A surface brighter than matt white can be is a retro-reflector, square to its beam.
    bright = reflectivity > largest_reflectivity()
    reflectivity = np.where(bright, apparent[chosen], reflectivity)
    facing = np.where(bright[:, None], -direction, facing)
    kinds = np.where(bright, BRIGHT, kind)
    azimuth, elevation = angles_from(direction)
    row = np.broadcast_to(np.arange(sweep.shape[0])[:, None], sweep.shape)[chosen]
    half_width = 0.5 * abs(grid.step_rad) * QUAD_OVERLAP
    above, below = (QUAD_OVERLAP * rad[row] for rad in (grid.above_rad, grid.below_rad))
    # The plane is ``depth`` = n x middle away along n, so a direction d meets it at the range depth / (n d).
    depth = np.einsum("ni,ni->n", facing, direction) * middle_m
    corners = []
    left_edge, right_edge = (np.broadcast_to(edge, sweep.shape)[chosen] for edge in span)
    for edge_offset, up in ((left_edge, above), (right_edge, above), (right_edge, -below), (left_edge, -below)):
        a, e = azimuth + edge_offset * half_width, np.clip(elevation + up, -0.5 * math.pi, 0.5 * math.pi)
        corner_direction = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            reach_m = depth / np.einsum("ni,ni->n", facing, corner_direction)
        # Beyond the plane's horizon the quotient is negative or huge; the quad ends before.
        reach_m = np.where(reach_m > 0.0, reach_m, np.inf).clip(middle_m / LARGEST_STRETCH, middle_m * LARGEST_STRETCH)
        corners.append(origin_m + reach_m[:, None] * corner_direction)
    return Surfels(corners_m=np.stack(corners, axis=1), reflectivity=reflectivity, kind=kinds)
