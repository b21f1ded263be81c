"""How far sensors see over their field of view, and on the ground around the vehicle that carries them.

A pattern that covers an angle is of no use where its echoes are too weak; range and coverage are combined here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...maths.arrays import Numbers
from ...sensor.model import Sensor
from ..ranging.plane import Target, detection_margin, maximum_range_m
from .cells import Cells
from .pattern import CellMaps

GROUND_M = 60.0
GROUND_STEP_M = 0.5

_SHARES = 1e-4  # aperture shares closer than this are one: the range goes with their fourth root


def range_map_m(sensor: Sensor, maps: CellMaps, target: Target) -> Numbers:
    """Maximum range on this target in each cell, with the scanner's own aperture; NaN without a pulse."""
    limit = np.full(len(maps.cell), np.nan)
    seen = np.isfinite(maps.share)
    if not seen.any():
        return limit
    steps, back = np.unique(np.rint(maps.share[seen] / _SHARES), return_inverse=True)
    found, _ = maximum_range_m(sensor, replace(target, aperture_share=np.maximum(steps * _SHARES, 0.0)))
    limit[seen] = np.asarray(found)[back.ravel()]
    return limit


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ground:
    """A square of level ground around the vehicle from above: rows of equal y, columns of equal x.

    seen  (sensors, rows, columns) whether each sensor sees the place
    """

    x_m: Numbers
    y_m: Numbers
    seen: Numbers

    @property
    def count(self) -> Numbers:
        """How many sensors see each place."""
        return np.asarray(self.seen.sum(axis=0))

    @property
    def square_metres(self) -> Numbers:
        """Area that each sensor sees."""
        return np.asarray(self.seen.sum(axis=(1, 2)) * (self.x_m[1] - self.x_m[0]) ** 2)

    def nearest_blind_m(self) -> float:
        """Radius around the origin within which no sensor sees anything; inf if nothing is seen at all."""
        away = np.hypot(self.x_m[None, :], self.y_m[:, None])
        return float(np.min(np.where(self.count > 0, away, np.inf)))


def ground(
    sensors: Sequence[Sensor],
    cells: Cells,
    maps: Sequence[CellMaps],
    target: Target,
    *,
    half_m: float = GROUND_M,
    step_m: float = GROUND_STEP_M,
) -> Ground:
    """Which sensors see which places of the plane z = 0 of the vehicle's frame.

    A place is seen if its direction is in a cell of the field of view, and an echo of ground with the target's
    reflectivity, at the beam's incidence there, reaches the comparator's level. Nothing is in the way, not even the
    vehicle's own body. A sensor that is not above the ground sees none of it.
    """
    axis = np.arange(-half_m + 0.5 * step_m, half_m, step_m)
    x, y = (a.ravel() for a in np.meshgrid(axis, axis))
    seen = np.zeros((len(sensors), len(axis), len(axis)), dtype=bool)
    for number, (sensor, own) in enumerate(zip(sensors, maps, strict=True)):
        height = float(sensor.mounting.position_m[2])
        if height <= 0.0:
            continue
        there = sensor.mounting.inverse_apply(np.column_stack([x, y, np.zeros_like(x)]))
        distance = np.linalg.norm(there, axis=1)
        azimuth = np.degrees(np.arctan2(there[:, 1], there[:, 0]))
        elevation = np.degrees(np.arctan2(there[:, 2], np.hypot(there[:, 0], there[:, 1])))
        at = cells.of(azimuth, elevation)
        place = np.minimum(np.searchsorted(own.cell, at), len(own.cell) - 1)
        mean = float(np.nanmean(own.share))
        share = np.where(np.isfinite(own.share), own.share, mean)[place]
        spot = replace(target, cos_incidence=height / distance, aperture_share=share)
        margin = detection_margin(sensor, spot, distance)
        seen[number] = ((own.cell[place] == at) & (margin >= 1.0)).reshape(seen.shape[1:])
    return Ground(x_m=axis, y_m=axis, seen=seen)
