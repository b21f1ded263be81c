"""Pictures: a PointCloud in, a PNG or SVG file out.

Points are drawn by our own rasteriser (`lidarscene.cloud.pixels`), because a million markers are too slow in
matplotlib, which only adds title, axes and scale. It is imported when called.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from ..cloud.pixels import Camera, Cells, camera_for, cells_of, coloured, lit, splat
from ..cloud.points import PointCloud
from ..cloud.thinning import Thinned
from ..errors import InputError
from ..files.atomic import atomic_output
from ..formats.columns import COLUMNS, STATUS_NAMES
from ..maths.arrays import Numbers
from ..scene.model import View

Box = tuple[float, float, float, float]  # left, bottom, width, height, as parts of the figure

BACKGROUND, MISSING, INK, ALARM = "#0b0e14", "#23272f", "#d7dce4", "#ff2fd0"
PALETTE = ("#4cc9f0", "#ffb703", "#80ed99", "#f15bb5", "#a78bfa", "#ff6b35", "#e9ff70", "#2ec4b6",
           "#c08552", "#9fb4ff", "#ff8fa3", "#6a994e")  # fmt: skip
NO_SURFACE = "#6b7280"
ROUND_RANGES_M = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
LOGARITHMIC = ("intensity", "snr")
DPI = 200  # of a picture 1920 pixels wide
SUPERSAMPLING = 2
MOST_STRIPS = 3


def perspective_picture(
    cloud: PointCloud,
    path: str | os.PathLike[str],
    *,
    colour_by: str = "intensity",
    view: View | None = None,
    highlight_false_alarms: bool = True,
    size_px: tuple[int, int] = (1920, 1080),
) -> None:
    """Draw the cloud as the camera ``view`` sees it, which is in the coordinates of the points.

    Without one: from above and behind the sensor, towards what is near.
    """
    figure, whole = _figure(size_px), Thinned.of(cloud)
    cloud = whole.cloud()
    camera = _camera(cloud, view)
    shades = _Shades(cloud, colour_by)
    _draw_perspective(figure, (0.0, 0.0, 1.0, 1.0), whole, shades, camera, alarms=highlight_false_alarms)
    _save(figure, path)


def range_image(
    cloud: PointCloud,
    path: str | os.PathLike[str],
    *,
    colour_by: str = "range",
    size_px: tuple[int, int] = (1920, 640),
) -> None:
    """Draw azimuth by elevation as the sensor sees it, one cell for each beam; dark grey without a point."""
    figure, whole = _figure(size_px), Thinned.of(cloud)
    cloud = whole.cloud()
    box = (0.06, 0.17, 0.84, 0.68)
    _draw_range_image(figure, box, cells_of(cloud), _Shades(cloud, colour_by), labels=True)
    _title(figure, whole)
    _save(figure, path)


def frame_picture(
    cloud: PointCloud | Thinned,
    path: str | os.PathLike[str],
    *,
    colour_by: str = "intensity",
    view: View | None = None,
    strips: tuple[str, ...] = ("range", "intensity"),
    size_px: tuple[int, int] = (1920, 1600),
) -> None:
    """Draw the perspective on top, and below it a range image for each column in ``strips``.

    A cloud of several sensors has one range image for each sensor instead, as far as there is room. Of very many
    points every k-th is drawn (`cloud.thinning.Thinned`), and the title says so.
    """
    whole = cloud if isinstance(cloud, Thinned) else Thinned.of(cloud)
    cloud = whole.cloud()
    parts = _sensors_apart(cloud)
    images = [(cloud, name, "") for name in strips] if len(parts) < 2 else [
        (part, "range", label) for label, part in parts[:MOST_STRIPS]
    ]  # fmt: skip
    figure = _figure(size_px)
    strip, foot = 0.165, 0.055 if images else 0.0
    rest = foot + strip * len(images)
    shades = _Shades(cloud, colour_by)
    camera = _camera(cloud, view)
    _draw_perspective(figure, (0.0, rest, 1.0, 1.0 - rest), whole, shades, camera, alarms=True)
    own_axes = len(parts) > 1  # sensors look in different directions, so their strips share no axis
    for i, (part, name, label) in enumerate(reversed(images)):
        box = (0.06, foot + i * strip, 0.84, (0.72 if own_axes else 0.86) * strip)
        _draw_range_image(
            figure, box, cells_of(part), _Shades(part, name), labels=own_axes or i == 0, name=label
        )
    _save(figure, path)


def _camera(cloud: PointCloud, view: View | None) -> Camera:
    """The camera of a view; without one, what is near decides."""
    if view is None:
        return camera_for(cloud)
    return camera_for(cloud, eye_m=view.eye_m, target_m=view.target_m, fov_deg=view.fov_deg)


def _sensors_apart(cloud: PointCloud) -> list[tuple[str, PointCloud]]:
    """Label and points of each sensor of a rig."""
    return [
        (label, cloud.select(cloud.sensor_index == number)) for number, label in enumerate(cloud.sensor_names)
    ]


class _Shades:
    """Colour of each point for one column, and the scale that explains it.

    rgb    (n, 3) uint8
    kinds  (label, colour) of each category, most frequent first; empty for a quantity
    """

    def __init__(self, cloud: PointCloud, name: str) -> None:
        from matplotlib import colors

        self.name = name
        values = np.asarray(cloud.column(name))
        units = {c.name: c.unit for c in COLUMNS}
        unit = cloud.metadata.get(f"{name}_unit", units[name])
        self.kinds: list[tuple[str, str]] = []
        if (names := _category_names(cloud, name)) is not None:
            values = self._sort_kinds(values, names)
            palette = [colour for _, colour in self.kinds] or [NO_SURFACE]
            self.map: Any = colors.ListedColormap(palette)
            self.norm: Any = colors.Normalize(-0.5, len(palette) - 0.5)
        else:
            if unit == "rad":
                values, unit = np.degrees(values), "°"
            elif name == "pulse_width":
                values, unit = 1e9 * values, "ns"
            self.map = _colour_map(name)
            self.norm = _norm(values, name)
        self.label = name.replace("_", " ") + (f" [{unit}]" if unit != "1" and names is None else "")
        finite = np.isfinite(values)
        colours = self.map(np.asarray(self.norm(np.where(finite, values, 1.0))), bytes=True)[:, :3]
        self.rgb = np.where(finite[:, None], colours, _rgb(NO_SURFACE))

    def _sort_kinds(self, values: Numbers, names: dict[int, str]) -> Numbers:
        """Number the categories by frequency; all beyond the palette share one colour."""
        found, inverse, counts = np.unique(values, return_inverse=True, return_counts=True)
        order = np.argsort(-counts, kind="stable")
        rank = np.argsort(order, kind="stable")
        colours = iter(PALETTE)
        for value in found[order][: len(PALETTE)].tolist():
            colour = NO_SURFACE if value < 0 else next(colours)
            self.kinds.append(("none" if value < 0 else names.get(value, str(value)), colour))
        if len(found) > len(PALETTE):
            self.kinds.append((f"{len(found) - len(PALETTE)} more", "#e5e7eb"))
        return np.asarray(np.minimum(rank[inverse], len(PALETTE)), dtype=np.float64)


def _category_names(cloud: PointCloud, name: str) -> dict[int, str] | None:
    """Names by value for a column of categories, None for a quantity."""
    tables = {
        "status": STATUS_NAMES,
        "in_shadow": ("lit", "in shadow"),
        "body": cloud.body_names,
        "sensor_index": cloud.sensor_names,
    }
    tables |= {"class": cloud.class_names, "material": cloud.material_names}
    tables |= {
        "interactions": ("direct", "after one", "after two", "after three"),
        "ghost": ("in its place", "ghost"),
    }
    tables |= {"return_number": ("none", "first", "second", "third")}
    return dict(enumerate(tables[name])) if name in tables else None


def _colour_map(name: str) -> Any:
    """A perceptual colour map without its dark end, which would vanish on the dark background."""
    import matplotlib as mpl
    from matplotlib import colors

    chosen = {"range": ("turbo_r", 0.06, 0.94), "true_range": ("turbo_r", 0.06, 0.94)}
    chosen |= dict.fromkeys(LOGARITHMIC, ("inferno", 0.3, 1.0))
    base, low, high = chosen.get(name, ("viridis", 0.12, 1.0))
    return colors.ListedColormap(mpl.colormaps[base](np.linspace(low, high, 256)))


def _norm(values: Numbers, name: str) -> Any:
    """Scale from the 1st to the 99th percentile: logarithmic for powers, with more contrast at near ranges."""
    from matplotlib import colors

    usable = values[np.isfinite(values)]
    if name in LOGARITHMIC:
        usable = usable[usable > 0]
    low, high = np.percentile(usable, (1, 99)).tolist() if len(usable) else (0.1, 1.0)
    if name.endswith("probability"):
        low, high = 0.0, 1.0
    if name in LOGARITHMIC:
        return colors.LogNorm(low, max(high, low * 1.01), clip=True)
    gamma = 0.5 if name.endswith("range") else 1.0
    return colors.PowerNorm(gamma, low, high if high > low else low + 1.0, clip=True)


def _draw_perspective(
    figure: Any, box: Box, whole: Thinned, shades: _Shades, camera: Camera, *, alarms: bool
) -> None:
    """The perspective in this box of the figure, with title and scale."""
    left, bottom, width, height = box
    cloud = whole.cloud()
    pixels = [SUPERSAMPLING * n for n in _pixels(figure, box)]
    rgb, large = shades.rgb, np.zeros(len(cloud), bool)
    if alarms and shades.name != "status":
        large = cloud.status == 1
        rgb = np.where(large[:, None], _rgb(ALARM), rgb)
    front, depth_m = splat(camera, cloud.xyz_m, size=(pixels[0], pixels[1]), large=large)
    _show(figure, box, lit(coloured(front, rgb, nothing=_rgb(BACKGROUND)), depth_m, reduction=SUPERSAMPLING))
    _title(figure, whole)
    if large.any():
        figure.text(0.975, 0.975, "●  false alarm", color=ALARM, fontsize=7.5, ha="right", va="top")
    if shades.kinds:
        _legend(figure, shades, (left + 0.025, bottom + 0.04 * height, width, 0.8 * height))
    elif len(cloud):
        _panel(figure, (left + 0.015, bottom + 0.02 * height, 0.24 * width, 0.11 * height))
        bar = (left + 0.025, bottom + 0.095 * height, 0.22 * width, 0.016 * height)
        _scale(figure, bar, shades, "horizontal")
    else:
        figure.text(left + width / 2, bottom + height / 2, "no points", color=INK, fontsize=16, ha="center")


def _draw_range_image(
    figure: Any, box: Box, cells: Cells, shades: _Shades, *, labels: bool, name: str = ""
) -> None:
    """One range image in this box of the figure, with axes in degrees and a scale."""
    left, bottom, width, height = box
    image = coloured(cells.image(size=_pixels(figure, box)), shades.rgb, nothing=_rgb(MISSING))
    x, y = cells.azimuth_deg, cells.elevation_deg
    axes = _show(figure, box, image, extent=(x[-1], x[0], y[0], y[-1]))
    axes.set_axis_on()
    axes.tick_params(colors=INK, labelsize=6, length=2, labelbottom=labels)
    axes.set_ylabel(f"{name}\nelevation [°]".lstrip(), color=INK, fontsize=6.5, parse_math=False)
    if labels:
        axes.set_xlabel("azimuth [°]  (left is positive)", color=INK, fontsize=6.5)
    if shades.kinds:
        _legend(figure, shades, (left + width + 0.012, bottom, 0.1, height))
    elif len(shades.rgb):
        _scale(figure, (left + width + 0.012, bottom, 0.010, height), shades, "vertical")
    else:
        figure.text(left + width / 2, bottom + height / 2, "no points", color=INK, fontsize=9, ha="center")


def _rgb(colour: str) -> Numbers:
    """(3,) uint8 of "#rrggbb"."""
    return np.frombuffer(bytes.fromhex(colour[1:]), np.uint8)


def _figure(size_px: tuple[int, int]) -> Any:
    """An empty dark figure of this size; text scales with the width."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    width, height = size_px
    dpi = DPI * width / 1920
    figure = Figure(figsize=(width / dpi, height / dpi), dpi=dpi, facecolor=BACKGROUND)
    FigureCanvasAgg(figure)
    return figure


def _pixels(figure: Any, box: Box) -> tuple[int, int]:
    """Width and height of this box of the figure, in pixels."""
    width, height = figure.get_size_inches() * figure.dpi
    return max(round(width * box[2]), 1), max(round(height * box[3]), 1)


def _show(figure: Any, box: Box, image: Numbers, **options: Any) -> Any:
    """Put the image in this box, pixel by pixel; returns its axes, which are off."""
    axes = figure.add_axes(box)
    axes.imshow(image, aspect="auto", interpolation="none", **options)
    axes.set_axis_off()
    axes.spines[:].set_visible(False)
    return axes


def _title(figure: Any, whole: Thinned) -> None:
    """Names of scene and sensor, and the number of points."""
    kinds = zip(("false alarms", "of other lidars", "of the weather"), whole.statuses[1:4], strict=True)
    named = [Path(whole.cloud().metadata.get(k, "")).name.removesuffix(".toml") for k in ("scene", "sensor")]
    numbers = {"points": whole.points} | {name: int(count) for name, count in kinds}
    counts = [
        f"{count:,} {name}".replace(",", "\u202f")
        for name, count in numbers.items()
        if count or name == "points"
    ]
    if whole.step > 1:
        counts.append(f"1 in {whole.step} drawn")
    box = {"facecolor": BACKGROUND, "alpha": 0.7, "edgecolor": "none", "pad": 2.5}
    options = {"color": INK, "ha": "left", "va": "top", "parse_math": False, "bbox": box}
    title = "  ·  ".join(filter(None, named)) or "lidarscene"
    figure.text(0.025, 0.975, title, fontsize=10, weight="bold", **options)
    y = 0.975 - 0.21 / figure.get_size_inches()[1]
    figure.text(0.025, y, "  ·  ".join(c for c in counts if c), fontsize=7.5, **options)


def _scale(figure: Any, box: Box, shades: _Shades, orientation: str) -> None:
    """A small colour bar with quantity and unit."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.ticker import NullLocator

    mappable = ScalarMappable(norm=shades.norm, cmap=shades.map)
    bar = figure.colorbar(mappable, cax=figure.add_axes(box, zorder=2), orientation=orientation)
    low, high = shades.norm.vmin, shades.norm.vmax
    ticks = ROUND_RANGES_M if shades.name.endswith("range") else bar.get_ticks()
    if (
        shades.name in LOGARITHMIC and high < 30.0 * low
    ):  # few powers of ten, so 1, 2 and 5 of each, written out
        decades = 10.0 ** np.arange(np.floor(np.log10(low)), np.log10(high))
        ticks = np.outer(decades, (1.0, 2.0, 5.0)).ravel()
        bar.formatter, bar.minorlocator = (lambda value, _: f"{value:g}"), NullLocator()
    bar.set_ticks([t for t in ticks if low <= t <= high])
    bar.outline.set_visible(False)
    bar.ax.tick_params(colors=INK, labelsize=6, length=2, which="both")
    bar.set_label(shades.label, color=INK, fontsize=6.5 if orientation == "vertical" else 7.5)


def _legend(figure: Any, shades: _Shades, box: Box) -> None:
    """The categories, one line each, most frequent first, as many as fit."""
    line = 0.135 / figure.get_size_inches()[1]
    kinds = shades.kinds[: max(round(box[3] / line), 2)]
    if len(kinds) < len(shades.kinds):
        kinds[-1] = (f"{len(shades.kinds) - len(kinds) + 1} more", INK)
    shorts = [label if len(label) <= 24 else label[:23] + "…" for label, _ in kinds]
    x, y, width = box[0], box[1], 0.03 + 0.0068 * max(map(len, shorts))
    _panel(figure, (x - 0.008, y - 0.6 * line, width, (len(kinds) + 0.7) * line))
    for i, (short, (_, colour)) in enumerate(zip(shorts[::-1], kinds[::-1], strict=True)):
        figure.text(x, y + i * line, "●", color=colour, fontsize=7)
        figure.text(x + 0.014, y + i * line, short, color=INK, fontsize=6.5, parse_math=False)


def _panel(figure: Any, box: Box) -> None:
    """A dark, half-transparent rectangle under text that lies over points."""
    from matplotlib.patches import Rectangle

    veil = Rectangle(box[:2], *box[2:], transform=figure.transFigure, color=BACKGROUND, alpha=0.7, lw=0)
    figure.add_artist(veil)


def _save(figure: Any, path: str | os.PathLike[str]) -> None:
    """Write the format of the suffix, atomically."""
    kind = Path(path).suffix.lower().lstrip(".")
    if kind not in ("png", "svg"):
        raise InputError(f"{os.fspath(path)}: suffix '.{kind}' names no picture format; known: .png, .svg")
    options = {"metadata": {"Date": None}} if kind == "svg" else {}
    with atomic_output(path) as temporary:
        figure.savefig(temporary, format=kind, facecolor=BACKGROUND, **options)
