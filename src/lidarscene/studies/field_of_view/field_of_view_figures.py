"""Figures of a field-of-view study: name, drawing, table and caption of each.

A figure and its CSV come from one place, so that they cannot disagree.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...figures import lines as charts
from ...figures import maps
from ...figures.report import Figure
from ...maths.arrays import Numbers
from ..ranging.conditions import PROBABILITY
from ..ranging.plane import Target
from .pattern_coverage import LONG, rate_hz
from .reach import GroundView
from .spacing import PERCENTILES, QUERIES
from .sphere_cells import SphereCells

if TYPE_CHECKING:
    from .body_points import BodyPoints
    from .sensor_view import SensorView

SUMMARY = (
    "sensor",
    "points per second",
    "frame",
    "field of view",
    "azimuth",
    "elevation",
    "spacing, median",
    f"range at P_d {PROBABILITY:g}",
)
NO_GROUND = (
    "No view from above: no sensor's [mounting] is above the ground. With a rig, or heights such as "
    "SENSOR:mounting.position_m=[0,0,1.9], the ground around the vehicle, overlaps and blind zones are drawn."
)
DOTS = 60_000  # of a pattern that are drawn and listed
OVERLAID = 120_000  # of all sensors together: three frames of 16 channels are whole

_GAP_DEG = 5.0
"""Choice: degrees of azimuth that a turning head may leave out."""

_WIDE = 1200  # pixels across a map at most


def introduction(cell_deg: float, mask: str, dwell_s: float, target: Target) -> str:
    """Paragraph on the definitions that all figures share."""
    area = (
        "the cells whose middle lies in the convex outline, in azimuth and elevation, of all pulses, and "
        "those that got one,"
        if mask == "outline"
        else "the cells that ever got a pulse"
    )
    return (
        f"Cells are {cell_deg:g} degrees high and about as wide: rows of equal elevation, cut so that all cells have "
        f"the same solid angle, {cell_deg**2:.4g} square degrees. The field of view is {area} in {LONG} times the "
        "longest time asked for, and at least a frame. A cell is covered once one pulse's axis has fallen into it; the "
        "spot's size does not count, the cell's does. Directions are those in which the beams leave, without jitter. A "
        f"visit is all pulses in a cell that follow each other within {1e3 * dwell_s:g} ms. The target is a plane "
        f"of reflectivity {target.reflectivity:g}, square to the beam, in {target.illuminance_klux:g} klux of sun 60 "
        f"degrees off its normal, through air of transmittance {target.transmittance:g}."
    )


def summary_row(view: SensorView) -> tuple[str, ...]:
    """Row under `SUMMARY` of one sensor's numbers."""
    ranges = view.range_m[np.isfinite(view.range_m)]
    reach = f"{ranges.min():.1f} to {ranges.max():.1f} m" if len(ranges) else "none or without limit"
    spacing = f"{np.median(view.spacing_deg):.4f}°" if len(view.spacing_deg) else "-"
    return (
        view.name,
        f"{rate_hz(view.sensor.scanner):,.0f}",
        f"{view.sensor.scanner.frame_s:.4g} s",
        f"{view.coverage_maps.square_degrees.sum():,.0f} square degrees",
        azimuth_text(view.frame.azimuth_deg),
        f"{view.frame.elevation_deg.min():.2f} to {view.frame.elevation_deg.max():.2f}°",
        spacing,
        reach,
    )


def azimuth_arc_deg(azimuth_deg: Numbers) -> tuple[float, float]:
    """Ends of the shortest arc that holds all azimuths, from right to left; the left end may exceed 180 degrees.

    The arc is -180 to 180 if no gap is wider than those that a turning head leaves.
    """
    sorted_deg = np.unique(np.mod(azimuth_deg, 360.0))
    # The arc is the circle without its widest gap: it begins after the gap and ends before it.
    gaps = np.diff(sorted_deg, append=sorted_deg[0] + 360.0)
    widest = int(gaps.argmax())
    if gaps[widest] <= _GAP_DEG:
        return -180.0, 180.0
    first, last = float(sorted_deg[(widest + 1) % len(sorted_deg)]), float(sorted_deg[widest])
    first -= 360.0 * (first > 180.0)
    return first, last + 360.0 * np.ceil((first - last) / 360.0)


def azimuth_text(azimuth_deg: Numbers) -> str:
    """Arc of these azimuths in words."""
    first, last = azimuth_arc_deg(azimuth_deg)
    return "all around" if last - first >= 360.0 else f"{first:.2f} to {last:.2f}°"


def coverage_figure(views: Sequence[SensorView], times_s: Sequence[float], cell_deg: float) -> Figure:
    """Share of the field of view that has received a pulse, against time."""
    fine = np.unique(np.concatenate([np.linspace(0.0, max(times_s), 141), times_s]))
    curves = [100.0 * view.coverage_maps.coverage(fine) for view in views]
    chart = charts.Chart(
        lines=_lines(views, fine, curves),
        x_label="time [s]",
        y_label="field of view covered [%]",
        y_limits=(0.0, 103.0),
        x_limits=(0.0, max(times_s)),
        title=f"Cells of {cell_deg:g} degrees",
    )
    caption = f"Share of the field of view whose cells of {cell_deg:g} degrees have got a pulse, against time."
    return _shares_figure("coverage", chart, "time_s", (fine, *curves), caption)


def _lines(views: Sequence[SensorView], x: Numbers, curves: Sequence[Numbers]) -> tuple[charts.Line, ...]:
    """Lines of all sensors, whose styles tell those of one colour apart."""
    return tuple(
        charts.Line(label=view.name, x=x, y=y, colour=i, style=tuple(charts.STYLES)[i // 7 % 4])
        for i, (view, y) in enumerate(zip(views, curves, strict=True))
    )


def _shares_figure(name: str, chart: charts.Chart, x_name: str, columns: Sequence[Numbers], caption: str) -> Figure:
    """Figure of a chart of shares, with columns of x and of the shares of its lines."""
    header = (x_name, *(f"{line.label} [%]" for line in chart.lines))
    return Figure(name, lambda path: charts.save(chart, [path]), (header, zip(*columns, strict=True)), caption)


def coverage_rows(views: Sequence[SensorView], times_s: Sequence[float]) -> list[tuple[str, ...]]:
    """Table rows of the coverage at the requested times."""
    times = np.array(times_s)
    return [(view.name, *(f"{100.0 * share:.1f} %" for share in view.coverage_maps.coverage(times))) for view in views]


def spacing_figure(views: Sequence[SensorView]) -> Figure:
    """Histogram of the angle to the nearest other pulse of the frame."""
    angles_deg = np.concatenate([view.spacing_deg for view in views])
    angles_deg = angles_deg[angles_deg > 0.0] if np.any(angles_deg > 0.0) else np.array([0.01, 1.0])
    low, high = np.quantile(angles_deg, 0.0005) * 0.8, angles_deg.max() * 1.2
    edges = np.geomspace(low, max(high, 2.0 * low), 81)
    middle = np.sqrt(edges[1:] * edges[:-1])
    shares = [
        100.0 * np.histogram(np.clip(view.spacing_deg, edges[0], edges[-1]), edges)[0] / max(len(view.spacing_deg), 1)
        for view in views
    ]
    # Steps: each bin's share is drawn from its lower to its upper edge.
    x = np.repeat(edges, 2)[1:-1]
    chart = charts.Chart(
        lines=_lines(views, x, [np.repeat(y, 2) for y in shares]),
        x_label="angle to the nearest other pulse [deg]",
        y_label="pulses [%]",
        x_log=True,
        y_limits=(0.0, None),
        title="Pulses of one frame",
    )
    caption = (
        "How far the pulses of one frame are from their nearest neighbour; percentiles, in degrees, below. The search "
        f"is exact, for up to {QUERIES} pulses evenly taken of the frame."
    )
    return _shares_figure("spacing", chart, "spacing_deg", (middle, *shares), caption)


def spacing_rows(views: Sequence[SensorView]) -> list[tuple[str, ...]]:
    """Table rows of the spacing's percentiles."""
    return [
        (view.name, *(f"{angle_deg:.4f}°" for angle_deg in np.percentile(view.spacing_deg, PERCENTILES)))
        for view in views
        if len(view.spacing_deg)
    ]


def ground_figure(views: Sequence[SensorView], below: GroundView) -> Figure:
    """Map of the ground around the vehicle by the number of sensors that see it."""
    half = float(below.x_m[-1] + 0.5 * (below.x_m[1] - below.x_m[0]))
    stands = [(view.name, view.sensor.mounting.position_m) for view in views]
    names_at: dict[tuple[float, float], list[str]] = {}
    for name, position_m in stands:
        names_at.setdefault((float(position_m[0]), float(position_m[1])), []).append(name)
    places = [(", ".join(names), x, y) for (x, y), names in names_at.items()]
    blind = below.nearest_blind_m()
    nearest = (
        f"No sensor sees ground nearer than {blind:.1f} m to the origin; "
        if np.isfinite(blind)
        else f"No sensor sees ground within {half:g} m; "
    )
    caption = (
        "The ground z = 0 from above, by how many sensors see it: in the field of view, and an echo of ground with the "
        "target's reflectivity, at the beam's incidence there, reaches the comparator. The space between the lines of "
        "a pattern counts as seen. The vehicle itself hides nothing, and a sensor not above the ground sees none. "
        + nearest
        + ", ".join(
            f"{view.name} sees {area_m2:,.0f} m²" for view, area_m2 in zip(views, below.square_metres, strict=True)
        )
        + f", two or more see {np.sum(below.count > 1) * (below.x_m[1] - below.x_m[0]) ** 2:,.0f} m²."
    )
    x, y = np.meshgrid(below.x_m, below.y_m)
    is_seen = below.count > 0
    rows = zip(
        x[is_seen],
        y[is_seen],
        below.count[is_seen],
        *(sees[is_seen].astype(int) for sees in below.is_seen),
        strict=True,
    )
    header = ("x_m", "y_m", "sensors", *(view.name for view in views))
    title = "Ground seen from above; grey: blind"
    draw = partial(maps.save_ground, count=below.count, half_m=half, sensors=places, title=title)
    return Figure("ground", draw, (header, rows), caption)


def body_points_figure(bodies: Sequence[tuple[str, list[BodyPoints]]], scene: str) -> Figure:
    """Points on each body against its distance, for each sensor."""
    groups = [
        (name, np.array([body.distance_m for body in sensor_bodies]), np.array([body.points for body in sensor_bodies]))
        for name, sensor_bodies in bodies
    ]
    rows = [
        (name, body.body, body.label, body.distance_m, body.points)
        for name, sensor_bodies in bodies
        for body in sensor_bodies
    ]
    caption = (
        f"Points of one frame on each body with a class of the scene {scene}, against the median of their ranges. "
        "Every sensor is at its own mounting, seen from where the scene's sensor stands or the pose given, or at its "
        "place on the rig's vehicle."
    )
    draw = partial(
        maps.save_scatter,
        groups=groups,
        x_label="distance [m]",
        y_label="points on the body",
        title=f"One frame in the scene {scene}",
    )
    return Figure("bodies", draw, (("sensor", "body", "class", "distance_m", "points"), rows), caption)


def all_patterns_figure(views: Sequence[SensorView]) -> Figure:
    """Directions of the first frames of all sensors, one over the other."""
    most_pulses = max(OVERLAID // len(views), 1)
    extents = np.array([_extent(view) for view in views])
    extent = (*extents.min(axis=0)[[0]], extents[:, 1].max(), extents[:, 2].min(), extents[:, 3].max())
    # The widest field lies at the bottom, so that it hides no other.
    order = np.argsort([-view.coverage_maps.square_degrees.sum() for view in views], kind="stable")
    layers = [
        maps.Layer(
            label=view.name,
            colour=int(number),
            azimuth_deg=view.frame.azimuth_deg[:most_pulses],
            elevation_deg=view.frame.elevation_deg[:most_pulses],
        )
        for number, view in ((number, views[number]) for number in order)
    ]
    rows = [
        (view.name, *row)
        for view in views
        for row in zip(
            view.frame.time_s[:most_pulses],
            view.frame.azimuth_deg[:most_pulses],
            view.frame.elevation_deg[:most_pulses],
            strict=True,
        )
    ]
    caption = f"Where the pulses of all sensors go, up to {most_pulses:,} of each that come first in its frame."
    draw = partial(maps.save_layers, layers=layers, extent=extent, title="Patterns of all sensors, at their mountings")
    return Figure("patterns", draw, (("sensor", "time_s", "azimuth_deg", "elevation_deg"), rows), caption)


def pattern_figure(view: SensorView) -> Figure:
    """Directions of the first frame's pulses, coloured by time."""
    count = len(view.frame)
    # Pulses in a row, not every k-th, which would draw moire: the first part of a long frame, coloured by time.
    drawn = slice(0, min(count, DOTS))
    columns = [view.frame.azimuth_deg[drawn], view.frame.elevation_deg[drawn], view.frame.time_s[drawn]]
    part = "of one frame" if count <= DOTS else f"that come first of the {count:,} of a frame"
    caption = f"Where the {min(count, DOTS):,} pulses {part} go, coloured by time."
    draw = partial(
        maps.save_pattern,
        azimuth_deg=columns[0],
        elevation_deg=columns[1],
        time_s=columns[2],
        extent=_extent(view),
        title=f"{view.name}: the {min(count, DOTS):,} pulses {part}",
    )
    rows = zip(columns[2], columns[0], columns[1], strict=True)
    return Figure(f"{view.slug}-pattern", draw, (("time_s", "azimuth_deg", "elevation_deg"), rows), caption)


def density_figure(view: SensorView) -> Figure:
    """Map of the pulses per square degree."""
    duration = f"in {view.coverage_s:g} s"
    caption = f"Pulses per square degree of solid angle {duration}; cells without one are grey."
    values = np.where(view.coverage_maps.pulses > 0, view.coverage_maps.density, np.nan)
    words = _MapWords("density", f"pulses per square degree {duration}", "no pulse", "density_per_deg2")
    return _map_figure(view, values, words, caption, log=_needs_log_scale(values))


def revisit_figure(view: SensorView) -> Figure:
    """Map of the mean time between visits."""
    caption = (
        f"Mean time from one visit of a cell to the next in {view.revisit_s:.4g} s; cells with fewer than two visits "
        "are grey."
    )
    values = view.revisit_maps.revisit_s * 1e3
    words = _MapWords("revisit", "mean time between visits [ms]", "fewer than two visits", "revisit_ms")
    return _map_figure(view, values, words, caption, log=_needs_log_scale(values))


def range_figure(view: SensorView) -> Figure:
    """Map of the range on the target."""
    caption = (
        f"Range at P_d {PROBABILITY:g} on the target, by the scanner's effective aperture in each direction; cells "
        "without a pulse, and those without a limit, are grey."
    )
    missing = "no limit, or no pulse" if np.any(np.isinf(view.range_m)) else "no pulse"
    return _map_figure(
        view,
        view.range_m,
        _MapWords("range", f"range at P_d {PROBABILITY:g} [m]", missing, "range_m"),
        caption,
        log=False,
    )


class _MapWords(NamedTuple):
    """Words of a map.

    Attributes:
        kind: end of its file name
        label: text of its colour scale
        missing: text for cells without a value
        column: name of its column in the CSV
    """

    kind: str
    label: str
    missing: str
    column: str


def _needs_log_scale(values: Numbers) -> bool:
    """True if a linear scale would show only the largest values."""
    finite = values[np.isfinite(values)]
    return bool(len(finite) and finite.max() > 30.0 * finite.min())


def _map_figure(view: SensorView, values: Numbers, map_words: _MapWords, caption: str, *, log: bool) -> Figure:
    raster, outside, extent = cell_raster(view.cells, view.coverage_maps.cell, values)
    size = view.cells.size_deg
    picture = maps.AngleMap(
        values=raster,
        outside=outside,
        extent=extent,
        label=map_words.label,
        missing=map_words.missing,
        log=log,
        title=f"{view.name}, cells of {size:g} degrees",
    )
    azimuth, elevation = view.cells.middle_deg(view.coverage_maps.cell)
    rows = zip(azimuth, elevation, values, strict=True)
    draw = partial(maps.save_map, angle_map=picture)
    return Figure(
        f"{view.slug}-{map_words.kind}", draw, (("azimuth_deg", "elevation_deg", map_words.column), rows), caption
    )


def _extent(view: SensorView) -> tuple[float, float, float, float]:
    left, right, low, high = cell_raster(view.cells, view.coverage_maps.cell, np.zeros(len(view.coverage_maps.cell)))[2]
    margin_x, margin_y = 0.015 * (right - left), 0.02 * (high - low)
    return left - margin_x, right + margin_x, low - margin_y, high + margin_y


def cell_raster(
    cells: SphereCells, cell: Numbers, values: Numbers
) -> tuple[Numbers, Numbers, tuple[float, float, float, float]]:
    """Image of values given for cells: rows of equal elevation from below, columns of equal azimuth.

    Returns:
        the values (rows, columns), a mask of the pixels without a cell, and the image's edges in degrees (left, right,
        low, high)
    """
    row = cells.row_of(cell)
    azimuth, _ = cells.middle_deg(cell)
    half_width = 180.0 / cells.columns[row]
    left, right = max(float((azimuth - half_width).min()), -180.0), min(float((azimuth + half_width).max()), 180.0)
    low, high = int(row.min()), int(row.max())
    width_px = int(np.clip(3.0 * (right - left) / cells.size_deg, 60, _WIDE))
    pixel_azimuth = left + (np.arange(width_px) + 0.5) * (right - left) / width_px
    row_elevation = 0.5 * (cells.edges_deg[low : high + 1] + cells.edges_deg[low + 1 : high + 2])
    pixel_cell = cells.locate(*(angle.ravel() for angle in np.meshgrid(pixel_azimuth, row_elevation)))
    place = np.minimum(np.searchsorted(cell, pixel_cell), len(cell) - 1)
    inside = (cell[place] == pixel_cell).reshape(len(row_elevation), width_px)
    raster = np.where(inside, values[place].reshape(len(row_elevation), width_px), np.nan)
    return raster, ~inside, (left, right, float(cells.edges_deg[low]), float(cells.edges_deg[high + 1]))
