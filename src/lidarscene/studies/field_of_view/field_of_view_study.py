"""Entry point of field-of-view studies: `field_of_view_study` takes sensors and returns a report with figures.

The command `fov` and Python users call it.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...figures.report import Data, Report, text_table
from ...sensor.sensor_model import Sensor
from . import field_of_view_figures as figures
from .pattern_coverage import DWELL_S, rate_hz
from .reach import GroundView, ground_view
from .sensor_view import SensorView, study_sensor
from .spacing import PERCENTILES
from .study_options import FieldOfViewStudy

if TYPE_CHECKING:
    from ...maths.pose import Pose
    from ...scene.scene import Scene
    from .body_points import BodyPoints

ProgressCallback = Callable[[int, int], object]
"""Function of the steps done and of their total."""

PAGES = ("index.html", "index.md")


def slugs(names: Sequence[str]) -> list[str]:
    """Start of each sensor's file names: its name in lower case with hyphens, numbered where it would repeat."""
    unique_slugs: list[str] = []
    for name in names:
        stem = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-") or "sensor"
        alike = sum(previous == stem or previous.startswith(f"{stem}-") for previous in unique_slugs)
        numbered = (f"{stem}-{number}" for number in itertools.count(alike + 1))
        slug = stem if stem not in unique_slugs else next(slug for slug in numbered if slug not in unique_slugs)
        unique_slugs.append(slug)
    return unique_slugs


def field_of_view_study(
    sensors: Sequence[tuple[str, Sensor]],
    study: FieldOfViewStudy,
    *,
    scene: Scene | None = None,
    vehicle: Pose | None = None,
    progress: ProgressCallback = lambda done, total: None,
) -> Report:
    """Study what sensors cover; returns figures and numbers.

    Args:
        sensors: names and sensors, each at its mounting
        scene: scene on whose bodies points are counted too, if not None
        vehicle: pose in that scene of the frame of the mountings; the scene's sensor pose if None
        progress: called with (done, total) sensors

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    names = [name for name, _ in sensors]
    progress(0, len(sensors))
    views: list[SensorView] = []
    for (name, sensor), slug in zip(sensors, slugs(names), strict=True):
        views.append(study_sensor(name, slug, sensor, study))
        progress(len(views), len(sensors))
    below = _ground_around(views, study) if _on_vehicle(sensors) else None
    bodies = _points_on_bodies(sensors, scene, vehicle) if scene is not None else None
    report = Report(
        "Fields of view",
        numbers={"cell_deg": study.cell_deg, "sensors": {view.name: _numbers(view, study) for view in views}},
        main_table=_main_table(views, study),
        summary=_summary(views, study),
        pages=PAGES,
        embeds=False,
        columns=True,
    )
    report.add_paragraph(figures.introduction(study.cell_deg, study.mask, DWELL_S, study.target))
    report.add_table(figures.SUMMARY, [figures.summary_row(view) for view in views])

    report.add_heading("All sensors")
    if len(views) > 1:
        report.add_figure(figures.all_patterns_figure(views))
    report.add_figure(figures.coverage_figure(views, study.times_s, study.cell_deg))
    report.add_table(
        ("sensor", *(f"{time_s:g} s" for time_s in study.times_s)), figures.coverage_rows(views, study.times_s)
    )
    report.add_figure(figures.spacing_figure(views))
    report.add_table(("sensor", *(f"{percentile} %" for percentile in PERCENTILES)), figures.spacing_rows(views))
    if below is not None:
        report.add_figure(figures.ground_figure(views, below))
    else:
        report.add_paragraph(figures.NO_GROUND)
    if bodies is not None and scene is not None:
        report.add_figure(figures.body_points_figure(bodies, scene.name))
    for view in views:
        report.add_heading(view.name)
        for figure in (figures.pattern_figure, figures.density_figure, figures.revisit_figure, figures.range_figure):
            report.add_figure(figure(view))
    return report


def _on_vehicle(sensors: Sequence[tuple[str, Sensor]]) -> bool:
    """True if any sensor stands above the vehicle's ground."""
    return any(float(sensor.mounting.position_m[2]) > 0.0 for _, sensor in sensors)


def _ground_around(views: Sequence[SensorView], study: FieldOfViewStudy) -> GroundView:
    cells = views[0].cells
    return ground_view([view.sensor for view in views], cells, [view.revisit_maps for view in views], study.target)


def _points_on_bodies(
    sensors: Sequence[tuple[str, Sensor]], scene: Scene, vehicle: Pose | None
) -> list[tuple[str, list[BodyPoints]]]:
    from ...sensor.rig_file import Mounted
    from .body_points import points_on_bodies

    mounted = [Mounted(label=name, sensor=sensor) for name, sensor in sensors]
    return points_on_bodies(scene, mounted, vehicle=vehicle)


def _numbers(view: SensorView, study: FieldOfViewStudy) -> dict[str, Any]:
    """Numbers of one sensor, for JSON."""
    return {
        "points_per_s": rate_hz(view.sensor.scanner),
        "azimuth_deg": list(figures.azimuth_arc_deg(view.frame.azimuth_deg)),
        "elevation_deg": [float(view.frame.elevation_deg.min()), float(view.frame.elevation_deg.max())],
        "field_square_degrees": float(view.coverage_maps.square_degrees.sum()),
        "coverage": dict(zip(map(str, study.times_s), _coverage(view, study), strict=True)),
        "spacing_deg": dict(
            zip(map(str, PERCENTILES), np.percentile(view.spacing_deg, PERCENTILES).tolist(), strict=True)
        )
        if len(view.spacing_deg)
        else {},
    }


def _main_table(views: Sequence[SensorView], study: FieldOfViewStudy) -> Data:
    """Field, points per second and coverage of each sensor, as numbers."""
    ends = [f"{angle}_{end}_deg" for angle in ("azimuth", "elevation") for end in ("from", "to")]
    header = ("sensor", "points_per_s", *ends, "field_square_degrees", *(f"coverage_{t:g}_s" for t in study.times_s))
    rows = []
    for view in views:
        numbers = _numbers(view, study)
        angles = (*numbers["azimuth_deg"], *numbers["elevation_deg"])
        covered = numbers["coverage"].values()
        rows.append((view.name, numbers["points_per_s"], *angles, numbers["field_square_degrees"], *covered))
    return header, rows


def _summary(views: Sequence[SensorView], study: FieldOfViewStudy) -> str:
    width = max(len(view.name) for view in views)
    lines = [
        f"{view.name:<{width}}  azimuth {figures.azimuth_text(view.frame.azimuth_deg)}, elevation "
        f"{view.frame.elevation_deg.min():.2f} to {view.frame.elevation_deg.max():.2f}°"
        for view in views
    ]
    lines += [f"coverage with cells of {study.cell_deg:g} degrees"]
    header = ("", *(f"{time_s:g} s" for time_s in study.times_s))
    lines.append(text_table(header, figures.coverage_rows(views, study.times_s), "<>"))
    return "\n".join(lines)


def _coverage(view: SensorView, study: FieldOfViewStudy) -> list[float]:
    return [float(share) for share in view.coverage_maps.coverage(np.array(study.times_s))]
