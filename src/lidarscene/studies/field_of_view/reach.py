"""Range of a sensor over its field of view, and the ground around the vehicle that its sensors see.

A pattern that covers an angle is of no use where its echoes are too weak; range and coverage are combined here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...maths.arrays import Numbers
from ...sensor.sensor_model import Sensor
from ..ranging.conditions import PROBABILITY
from ..ranging.plane import Target, detection_probability, detection_range_m
from .pattern_coverage import CellMaps
from .sphere_cells import SphereCells

GROUND_M = 60.0
"""Choice: half side [m] of the square of ground around the sensor that is mapped."""

GROUND_STEP_M = 0.5
"""Choice: edge [m] of the cells of that map."""

_SHARE_STEP = 1e-4
"""Accuracy bought: aperture shares are rounded to this, so that few ranges are solved for: the range goes with their
fourth root."""


def range_map_m(sensor: Sensor, maps: CellMaps, target: Target) -> Numbers:
    """Range [m] on this target in each cell, by the scanner's effective aperture there; NaN without a pulse."""
    limit = np.full(len(maps.cell), np.nan)
    has_pulse = np.isfinite(maps.share[:, 0])
    if not has_pulse.any():
        return limit
    steps, step_index = np.unique(np.rint(maps.share[has_pulse] / _SHARE_STEP), axis=0, return_inverse=True)
    along = _seen_by(target, steps * _SHARE_STEP)
    range_m, _ = detection_range_m(sensor, along, PROBABILITY)
    limit[has_pulse] = np.asarray(range_m)[step_index.ravel()]
    return limit


def _seen_by(target: Target, share: Numbers) -> Target:
    """Target in directions with these shares (n, 2) of aperture and background."""
    return replace(target, aperture_share=share[:, 0], background_share=share[:, 1])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundView:
    """A square of level ground around the vehicle from above: rows of equal y, columns of equal x.

    Attributes:
        is_seen: (sensors, rows, columns) whether each sensor sees the place
    """

    x_m: Numbers
    y_m: Numbers
    is_seen: Numbers

    @property
    def count(self) -> Numbers:
        """Number of sensors that see each place, (rows, columns)."""
        return np.asarray(self.is_seen.sum(axis=0))

    @property
    def square_metres(self) -> Numbers:
        """Area in square metres that each sensor sees."""
        return np.asarray(self.is_seen.sum(axis=(1, 2)) * (self.x_m[1] - self.x_m[0]) ** 2)

    def nearest_blind_m(self) -> float:
        """Radius around the origin within which no sensor sees anything; inf if nothing is seen at all."""
        distance_m = np.hypot(self.x_m[None, :], self.y_m[:, None])
        return float(np.min(np.where(self.count > 0, distance_m, np.inf)))


def ground_view(
    sensors: Sequence[Sensor],
    cells: SphereCells,
    maps: Sequence[CellMaps],
    target: Target,
    *,
    half_m: float = GROUND_M,
    step_m: float = GROUND_STEP_M,
) -> GroundView:
    """Find the places of the plane z = 0 of the vehicle's frame that each sensor sees.

    A place is seen if its direction is in a cell of the field of view, and an echo of ground with the target's
    reflectivity, at the beam's incidence there, is detected with P_d 0.9 or more. Nothing is in the way, not even the
    vehicle's own body. A sensor that is not above the ground sees none of it.

    Args:
        maps: field of view of each sensor, in the same cells
        half_m: half the side of the square around the origin
        step_m: distance between places
    """
    axis = np.arange(-half_m + 0.5 * step_m, half_m, step_m)
    x, y = (coordinate.ravel() for coordinate in np.meshgrid(axis, axis))
    is_seen = np.zeros((len(sensors), len(axis), len(axis)), dtype=bool)
    for number, (sensor, cell_maps) in enumerate(zip(sensors, maps, strict=True)):
        height_m = float(sensor.mounting.position_m[2])
        if height_m <= 0.0:
            continue
        direction = sensor.mounting.inverse_apply(np.column_stack([x, y, np.zeros_like(x)]))
        distance_m = np.linalg.norm(direction, axis=1)
        azimuth = np.degrees(np.arctan2(direction[:, 1], direction[:, 0]))
        elevation = np.degrees(np.arctan2(direction[:, 2], np.hypot(direction[:, 0], direction[:, 1])))
        cell = cells.locate(azimuth, elevation)
        place = np.minimum(np.searchsorted(cell_maps.cell, cell), len(cell_maps.cell) - 1)
        # A cell of the outline between pulses has no aperture of its own: it gets the mean of the others.
        mean_share = np.nanmean(cell_maps.share, axis=0)
        share = np.where(np.isfinite(cell_maps.share), cell_maps.share, mean_share)[place]
        tilted_target = replace(_seen_by(target, share), cos_incidence=height_m / distance_m)
        is_detected = detection_probability(sensor, tilted_target, distance_m) >= PROBABILITY
        is_seen[number] = ((cell_maps.cell[place] == cell) & is_detected).reshape(is_seen.shape[1:])
    return GroundView(x_m=axis, y_m=axis, is_seen=is_seen)
