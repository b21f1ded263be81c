"""A comparison as files: a page with everything, JSON, CSV, pictures and difference clouds.

All names are known before any work is done, so that a file that cannot be written is found first.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...cloud import pixels
from ...cloud.point_cloud import PointCloud
from ...figures import pictures as plots
from ...figures.page import Page, csv_text
from ...files.atomic import atomic_folder, put_text, require_writable
from ...files.json_text import json_text
from ...formats.ply import write_columns
from ...maths.arrays import Numbers
from ...scene.scene import View
from ..field_of_view.study import slugs
from . import figures as figures
from . import report as report
from .as_json import as_dict
from .data import Observation
from .numbers import DIFFERENCE, difference, pairs
from .report import Comparison

PAGE, NUMBERS = "index.html", "compare.json"
COLOURS = {"both": (150, 150, 150), "only_a": (0, 114, 178), "only_b": (213, 94, 0)}
"""Of the points of a difference cloud: grey, and the charts' blue and vermilion."""

_PICTURE_PX = (1200, 675)
_PAIR_HEADER = ("by", "group", "both", "only_a", "only_b", "neither", "difference", "difference_low", "difference_high")


@dataclass(frozen=True, slots=True)
class Output:
    """Folder of a comparison and camera of its pictures; None: chosen by what is near the first sensor."""

    folder: Path
    view: View | None = None


def file_names(names: Sequence[str], *, matched: bool, rated: bool, swept: bool, simulated: bool) -> list[str]:
    """Names of all files that `write` may write."""
    file_slugs = slugs(names)
    drawn = [*(["rate-range", "rate-incidence", "rate-reflectivity", "rate-class"] if rated else []), "error-range"]
    drawn += [f"snr-{slug}" for slug in file_slugs[1:]] if matched else []
    drawn += ["illuminance"] if swept else []
    pictures = [f"cloud-{slug}.png" for slug in file_slugs]
    files = [PAGE, NUMBERS, *(f"{stem}.{suffix}" for stem in drawn for suffix in ("png", "csv")), *pictures]
    files += ["rate-body.csv"] if rated else []
    files += [f"{slug}.ply" for slug in file_slugs] if simulated else []
    if matched:
        files += [f"difference-{slug}.{suffix}" for slug in file_slugs[1:] for suffix in ("ply", "png")]
        files += [f"pairs-{slug}.csv" for slug in file_slugs[1:]]
    return files


def require_files(folder: Path, names: Sequence[str]) -> None:
    """Check that all files can be written, before any work is done. Raises OutputError."""
    for name in names:
        require_writable(folder / name)


def write(comparison: Comparison, output: Output, *, as_json: bool = False) -> str:
    """Write all files; returns the text to print. Raises OutputError."""
    with atomic_folder(output.folder) as temporary:
        numbers = _write(comparison, dataclasses.replace(output, folder=temporary))
    page = output.folder / PAGE
    return numbers if as_json else f"{report.as_text(comparison)}\nwrote {page} and the files beside it"


def _write(comparison: Comparison, output: Output) -> str:
    """All files; returns the numbers as JSON."""
    folder, file_slugs = output.folder, slugs([observation.name for observation in comparison.observations])
    page = Page(comparison.title, folder=folder, columns=True)
    page.paragraph(report.verdict(comparison))
    page.table(*report.fate(comparison))
    page.table(*report.summary(comparison))
    for note in (*comparison.notes, *comparison.windows):
        page.paragraph(note)
    if comparison.matched:
        page.heading("Who found what")
        page.table(report.PAIRS, report.pair_rows(comparison))
        _pair_tables(comparison, folder, file_slugs)
    page.heading("The clouds")
    _pictures(page, comparison, output, file_slugs)
    if comparison.rated:
        _rates(page, comparison, folder)
    else:
        page.heading("Echoes")
        for key in ("range", "class"):
            page.table(*report.counts_table(comparison, key))
    page.heading("Range error")
    _show(page, folder, figures.errors(comparison.observations, comparison.group("range")))
    _signal_to_noise(page, comparison, folder, file_slugs)
    if comparison.sweep is not None:
        page.heading("Illuminance")
        for line in report.crossing_lines(comparison.sweep, comparison.observations[0].name):
            page.paragraph(line)
        page.table(*report.sweep_table(comparison.sweep))
        _show(page, folder, figures.illuminance(comparison.sweep))
    if comparison.seed is not None:
        for observation, slug in zip(comparison.observations, file_slugs, strict=True):
            observation.cloud.save(folder / f"{slug}.ply")
    numbers = json_text(as_dict(comparison), indent=2)
    put_text(folder / NUMBERS, numbers + "\n")
    put_text(folder / PAGE, page.as_html())
    return numbers


def _show(page: Page, folder: Path, figure: figures.Figure | None) -> None:
    if figure is not None:
        stem, draw, table, caption = figure
        draw(folder / f"{stem}.png")
        put_text(folder / f"{stem}.csv", csv_text(*table))
        page.figure(name=stem, number=stem, caption=caption, svg=False)


def _rates(page: Page, comparison: Comparison, folder: Path) -> None:
    page.heading("Detection rate")
    observations = comparison.observations
    for key in ("range", "incidence", "reflectivity"):
        _show(page, folder, figures.rate(observations, comparison.group(key), comparison.population))
    _show(page, folder, figures.rate_by_class(observations, comparison.group("class"), comparison.population))
    page.table(*report.group_table(comparison, "class"))
    body = comparison.group("body")
    put_text(folder / "rate-body.csv", csv_text(figures.RATE_HEADER, figures.rate_rows(observations, body)))
    header, rows = report.group_table(comparison, "body", report.MOST_BODIES)
    choice = "with most pulses that only one sensor found" if comparison.matched else "of most pulses"
    page.paragraph(f"The {len(rows)} bodies {choice}; rate-body.csv has all.")
    page.table(header, rows)


def _signal_to_noise(page: Page, comparison: Comparison, folder: Path, file_slugs: Sequence[str]) -> None:
    if comparison.matched:
        page.heading("Signal-to-noise ratio")
    for number, ((a, b), slug) in enumerate(_against_first(comparison, file_slugs), start=1):
        _show(page, folder, figures.snr(a, b, slug, (comparison.sensors[0], comparison.sensors[number])))


def _against_first(comparison: Comparison, file_slugs: Sequence[str]) -> Iterator[tuple[tuple[Observation, Observation], str]]:
    """The first observation with each other one, where pulses match, and the slug of the other."""
    return zip(comparison.against_first(), file_slugs[1:] if comparison.matched else (), strict=True)


def _pair_tables(comparison: Comparison, folder: Path, file_slugs: Sequence[str]) -> None:
    for (a, b), slug in _against_first(comparison, file_slugs):
        rows = []
        for group in (None, *comparison.groups):
            for pair in pairs(a.rated_surfaces, b.rated_surfaces, group):
                if pair.pulses:
                    rows.append(
                        (
                            group.key if group else "all",
                            pair.group,
                            pair.both,
                            pair.only_a,
                            pair.only_b,
                            pair.neither,
                            pair.difference,
                            *pair.difference_interval,
                        )
                    )
        put_text(folder / f"pairs-{slug}.csv", csv_text(_PAIR_HEADER, rows))


def _pictures(page: Page, comparison: Comparison, output: Output, file_slugs: Sequence[str]) -> None:
    """Every cloud and every difference cloud, from one point of view."""
    view = _view(comparison.observations[0].cloud, output.view)
    # One scale for all, or the same colour would mean different things.
    scale = plots.common_scale([observation.cloud for observation in comparison.observations], "snr")
    captions = []
    for observation, slug in zip(comparison.observations, file_slugs, strict=True):
        name = f"cloud-{slug}"
        _picture(observation.cloud, output.folder / f"{name}.png", view, colour_by="snr", scale=scale)
        captions.append((name, f"{observation.name}: {len(observation.cloud):,} points by their signal-to-noise ratio."))
    page.pictures(captions)
    for (a, b), slug in _against_first(comparison, file_slugs):
        cloud, kinds = difference(a, b)
        name = f"difference-{slug}"
        _save_difference(output.folder / f"{name}.ply", cloud, kinds, a.name, b.name)
        labels = ("both", f"only {a.name}", f"only {b.name}")
        metadata = dict(cloud.metadata) | {"sensor": f"{a.name} against {b.name}"}
        sorted_by_kind = dataclasses.replace(cloud, class_id=kinds, class_names=labels, metadata=metadata)
        _picture(sorted_by_kind, output.folder / f"{name}.png", view, colour_by="class")
        counts = ", ".join(f"{label} {np.count_nonzero(kinds == kind):,}" for kind, label in enumerate(labels))
        page.pictures([(name, f"Difference cloud, first echoes of the pulses that have one: {counts}.")])


def _picture(
    cloud: PointCloud, path: Path, view: View, *, colour_by: str, scale: tuple[float, float] | None = None
) -> None:
    plots.perspective_picture(cloud, path, colour_by=colour_by, view=view, size_px=_PICTURE_PX, scale=scale)


def _view(cloud: PointCloud, view: View | None) -> View:
    """The scene's camera, or the one that `figures.pictures` would choose for this cloud."""
    if view is not None:
        return view
    camera = pixels.camera_for(cloud, shape=_PICTURE_PX)
    x, y, z = (float(v) for v in camera.eye_m)
    right, up, ahead = (float(v) for v in camera.eye_m + 10.0 * camera.axes[2])
    return View(eye_m=(x, y, z), target_m=(right, up, ahead), fov_deg=camera.fov_deg)


def _save_difference(path: Path, cloud: PointCloud, kinds: Numbers, a: str, b: str) -> None:
    """The difference cloud with colours that every viewer shows.

    Classes and bodies are numbers, named in the file's comments.
    """
    rgb = np.array([COLOURS[kind] for kind in DIFFERENCE], dtype=np.uint8)[kinds]
    columns = {column.name: cloud.column(column.name) for column in cloud.columns}
    columns |= {"difference": kinds, "red": rgb[:, 0], "green": rgb[:, 1], "blue": rgb[:, 2]}
    comments = [f"difference cloud by lidarscene: A is {a}, B is {b}"]
    comments += [f"difference {number} {kind}" for number, kind in enumerate(DIFFERENCE)]
    comments += [f"unit {column.name} {column.unit}" for column in cloud.columns]
    comments += [f"class {number} {name}" for number, name in enumerate(cloud.class_names)]
    comments += [f"body {number} {name}" for number, name in enumerate(cloud.body_names)]
    write_columns(path, columns, comments=comments)
