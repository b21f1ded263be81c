"""Projection of a cloud onto pixels: the index of the point that each pixel shows.

Pictures, thumbnails and comparisons colour points in different ways but share this projection. There are two kinds: a
pinhole camera that draws points as discs, the nearest on top, and the sensor's own view, azimuth by elevation, one
cell a beam. Plain NumPy without OpenGL, so it runs wherever the simulation runs.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..formats.cloud_columns import Cloud
from ..maths.arrays import Numbers

Vector = tuple[float, float, float]

NOTHING = -1
"""Index of a pixel that shows no point."""

SAME_ANGLE_RAD = 2e-5
"""Choice: difference of angles below which they belong to the same row or column of the scan."""
SURFACE_PX = 3
"""Width in pixels of the picture of one pixel of the surfaces drawn behind the points."""

FAINT = (0.35, 0.65)
"""Choice: brightness of a surface seen edge on, and the part added when it is seen square on."""

SURFACE_RGB = (41.0, 48.0, 62.0)
"""Choice: colour of a bright surface behind the points: dark, so that the points stand out."""

DISCS = 1 << 13
"""Discs drawn at once, so that their pixels fit into the CPU's cache."""

EMPTY = 200.0
"""Choice: log2 of the depth of an empty pixel, beyond any float32 depth in metres."""


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A pinhole: ``axes`` has the rows right, down, forward; the full angle across is ``fov_deg``."""

    eye_m: Numbers
    axes: Numbers
    fov_deg: float

    def project(self, xyz_m: Numbers, *, width: int, height: int) -> tuple[Numbers, Numbers, Numbers]:
        """Pixel column, row and depth in metres of each point, float32; a depth <= 0 is behind."""
        right, down, depth = (self.axes @ (xyz_m - self.eye_m).T).astype(np.float32)
        focal = 0.5 * width / math.tan(0.5 * math.radians(self.fov_deg))
        scale = np.float32(focal) / np.maximum(depth, np.float32(1e-3))
        return right * scale + np.float32(0.5 * width), down * scale + np.float32(0.5 * height), depth

    def rays(self, width: int, height: int) -> tuple[Numbers, Numbers]:
        """Unit vectors from the eye through the pixels' middles, and their components along the view axis, float32.

        Shapes (3, height * width) and (height * width,).
        """
        half = math.tan(0.5 * math.radians(self.fov_deg))
        u = half * (2.0 * (np.arange(width) + 0.5) / width - 1.0)
        v = half * (2.0 * (np.arange(height) + 0.5) - height) / width
        across, along = (np.ravel(x) for x in np.meshgrid(u.astype(np.float32), v.astype(np.float32)))
        ahead = 1.0 / np.sqrt(1.0 + across * across + along * along)
        turned = self.axes.T.astype(np.float32) @ np.stack([across, along, np.ones_like(across)])
        return turned * ahead, ahead


def camera_for(
    cloud: Cloud,
    *,
    eye_m: Vector | None = None,
    target_m: Vector | None = None,
    fov_deg: float = 60.0,
    shape: tuple[int, int] | None = None,
) -> Camera:
    """Camera from eye to target, z up. A missing eye or target is chosen from the echoes near the sensor.

    Args:
        shape: width and height of a picture that these echoes shall fill; adapts the target and the angle
    """
    sensor = cloud.sensor_position_m
    echoes_m = cloud.xyz_m[cloud.column("status") == 0] - sensor
    distance_m = np.sqrt(echoes_m[:, 0] ** 2 + echoes_m[:, 1] ** 2)
    reach, direction, ground = _near_field(echoes_m, distance_m)
    backward, up, forward = 0.40, 0.22, 1.3
    shown = np.ones(len(echoes_m), bool)
    if not direction.any():
        # All around. From high above there would be rings on black.
        reach, direction = _worth_seeing(echoes_m, distance_m, ground)
        backward, up, forward = 0.45, 0.30, 1.0
        shown = echoes_m @ direction > SIDE * distance_m
    eye = sensor - backward * reach * direction + (0.0, 0.0, up * reach)
    target = sensor + forward * reach * direction + (0.0, 0.0, 0.5 * ground)
    eye = eye if eye_m is None else np.array(eye_m, np.float64)
    target = target if target_m is None else np.array(target_m, np.float64)
    if shape is not None:
        near = np.flatnonzero((distance_m <= 1.5 * reach) & shown)
        sample_m = echoes_m[near[:: max(len(near) // 20_000, 1)]]
        target, fov_deg = _fit_view(eye, target, sample_m + sensor, shape, fov_deg)
    look = target - eye
    right = np.cross(look, (0.0, 0.0, 1.0))
    if not 0 < fov_deg < 180 or not np.linalg.norm(right) > 1e-9 * np.linalg.norm(look):
        raise InputError(f"camera: eye {eye}, target {target}, {fov_deg} degrees: no view with z up")
    look, right = look / np.linalg.norm(look), right / np.linalg.norm(right)
    return Camera(eye_m=eye, axes=np.stack([right, np.cross(look, right), look]), fov_deg=fov_deg)


def _fit_view(
    eye: Numbers, target: Numbers, xyz_m: Numbers, shape: tuple[int, int], fov_deg: float
) -> tuple[Numbers, float]:
    """Target and angle with which the bulk of the points fills a picture of this shape."""
    for _ in range(3):
        look = (target - eye) / np.linalg.norm(target - eye)
        right = np.cross(look, (0.0, 0.0, 1.0))
        right /= np.linalg.norm(right)
        down = np.cross(look, right)
        across, along, depth = np.stack([right, down, look]) @ (xyz_m - eye).T
        ahead = depth > 1.0
        if np.count_nonzero(ahead) < 10:
            return target, fov_deg
        u, v = (np.percentile(x[ahead] / depth[ahead], (1.0, 99.0)) for x in (across, along))
        # Limits on the turn keep the camera from looking straight up or down.
        target = eye + look + right * np.clip(u.mean(), -0.5, 0.5) + down * np.clip(v.mean(), -0.5, 0.5)
    half = 1.05 * max(0.5 * float(np.ptp(u)), 0.5 * float(np.ptp(v)) * shape[0] / shape[1])
    return target, float(np.clip(2.0 * np.degrees(np.arctan(half)), 25.0, 95.0))


def _near_field(echoes_m: Numbers, distance: Numbers) -> tuple[float, Numbers, float]:
    """Reach of the bulk of the echoes, its horizontal direction (a unit vector, 0 if all around) and its height.

    Args:
        distance: (n,) horizontal distances in metres
    """
    if not len(distance) or not distance.max() > 0:
        return 20.0, np.array([1.0, 0.0, 0.0]), -1.5
    reach = min(max(float(np.percentile(distance, 70)), 3.0), 60.0)
    near = np.flatnonzero(distance <= max(reach, float(distance.min())))
    weight = 1.0 / np.maximum(distance[near], 1e-6)
    mean = np.array([(echoes_m[near, axis] * weight).mean() for axis in (0, 1)])
    length = float(np.linalg.norm(mean))
    ahead = np.array([*(mean / length), 0.0]) if length > 0.3 else np.zeros(3)
    return reach, ahead, float(np.median(echoes_m[near, 2]))


def _worth_seeing(echoes_m: Numbers, distance: Numbers, ground: float) -> tuple[float, Numbers]:
    """Reach and direction of what stands off the ground: forward, unless little stands there, else where most does."""
    standing = (echoes_m[:, 2] > ground + OFF_GROUND_M) & (distance > NEAREST_M) & (distance < 60.0)
    away_m, weight = distance[standing], 1.0 / distance[standing]
    if not len(away_m):
        return 20.0, np.array([1.0, 0.0, 0.0])
    units = echoes_m[standing, :2] / away_m[:, None]
    angles = np.arange(SECTORS) * 2.0 * math.pi / SECTORS
    directions = np.stack([np.cos(angles), np.sin(angles), np.zeros(SECTORS)], axis=1)
    inside = units @ directions[:, :2].T > SIDE
    sums = weight @ inside
    chosen = 0 if sums[0] >= 0.3 * sums.max() else int(np.argmax(sums))
    return min(max(float(np.median(away_m[inside[:, chosen]])), 8.0), 25.0), directions[chosen]


OFF_GROUND_M, NEAREST_M, SECTORS = 0.4, 2.0, 24
"""Choice: height over the ground from which echoes count as of things, horizontal distance from which they are not of
the own vehicle, and the directions of a turn that are compared."""

SIDE = 0.7
"""Choice: cosine of the half angle of what a picture shows of a cloud all round."""


@dataclass(frozen=True, kw_only=True)
class Front:
    """Points that a picture shows, farthest first, and which of them each pixel shows.

    Attributes:
        point: (m,) int64 indices in the cloud
        depth_m: (m,) float32
        rank: (height, width) int32 index into these two, or NOTHING; the larger of two ranks is the nearer point
    """

    point: Numbers
    depth_m: Numbers
    rank: Numbers


def splat(camera: Camera, xyz_m: Numbers, *, size: tuple[int, int], large: Numbers | None = None) -> Front:
    """Draw points as discs that fill a part of the picture and grow with nearness; the nearest is on top.

    Args:
        xyz_m: (n, 3)
        size: width and height in pixels
        large: (n,) bool, drawn twice as wide
    """
    width, height = size
    u, v, depth = camera.project(xyz_m, width=width, height=height)
    margin = 0.02 * width
    in_view = (depth > 0.1) & (u > -margin) & (u < width + margin) & (v > -margin) & (v < height + margin)
    index = np.flatnonzero(in_view)
    index = index[_farthest_first(depth[index])]
    u, v, depth = u[index], v[index], depth[index]
    if not len(index):
        return Front(point=index, depth_m=depth, rank=np.full((height, width), NOTHING, np.int32))
    # Discs of this radius would cover 0.3^2 pi = 28 % of the picture if they did not overlap.
    base = min(max(0.3 * math.sqrt(width * height / len(index)), 1.0), 3.5)
    radius = base * np.clip(np.sqrt(np.median(depth) / depth), 0.8, 2.2)
    if large is not None:
        radius *= np.where(large[index], 2.0, 1.0)
    # Points and discs that reach over the edge need no care where there is a rim to draw on.
    rim = math.ceil(margin) + math.ceil(radius.max())
    padded = np.full((height + 2 * rim, width + 2 * rim), NOTHING, np.int32)
    centre = (v.astype(np.int64) + rim) * padded.shape[1] + u.astype(np.int64) + rim
    _discs(padded, centre, 0.25 * np.rint(4.0 * radius))
    return Front(point=index, depth_m=depth, rank=padded[rim:-rim, rim:-rim])


def _farthest_first(depth: Numbers) -> Numbers:
    """Indices that sort positive float32 depths, largest first; equal depths keep their order."""
    # Positive floats sort like their bit patterns. With the index in the lower 32 bits all keys differ, so an unstable
    # sort of integers does, in a fifth of the time of a stable argsort of floats.
    key = (~depth.view(np.uint32)).astype(np.uint64) << np.uint64(32) | np.arange(len(depth), dtype=np.uint64)
    return np.asarray(np.sort(key) & np.uint64(0xFFFFFFFF)).astype(np.int64)


def _discs(rank: Numbers, centre: Numbers, radius: Numbers) -> None:
    """Write each point's number over the pixels of its disc.

    Args:
        centre: (m,) indices of the discs' middles in the flat image; the points come farthest first
    """
    flat, across = rank.reshape(-1), rank.shape[1]
    starts = np.flatnonzero(np.diff(radius, prepend=-1.0)).tolist()
    for first, last in zip(starts, [*starts[1:], len(centre)], strict=True):
        reach = math.ceil(radius[first])
        dy, dx = np.mgrid[-reach : reach + 1, -reach : reach + 1]
        disc = (dy * across + dx)[dx**2 + dy**2 <= radius[first] ** 2]
        for part in range(first, last, DISCS):
            stop = min(part + DISCS, last)
            flat[centre[part:stop, None] + disc] = np.arange(part, stop, dtype=np.int32)[:, None]


def colour_image(point: Numbers, rgb: Numbers, *, background: Numbers) -> Numbers:
    """(height, width, 3) uint8 colours of an image of point indices, from (n, 3) colours of the points."""
    # Indexing packed colours of four bytes is three times as fast as rows of three. NOTHING, -1, picks the background.
    return unpack_rgb(pack_rgb(np.concatenate([rgb, np.reshape(background, (1, 3))]))[point])


def pack_rgb(rgb: Numbers) -> Numbers:
    """Pack colours (..., 3), a byte each, into uint32 (...,)."""
    r, g, b = (rgb[..., k].astype(np.uint32) for k in range(3))
    return np.asarray(r | g << np.uint32(8) | b << np.uint32(16))


def unpack_rgb(colour: Numbers) -> Numbers:
    """Unpack uint32 colours (...,) into uint8 (..., 3)."""
    return np.asarray(colour.astype("<u4").view(np.uint8).reshape(*colour.shape, 4)[..., :3])


def eye_dome_picture(front: Front, rgb: Numbers, *, background: Numbers, reduction: int) -> tuple[Numbers, Numbers]:
    """Picture reduced by this factor, with eye-dome lighting: pixels beside nearer ones are darker, so edges show.

    Args:
        rgb: (n, 3) uint8 colours of the cloud's points
        background: (3,) uint8 colour of pixels without a point

    Returns:
        packed colours (height, width), and (height, width) bool, True where a pixel shows a point
    """
    # Eye-dome lighting after C. Boucheny (thesis, Grenoble 2009), on four neighbours. The largest rank in a square of
    # pixels is its nearest point.
    nearest = functools.reduce(np.maximum, (front.rank[i::reduction] for i in range(reduction)))
    nearest = functools.reduce(np.maximum, (nearest[:, j::reduction] for j in range(reduction)))
    covered = nearest != NOTHING
    pixel = np.flatnonzero(covered)
    row, column = np.divmod(pixel, nearest.shape[1])
    image = np.full(nearest.shape, pack_rgb(np.reshape(background, (1, 3)))[0], np.uint32)
    # Neighbours beyond the edge are those of the opposite side. Empty pixels are the farthest and darken nothing.
    depth = np.full(len(front.depth_m) + 1, EMPTY, np.float32)
    depth[:-1] = np.log2(front.depth_m)
    around = np.pad(depth[nearest], 1, mode="wrap")
    across = around.shape[1]
    middle, around = (row + 1) * across + column + 1, around.reshape(-1)
    own_depth = around[middle]
    shade = np.zeros(own_depth.shape, np.float32)
    for step in (-1, 1, -across, across):
        shade += np.clip(own_depth - around[middle + step], 0.0, 0.5)
    dimmed = np.exp(np.float32(-1.6) * shade) / np.float32(reduction * reduction)
    # Sixteen bits a colour, so that the sum over reduction^2 pixels does not overflow.
    palette = np.zeros((len(front.point) + 1, 4), np.uint16)
    palette[:-1, :3], palette[-1, :3] = rgb[front.point], background
    total = np.zeros(own_depth.shape, np.uint64)
    for i, j in np.ndindex(reduction, reduction):
        total += palette.view(np.uint64)[:, 0][front.rank[i::reduction, j::reduction].reshape(-1)[pixel]]
    total = total.view(np.uint16).reshape(-1, 4)
    mean = [(total[:, k] * dimmed).astype(np.uint8) for k in range(3)]
    image.reshape(-1)[pixel] = pack_rgb(np.stack(mean, axis=-1))
    return image, covered


def draw_surfaces_behind(
    image: Numbers, covered: Numbers, camera: Camera, surfaces: Callable[[Camera, tuple[int, int]], Numbers]
) -> Numbers:
    """Draw surfaces faintly where no point is.

    Args:
        image: (height, width) packed colours
        covered: (height, width) bool, True where a pixel shows a point
        surfaces: function of a camera and a size; gives depths (height, width) in metres, inf without a surface
    """
    height, width = covered.shape
    small = -(-width // SURFACE_PX), -(-height // SURFACE_PX)
    depth = surfaces(camera, small)
    has_surface = np.isfinite(depth)
    if not has_surface.any():
        return image
    # Brightness goes with the cosine of incidence, which follows from the slope of log depth from pixel to pixel.
    focal = np.float32(0.5 * small[0] / math.tan(0.5 * math.radians(camera.fov_deg)))
    down, across = np.gradient(np.log(np.where(has_surface, depth, np.float32(1e4))))
    square = 1.0 / np.sqrt(1.0 + focal * focal * (down * down + across * across))
    faint = pack_rgb(((FAINT[0] + FAINT[1] * square)[..., None] * np.array(SURFACE_RGB)).astype(np.uint8))
    large = np.repeat(np.repeat(faint, SURFACE_PX, axis=0), SURFACE_PX, axis=1)[:height, :width]
    shows_surface = (
        np.repeat(np.repeat(has_surface, SURFACE_PX, axis=0), SURFACE_PX, axis=1)[:height, :width] & ~covered
    )
    return np.asarray(np.where(shows_surface, large, image))


@dataclass(frozen=True, kw_only=True)
class Cells:
    """The sensor's view: cells of azimuth by elevation and the point in each.

    Attributes:
        azimuth_deg: (columns + 1,) rising edges
        elevation_deg: (rows + 1,) rising edges
        point: (rows, columns) int32 index of the point, or NOTHING
    """

    azimuth_deg: Numbers
    elevation_deg: Numbers
    point: Numbers

    def image(self, *, size: tuple[int, int]) -> Numbers:
        """(height, width) int32 point of each pixel; azimuth grows to the left, elevation upwards."""
        width, height = size
        azimuth = _centres(self.azimuth_deg[-1], self.azimuth_deg[0], width)
        elevation = _centres(self.elevation_deg[-1], self.elevation_deg[0], height)
        column = np.searchsorted(self.azimuth_deg, azimuth).clip(1, self.point.shape[1]) - 1
        row = np.searchsorted(self.elevation_deg, elevation).clip(1, self.point.shape[0]) - 1
        return np.asarray(self.point[row[:, None], column])


def _centres(first: float, last: float, count: int) -> Numbers:
    """Middles of n equal steps."""
    return first + (last - first) * (np.arange(count) + 0.5) / count


def cells_of(cloud: Cloud) -> Cells:
    """Sort the beams into cells; where several points share one, the first return is shown.

    Rows and columns are those of the scan where it has some, else cells as large as the points are dense.
    """
    return cells_of_beams(cloud.column("azimuth"), cloud.column("elevation"), cloud.column("return_number"))


def cells_of_beams(azimuth_rad: Numbers, elevation_rad: Numbers, return_number: Numbers) -> Cells:
    """`cells_of` for (n,) angles; of several in one cell one with the lowest return number is shown."""
    azimuth, elevation = azimuth_rad.astype(np.float64), elevation_rad.astype(np.float64)
    count = max(len(azimuth), 1)
    dense = 1.3 * math.sqrt(max(_span(azimuth) * _span(elevation), 1e-12) / count)
    rows = _groups(elevation)
    # A scan in rows has few distinct elevations. Others, such as rosettes, get square cells by the density of points.
    if len(rows) <= max(count / 16, 1):
        y = _edges(rows)
        x_step = _step_in_rows(azimuth, np.searchsorted(y, elevation))
        columns = _groups(azimuth)
        is_grid = len(columns) < 2 or np.median(np.diff(columns)) > 0.6 * x_step
        x = _edges(columns) if is_grid else _bins(azimuth, x_step)
    else:
        x, y = _bins(azimuth, dense), _bins(elevation, dense)
    point = np.full((len(y) - 1, len(x) - 1), NOTHING, np.int32)
    # Of points assigned to one cell the last stays: highest return numbers are written first.
    order = np.argsort(255 - return_number.astype(np.uint8), kind="stable")
    row = np.searchsorted(y, elevation[order]).clip(1, len(y) - 1) - 1
    column = np.searchsorted(x, azimuth[order]).clip(1, len(x) - 1) - 1
    point[row, column] = order
    return Cells(azimuth_deg=np.degrees(x), elevation_deg=np.degrees(y), point=point)


def _span(values: Numbers) -> float:
    """Largest less smallest."""
    return float(np.ptp(values)) if len(values) else 0.0


def _groups(values: Numbers) -> Numbers:
    """Distinct angles, rising; those closer than SAME_ANGLE_RAD count as one."""
    distinct = np.unique(values)
    return distinct[np.diff(distinct, prepend=-np.inf) > SAME_ANGLE_RAD]


def _step_in_rows(values: Numbers, row: Numbers) -> float:
    """Median step between neighbours of one row, radians; 0 without neighbours."""
    order = np.argsort(values)
    order = order[np.argsort(row[order].astype(np.uint16), kind="stable")]  # of 16 bits, one pass without comparing
    step = np.diff(values[order])[np.diff(row[order]) == 0]
    step = step[step > SAME_ANGLE_RAD]
    return float(np.median(step)) if len(step) else 0.0


def _edges(centres: Numbers) -> Numbers:
    """Edges around rising centres: equal steps, with empty ones, if the gaps are multiples of one step."""
    if len(centres) < 2:
        middle = centres[0] if len(centres) else 0.0
        return np.array([middle - 1e-3, middle + 1e-3])
    gaps = np.diff(centres)
    multiple = np.rint(gaps / np.percentile(gaps, 10))
    step = (centres[-1] - centres[0]) / multiple.sum()
    if np.abs(gaps - multiple * step).max() < 0.15 * step:
        return np.asarray(centres[0] + step * (np.arange(multiple.sum() + 2) - 0.5))
    middles = centres[:-1] + 0.5 * gaps
    return np.array([centres[0] - 0.5 * gaps[0], *middles, centres[-1] + 0.5 * gaps[-1]])


def _bins(values: Numbers, step: float) -> Numbers:
    """Edges of equal bins of about this width over all values."""
    low, span = (float(values.min()), _span(values)) if len(values) else (0.0, 0.0)
    count = int(min(max(span / step if step > 0 else 1, 0), 8192)) + 1
    width = max(span / max(count - 1, 1), 1e-3 if span == 0 else 0.0)
    return low + width * (np.arange(count + 1) - 0.5)


OPTIONAL = ("ambient",)
"""Columns that are shown where a cloud has them, beside range, intensity and status."""


def images(cloud: Cloud) -> dict[str, Numbers]:
    """Make the images of a cloud: name -> (rows, columns), 0 where no point is.

    range, intensity and the OPTIONAL columns have the cloud's values and types; status is 1 + the cloud's, so
    that 0 is nothing and 1 an echo; point is the index of the point, -1 for none.
    azimuth_deg (columns + 1,) and elevation_deg (rows + 1,) are the edges of the pixels; both fall.
    """
    cells = cells_of(cloud)
    # Cells count from the lowest and rightmost; an image from its top left, as the sensor sees it.
    point = cells.point[::-1, ::-1]
    names = ["range", "intensity", *(n for n in OPTIONAL if n in (c.name for c in cloud.columns))]
    arrays = {name: pixel_values(cloud.column(name), point) for name in names}
    arrays["status"] = pixel_values(cloud.column("status") + np.uint8(1), point)
    return arrays | {"point": point, "azimuth_deg": cells.azimuth_deg[::-1], "elevation_deg": cells.elevation_deg[::-1]}


def pixel_values(values: Numbers, point: Numbers) -> Numbers:
    """Values of the points that the pixels show; 0 for NOTHING."""
    # One value more than points: the pixels without a point take it.
    return np.append(values, values.dtype.type(0))[np.where(point == NOTHING, len(values), point)]
