"""Line charts: a `Chart` in, a PNG or SVG file out.

Colours are Okabe and Ito's, which people with any colour vision can tell apart. matplotlib is imported when called,
without pyplot, so a chart changes no global state.
"""

from __future__ import annotations

import os
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..errors import InputError
from ..files.atomic import atomic_output
from ..maths.arrays import Numbers

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Blue, vermilion, green, purple, orange, sky, black. Yellow is left out: too pale on white."""

INK, GREY, GRID = "#1a1a1a", "#6b6b6b", "#dddddd"

STYLES = {"solid": "-", "dashed": (0, (5, 2.2)), "dotted": (0, (1.2, 1.8)), "dashdot": (0, (6, 2, 1.2, 2))}
"""Choice: dashes of the line styles by name."""

SIZE_INCHES = (6.0, 4.2)
"""Choice: size of a chart, width and height."""

DPI = 200
_LEGEND_CHARACTERS = 88  # characters in a row of the legend


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """One curve. NaN and infinite values leave gaps. Lines with the same ``colour`` number share a colour."""

    label: str
    x: Numbers
    y: Numbers
    colour: int = 0
    style: str = "solid"
    width: float = 1.8
    opacity: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Mark:
    """A marked point with a text at ``offset`` (in points), or where it is free; ``colour`` None is ink."""

    x: float
    y: float
    text: str
    colour: int | None = None
    offset: tuple[float, float] = (8.0, 8.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Level:
    """A horizontal dotted line with a text at its left or right end."""

    y: float
    text: str
    side: str = "left"


@dataclass(frozen=True, slots=True, kw_only=True)
class Chart:
    """Lines on common axes. Limits of None fit the data."""

    lines: tuple[Line, ...]
    x_label: str
    y_label: str
    title: str = ""
    x_log: bool = False
    y_log: bool = False
    x_limits: tuple[float, float] | None = None
    y_limits: tuple[float | None, float | None] | None = None
    marks: tuple[Mark, ...] = ()
    levels: tuple[Level, ...] = ()


def suffix_of(path: str | os.PathLike[str]) -> str:
    """Picture format by the file's suffix: png or svg.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    kind = Path(path).suffix.lower().lstrip(".")
    if kind not in ("png", "svg"):
        raise InputError(f"{os.fspath(path)}: suffix '.{kind}' names no picture format; known: .png, .svg")
    return kind


def save(chart: Chart, paths: Iterable[str | os.PathLike[str]]) -> None:
    """Draw the chart once and write it to each path, atomically.

    Raises:
        InputError: if a file, a key or a value cannot be understood
        OutputError: if a result cannot be written
    """
    kinds = [(path, suffix_of(path)) for path in paths]
    figure = _draw_chart(chart)
    for path, kind in kinds:
        write_figure(figure, path, kind)


def empty_figure(size_inches: tuple[float, float], **options: Any) -> Any:
    """White figure of matplotlib that no window shows."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size_inches, facecolor="white", **{"dpi": DPI} | options)
    FigureCanvasAgg(figure)
    return figure


def write_figure(figure: Any, path: str | os.PathLike[str], kind: str = "png") -> None:
    """Write a figure, atomically; equal figures are equal files, without a date and random ids.

    Raises:
        OutputError: if a result cannot be written
    """
    import matplotlib as mpl

    options = {"svg.hashsalt": "lidarscene", "svg.fonttype": "path"}
    with mpl.rc_context(options), atomic_output(path) as temporary:
        figure.savefig(temporary, format=kind, metadata={"Date" if kind == "svg" else "Software": None})


def _draw_chart(chart: Chart) -> Any:
    figure = empty_figure(SIZE_INCHES)
    axes = figure.add_subplot()
    if chart.x_log:
        axes.set_xscale("log")
    if chart.y_log:
        axes.set_yscale("log")
    for line in chart.lines:
        axes.plot(
            line.x,
            np.where(np.isfinite(line.y), line.y, np.nan),
            label=literal(line.label),
            color=colour_of(line.colour),
            linestyle=STYLES[line.style],
            linewidth=line.width,
            alpha=line.opacity,
            solid_capstyle="round",
        )
    _frame(axes, chart)
    _notes(axes, chart)
    _legend(figure, axes, chart)
    arrange(figure)
    _place_texts(figure, axes, chart)
    return figure


def arrange(figure: Any) -> None:
    """Place axes and texts, once: a figure with a layout engine would be drawn twice for each file."""
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    ConstrainedLayoutEngine().execute(figure)


def _frame(axes: Any, chart: Chart) -> None:
    """Set limits, ticks, grid and labels."""
    # A chart of marks alone, or of one place, has no width: there Matplotlib chooses the limits.
    x = np.concatenate([line.x for line in chart.lines] or [np.zeros(0)])
    low, high = chart.x_limits or (float(x.min(initial=np.inf)), float(x.max(initial=-np.inf)))
    if low < high:
        axes.set_xlim(low, high)
    if chart.y_limits:
        axes.set_ylim(*chart.y_limits)
    for axis, log in ((axes.xaxis, chart.x_log), (axes.yaxis, chart.y_log)):
        if log:
            _plain_decades(axis)
    plain_axes(axes, literal(chart.x_label), literal(chart.y_label), grid="both")
    axes.tick_params(which="minor", length=2, width=0.5, labelsize=7.5)
    axes.spines[["left", "bottom"]].set_linewidth(0.7)


def plain_axes(axes: Any, x_label: str = "", y_label: str = "", *, grid: Literal["", "x", "both"] = "") -> None:
    """Draw labels, ticks and two spines in ink, and lines of a grid below what is drawn."""
    for set_label, label in ((axes.set_xlabel, x_label), (axes.set_ylabel, y_label)):
        if label:
            set_label(label, fontsize=10, color=INK)
    axes.tick_params(labelsize=8.5, colors=INK, length=3.5, width=0.7)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(INK)
    if grid:
        axes.grid(visible=True, axis=grid, color=GRID, linewidth=0.6)
        axes.set_axisbelow(True)


def _plain_decades(axis: Any) -> None:
    """Label ticks 1, 10, 100 instead of powers; also 2 and 5 if the axis has little more than a decade."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axis.get_view_interval()
    narrow = low > 0.0 and high / low < 50.0
    written = FuncFormatter(lambda value, _: f"{value:g}" if 1e-4 <= value < 1e5 else f"{value:.0e}")
    axis.set_major_locator(LogLocator(base=10.0, subs=(1.0, 2.0, 5.0) if narrow else (1.0,), numticks=20))
    axis.set_major_formatter(written)
    axis.set_minor_locator(LogLocator(base=10.0, subs=tuple(range(2, 10)), numticks=100))
    axis.set_minor_formatter(NullFormatter())


def halo(width: float = 2.5) -> list[Any]:
    """White edge around a text."""
    from matplotlib.patheffects import withStroke

    return [withStroke(linewidth=width, foreground="white")]


def _notes(axes: Any, chart: Chart) -> None:
    """Draw levels with their texts, and marked points."""
    for level in chart.levels:
        axes.axhline(level.y, color=GREY, linewidth=1.0, linestyle=STYLES["dotted"], zorder=1.5)
        x, align = (0.01, "left") if level.side == "left" else (0.99, "right")
        axes.annotate(
            literal(level.text),
            (x, level.y),
            xycoords=("axes fraction", "data"),
            xytext=(0, 3),
            textcoords="offset points",
            ha=align,
            va="bottom",
            fontsize=8,
            color=GREY,
            path_effects=halo(),
        )
    for mark in chart.marks:
        point = {"color": _ink(mark), "markersize": 5, "markeredgecolor": "white", "zorder": 4, "clip_on": False}
        axes.plot([mark.x], [mark.y], "o", **point)


def _ink(mark: Mark) -> str:
    return INK if mark.colour is None else colour_of(mark.colour)


_PLACES = [(x, up * y) for y in (8.0, 22.0, 36.0, 50.0, 64.0) for up in (1.0, -1.0) for x in (8.0, -8.0)]
"""Choice: offsets in points that are tried for the text of a mark, the nearest first."""


def _place_texts(figure: Any, axes: Any, chart: Chart) -> None:
    """Write the text of each mark at its offset; where another text or the edge is in the way, at the next free place.

    Of the free places it is the nearest that covers little of the curves. A line leads from a far one to its mark.
    """
    from matplotlib.text import Text
    from matplotlib.transforms import Bbox

    renderer = figure.canvas.get_renderer()
    points = axes.transData.transform([(mark.x, mark.y) for mark in chart.marks] or np.empty((0, 2)))
    # Texts of levels, and the marks themselves: squares of 8 pixels around them.
    taken = [Text.get_window_extent(text, renderer) for text in axes.texts]
    marked = [Bbox.from_extents(x - 8.0, y - 8.0, x + 8.0, y + 8.0) for x, y in points]
    curves = np.concatenate(
        [axes.transData.transform(np.column_stack([line.x, line.y])) for line in chart.lines] or [points]
    )
    for number, mark in enumerate(chart.marks):
        if not mark.text:
            continue
        of_others = [*taken, *(box for place, box in enumerate(marked) if place != number)]
        places = []
        for offset in (mark.offset, *_PLACES):
            text = _annotation(axes, mark, offset)
            text.update_positions(renderer)
            box = Text.get_window_extent(text, renderer)
            text.remove()
            is_free = not box.count_overlaps(of_others) and _is_within(box, figure.bbox)
            if is_free and offset == mark.offset:
                places = [(0.0, offset, box)]
                break
            if is_free:
                inside = np.all((curves >= box.min) & (curves <= box.max), axis=1)
                places.append((3 * int(inside.sum()) + abs(offset[1]), offset, box))
        # No room anywhere: its own place, over another text.
        _, offset, box = min(places, key=lambda place: place[0], default=(0.0, mark.offset, box))
        _annotation(axes, mark, offset)
        taken.append(box)


def _is_within(box: Any, whole: Any) -> bool:
    return bool(np.all(box.min >= whole.min) and np.all(box.max <= whole.max))


def _annotation(axes: Any, mark: Mark, offset: tuple[float, float]) -> Any:
    """Text of a mark, with a line to it from farther away than its own offset."""
    is_far = abs(offset[1]) > max(abs(mark.offset[1]), 8.0)
    return axes.annotate(
        literal(mark.text),
        (mark.x, mark.y),
        xytext=offset,
        textcoords="offset points",
        fontsize=8.5,
        color=_ink(mark),
        ha="left" if offset[0] >= 0 else "right",
        va="bottom" if offset[1] >= 0 else "top",
        path_effects=halo(),
        zorder=5,
        arrowprops={"arrowstyle": "-", "color": _ink(mark), "linewidth": 0.6, "shrinkA": 1.0} if is_far else None,
    )


def _legend(figure: Any, axes: Any, chart: Chart) -> None:
    """Draw title and legend above the axes, where no curve can cross them."""
    if chart.title:
        wrapped = "\n".join(textwrap.wrap(literal(chart.title), 98))
        figure.suptitle(wrapped, x=0.012, ha="left", fontsize=8.5, color=GREY, linespacing=1.25)
    labels = [line.label for line in chart.lines if line.label]
    if not labels:
        return
    longest = max((len(label) for label in labels), default=1)
    columns = max(1, min(len(labels), _LEGEND_CHARACTERS // (longest + 9)))
    if sum(len(label) + 9 for label in labels) <= _LEGEND_CHARACTERS:
        columns = len(labels)
    legend_above(axes, columns, labelcolor=INK, handlelength=2.6, columnspacing=1.6, borderaxespad=0.4)


def legend_above(axes: Any, columns: int, **options: Any) -> None:
    """Draw the legend above the axes, in so many columns."""
    axes.legend(loc="lower left", bbox_to_anchor=(-0.01, 1.0), ncols=columns, frameon=False, fontsize=8.5, **options)


def colour_of(number: int) -> str:
    """Colour of the line, sensor or group of this number."""
    return COLOURS[number % len(COLOURS)]


def literal(text: str) -> str:
    """Return a text with literal dollar signs, which matplotlib would take for a formula."""
    return text.replace("$", r"\$")


# --- tornado ----------------------------------------------------------------------------------------


def tornado(
    paths: Iterable[str | os.PathLike[str]], *, bars: Sequence[tuple[str, float]], title: str, label: str
) -> None:
    """Draw horizontal bars left and right of zero, in the given order from the top, each with its number.

    The sign shows in direction and in colour.

    Raises:
        InputError: if a file, a key or a value cannot be understood
        OutputError: if a result cannot be written
    """
    kinds = [(path, suffix_of(path)) for path in paths]
    figure = empty_figure((SIZE_INCHES[0], 1.1 + 0.215 * max(len(bars), 2)))
    _tornado(figure.add_subplot(), bars, title, label)
    arrange(figure)
    for path, kind in kinds:
        write_figure(figure, path, kind)


def _tornado(axes: Any, bars: Sequence[tuple[str, float]], title: str, label: str) -> None:
    """Draw bars, numbers at their ends, names along the left edge."""
    values = [value for _, value in bars]
    places = range(len(bars))
    axes.barh(places, values, height=0.68, color=[colour_of(0 if value > 0.0 else 1) for value in values])
    for place, value in zip(places, values, strict=True):
        side = 1.0 if value > 0.0 else -1.0
        number = f"{value:+.2f}" if abs(value) >= 0.095 else f"{value:+.3f}"
        axes.annotate(
            number.replace("-", "\N{MINUS SIGN}"),
            (value, place),
            xytext=(3.0 * side, 0),
            color=INK,
            textcoords="offset points",
            ha="left" if side > 0.0 else "right",
            va="center",
            fontsize=7.5,
            path_effects=halo(2.0),
        )
    widest = 1.28 * max((abs(value) for value in values), default=1.0)
    axes.set_xlim(-widest, widest)
    axes.set_ylim(len(bars) - 0.4, -0.6)
    axes.set_yticks(list(places), [literal(name) for name, _ in bars])
    axes.axvline(0.0, color=INK, linewidth=0.7)
    plain_axes(axes, literal(label), grid="x")
    axes.set_title(literal(title), fontsize=10, color=INK, loc="left", pad=8)
    axes.tick_params(axis="y", length=0, labelsize=8)
    axes.spines["left"].set_visible(False)
    axes.spines["bottom"].set_linewidth(0.7)
