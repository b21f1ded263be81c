"""List of points on the grid of the sensor that recorded it: rows are its channels, columns its firings in a turn.

The row of a point is that of its ring, or of the channel whose beam is nearest. Its column is its azimuth in steps, but
no two points of a row share one: azimuths are rounded, and drift where the motion of the car was taken out. Pixels
without a point are pulses without a return. For scanners whose beams do not turn the grid is a raster, as fine as the
points are dense.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...errors import InputError, OptionError
from ...maths.arrays import Numbers
from ...maths.pose import direction_from_angles
from ...recordings.sweep import Sweep
from ...scan.base import Scanner
from ...scan.spinning import Spinning
from .planes import has_grid, map_sweep, wrapped
from .tuning import (
    DUPLICATE_STEPS,
    LEAST_COHERENCE,
    LEAST_GAP_RAD,
    LEAST_IN_ORDER,
    LEAST_RINGS,
    LONGEST_STEP,
    POINTS_PER_PIXEL,
    SAME_TURN,
)

ROUNDS = 4
"""Rounds in which rows and exits find each other, and as many of rows and elevations."""

SAMPLE = 50
"""Points of a ring that choose its channel."""

USUAL_RATES_HZ = (5.0, 10.0, 15.0, 20.0)
"""Source: manuals of Velodyne, Hesai and Ouster; turns a second that users choose among."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rows:
    """Rows of a grid, in any order; arrays (rows,) and (rows, 3).

    Attributes:
        azimuth_rad: azimuth of each row's beam, from that of the head
        columns: firings of each row in a turn, of the sensor's own turns and of the usual ones
        exit_m: places in the head where the beams start; None: its origin
    """

    elevation_rad: Numbers
    azimuth_rad: Numbers
    columns: tuple[int, ...]
    exit_m: Numbers | None = None

    def exits(self, azimuth_rad: Numbers, row: Numbers) -> Numbers:
        """(..., 3) exits of beams of these azimuths, in the sensor's frame."""
        head = azimuth_rad - self.azimuth_rad[row]
        cos, sin = np.cos(head), np.sin(head)
        x, y, z = np.moveaxis(np.zeros((*np.shape(row), 3)) if self.exit_m is None else self.exit_m[row], -1, 0)
        return np.stack(np.broadcast_arrays(cos * x - sin * y, sin * x + cos * y, z), axis=-1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SensorGrid:
    """Sweep on the grid of its sensor, and the beams that it shows.

    Attributes:
        sweep: rows by the number of the channel, columns by rising azimuth
        elevation_rad: (rows,) recorded elevations
        azimuth_rad: (rows,) azimuth of the first column of each row; NaN where azimuths follow no steps
        sector_rad: azimuth at which the points begin, and angle that they span counter-clockwise; None: a whole turn
    """

    sweep: Sweep
    elevation_rad: Numbers
    azimuth_rad: Numbers
    sector_rad: tuple[float, float] | None


def on_grid(sweep: Sweep, scanner: Scanner) -> Sweep:
    """Put a list of points on the grid of its sensor; a sweep of rows and columns stays as it is.

    Raises:
        InputError: if a list has no returns, or for more rings than the sensor has channels
    """
    if not has_grid(sweep):
        return grid_of(sweep, scanner).sweep
    if isinstance(scanner, Spinning):
        _require_channels(sweep.shape[0], len(np.unique(scanner.lasers_by_place.values)))
    return sweep


def _require_channels(rings: int, channels: int) -> None:
    if rings > channels:
        must = "must have the {0} rings of the recording, got {1} channels"
        raise OptionError(f"{{sensor}}: {must}", rings, channels)


def grid_of(sweep: Sweep, scanner: Scanner) -> SensorGrid:
    """Put the first returns of a list on the grid of its sensor.

    Raises:
        InputError: if it has no returns, or more rings than the sensor has channels
    """
    is_point = sweep.has_return if sweep.return_number is None else sweep.has_return & (sweep.return_number <= 1)
    points_m = sweep.xyz_m[is_point]
    if not len(points_m):
        raise InputError(f"frame {sweep.metadata.get('frame', '')}: must have returns, got none")
    rows = rows_of(scanner) if isinstance(scanner, Spinning) else _raster(points_m)
    row, rows = _assign_rows(points_m, rows, _rings(sweep, is_point, len(rows.elevation_rad)))
    exit_m = rows.exits(np.arctan2(points_m[:, 1], points_m[:, 0]), row)
    beam_m = points_m - exit_m
    azimuth = np.arctan2(beam_m[:, 1], beam_m[:, 0])
    columns = _count_columns(row, azimuth, rows.columns)
    shape, step = (len(rows.elevation_rad), columns), 2.0 * math.pi / columns
    phase, is_regular = _phases(row, azimuth / step, shape[0])
    chosen, column = _assign_columns(row, azimuth / step - phase[row], columns)
    cell = row[chosen], column

    def lay_out(values: Numbers) -> Numbers:
        """Lay a value of each point out on the grid; pixels without a point get NaN, or 0 if it is whole."""
        empty = np.nan if values.dtype.kind == "f" else 0
        array = np.full((*shape, *values.shape[is_point.ndim :]), empty, values.dtype)
        array[cell] = values[is_point][chosen]
        return array

    column_azimuth = wrapped((np.arange(columns) + phase[:, None]) * step)
    elevation = np.broadcast_to(rows.elevation_rad[:, None], shape)
    direction = np.stack(direction_from_angles(azimuth_rad=column_azimuth, elevation_rad=elevation), axis=-1)
    origin_m = rows.exits(column_azimuth, np.arange(shape[0])[:, None])
    range_m = np.full(shape, np.nan)
    range_m[cell] = np.linalg.norm(beam_m[chosen], axis=-1)
    direction[cell], origin_m[cell] = beam_m[chosen] / range_m[cell][:, None], exit_m[chosen]
    sector = _sector(azimuth)
    recorded = np.ones(shape, bool)
    if sector is not None:  # a part that was cut out may end above or below, too
        recorded = np.isin(np.arange(shape[0]), row)[:, None] & (
            (column_azimuth - sector[0] + 0.5 * step) % (2.0 * math.pi) < sector[1] + step
        )
    return SensorGrid(
        sweep=replace(
            map_sweep(lay_out, sweep),
            range_m=range_m,
            recorded=recorded | np.isfinite(range_m),
            direction=direction,
            origin_m=None if rows.exit_m is None else origin_m,
            ring=np.broadcast_to(np.arange(shape[0])[:, None], shape),
            column=np.broadcast_to(np.arange(columns), shape),
            return_number=None,
            includes_lost=True,
        ),
        elevation_rad=rows.elevation_rad,
        azimuth_rad=np.where(is_regular, phase * step, np.nan),
        sector_rad=sector,
    )


def rows_of(scanner: Spinning) -> Rows:
    """Rows of a scanner, by the number of the channel."""
    _, place, counts = np.unique(scanner.lasers_by_place.values, return_index=True, return_counts=True)
    start, end = np.asarray(scanner.head.angle_rad(np.arange(2)), np.float64)
    firings, step = int(counts.max()), abs(float(wrapped(end - start)))
    return Rows(
        elevation_rad=scanner.elevation_rad.values[place],
        azimuth_rad=scanner.azimuth_rad.values[place],
        exit_m=None if scanner.start_m is None else np.stack([table.values[place] for table in scanner.start_m], -1),
        columns=(
            round(firings * 2.0 * math.pi / step),
            *(round(firings / (rate_hz * scanner.cycle_s)) for rate_hz in USUAL_RATES_HZ),
        ),
    )


def _raster(points_m: Numbers) -> Rows:
    """Rows of a raster with `POINTS_PER_PIXEL`."""
    height = points_m[:, 2] / np.linalg.norm(points_m, axis=-1)
    sector = _sector(np.arctan2(points_m[:, 1], points_m[:, 0]))
    angle_sr = (2.0 * math.pi if sector is None else sector[1]) * float(np.ptp(height))
    step = math.sqrt(max(angle_sr, 1e-6) * POINTS_PER_PIXEL / len(points_m))
    low, high = np.arcsin([height.min(), height.max()])
    elevation = np.linspace(high, low, max(2, round((high - low) / step)))
    return Rows(
        elevation_rad=elevation, azimuth_rad=np.zeros_like(elevation), columns=(max(2, round(2.0 * math.pi / step)),)
    )


def _rings(sweep: Sweep, is_point: Numbers, rows: int) -> Numbers | None:
    """Ring of each point: as recorded, by the rows or columns of the list, or by its order; None if it has no rings.

    In a file ring by ring azimuths go one way all along, and pass the x axis once for each ring; in one by time they do
    so once or twice.
    """
    if sweep.ring is not None:
        return sweep.ring[is_point]
    if rows in sweep.shape and is_point.ndim == 2:
        return np.nonzero(is_point)[sweep.shape.index(rows)]
    azimuth = np.arctan2(*sweep.direction[is_point][:, 1::-1].T) % (2.0 * math.pi)
    steps = np.diff(azimuth)
    sign = np.sign(np.median(wrapped(steps))) if len(steps) else 0.0
    ring = np.r_[0, np.cumsum(steps * sign < -math.pi)]
    in_order = bool(np.mean(wrapped(steps) * sign > 0.0) > LEAST_IN_ORDER) if len(steps) else False
    return ring if in_order and LEAST_RINGS * rows < ring[-1] + 1 <= rows else None


def _assign_rows(points_m: Numbers, rows: Rows, ring: Numbers | None) -> tuple[Numbers, Rows]:
    """Row of each point, and the rows as recorded.

    Some drivers count points from the exits of the beams, some from the sensor's origin: of the two, those are taken
    in which the points of a row have more nearly one elevation.

    Raises:
        InputError: for more rings than rows
    """
    candidates = [rows] if rows.exit_m is None else [rows, replace(rows, exit_m=None)]
    found = [_rows_and_spread(points_m, candidate, ring) for candidate in candidates]
    row, recorded_rows, _ = min(found, key=lambda result: result[2])
    return row, recorded_rows


def _rows_and_spread(points_m: Numbers, rows: Rows, ring: Numbers | None) -> tuple[Numbers, Rows, float]:
    """Row of each point, the rows with the recorded elevations, and the median deviation from these."""
    azimuth = np.arctan2(points_m[:, 1], points_m[:, 0])
    numbers = np.arange(len(rows.elevation_rad))

    def elevations(chosen: Numbers, row: Numbers) -> Numbers:
        """Elevations of these points, seen from the exits of these rows."""
        beam_m = points_m[chosen] - rows.exits(azimuth[chosen], row)
        return np.asarray(np.arctan2(beam_m[..., 2], np.hypot(beam_m[..., 0], beam_m[..., 1])))

    def centred(row: Numbers) -> tuple[Numbers, float]:
        """Elevation of each row as recorded, and the spread; rows without points move as the others do."""
        off = elevations(every, row) - rows.elevation_rad[row]
        medians = np.array([np.median(off[row == number]) if (row == number).any() else np.nan for number in numbers])
        shift = np.where(np.isfinite(medians), medians, np.nanmedian(medians))
        return rows.elevation_rad + shift, float(np.median(np.abs(off - shift[row])))

    every = np.arange(len(points_m))
    if ring is not None:
        row = _rows_of_rings(ring, rows, elevations)
        elevation, spread = centred(row)
        return row, replace(rows, elevation_rad=elevation), spread
    elevation, row, spread = rows.elevation_rad, np.zeros(len(points_m), int), math.inf
    seen = np.arctan2(points_m[:, 2], np.hypot(points_m[:, 0], points_m[:, 1]))
    for number in range(2 * ROUNDS):
        order = np.argsort(elevation)
        row = order[np.searchsorted(0.5 * (elevation[order][1:] + elevation[order][:-1]), seen)]
        seen = elevations(every, row)
        if number >= ROUNDS:  # rows first, since exits move points by several of them
            elevation, spread = centred(row)
    return row, replace(rows, elevation_rad=elevation), spread


def _rows_of_rings(ring: Numbers, rows: Rows, elevations: Callable[[Numbers, Numbers], Numbers]) -> Numbers:
    """Row of each point by its ring, so that the rings' elevations differ least from those of their rows.

    Raises:
        InputError: for more rings than rows
    """
    from scipy.optimize import linear_sum_assignment

    names, inverse, counts = np.unique(ring, return_inverse=True, return_counts=True)
    _require_channels(len(names), len(rows.elevation_rad))
    order, numbers = np.argsort(inverse, kind="stable"), np.arange(len(rows.elevation_rad))
    cost = np.zeros((len(names), len(numbers)))
    for number, members in enumerate(np.split(order, np.cumsum(counts)[:-1])):
        sample = members[:: max(1, len(members) // SAMPLE)]
        seen = elevations(sample[:, None], np.broadcast_to(numbers, (len(sample), len(numbers))))
        cost[number] = (np.median(seen, axis=0) - rows.elevation_rad) ** 2  # a convex cost keeps the order
    return np.asarray(linear_sum_assignment(cost)[1][inverse])


def _count_columns(row: Numbers, azimuth: Numbers, usual: tuple[int, ...]) -> int:
    """Firings in a turn by the mean step between neighbours of a row, or what is usual near that; rasters have one."""
    order = _without_duplicates(row, azimuth * usual[0] / (2.0 * math.pi))
    steps = np.diff(azimuth[order])[np.diff(row[order]) == 0]
    if len(usual) == 1 or not len(steps):
        return usual[0]
    columns = 2.0 * math.pi / float(np.mean(steps[steps <= LONGEST_STEP * np.median(steps)]))
    nearest = min(usual, key=lambda number: abs(columns / number - 1.0))
    return nearest if abs(columns / nearest - 1.0) < SAME_TURN else round(columns)


def _without_duplicates(row: Numbers, place: Numbers) -> Numbers:
    """Indices of the points by row and place, but of two returns of one pulse."""
    order = np.lexsort((place, row))
    is_other = (np.diff(row[order], prepend=-1) != 0) | (np.diff(place[order], prepend=-np.inf) > DUPLICATE_STEPS)
    return np.asarray(order[is_other])


def _phases(row: Numbers, turns: Numbers, rows: int) -> tuple[Numbers, Numbers]:
    """Place of each row's columns within a step, and whether its azimuths have one; ``turns`` are azimuths in steps."""
    vectors = np.exp(2j * math.pi * turns)
    sums = np.bincount(row, vectors.real, rows) + 1j * np.bincount(row, vectors.imag, rows)
    is_regular = np.abs(sums) > LEAST_COHERENCE * np.bincount(row, minlength=rows)
    return np.angle(sums) / (2.0 * math.pi), is_regular


def _assign_columns(row: Numbers, place: Numbers, columns: int) -> tuple[Numbers, Numbers]:
    """Points on the grid and the columns they get: of two that are nearest to one column, one may take the next."""
    order = _without_duplicates(row, place)
    nearest = np.rint(place[order])
    off = place[order] - nearest
    order, nearest, off = (values[np.argsort(np.abs(off), kind="stable")] for values in (order, nearest, off))
    point = np.full((int(row.max()) + 1, columns), -1)
    for wanted in (nearest, nearest + np.sign(off)):
        column = wanted.astype(int) % columns
        left = np.flatnonzero(~np.isin(order, point) & (point[row[order], column] < 0))[::-1]
        point[row[order[left]], column[left]] = order[left]  # the last one written is the nearest
    on_grid_rows, on_grid_columns = np.nonzero(point >= 0)
    return point[on_grid_rows, on_grid_columns], on_grid_columns


def _sector(azimuth: Numbers) -> tuple[float, float] | None:
    """Azimuth at which the points begin after their widest gap, and the angle that they span; None for a whole turn."""
    ordered = np.sort(azimuth)
    gaps = np.diff(ordered, append=ordered[:1] + 2.0 * math.pi)
    widest = int(np.argmax(gaps))
    if gaps[widest] < LEAST_GAP_RAD:
        return None
    return float(ordered[(widest + 1) % len(ordered)]), float(2.0 * math.pi - gaps[widest])
