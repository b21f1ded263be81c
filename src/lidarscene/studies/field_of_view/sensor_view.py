"""Results of a field-of-view study for one sensor.

A module of its own, because both the figures and the study need these types.
"""

from __future__ import annotations

from dataclasses import dataclass

from ...maths.arrays import Numbers
from ...sensor.sensor_model import Sensor
from .pattern_coverage import CellMaps, FiredPulses, cell_maps, field_cells, fired_pulses
from .reach import range_map_m
from .spacing import nearest_deg
from .sphere_cells import SphereCells
from .study_options import FieldOfViewStudy


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SensorView:
    """Results of a study for one sensor.

    Attributes:
        slug: start of the sensor's file names
        frame: pulses of the first frame
        watched_s: time over which the field of view was determined
        coverage_s: the longest requested time
        revisit_s: that time or two frames, whichever is longer
        coverage_maps: numbers of the cells after coverage_s
        revisit_maps: numbers of the cells after revisit_s
        range_m: (cells,) range at P_d 0.9 on the target; NaN without a pulse, inf without a limit
        spacing_deg: angles from pulses of the first frame to their nearest neighbours
    """

    name: str
    slug: str
    sensor: Sensor
    cells: SphereCells
    frame: FiredPulses
    watched_s: float
    coverage_s: float
    revisit_s: float
    coverage_maps: CellMaps
    revisit_maps: CellMaps
    range_m: Numbers
    spacing_deg: Numbers


def study_sensor(name: str, slug: str, sensor: Sensor, study: FieldOfViewStudy) -> SensorView:
    """Compute the results for one sensor.

    Raises:
        InputError: if its pulses are too many
    """
    cells, coverage_s = SphereCells.of_size(study.cell_deg), max(study.times_s)
    revisit_s = max(coverage_s, 2.0 * sensor.scanner.frame_s)
    pulses = fired_pulses(sensor.scanner, revisit_s)
    mask, watched_s = field_cells(sensor.scanner, cells, coverage_s, kind=study.mask)
    revisit_maps = cell_maps(pulses, cells, mask)
    coverage_maps = cell_maps(pulses.until(coverage_s), cells, mask)
    frame = pulses.until(sensor.scanner.frame_s)
    return SensorView(
        name=name,
        slug=slug,
        sensor=sensor,
        cells=cells,
        frame=frame,
        watched_s=watched_s,
        coverage_s=coverage_s,
        revisit_s=revisit_s,
        coverage_maps=coverage_maps,
        revisit_maps=revisit_maps,
        range_m=range_map_m(sensor, revisit_maps, study.target),
        spacing_deg=nearest_deg(frame.direction),
    )
