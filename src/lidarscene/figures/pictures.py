"""Pictures: a PointCloud in, a PNG or SVG file out.

Points are drawn by our own rasteriser (`lidarscene.cloud.pixels`) on a `Canvas`. Title and scale stand above the
points, never on them. Where the surfaces are known, they are drawn faintly behind the points.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ..cloud.pixels import (
    Camera,
    Cells,
    camera_for,
    cells_of,
    colour_image,
    draw_surfaces_behind,
    eye_dome_picture,
    splat,
    unpack_rgb,
)
from ..cloud.point_cloud import PointCloud
from ..cloud.scales import Scale, scale_of
from ..cloud.shades import OWN_COLOURS, FixedColours, Shades, rgb
from ..cloud.thinning import Thinned
from ..files.facts import Picture
from ..maths.arrays import Numbers
from ..scene.scene import View
from .canvas import Canvas

PixelBox = tuple[int, int, int, int]  # left, top, width, height in pixels

BACKGROUND, MISSING, INK, ALARM = "#0b0e14", "#23272f", "#d7dce4", "#ff2fd0"
SUPERSAMPLING = 2
MOST_STRIPS = 3
HEAD, FOOT, LEFT, RIGHT, STRIP = 84, 76, 110, 150, 250
"""Heights of title and lowest axis, margins of range images, and their height, of a picture 1920 pixels wide."""

LARGE, MEDIUM, SMALL = 27.0, 21.0, 18.0
"""Choice: sizes of texts, pixels of a picture 1920 pixels wide."""

Surfaces = Callable[[Camera, tuple[int, int]], Numbers]
"""Function of a camera in the coordinates of the points, and a size; returns the depth of the surface in each pixel,
metres, of shape (height, width); infinite where there is none."""


def perspective_picture(
    cloud: PointCloud,
    path: str | os.PathLike[str],
    *,
    colour_by: str = "intensity",
    view: View | None = None,
    highlight_false_alarms: bool = True,
    size_px: tuple[int, int] = (1920, 1080),
    colours: FixedColours = OWN_COLOURS,
) -> None:
    """Draw the cloud as the camera ``view`` sees it, which is in the coordinates of the points.

    Args:
        view: without one: from above and behind the sensor, towards what is near
        colours: limits or palette that several pictures have
    """
    canvas, whole = Canvas(size_px, BACKGROUND, INK), Thinned.of_cloud(cloud)
    cloud = whole.cloud()
    shades = Shades(cloud, colour_by, colours)
    head = _head(canvas, whole, shades, alarms=highlight_false_alarms)
    box = (0, head, size_px[0], max(size_px[1] - head, 1))
    _draw_perspective(canvas, box, cloud, shades, view, alarms=highlight_false_alarms)
    canvas.save(path)


def draw_in_memory(cloud: PointCloud, *, colour_by: str, view: View | None, size_px: tuple[int, int]) -> Picture:
    """See `PointCloud.plot`."""
    draw = functools.partial(perspective_picture, cloud, colour_by=colour_by, view=view, size_px=size_px)
    return Picture.drawn(draw)


def range_image(
    cloud: PointCloud, path: str | os.PathLike[str], *, colour_by: str = "range", size_px: tuple[int, int] = (1920, 640)
) -> None:
    """Draw azimuth by elevation as the sensor sees it, one cell for each beam; dark grey without a point."""
    canvas, whole = Canvas(size_px, BACKGROUND, INK), Thinned.of_cloud(cloud)
    cloud = whole.cloud()
    shades, unit = Shades(cloud, colour_by), canvas.unit
    head = _head(canvas, whole, None, alarms=False)
    box = _strip_box(size_px[0], head, size_px[1] - head - FOOT * unit, unit)
    _draw_range_image(canvas, box, cells_of(cloud), shades, labels=True)
    canvas.save(path)


def frame_picture(
    cloud: PointCloud | Thinned,
    path: str | os.PathLike[str],
    *,
    colour_by: str = "intensity",
    view: View | None = None,
    strips: tuple[str, ...] = ("range", "intensity"),
    size_px: tuple[int, int] = (1920, 1600),
    surfaces: Surfaces | None = None,
) -> None:
    """Draw the perspective on top, and below it a range image for each column in ``strips``.

    A cloud of several sensors has one range image for each sensor instead, as far as there is room. Of very many
    points every k-th is drawn (`cloud.thinning.Thinned`), and the title says so. ``surfaces`` are drawn faintly.
    """
    whole = cloud if isinstance(cloud, Thinned) else Thinned.of_cloud(cloud)
    cloud = whole.cloud()
    parts = _sensors_apart(cloud)
    images = (
        [(cloud, name, "") for name in strips]
        if not parts
        else [(part, "range", label) for label, part in parts[:MOST_STRIPS]]
    )
    cells = {id(part): cells_of(part) for part in {id(part): part for part, _, _ in images}.values()}
    canvas = Canvas(size_px, BACKGROUND, INK)
    width, height = size_px
    strip, foot = STRIP / 1600 * height, FOOT * canvas.unit if images else 0.0
    shades = Shades(cloud, colour_by)
    head = _head(canvas, whole, shades, alarms=True)
    strips_height = round(foot + strip * len(images))
    box = (0, head, width, max(height - head - strips_height, 1))
    _draw_perspective(canvas, box, cloud, shades, view, alarms=True, surfaces=surfaces)
    own_axes = bool(parts)  # sensors look in different directions, so their strips share no axis
    for i, (part, name, label) in enumerate(reversed(images)):
        below = foot + i * strip
        high = (0.68 if own_axes else 0.88) * strip
        box = _strip_box(width, height - below - high, high, canvas.unit)
        last = own_axes or i == 0
        strip_shades = shades if part is cloud and name == colour_by else Shades(part, name)
        _draw_range_image(canvas, box, cells[id(part)], strip_shades, labels=last, name=label)
    canvas.save(path)


def common_scale(clouds: Sequence[PointCloud], name: str) -> tuple[float, float]:
    """Return lowest and highest value of a colour scale that suits a column of all these clouds."""
    scale = scale_of(name, np.concatenate([np.asarray(cloud.column(name)) for cloud in clouds]))
    return scale.low, scale.high


def _strip_box(width: int, top: float, height: float, unit: float) -> PixelBox:
    """Return the box of a range image, between its axis and its scale."""
    left, right = round(LEFT * unit), round(RIGHT * unit)
    return left, round(top), max(width - left - right, 1), max(round(height), 1)


def _camera(cloud: PointCloud, view: View | None, size: tuple[int, int]) -> Camera:
    """Return the camera of a view; without one, a camera chosen by the points that are near."""
    if view is None:
        return camera_for(cloud, shape=size)
    return camera_for(cloud, eye_m=view.eye_m, target_m=view.target_m, fov_deg=view.fov_deg)


def _sensors_apart(cloud: PointCloud) -> list[tuple[str, PointCloud]]:
    """Return label and points of each sensor of a rig; empty for a single sensor."""
    if len(cloud.sensor_names) < 2:
        return []
    return [(label, cloud.select(cloud.sensor_index == number)) for number, label in enumerate(cloud.sensor_names)]


def _draw_perspective(
    canvas: Canvas,
    box: PixelBox,
    cloud: PointCloud,
    shades: Shades,
    view: View | None,
    *,
    alarms: bool,
    surfaces: Surfaces | None = None,
) -> None:
    """Draw the perspective into a box."""
    left, top, width, height = box
    camera = _camera(cloud, view, (width, height))
    size = SUPERSAMPLING * width, SUPERSAMPLING * height
    colours, large = shades.rgb, np.zeros(len(cloud), bool)
    if alarms and shades.name != "status":
        large = cloud.status == 1
        if large.any():
            colours = np.where(large[:, None], rgb(ALARM), colours)
    front = splat(camera, cloud.xyz_m, size=size, large=large)
    image, shows_point = eye_dome_picture(front, colours, background=rgb(BACKGROUND), reduction=SUPERSAMPLING)
    if surfaces is not None:
        image = draw_surfaces_behind(image, shows_point, camera, surfaces)
    canvas.show(unpack_rgb(image), left, top)
    if not len(cloud):
        canvas.text(left + width / 2, top + height / 2, "no points", 44.0, anchor="mm")


def _draw_range_image(
    canvas: Canvas, box: PixelBox, cells: Cells, shades: Shades, *, labels: bool, name: str = ""
) -> None:
    """Draw one range image into a box, with axes in degrees and a scale."""
    left, top, width, height = box
    unit = canvas.unit
    canvas.show(colour_image(cells.image(size=(width, height)), shades.rgb, background=rgb(MISSING)), left, top)
    x, y = cells.azimuth_deg, cells.elevation_deg
    for value in _ticks(float(y[0]), float(y[-1]), max(round(height / (44 * unit)), 2)):
        tick_y = top + height * (y[-1] - value) / (y[-1] - y[0])
        canvas.fill(left - 6 * unit, tick_y, 6 * unit, unit, INK)
        canvas.text(left - 10 * unit, tick_y, f"{value:g}".replace("-", "\N{MINUS SIGN}"), SMALL, anchor="rm")
    for value in _ticks(float(x[0]), float(x[-1]), 8):
        tick_x = left + width * (x[-1] - value) / (x[-1] - x[0])
        canvas.fill(tick_x, top + height, unit, 6 * unit, INK)
        if labels:
            tick_label = f"{value:g}".replace("-", "\N{MINUS SIGN}")
            canvas.text(tick_x, top + height + 20 * unit, tick_label, SMALL, anchor="mm")
    if labels:
        below = top + height + 50 * unit
        canvas.text(left + width / 2, below, "azimuth [°]  (left is positive)", SMALL, anchor="mm")
    middle = top + height / 2
    if name:
        canvas.text(20 * unit, middle, name, SMALL, anchor="mm", upright=True)
    canvas.text((48 if name else 34) * unit, middle, "elevation [°]", SMALL, anchor="mm", upright=True)
    if not len(shades.rgb):
        canvas.text(left + width / 2, middle, "no points", 25.0, anchor="mm")
    elif shades.scale is None:
        line = 24 * unit
        for i, (label, colour) in enumerate(shades.kinds[: max(int(height / line), 1)]):
            row_y = top + (i + 0.5) * line
            canvas.fill(left + width + 12 * unit, row_y - 5 * unit, 10 * unit, 10 * unit, colour)
            canvas.text(left + width + 28 * unit, row_y, _shorten(label, 10), SMALL)
    else:
        bar = left + width + 18 * unit
        parts = (np.arange(height)[::-1] + 0.5) / height
        canvas.show(np.repeat(shades.scale.table(parts)[:, None], max(round(18 * unit), 1), axis=1), round(bar), top)
        for value, tick_label in shades.scale.ticks(max(round(height / (40 * unit)), 2)):
            label_y = top + height * (1.0 - shades.scale.part(value))
            canvas.text(bar + 24 * unit, label_y, tick_label, SMALL)
        canvas.text(left + width + 128 * unit, middle, shades.label, SMALL, anchor="mm", upright=True)


def _ticks(low: float, high: float, most: int) -> list[float]:
    """Return round values from ``low`` to ``high``, about ``most`` of them."""
    step = next(step for step in _STEPS_DEG if (high - low) / step <= most or step == _STEPS_DEG[-1])
    return [n * step for n in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1)]


_STEPS_DEG = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0, 90.0)
"""Choice: steps from which a picture's axis takes the one that leaves room for its numbers."""


def _shorten(label: str, most: int) -> str:
    return label if len(label) <= most else f"{label[: most - 1]}…"


def _head(canvas: Canvas, whole: Thinned, shades: Shades | None, *, alarms: bool) -> int:
    """Draw names, numbers of points and the meaning of colours above everything; return the height in pixels."""
    unit = canvas.unit
    kinds = zip(("false alarms", "of other lidars", "of the weather"), whole.statuses[1:4], strict=True)
    file_names = [Path(whole.cloud().metadata.get(key, "")).name.removesuffix(".toml") for key in ("scene", "sensor")]
    title = "  ·  ".join(filter(None, file_names)) or "lidarscene"
    canvas.text(30 * unit, 28 * unit, title, LARGE, bold=True)
    numbers = {"points": whole.points} | {name: int(count) for name, count in kinds}
    x = 30 * unit
    for name, count in numbers.items():
        if not count and name != "points":
            continue
        if name == "false alarms" and alarms and shades is not None and shades.name != "status":
            canvas.fill(x, 56 * unit, 11 * unit, 11 * unit, ALARM)
            x += 20 * unit
        count_text = f"{count:,} {name if count != 1 else name.replace('alarms', 'alarm')}".replace(",", "\u202f")
        canvas.text(x, 62 * unit, count_text, MEDIUM)
        x += canvas.length(count_text, MEDIUM) + 28 * unit
    if whole.step > 1:
        canvas.text(x, 62 * unit, f"1 in {whole.step} drawn", MEDIUM)
        x += canvas.length(f"1 in {whole.step} drawn", MEDIUM) + 28 * unit
    x = max(x, 30 * unit + canvas.length(title, LARGE, bold=True) + 28 * unit)
    if shades is not None and shades.scale is not None and len(shades.rgb):
        _bar(canvas, shades.scale, shades.label)
    elif shades is not None:
        _legend(canvas, shades.kinds, x)
    return round(HEAD * unit)


def _bar(canvas: Canvas, scale: Scale, label: str) -> None:
    """Draw a colour bar at the right of the head."""
    unit, width = canvas.unit, canvas.image.shape[1]
    long = round(480 * unit)
    left, top = width - long - round(50 * unit), round(20 * unit)
    parts = (np.arange(long) + 0.5) / long
    canvas.show(np.repeat(scale.table(parts)[None], max(round(16 * unit), 1), axis=0), left, top)
    canvas.text(left - 16 * unit, top + 8 * unit, label, MEDIUM, anchor="rm")
    for value, tick_label in scale.ticks(7):
        tick_x = left + long * scale.part(value)
        canvas.fill(tick_x, top + 17 * unit, unit, 6 * unit, INK)
        canvas.text(tick_x, top + 36 * unit, tick_label, SMALL, anchor="mm")


def _legend(canvas: Canvas, kinds: Sequence[tuple[str, str]], left: float) -> None:
    """Draw the categories in three lines at the right of the head, most frequent first, as many as fit."""
    unit, width = canvas.unit, canvas.image.shape[1]
    shorts = [(_shorten(label, 24), colour) for label, colour in kinds]
    wide = max((canvas.length(label, SMALL) for label, _ in shorts), default=0.0) + 48 * unit
    columns = max(int((width - left - 20 * unit) / wide), 1)
    entries = shorts[: 3 * columns]
    if len(entries) < len(shorts):
        entries[-1] = (f"{len(shorts) - len(entries) + 1} more", INK)
    columns_used = -(-len(entries) // 3)
    for number, (label, colour) in enumerate(entries):
        x = width - 20 * unit - (columns_used - number // 3) * wide
        y = (20 + 23 * (number % 3)) * unit
        canvas.fill(x, y - 6 * unit, 12 * unit, 12 * unit, colour)
        canvas.text(x + 20 * unit, y, label, SMALL)
