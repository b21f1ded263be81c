"""Report of a comparison: a page with everything, JSON, CSV, pictures and difference clouds.

Numbers in the JSON keep their units in their names; null means not known.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, astuple
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...cloud import pixels
from ...cloud.point_cloud import PointCloud
from ...cloud.shades import FixedColours
from ...cloud.shades import rgb as rgb_of
from ...figures import pictures as plots
from ...figures.report import PAGE, Data, Report
from ...formats.ply import write_columns
from ...maths.arrays import Numbers
from ...scene.scene import View
from ..field_of_view.field_of_view_study import slugs
from . import comparison_figures as figures
from . import comparison_report as report
from .comparison_report import Comparison
from .comparison_statistics import (
    DIFFERENCE,
    DetectionRate,
    PairCounts,
    count_pairs,
    detection_deviation,
    difference_cloud,
    overall_rate,
    paired_range_difference,
    range_errors,
    rates_by_group,
)
from .illuminance_sweep import IlluminanceSweep
from .observations import Observation

NUMBERS = "compare.json"
COLOURS = ("#969696", "#0072b2", "#d55e00")
"""Colours of a difference cloud, in its picture and its file: of both grey, of A and B the charts' blue and red."""

_PICTURE_PX = (1200, 675)
_PAIR_HEADER = ("by", "group", "both", "only_a", "only_b", "neither", "difference", "difference_low", "difference_high")


def comparison_page(comparison: Comparison, view: View | None = None) -> Report:
    """Report of a comparison: its page, JSON, CSV, pictures and clouds.

    Args:
        view: camera of its pictures; None: a camera that shows what is near the first sensor
    """
    file_slugs = slugs([observation.name for observation in comparison.observations])
    numbers = comparison_as_dict(comparison)
    page = Report(
        comparison.title,
        numbers=numbers,
        main_table=_main_table(numbers),
        summary=report.as_text(comparison),
        pages=(PAGE, NUMBERS),
        columns=True,
    )
    for sentence in (*comparison.equal_terms, report.verdict(comparison)):
        page.add_paragraph(sentence)
    page.add_table(*report.fate_table(comparison))
    page.add_table(*report.summary_table(comparison))
    for note in (*comparison.notes, *comparison.aliasing_notes):
        page.add_paragraph(note)
    if comparison.matched:
        page.add_heading("What each sensor detects")
        page.add_table(report.PAIRS, report.pair_rows(comparison))
        _add_pairs(page, comparison, file_slugs)
    page.add_heading("The clouds")
    _add_clouds(page, comparison, view, file_slugs)
    if comparison.rated:
        _add_rates(page, comparison)
    else:
        page.add_heading("Echoes")
        for key in ("range", "class"):
            page.add_table(*report.counts_table(comparison, key))
    page.add_heading("Range error")
    page.add_figure(figures.range_error_figure(comparison.observations, comparison.group("range")))
    _add_snr(page, comparison, file_slugs)
    if comparison.sweep is not None:
        page.add_heading("Illuminance")
        for line in report.crossing_lines(comparison.sweep, comparison.observations[0].name):
            page.add_paragraph(line)
        page.add_table(*report.sweep_table(comparison.sweep))
        page.add_figure(figures.illuminance_figure(comparison.sweep))
    if comparison.seed is not None:
        for observation, slug in zip(comparison.observations, file_slugs, strict=True):
            page.add_file(f"{slug}.ply", observation.cloud.save)
    return page


def _main_table(numbers: dict[str, Any]) -> Data:
    """Pulses, points, false alarms, rate and range error of each sensor, as numbers."""
    header = ("sensor", "pulses", "points", "false_alarms", "rate", "range_bias_m", "range_sigma_m")
    rows = []
    for sensor in numbers["sensors"]:
        error = sensor["range_error"] or {}
        rate = (sensor.get("rate") or {}).get("rate")
        counts = (sensor["pulses"], sensor["points"], sensor["false_alarms"])
        rows.append((sensor["name"], *counts, rate, error.get("bias_m"), error.get("sigma_m")))
    return header, rows


def _add_rates(page: Report, comparison: Comparison) -> None:
    page.add_heading("Detection rate")
    observations = comparison.observations
    for key in ("range", "incidence", "reflectivity"):
        page.add_figure(figures.rate_figure(observations, comparison.group(key), comparison.population))
    page.add_figure(figures.class_rate_figure(observations, comparison.group("class"), comparison.population))
    page.add_table(*report.group_table(comparison, "class"))
    body = comparison.group("body")
    page.add_data("rate-body", (figures.RATE_HEADER, figures.rate_rows(observations, body)))
    header, rows = report.group_table(comparison, "body", report.MOST_BODIES)
    choice = "with most pulses that only one sensor detected" if comparison.matched else "of most pulses"
    page.add_paragraph(f"The {len(rows)} bodies {choice}; rate-body.csv has all.")
    page.add_table(header, rows)


def _add_snr(page: Report, comparison: Comparison, file_slugs: Sequence[str]) -> None:
    if comparison.matched:
        page.add_heading("Signal-to-noise ratio")
    for number, ((a, b), slug) in enumerate(_against_first(comparison, file_slugs), start=1):
        figure = figures.snr_figure(a, b, slug, (comparison.sensors[0], comparison.sensors[number]))
        if figure is not None:
            page.add_figure(figure)


def _against_first(
    comparison: Comparison, file_slugs: Sequence[str]
) -> Iterator[tuple[tuple[Observation, Observation], str]]:
    """Pairs of the first observation and another, with the slug of the other; none where pulses do not match."""
    return zip(comparison.against_first(), file_slugs[1:] if comparison.matched else (), strict=True)


def _add_pairs(page: Report, comparison: Comparison, file_slugs: Sequence[str]) -> None:
    for (a, b), slug in _against_first(comparison, file_slugs):
        rows = []
        for group in (None, *comparison.groups):
            for pair in count_pairs(a.rated_surfaces, b.rated_surfaces, group):
                if pair.pulses:
                    key = group.key if group else "all"
                    rows.append((key, *astuple(pair), pair.difference, *pair.difference_interval))
        page.add_data(f"pairs-{slug}", (_PAIR_HEADER, rows))


def _add_clouds(page: Report, comparison: Comparison, view: View | None, file_slugs: Sequence[str]) -> None:
    """Add pictures of every cloud and every difference cloud from one point of view, and the difference clouds."""
    view = _view(comparison.observations[0].cloud, view)
    # One scale for all, or the same colour would mean different things.
    scale = plots.common_scale([observation.cloud for observation in comparison.observations], "snr")
    page.add_pictures(
        [
            (
                f"cloud-{slug}",
                f"{observation.name}: {len(observation.cloud):,} points by their signal-to-noise ratio.",
                _drawing(observation.cloud, view, colour_by="snr", colours=FixedColours(limits=scale)),
            )
            for observation, slug in zip(comparison.observations, file_slugs, strict=True)
        ]
    )
    for (a, b), slug in _against_first(comparison, file_slugs):
        cloud, kinds = difference_cloud(a, b)
        name = f"difference-{slug}"
        page.add_file(f"{name}.ply", partial(_save_difference, cloud=cloud, kinds=kinds, a=a.name, b=b.name))
        labels = ("both", f"only {a.name}", f"only {b.name}")
        metadata = dict(cloud.metadata) | {"sensor": f"{a.name} against {b.name}"}
        sorted_by_kind = dataclasses.replace(cloud, class_id=kinds, class_names=labels, metadata=metadata)
        counts = ", ".join(f"{label} {np.count_nonzero(kinds == kind):,}" for kind, label in enumerate(labels))
        caption = f"Difference cloud, with the first echo of each pulse that has one: {counts}."
        page.add_pictures(
            [(name, caption, _drawing(sorted_by_kind, view, colour_by="class", colours=FixedColours(palette=COLOURS)))]
        )


def _drawing(cloud: PointCloud, view: View, *, colour_by: str, colours: FixedColours) -> Callable[[Path], None]:
    """Function that draws a cloud to a path."""
    return lambda path: plots.perspective_picture(
        cloud, path, colour_by=colour_by, view=view, size_px=_PICTURE_PX, colours=colours
    )


def _view(cloud: PointCloud, view: View | None) -> View:
    """The scene's camera, or the one that `figures.pictures` would choose for this cloud."""
    if view is not None:
        return view
    camera = pixels.camera_for(cloud, shape=_PICTURE_PX)
    x, y, z = (float(v) for v in camera.eye_m)
    target_x, target_y, target_z = (float(v) for v in camera.eye_m + 10.0 * camera.axes[2])
    return View(eye_m=(x, y, z), target_m=(target_x, target_y, target_z), fov_deg=camera.fov_deg)


def _save_difference(path: Path, cloud: PointCloud, kinds: Numbers, a: str, b: str) -> None:
    """Write a difference cloud as PLY, with its kinds as colours that every viewer shows.

    Classes and bodies are numbers, whose names the file's comments list.
    """
    rgb = np.array([rgb_of(colour) for colour in COLOURS])[kinds]
    columns = {column.name: cloud.column(column.name) for column in cloud.columns}
    columns |= {"difference": kinds, "red": rgb[:, 0], "green": rgb[:, 1], "blue": rgb[:, 2]}
    comments = [f"difference cloud by lidarscene: A is {a}, B is {b}"]
    comments += [f"difference {number} {kind}" for number, kind in enumerate(DIFFERENCE)]
    comments += [f"unit {column.name} {column.unit}" for column in cloud.columns]
    comments += [f"class {number} {name}" for number, name in enumerate(cloud.class_names)]
    comments += [f"body {number} {name}" for number, name in enumerate(cloud.body_names)]
    write_columns(path, columns, comments=comments)


def comparison_as_dict(comparison: Comparison) -> dict[str, Any]:
    """All results as a dictionary for JSON; None for unknown numbers."""
    result: dict[str, Any] = {
        "title": comparison.title,
        "verdict": report.verdict(comparison),
        "equal_terms": list(comparison.equal_terms),
        "matched": comparison.matched,
        "rates_are_shares_of": comparison.population,
        "seed": comparison.seed,
        "notes": [*comparison.notes, *comparison.aliasing_notes],
        "sensors": [_observation_as_dict(comparison, observation) for observation in comparison.observations],
        "pairs": [_pair_as_dict(comparison, a, b) for a, b in comparison.against_first()],
    }
    if comparison.sweep is not None:
        result["sweep"] = _sweep_as_dict(comparison.sweep)
    return result


def _sweep_as_dict(sweep: IlluminanceSweep) -> dict[str, Any]:
    return {
        "illuminance_klux": list(sweep.illuminances_klux),
        "courses": {
            name: [
                {
                    "illuminance_klux": step.illuminance_klux,
                    **_rate_as_dict(step.rate),
                    "false_alarms": step.false_alarms,
                    "sigma_m": step.sigma_m,
                }
                for step in course
            ]
            for name, course in sweep.courses.items()
        },
        "crossings": {
            name: [asdict(crossing) for crossing in crossings] for name, crossings in sweep.crossings.items()
        },
        "on_plane_klux": sweep.on_plane_klux,
    }


def _observation_as_dict(comparison: Comparison, observation: Observation) -> dict[str, Any]:
    errors = range_errors(observation)
    result: dict[str, Any] = {
        "name": observation.name,
        "pulses": observation.pulses_fired,
        "points": len(observation.cloud),
        "false_alarms": observation.false_alarms,
        "lost": {key.replace(" ", "_"): count for key, count in observation.losses.items()},
        "range_error": asdict(errors[0]) if errors else None,
        "range_error_by_range": [asdict(error) for error in range_errors(observation, comparison.group("range"))],
    }
    if observation.surfaces is not None:
        result |= {
            "rate": _rate_as_dict(overall_rate(observation.surfaces)),
            "deviation_from_expected": detection_deviation(observation.surfaces),
        }
        result["rates"] = {
            group.key: [
                _rate_as_dict(group_rate)
                for group_rate in rates_by_group(observation.surfaces, group)
                if group_rate.surfaces
            ]
            for group in comparison.groups
        }
    return result


def _pair_as_dict(comparison: Comparison, a: Observation, b: Observation) -> dict[str, Any]:
    (total,) = count_pairs(a.rated_surfaces, b.rated_surfaces)
    range_difference = paired_range_difference(a, b)
    return {
        "a": a.name,
        "b": b.name,
        **_pair_counts_as_dict(total),
        "range_difference": asdict(range_difference) if range_difference else None,
        "by": {
            group.key: [
                _pair_counts_as_dict(pair)
                for pair in count_pairs(a.rated_surfaces, b.rated_surfaces, group)
                if pair.pulses
            ]
            for group in comparison.groups
        },
    }


def _rate_as_dict(group_rate: DetectionRate) -> dict[str, Any]:
    return asdict(group_rate) | {"rate": group_rate.rate, "interval": list(group_rate.interval)}


def _pair_counts_as_dict(pair: PairCounts) -> dict[str, Any]:
    return asdict(pair) | {"difference": pair.difference, "interval": list(pair.difference_interval)}
