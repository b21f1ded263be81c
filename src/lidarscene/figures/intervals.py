"""Charts of comparisons: values with their intervals over bins or names, and one sensor's SNR over another's.

A detection rate without its interval invites wrong conclusions, so these charts always draw both. matplotlib is
imported when called.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..maths.arrays import Numbers
from .lines import COLOURS, GREY, INK, colour_of, legend_above, literal, plain_axes
from .maps import MARKERS, save_figure

_MOST_SCATTERED = 12_000  # most points of a scatter plot


@dataclass(frozen=True, slots=True, kw_only=True)
class Series:
    """Values (n,) of one sensor, the ends of their intervals, and the expected values if they are known."""

    label: str
    x: Numbers
    y: Numbers
    low: Numbers
    high: Numbers
    expected: Numbers | None = None


def save_series(
    path: str | os.PathLike[str],
    series: Sequence[Series],
    *,
    x_label: str,
    y_label: str,
    title: str,
    y_limits: tuple[float | None, float | None] | None = None,
) -> None:
    """Draw series over bins: markers with bars for the intervals, lines for expected values.

    Raises:
        OutputError: if a result cannot be written
    """

    def draw(_: Any, axes: Any) -> None:
        _draw_over_bins(axes, series)
        if y_limits is not None:
            axes.set_ylim(*y_limits)
        plain_axes(axes, x_label, y_label, grid="both")
        legend_above(axes, min(len(series), 4))

    save_figure(path, draw, title, 4.2)


def save_panels(
    path: str | os.PathLike[str], panels: Sequence[tuple[str, Sequence[Series]]], *, x_label: str, title: str
) -> None:
    """Draw charts as of `save_series` one above the other.

    Args:
        panels: (label of the values, series) of each, from the top

    Raises:
        OutputError: if a result cannot be written
    """

    def draw(figure: Any, axes: Any) -> None:
        figure.delaxes(axes)
        rows = figure.subplots(len(panels), 1, sharex=True)
        for panel, (y_label, series) in zip(rows, panels, strict=True):
            _draw_over_bins(panel, series)
            plain_axes(panel, x_label if panel is rows[-1] else "", y_label, grid="both")
        legend_above(rows[0], min(len(panels[0][1]), 4))

    save_figure(path, draw, title, 6.4)


def _draw_over_bins(axes: Any, series: Sequence[Series]) -> None:
    bins = np.unique(np.concatenate([values.x for values in series]))
    step = float(np.min(np.diff(bins))) if len(bins) > 1 else 1.0
    for number, values in enumerate(series):
        # A little apart, so that bars of equal values do not hide each other.
        x = values.x + 0.14 * step * (number - 0.5 * (len(series) - 1))
        _draw_markers(axes, number, values, x, values.y, vertical=True)
        if values.expected is not None:
            axes.plot(x, values.expected, color=colour_of(number), linewidth=1.1)


def save_named(
    path: str | os.PathLike[str], series: Sequence[Series], *, names: Sequence[str], x_label: str, title: str
) -> None:
    """Draw series over names, from top to bottom; `Series.x` is the index of the name.

    Raises:
        OutputError: if a result cannot be written
    """

    def draw(_: Any, axes: Any) -> None:
        for number, values in enumerate(series):
            aside = 0.16 * (number - 0.5 * (len(series) - 1))
            rows = values.x + aside
            _draw_markers(axes, number, values, values.y, rows, vertical=False)
            if values.expected is not None:
                axes.plot(values.expected, rows, "|", color=colour_of(number), markersize=11, markeredgewidth=1.1)
        axes.set_yticks(range(len(names)), [literal(name) for name in names])
        axes.set_ylim(len(names) - 0.4, -0.6)
        plain_axes(axes, x_label, grid="both")
        legend_above(axes, min(len(series), 4))

    save_figure(path, draw, title, 1.4 + 0.3 * max(len(names), 2))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pairs:
    """SNR of the same pulses for two sensors, A and B.

    Attributes:
        kind: (n,) index into ``kinds`` of each pulse
        levels: thresholds of the two comparators; None: none
    """

    a: Numbers
    b: Numbers
    kind: Numbers
    kinds: Sequence[str]
    levels: tuple[float | None, float | None]


def save_snr(path: str | os.PathLike[str], pairs: Pairs, *, x_label: str, y_label: str, title: str) -> None:
    """Draw SNR of B over SNR of A, both axes logarithmic, a colour for each kind, lines at the thresholds.

    Raises:
        OutputError: if a result cannot be written
    """
    a, b, kind = pairs.a, pairs.b, pairs.kind

    def draw(_: Any, axes: Any) -> None:
        drawn = slice(None, None, max(len(a) // _MOST_SCATTERED, 1))
        shades = (GREY, COLOURS[0], COLOURS[1], "#c9c9c9")
        for number, label in enumerate(pairs.kinds):
            of_kind = kind[drawn] == number
            axes.scatter(
                a[drawn][of_kind],
                b[drawn][of_kind],
                s=5,
                alpha=0.5,
                linewidths=0,
                rasterized=True,
                color=shades[number],
                label=f"{label}: {np.count_nonzero(kind == number):,}",
            )
        axes.set_xscale("log")
        axes.set_yscale("log")
        low, high = float(min(a.min(), b.min())), float(max(a.max(), b.max()))
        axes.plot([low, high], [low, high], color=INK, linewidth=0.7, linestyle=(0, (5, 2.2)), zorder=1)
        for level, line in zip(pairs.levels, (axes.axvline, axes.axhline), strict=True):
            if level is not None:
                line(level, color=INK, linewidth=0.7, linestyle=(0, (1.2, 1.8)), zorder=1)
        plain_axes(axes, x_label, y_label, grid="both")
        legend_above(axes, 2)
        for handle in axes.get_legend().legend_handles:
            handle.set_sizes([24])
            handle.set_alpha(1.0)

    save_figure(path, draw, title, 5.4)


def _draw_markers(axes: Any, number: int, values: Series, x: Numbers, y: Numbers, *, vertical: bool) -> None:
    """Draw markers and bars of one sensor."""
    bars = {"yerr" if vertical else "xerr": np.stack([values.y - values.low, values.high - values.y]).clip(0.0)}
    axes.errorbar(
        x,
        y,
        fmt=MARKERS[number % len(MARKERS)],
        color=colour_of(number),
        markersize=4.5,
        linewidth=0,
        elinewidth=1.2,
        capsize=2,
        label=literal(values.label),
        markeredgecolor="white",
        markeredgewidth=0.4,
        **bars,
    )
