"""Entry point of field-of-view studies: `write_study` takes sensors and writes pictures, CSV and a report.

The command `fov` and Python users call it.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...figures.report import Report, require_writable_files, text_table
from ...files.atomic import atomic_folder
from ...files.json_text import json_text
from ...sensor.sensor_model import Sensor
from . import field_of_view_figures as figures
from .pattern_coverage import DWELL_S, rate_hz
from .reach import Ground, ground_view
from .sensor_view import SensorView, study_sensor
from .spacing import PERCENTILES
from .study_options import FieldOfViewStudy

if TYPE_CHECKING:
    from ...maths.pose import Pose
    from ...scene.scene import Scene
    from .body_points import BodyPoints

ProgressCallback = Callable[[int, int], object]
"""Function of the steps done and of their total."""

PAGES = ("index.md", "index.html")
MAPS = ("pattern", "density", "revisit", "range")


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


def file_names(names: Sequence[str], *, with_ground: bool, with_scene: bool) -> list[str]:
    """Names of all files that `write_study` writes."""
    stems = [
        *(["patterns"] if len(names) > 1 else []),
        "coverage",
        "spacing",
        *(["ground"] if with_ground else []),
        *(["bodies"] if with_scene else []),
    ]
    stems += [f"{slug}-{kind}" for slug in slugs(names) for kind in MAPS]
    return [*PAGES, *(f"{stem}.{suffix}" for stem in stems for suffix in ("png", "csv"))]


def write_study(
    folder: Path,
    sensors: Sequence[tuple[str, Sensor]],
    study: FieldOfViewStudy,
    *,
    scene: Scene | None = None,
    vehicle: Pose | None = None,
    as_json: bool = False,
    progress: ProgressCallback = lambda done, total: None,
) -> str:
    """Write all figures and both pages; returns the text to print. Raises InputError, OutputError.

    sensors   names and sensors, each at its mounting
    scene     scene on whose bodies points are counted too, if not None
    vehicle   pose in that scene of the frame of the mountings; the scene's sensor pose if None
    progress  called with (done, total) after each step: a sensor's pattern, the common figures, a sensor's maps
    """
    names = [name for name, _ in sensors]
    files = file_names(names, with_ground=_on_vehicle(sensors), with_scene=scene is not None)
    require_writable_files(folder, files)
    with atomic_folder(folder) as temporary:
        views = _write_files(temporary, sensors, study, scene, vehicle, progress)
    return _result_text(folder, views, study, files, as_json=as_json)


def _write_files(
    folder: Path,
    sensors: Sequence[tuple[str, Sensor]],
    study: FieldOfViewStudy,
    scene: Scene | None,
    vehicle: Pose | None,
    progress: ProgressCallback,
) -> list[SensorView]:
    """Write all files into a folder; returns the results for each sensor."""
    names = [name for name, _ in sensors]
    on_vehicle = _on_vehicle(sensors)
    total = 2 * len(sensors) + 1
    progress(0, total)
    views: list[SensorView] = []
    for (name, sensor), slug in zip(sensors, slugs(names), strict=True):
        views.append(study_sensor(name, slug, sensor, study))
        progress(len(views), total)
    below = _ground_around(views, study) if on_vehicle else None
    bodies = _points_on_bodies(sensors, scene, vehicle) if scene is not None else None
    report = Report("Fields of view", folder, embeds=False, columns=True)
    report.paragraph(figures.introduction(study.cell_deg, study.mask, DWELL_S, study.target))
    report.table(figures.SUMMARY, [figures.summary_row(view) for view in views])

    report.heading("All sensors")
    if len(views) > 1:
        report.figure(figures.all_patterns_figure(views))
    report.figure(figures.coverage_figure(views, study.times_s, study.cell_deg))
    report.table(
        ("sensor", *(f"{time_s:g} s" for time_s in study.times_s)), figures.coverage_rows(views, study.times_s)
    )
    report.figure(figures.spacing_figure(views))
    report.table(("sensor", *(f"{percentile} %" for percentile in PERCENTILES)), figures.spacing_rows(views))
    if below is not None:
        report.figure(figures.ground_figure(views, below))
    else:
        report.paragraph(figures.NO_GROUND)
    if bodies is not None and scene is not None:
        report.figure(figures.body_points_figure(bodies, scene.name))
    progress(len(sensors) + 1, total)
    for step, view in enumerate(views, start=len(sensors) + 2):
        report.heading(view.name)
        for figure in (figures.pattern_figure, figures.density_figure, figures.revisit_figure, figures.range_figure):
            report.figure(figure(view))
        progress(step, total)
    report.write(*PAGES)
    return views


def _on_vehicle(sensors: Sequence[tuple[str, Sensor]]) -> bool:
    """True if any sensor stands above the vehicle's ground."""
    return any(float(sensor.mounting.position_m[2]) > 0.0 for _, sensor in sensors)


def _ground_around(views: Sequence[SensorView], study: FieldOfViewStudy) -> Ground:
    cells = views[0].cells
    return ground_view([view.sensor for view in views], cells, [view.revisit_maps for view in views], study.target)


def _points_on_bodies(
    sensors: Sequence[tuple[str, Sensor]], scene: Scene, vehicle: Pose | None
) -> list[tuple[str, list[BodyPoints]]]:
    from ...sensor.rig_file import Mounted
    from .body_points import points_on_bodies

    mounted = [Mounted(label=name, sensor=sensor) for name, sensor in sensors]
    return points_on_bodies(scene, mounted, vehicle=vehicle)


def _result_text(
    folder: Path, views: Sequence[SensorView], study: FieldOfViewStudy, files: Sequence[str], *, as_json: bool
) -> str:
    if as_json:
        rows = {
            view.name: {
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
            for view in views
        }
        return json_text({"cell_deg": study.cell_deg, "sensors": rows, "files": [str(folder / name) for name in files]})
    width = max(len(view.name) for view in views)
    lines = [
        f"{view.name:<{width}}  azimuth {figures.azimuth_text(view.frame.azimuth_deg)}, elevation "
        f"{view.frame.elevation_deg.min():.2f} to {view.frame.elevation_deg.max():.2f}°"
        for view in views
    ]
    lines += [f"coverage with cells of {study.cell_deg:g} degrees"]
    header = ("", *(f"{time_s:g} s" for time_s in study.times_s))
    lines.append(text_table(header, figures.coverage_rows(views, study.times_s), "<>"))
    lines.append(f"wrote {folder / PAGES[0]}, {folder / PAGES[1]} and the figures beside them")
    return "\n".join(lines)


def _coverage(view: SensorView, study: FieldOfViewStudy) -> list[float]:
    return [float(share) for share in view.coverage_maps.coverage(np.array(study.times_s))]
