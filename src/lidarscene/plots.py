"""Pictures: a PointCloud in, a PNG or SVG file out.

The perspective view projects and splats the points here, in numpy, nearest on top; matplotlib, imported when
called, frames the image with title and scale.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lidarscene.cloud import COLUMNS, RANGE, STATUS_NAMES, PointCloud
from lidarscene.errors import InputError
from lidarscene.io.files import atomic_output

Array = np.ndarray[Any, Any]
Vector = tuple[float, float, float]

BACKGROUND, MISSING, INK, ALARM = "#0b0e14", "#23272f", "#d7dce4", "#ff2fd0"
PALETTE = ("#4cc9f0", "#ffb703", "#80ed99", "#f15bb5", "#a78bfa", "#ff6b35", "#e9ff70", "#2ec4b6",
           "#c08552", "#9fb4ff", "#ff8fa3", "#6a994e")  # fmt: skip
NO_SURFACE = "#6b7280"
LOGARITHMIC = ("intensity", "snr")
SHORT_NAMES = {"detection_probability": "detection probability", "return_number": "return",
               "incidence_angle": "incidence angle", "in_shadow": "shadow", "true_range": "true range",
               "sun_angle": "sun angle"}  # fmt: skip
DPI = 200  # of a picture 1920 pixels wide
SUPERSAMPLING = 2


def perspective_picture(
    cloud: PointCloud,
    path: str | os.PathLike[str],
    *,
    colour_by: str = "intensity",
    eye_m: Vector | None = None,
    target_m: Vector | None = None,
    fov_deg: float = 60.0,
    highlight_false_alarms: bool = True,
    size_px: tuple[int, int] = (1920, 1080),
) -> None:
    """Draw the cloud as seen from ``eye_m`` towards ``target_m``, in the frame of the points.

    Without them: from above and behind the sensor, towards what is near. ``fov_deg`` is the full angle across.
    """
    figure = _figure(size_px)
    shades = _Shades(cloud, colour_by)
    camera = _camera(cloud, eye_m, target_m, fov_deg)
    _draw_perspective(figure, (0.0, 0.0, 1.0, 1.0), cloud, shades, camera, highlight_false_alarms)
    _save(figure, path)


def range_image(
    cloud: PointCloud,
    path: str | os.PathLike[str],
    *,
    colour_by: str = "range",
    size_px: tuple[int, int] = (1920, 640),
) -> None:
    """Draw azimuth by elevation as the sensor sees it, one cell a beam; dark grey where no point came."""
    figure = _figure(size_px)
    _draw_range_image(figure, (0.06, 0.14, 0.86, 0.74), cloud, _Shades(cloud, colour_by), _cells(cloud))
    _title(figure, cloud)
    _save(figure, path)


def frame_picture(
    cloud: PointCloud,
    path: str | os.PathLike[str],
    *,
    colour_by: str = "intensity",
    strips: tuple[str, ...] = ("range", "intensity"),
    size_px: tuple[int, int] = (1920, 1600),
) -> None:
    """Draw both: the perspective on top, below it a range image for each column named in ``strips``."""
    figure = _figure(size_px)
    top = 0.62 if strips else 1.0
    camera = _camera(cloud, None, None, 60.0)
    _draw_perspective(figure, (0.0, 1 - top, 1.0, top), cloud, _Shades(cloud, colour_by), camera, True)
    each = (1 - top) / max(len(strips), 1)
    cells = _cells(cloud)
    for i, name in enumerate(strips):
        box = (0.06, 1 - top - (i + 1) * each + 0.30 * each, 0.86, 0.62 * each)
        _draw_range_image(figure, box, cloud, _Shades(cloud, name), cells)
    _save(figure, path)


class _Shades:
    """The colour of each point for one column, and the scale that explains it.

    values  (n,) in the unit of the scale; rgb (n, 3) uint8
    kinds   (label, colour) of each category, most frequent first; empty for a quantity
    """

    def __init__(self, cloud: PointCloud, name: str) -> None:
        from matplotlib import colors

        self.column = {c.name: c for c in (*COLUMNS, RANGE)}.get(name)
        values = np.asarray(cloud.column(name))
        unit = cloud.metadata.get(f"{name}_unit", self.column.unit if self.column else "")
        names = _category_names(cloud, name)
        self.kinds: list[tuple[str, str]] = []
        if names is not None:
            values = self._sort_kinds(values, names)
            palette = [colour for _, colour in self.kinds] or [NO_SURFACE]
            self.map: Any = colors.ListedColormap(palette)
            self.norm: Any = colors.Normalize(-0.5, len(palette) - 0.5)
        else:
            if unit == "rad":
                values, unit = np.degrees(values), "°"
            self.map = _colour_map(name)
            self.norm = _norm(values, name)
        self.values = values
        self.label = SHORT_NAMES.get(name, name) + (f" [{unit}]" if unit != "1" and names is None else "")
        shown = np.ma.masked_invalid(values) if len(values) else np.ma.array(np.zeros(0))
        self.rgb = np.asarray(self.map(self.norm(shown), bytes=True))[:, :3]

    def _sort_kinds(self, values: Array, names: dict[int, str]) -> Array:
        """Number the categories by how often they come; all after the palette's last share its colour."""
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
    """Names by value for a column that sorts points, None for one that measures."""
    tables = {
        "body": cloud.body_names,
        "class": cloud.class_names,
        "material": cloud.material_names,
        "status": STATUS_NAMES,
        "in_shadow": ("lit", "in shadow"),
        "return_number": ("none", "first", "second", "third"),
    }
    return dict(enumerate(tables[name])) if name in tables else None


def _colour_map(name: str) -> Any:
    """A perceptual map without the dark end, which would be lost on the background."""
    import matplotlib as mpl
    from matplotlib import colors

    if name in ("range", "true_range", "time"):
        base, low, high = mpl.colormaps["turbo_r"], 0.06, 0.94
    elif name in LOGARITHMIC:
        base, low, high = mpl.colormaps["inferno"], 0.22, 1.0
    else:
        base, low, high = mpl.colormaps["viridis"], 0.12, 1.0
    shown = colors.ListedColormap(base(np.linspace(low, high, 256)))
    shown.set_bad(NO_SURFACE)
    return shown


def _norm(values: Array, name: str) -> Any:
    """The scale from the 1st to the 99th percentile; logarithmic for powers."""
    from matplotlib import colors

    usable = values[np.isfinite(values)]
    if name in LOGARITHMIC:
        usable = usable[usable > 0]
    low, high = np.percentile(usable, (1, 99)).tolist() if len(usable) else (0.1, 1.0)
    if name.endswith("probability"):
        low, high = 0.0, 1.0
    if name in LOGARITHMIC:
        return colors.LogNorm(low, max(high, low * 1.01), clip=True)
    return colors.Normalize(low, high if high > low else low + 1.0, clip=True)


@dataclass(frozen=True, kw_only=True)
class _Camera:
    """A pinhole: ``axes`` has the rows right, down, forward; the full angle across is ``fov_deg``."""

    eye_m: Array
    axes: Array
    fov_deg: float

    def project(self, xyz_m: Array, *, width: int, height: int) -> tuple[Array, Array, Array]:
        """Pixel column, row and depth in metres of each point, float32; a depth <= 0 is behind."""
        right, down, depth = (self.axes @ (xyz_m - self.eye_m).T).astype(np.float32)
        focal = 0.5 * width / math.tan(0.5 * math.radians(self.fov_deg))
        scale = focal / np.maximum(depth, np.float32(1e-3))
        return right * scale + 0.5 * width, down * scale + 0.5 * height, depth


def _camera(cloud: PointCloud, eye_m: Vector | None, target_m: Vector | None, fov_deg: float) -> _Camera:
    """From here to there, level; what is not given follows from the near half of the echoes."""
    sensor = cloud.sensor_position_m
    echoes = cloud.xyz_m[cloud.status == 0] - sensor if len(cloud) else np.zeros((0, 3))
    distance = np.linalg.norm(echoes[:, :2], axis=1)
    near = echoes[distance <= np.percentile(distance, 60)] if len(echoes) else np.array([[20.0, 0.0, -1.5]])
    reach = float(np.percentile(np.linalg.norm(near[:, :2], axis=1), 75))
    reach = min(max(reach, 2.0), 60.0)
    mean = (near[:, :2] / np.maximum(np.linalg.norm(near[:, :2], axis=1, keepdims=True), 1e-6)).mean(axis=0)
    ahead = np.array([1.0, 0.0, 0.0])
    around = float(np.linalg.norm(mean)) < 0.3
    if not around:
        ahead[:2] = mean / np.linalg.norm(mean)
    back, up, forward = (1.3, 0.9, 0.1) if around else (0.35, 0.32, 0.9)
    eye = sensor - back * reach * ahead + (0.0, 0.0, up * reach) if eye_m is None else np.array(eye_m, float)
    ground = np.array([0.0, 0.0, float(np.median(near[:, 2]))])
    target = sensor + forward * reach * ahead + ground if target_m is None else np.array(target_m, float)
    look = target - eye
    right = np.cross(look, (0.0, 0.0, 1.0))
    if not 0 < fov_deg < 180 or np.linalg.norm(right) < 1e-9 * max(1.0, float(np.linalg.norm(look))):
        raise InputError(f"camera: from {eye} to {target} with {fov_deg} degrees is no view with z up")
    look, right = look / np.linalg.norm(look), right / np.linalg.norm(right)
    return _Camera(eye_m=eye, axes=np.stack([right, np.cross(look, right), look]), fov_deg=fov_deg)


def _splat(camera: _Camera, xyz_m: Array, rgb: Array, *, large: Array, width: int, height: int) -> Array:
    """(height, width, 3) uint8 image of the points as discs, nearest on top, edges darkened.

    xyz_m (n, 3); rgb (n, 3) uint8; large (n,) bool, drawn twice as wide
    """
    w, h = width * SUPERSAMPLING, height * SUPERSAMPLING
    u, v, depth = camera.project(xyz_m, width=w, height=h)
    margin = 0.02 * w
    seen = (depth > 0.1) & (u > -margin) & (u < w + margin) & (v > -margin) & (v < h + margin)
    index = np.flatnonzero(seen)
    front = np.full((h, w), -1, np.int32)
    if len(index):
        index = index[np.argsort(-depth[index], kind="stable")]
        middle = float(np.median(depth[index]))
        base = min(max(0.42 * math.sqrt(0.4 * w * h / len(index)), 1.2), 3.5)
        growth = np.clip(np.sqrt(middle / depth[index]), 0.75, 2.2)
        radius = np.rint(base * growth * np.where(large[index], 2.0, 1.0)).astype(np.int32)
        _discs(front, index, u[index], v[index], radius)
    image = _lit(front, depth, rgb)
    return image.reshape(height, SUPERSAMPLING, width, SUPERSAMPLING, 3).mean(axis=(1, 3)).astype(np.uint8)


def _discs(front: Array, index: Array, u: Array, v: Array, radius: Array) -> None:
    """Write each point's index over the pixels of its disc; the points come farthest first."""
    h, w = front.shape
    starts = np.flatnonzero(np.diff(radius, prepend=-1))
    for first, last in zip(starts, [*starts[1:], len(index)], strict=True):
        r = int(radius[first])
        dy, dx = np.mgrid[-r : r + 1, -r : r + 1]
        inside = dx**2 + dy**2 <= (r + 0.3) ** 2
        for part in np.array_split(np.arange(first, last), (last - first) * inside.sum() // (1 << 22) + 1):
            x = u[part].astype(np.int32)[:, None] + dx[inside]
            y = v[part].astype(np.int32)[:, None] + dy[inside]
            kept = (x >= 0) & (x < w) & (y >= 0) & (y < h)
            front[y[kept], x[kept]] = np.broadcast_to(index[part][:, None], x.shape)[kept]


def _lit(front: Array, depth: Array, rgb: Array) -> Array:
    """Colours of the front points, darker where a neighbour is nearer (eye-dome lighting)."""
    covered = front >= 0
    near = np.where(covered, np.log2(np.maximum(depth, 0.1))[front], np.float32(np.inf))
    shade = np.zeros(front.shape, np.float32)
    reach = SUPERSAMPLING
    for dy, dx in ((0, reach), (0, -reach), (reach, 0), (-reach, 0)):
        step = np.where(covered, near, 0.0) - np.roll(near, (dy, dx), axis=(0, 1))
        shade += np.clip(step, 0.0, 0.5)
    bright = np.exp(np.float32(-1.6) * shade)[..., None]
    return np.where(covered[..., None], rgb[front] * bright, _rgb(BACKGROUND).astype(np.float32))
