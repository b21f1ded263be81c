"""What a field-of-view study asks, and one sensor's results.

A module of its own, because both the figures and the study need these types.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from ...maths.arrays import Numbers
from ...sensor.model import Sensor
from ..ranging.plane import Target
from .pattern_coverage import CellMaps, FiredPulses, cell_maps, field_cells, fired_pulses
from .reach import range_map_m
from .spacing import nearest_deg
from .sphere_cells import SphereCells

TIMES_S = (0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 1.4)
CELL_DEG = 0.28


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldOfViewStudy:
    """What is asked: times of coverage, size of cells, kind of field of view, target."""

    times_s: tuple[float, ...] = TIMES_S
    cell_deg: float = CELL_DEG
    mask: str = "outline"
    target: Target = field(default_factory=Target)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SensorView:
    """One sensor's results.

    frame    pulses of the first frame
    maps     for the longest requested time
    revisits for that time or two frames, whichever is longer
    """

    name: str
    slug: str
    sensor: Sensor
    cells: SphereCells
    frame: FiredPulses
    watched_s: float
    mapped_s: float
    revisits_s: float
    maps: CellMaps
    revisits: CellMaps
    range_m: Numbers
    spacing_deg: Numbers


def study_sensor(name: str, slug: str, sensor: Sensor, study: FieldOfViewStudy) -> SensorView:
    """One sensor's results. Raises InputError if its pulses are too many."""
    cells, longest = SphereCells.of_size(study.cell_deg), max(study.times_s)
    revisits_s = max(longest, 2.0 * sensor.scanner.frame_s)
    pulses = fired_pulses(sensor.scanner, revisits_s)
    mask, watched_s = field_cells(sensor.scanner, cells, longest, kind=study.mask)
    revisit_maps = cell_maps(pulses, cells, mask)
    coverage_maps = cell_maps(pulses.until(longest), cells, mask)
    frame = pulses.until(sensor.scanner.frame_s)
    return SensorView(
        name=name,
        slug=slug,
        sensor=sensor,
        cells=cells,
        frame=frame,
        watched_s=watched_s,
        mapped_s=longest,
        revisits_s=revisits_s,
        maps=coverage_maps,
        revisits=revisit_maps,
        range_m=range_map_m(sensor, revisit_maps, study.target),
        spacing_deg=nearest_deg(frame.direction),
    )
