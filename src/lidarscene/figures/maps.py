"""Pictures of fields of view: maps over angles, scan patterns, the ground from above, scatter plots.

Colour maps are viridis, readable with any colour vision and in grey. matplotlib is imported when called.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import InputError
from ..maths.arrays import Numbers
from .lines import (
    COLOURS,
    GREY,
    INK,
    arrange,
    colour_of,
    empty_figure,
    halo,
    legend_above,
    literal,
    plain_axes,
    write_figure,
)

WIDTH_INCHES = 7.2
"""Choice: width of a map."""

NO_DATA_COLOUR = "#e4e4e4"
MARKERS = "osD^vP*"


@dataclass(frozen=True, slots=True, kw_only=True)
class AngleMap:
    """An image over azimuth and elevation, degrees. NaN is grey; nothing is drawn where ``outside`` holds (white).

    Attributes:
        extent: lowest and highest azimuth, lowest and highest elevation
        missing: legend of the grey cells; empty: none
    """

    values: Numbers
    outside: Numbers
    extent: tuple[float, float, float, float]
    label: str
    title: str
    missing: str = ""
    log: bool = False


def save_map(path: str | os.PathLike[str], angle_map: AngleMap) -> None:
    """Draw a map over azimuth (to the left, as the sensor sees it) and elevation.

    Raises:
        OutputError: if a result cannot be written
    """

    def draw(figure: Any, axes: Any) -> None:
        from matplotlib.colors import ListedColormap, LogNorm, Normalize

        values = np.asarray(angle_map.values, dtype=np.float64)
        finite = values[np.isfinite(values) & ~angle_map.outside]
        if angle_map.log:
            finite = finite[finite > 0.0]
        low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
        if high - low <= 1e-3 * abs(high):  # one value: no colours for its last digits
            low, high = low - max(0.05 * abs(low), 1e-12), high + max(0.05 * abs(high), 1e-12)
        norm = (LogNorm if angle_map.log and low > 0.0 else Normalize)(low, high)
        options = {"extent": angle_map.extent, "aspect": "auto", "origin": "lower", "interpolation": "nearest"}
        blank = np.where(angle_map.outside | np.isfinite(values), np.nan, 1.0)
        axes.imshow(blank, cmap=ListedColormap([NO_DATA_COLOUR]), **options)
        visible = np.ma.masked_where(angle_map.outside | ~np.isfinite(values), values)
        image = axes.imshow(visible, cmap="viridis", norm=norm, **options)
        bar = _colour_bar(figure, axes, image, angle_map.label)
        if not angle_map.log:
            bar.ax.ticklabel_format(useOffset=False)
        _angle_axes(axes, angle_map.extent)
        if angle_map.missing and blank[np.isfinite(blank)].size:
            _colour_legend(axes, [(NO_DATA_COLOUR, angle_map.missing)])

    save_figure(path, draw, angle_map.title, _height(angle_map.extent))


def save_pattern(
    path: str | os.PathLike[str],
    azimuth_deg: Numbers,
    elevation_deg: Numbers,
    time_s: Numbers,
    *,
    extent: tuple[float, float, float, float],
    title: str,
) -> None:
    """Draw pulses over azimuth and elevation, coloured by time.

    Raises:
        OutputError: if a result cannot be written
    """

    def draw(figure: Any, axes: Any) -> None:
        dots = axes.scatter(
            azimuth_deg,
            elevation_deg,
            c=time_s * 1e3,
            cmap="viridis",
            linewidths=0,
            rasterized=True,
            vmin=0.0,
            vmax=float(time_s.max()) * 1e3 or 1.0,  # a flash has all its pulses at once
            s=float(np.clip(60_000.0 / max(len(time_s), 1), 0.6, 9.0)),
        )
        _colour_bar(figure, axes, dots, "time [ms]")
        _angle_axes(axes, extent)

    save_figure(path, draw, title, _height(extent))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layer:
    """The pulses of one sensor among others; ``colour`` is a number of `lines.COLOURS`."""

    label: str
    colour: int
    azimuth_deg: Numbers
    elevation_deg: Numbers


def save_layers(
    path: str | os.PathLike[str], layers: Sequence[Layer], *, extent: tuple[float, float, float, float], title: str
) -> None:
    """Draw pulses of several sensors over azimuth and elevation, the first at the bottom.

    Raises:
        OutputError: if a result cannot be written
    """

    def draw(figure: Any, axes: Any) -> None:
        for layer in layers:
            axes.scatter(
                layer.azimuth_deg,
                layer.elevation_deg,
                color=colour_of(layer.colour),
                linewidths=0,
                rasterized=True,
                s=float(np.clip(60_000.0 / max(len(layer.azimuth_deg), 1), 0.6, 9.0)),
            )
            axes.scatter([], [], color=colour_of(layer.colour), s=24, label=layer.label)
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, fontsize=8)
        _angle_axes(axes, extent)

    save_figure(path, draw, title, _height(extent))


def save_ground(
    path: str | os.PathLike[str],
    count: Numbers,
    *,
    half_m: float,
    sensors: Sequence[tuple[str, float, float]],
    title: str,
) -> None:
    """Draw how many sensors see each place of the ground, x forward and up the page.

    Raises:
        OutputError: if a result cannot be written
    """

    def draw(figure: Any, axes: Any) -> None:
        from matplotlib import colormaps
        from matplotlib.colors import ListedColormap

        most = max(int(count.max()), 1)
        shades = colormaps["viridis"](np.linspace(0.85, 0.1, most)) if most > 1 else [COLOURS[5]]
        colours = [NO_DATA_COLOUR, *shades]
        axes.imshow(
            np.flip(count.T, axis=1),
            origin="lower",
            cmap=ListedColormap(colours),
            extent=(-half_m, half_m, -half_m, half_m),
            vmin=-0.5,
            vmax=most + 0.5,
            interpolation="nearest",
        )
        for number, (name, x, y) in enumerate(sorted(sensors, key=lambda sensor: -sensor[1])):
            axes.plot([-y], [x], "o", color=COLOURS[1], markersize=5, markeredgecolor="white")
            axes.annotate(
                name,
                (-y, x),
                xytext=(6, -11 if number % 2 else 4),
                textcoords="offset points",
                fontsize=8,
                color=INK,
                path_effects=halo(),
            )
        axes.xaxis.set_major_formatter(lambda value, _: f"{0.0 - value:g}".replace("-", "\N{MINUS SIGN}"))
        words = ["blind", "one sensor", *(f"{n} sensors" for n in range(2, most + 1))]
        _colour_legend(axes, list(zip(colours, words, strict=True)))
        plain_axes(axes, "y, to the left [m]", "x, forward [m]")

    save_figure(path, draw, title, 7.4)


def save_scatter(
    path: str | os.PathLike[str],
    groups: Sequence[tuple[str, Numbers, Numbers]],
    *,
    x_label: str,
    y_label: str,
    title: str,
) -> None:
    """Draw points of each group on logarithmic axes, with a colour and a shape for each.

    Raises:
        OutputError: if a result cannot be written
    """

    def draw(figure: Any, axes: Any) -> None:
        for number, (name, x, y) in enumerate(groups):
            axes.scatter(
                x,
                y,
                s=26,
                alpha=0.8,
                label=name,
                color=colour_of(number),
                linewidths=0.4,
                marker=MARKERS[number % len(MARKERS)],
                edgecolors="white",
            )
        axes.set_xscale("log")
        axes.set_yscale("log")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(lambda value, _: f"{value:g}")
        low, high = axes.get_xlim()
        if high / low < 30.0:
            axes.xaxis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "235" else "")
            axes.tick_params(which="minor", labelsize=8)
        plain_axes(axes, x_label, y_label, grid="both")
        legend_above(axes, min(len(groups), 4))

    save_figure(path, draw, title, 4.8)


def save_figure(path: str | os.PathLike[str], draw: Callable[[Any, Any], None], title: str, height: float) -> None:
    """Let ``draw(figure, axes)`` draw, and write a PNG ``height`` inches high.

    Raises:
        InputError: if a file, a key or a value cannot be understood
        OutputError: if a result cannot be written
    """
    if not str(path).endswith(".png"):
        raise InputError(f"{path}: the name must end in .png")
    figure = empty_figure((WIDTH_INCHES, height))
    draw(figure, figure.add_subplot())
    figure.suptitle(literal(title), x=0.012, ha="left", fontsize=8.5, color=GREY, linespacing=1.25)
    arrange(figure)
    write_figure(figure, path)


def _angle_axes(axes: Any, extent: tuple[float, float, float, float]) -> None:
    axes.set_xlim(extent[1], extent[0])
    axes.set_ylim(extent[2], extent[3])
    plain_axes(axes, "azimuth, to the left [deg]", "elevation [deg]")


def _colour_bar(figure: Any, axes: Any, image: Any, label: str) -> Any:
    bar = figure.colorbar(image, ax=axes, pad=0.02, aspect=24, use_gridspec=False)
    bar.set_label(label, fontsize=9, color=INK)
    bar.ax.tick_params(labelsize=8)
    return bar


def _colour_legend(axes: Any, entries: Sequence[tuple[Any, str]]) -> None:
    from matplotlib.patches import Patch

    handles = [Patch(facecolor=colour, edgecolor=GREY, linewidth=0.5, label=text) for colour, text in entries]
    legend_above(axes, 5, handles=handles, borderaxespad=0.3)


def _height(extent: tuple[float, float, float, float]) -> float:
    """Height in inches at which degrees are about square, within limits."""
    wide, high = extent[1] - extent[0], extent[3] - extent[2]
    return float(np.clip(1.3 + (WIDTH_INCHES - 1.7) * high / wide, 3.2, 6.8))
