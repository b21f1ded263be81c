"""Pictures and the pixels in them: size, content, colours, and what they say when there is nothing to show."""

import dataclasses
import math
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from helpers.clouds import small_cloud
from helpers.drawn_street import street
from helpers.mistakes import told

from lidarscene.cloud import pixels
from lidarscene.cloud.builder import CloudBuilder
from lidarscene.cloud.pixels import NOTHING, camera_for, cells_of, cells_of_beams, splat
from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.cloud.scales import Scale
from lidarscene.cloud.shades import FixedColours, Shades, rgb
from lidarscene.errors import OutputError
from lidarscene.figures import pictures
from lidarscene.figures.canvas import Canvas
from lidarscene.figures.pictures import frame_picture, perspective_picture, range_image

SMALL = (480, 270)


def picture(path: Path) -> Any:
    """(height, width, 3) uint8."""
    from matplotlib import image

    return np.rint(255 * image.imread(path)[..., :3]).astype(np.uint8)


def test_rays_of_a_camera_go_through_the_middles_of_its_pixels() -> None:
    """Its own projection brings points along them back there."""
    eye_m, axes = np.array([1.0, 2.0, 3.0]), np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    camera = pixels.Camera(eye_m=eye_m, axes=axes, fov_deg=70.0)
    directions, ahead = camera.rays(6, 4)
    column, row, depth = camera.project(eye_m + 9.0 * directions.T, width=6, height=4)
    np.testing.assert_allclose(column.reshape(4, 6), np.tile(np.arange(6) + 0.5, (4, 1)), rtol=1e-5)
    np.testing.assert_allclose(row.reshape(4, 6), np.tile(np.arange(4)[:, None] + 0.5, (1, 6)), rtol=1e-5)
    np.testing.assert_allclose(depth, 9.0 * ahead, rtol=1e-5)


@pytest.fixture(scope="module")
def cloud() -> PointCloud:
    return street()


@pytest.fixture(scope="module")
def by_intensity(cloud: PointCloud, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Its picture."""
    path = tmp_path_factory.mktemp("pictures") / "a.png"
    perspective_picture(cloud, path, colour_by="intensity", size_px=SMALL)
    return picture(path)


@pytest.mark.parametrize(
    ("draw", "size"), [(perspective_picture, (1920, 1080)), (range_image, (1920, 640)), (frame_picture, (1920, 1600))]
)
def test_picture_has_its_size_and_shows_something(
    draw: Any, size: tuple[int, int], cloud: PointCloud, tmp_path: Path
) -> None:
    draw(cloud, tmp_path / "a.png")
    image = picture(tmp_path / "a.png")
    assert image.shape == (size[1], size[0], 3)
    assert (image.max(axis=2) > 80).mean() > 0.03


@pytest.mark.parametrize("draw", [perspective_picture, range_image, frame_picture])
@pytest.mark.parametrize("full", [True, False])
def test_size_can_be_chosen(draw: Any, full: bool, cloud: PointCloud, tmp_path: Path) -> None:
    """An odd one; of a cloud, and of one without points."""
    size = (801, 333)
    draw(cloud if full else PointCloud(**CloudBuilder().fields()), tmp_path / "a.png", size_px=size)
    image = picture(tmp_path / "a.png")
    assert image.shape == (size[1], size[0], 3)
    bright = float((image.max(axis=2) > 80).mean())
    assert bright > 0.03 if full else 1e-4 < bright < 0.1


@pytest.mark.parametrize(
    "name", ["true_range", "class", "body", "material", "status", "azimuth", "time", "in_shadow", "ghost"]
)
def test_colours_answer_to_the_column(name: str, cloud: PointCloud, by_intensity: Any, tmp_path: Path) -> None:
    """Rationale: the same points in other colours is another picture, and no column makes it fail."""
    perspective_picture(cloud, tmp_path / "b.png", colour_by=name, size_px=SMALL)
    assert (by_intensity != picture(tmp_path / "b.png")).any(axis=2).mean() > 0.1


def test_every_column_can_be_drawn(cloud: PointCloud, tmp_path: Path) -> None:
    thinned = cloud.select(slice(0, None, 40))
    for column in thinned.columns:
        range_image(thinned, tmp_path / "a.png", colour_by=column.name, size_px=(160, 80))
    for name in ("x", "range", "intensity", "detection_probability", "azimuth", "pulse_width", "class", "body"):
        range_image(thinned.select([0]), tmp_path / "a.png", colour_by=name, size_px=(160, 80))


def test_unknown_column_lists_the_choices(cloud: PointCloud, tmp_path: Path) -> None:
    for draw in (perspective_picture, range_image, frame_picture):
        with told("column 'colour' | x, y, z, range, intensity"):
            draw(cloud, tmp_path / "a.png", colour_by="colour")
    with told("'class'"):
        perspective_picture(cloud.without_truth(), tmp_path / "a.png", colour_by="class")


def test_svg_has_pixels_and_texts(cloud: PointCloud, tmp_path: Path) -> None:
    range_image(cloud, tmp_path / "a.svg")
    tree = ElementTree.parse(tmp_path / "a.svg").getroot()
    space = "{http://www.w3.org/2000/svg}"
    assert (tree.get("width"), tree.get("height")) == ("1920", "640")
    assert len(tree.findall(f"{space}image")) == 1
    texts = [element.text or "" for element in tree.findall(f"{space}text")]
    assert any("points" in text for text in texts)
    assert any("azimuth" in text for text in texts)


def test_no_label_lies_over_points(cloud: PointCloud, monkeypatch: Any, tmp_path: Path) -> None:
    """Every text, bar and legend stands in the head, beside or below: nothing is put on an image of points."""
    images: list[tuple[int, int, int, int]] = []
    texts: list[tuple[float, float]] = []
    show, text = Canvas.show, Canvas.text

    def record_image(self: Canvas, image: Any, x: int, y: int) -> None:
        if image.shape[0] > 60 and image.shape[1] > 60:  # a bar is narrower
            images.append((x, y, x + image.shape[1], y + image.shape[0]))
        show(self, image, x, y)

    def record_text(self: Canvas, x: float, y: float, *arguments: Any, **more: Any) -> None:
        texts.append((x, y))
        text(self, x, y, *arguments, **more)

    monkeypatch.setattr(Canvas, "show", record_image)
    monkeypatch.setattr(Canvas, "text", record_text)
    for column in ("intensity", "class"):
        frame_picture(cloud, tmp_path / "a.png", colour_by=column)
    assert len(images) == 6
    assert len(texts) > 40
    for left, top, right, bottom in images:
        assert not any(left < x < right and top < y < bottom for x, y in texts)


def test_surfaces_are_drawn_faintly_behind_points(cloud: PointCloud, tmp_path: Path) -> None:
    """A wall square to the camera: pixels with points stay as they are, others become brighter where it is.

    Reference: FAINT adds up to 1 for a surface seen square, so that its pixels have SURFACE_RGB.
    """
    thinned = cloud.select(slice(0, None, 50))

    def wall(camera: Any, size: tuple[int, int]) -> Any:
        depth = np.full(size[::-1], np.inf, np.float32)
        depth[:, : size[0] // 2] = 20.0
        return depth

    frame_picture(thinned, tmp_path / "a.png")
    frame_picture(thinned, tmp_path / "b.png", surfaces=wall)
    bare, with_surfaces = picture(tmp_path / "a.png")[90:], picture(tmp_path / "b.png")[90:]
    assert (with_surfaces >= bare).all()
    assert (bare != with_surfaces).any(axis=2).mean() > 0.2
    assert (bare[:, 970:] == with_surfaces[:, 970:]).all()
    empty = (bare[100:200, 100:800] == rgb(pictures.BACKGROUND)).all(axis=2)
    background_rgb = with_surfaces[100:200, 100:800][empty]
    assert (np.abs(np.median(background_rgb, axis=0) - np.array(pixels.SURFACE_RGB)) <= 1).all()
    bright = bare.max(axis=2) > 100
    assert (bare[bright] == with_surfaces[bright]).all()


def test_common_scale_holds_all_clouds(cloud: PointCloud, tmp_path: Path) -> None:
    """The same point has the same colour in each of the pictures, which their own scales would not give."""
    near, far = cloud.select(cloud.range_m < 15), cloud.select(cloud.range_m > 15)
    low, high = pictures.common_scale([near, far], "range")
    np.testing.assert_allclose([low, high], np.percentile(cloud.range_m, (1, 99)), rtol=1e-6)
    shades = [Shades(near_or_far, "range", FixedColours(limits=(low, high))).rgb for near_or_far in (near, far)]
    shades_of_all = Shades(cloud, "range").rgb
    np.testing.assert_array_equal(shades[0], shades_of_all[cloud.range_m < 15])
    assert (Shades(near, "range").rgb != shades[0]).any()


@pytest.mark.parametrize("name", ["viridis", "turbo", "inferno"])
def test_colour_maps_are_those_of_matplotlib(name: str) -> None:
    """Tolerance: interpolated between 33 colours, 4 of 255. The dark ends are left out."""
    import matplotlib as mpl

    base, low, high = {
        "viridis": ("viridis", 0.12, 1.0),
        "turbo": ("turbo_r", 0.06, 0.94),
        "inferno": ("inferno", 0.3, 1.0),
    }[name]
    parts = np.linspace(0.0, 1.0, 101)
    table = Scale(low=0.0, high=1.0, kind="linear", map=name).table(parts).astype(float)
    expected = 255.0 * mpl.colormaps[base](low + (high - low) * parts)[:, :3]
    np.testing.assert_allclose(table, expected, atol=4.5)


@pytest.mark.parametrize(
    ("scale", "texts"),
    [
        (Scale(low=2e-6, high=3e-3, kind="logarithmic", map="inferno"), ["10⁻⁵", "10⁻⁴", "10⁻³"]),
        (Scale(low=1.5, high=40.0, kind="logarithmic", map="inferno"), ["2", "5", "10", "20"]),
        (Scale(low=3.0, high=120.0, kind="root", map="turbo"), ["5", "10", "20", "50", "100"]),
        (Scale(low=-0.2, high=1.0, kind="linear", map="viridis"), [*["−0.2", "0", "0.2", "0.4", "0.6", "0.8", "1"]]),
    ],
)
def test_round_numbers_on_a_scale(scale: Scale, texts: list[str]) -> None:
    ticks = scale.ticks(7)
    assert [text for _, text in ticks] == texts
    assert all(0.0 <= scale.part(value) <= 1.0 for value, _ in ticks)


def test_a_fitted_camera_holds_the_bulk_and_fills_the_picture(cloud: PointCloud) -> None:
    """Rationale: without a view of its own, a picture shows nearly all of what is near, and not from far away."""
    camera = camera_for(cloud, shape=(1600, 800))
    near = (cloud.status == 0) & (cloud.range_m < 30)
    u, v, depth = camera.project(cloud.xyz_m[near].astype(float), width=1600, height=800)
    ahead = depth > 1.0
    inside = ahead & (u > 0) & (u < 1600) & (v > 0) & (v < 800)
    assert inside.sum() > 0.9 * ahead.sum()
    assert max(np.ptp(u[inside]) / 1600, np.ptp(v[inside]) / 800) > 0.85


def test_other_suffix_and_bad_folder(cloud: PointCloud, tmp_path: Path) -> None:
    with told("a.gif | '.gif' | .png, .svg"):
        range_image(cloud, tmp_path / "a.gif")
    (tmp_path / "file").touch()
    with told("file | folder", OutputError):
        range_image(cloud, tmp_path / "file" / "a.png")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(("ahead", "bearing_deg"), [(0.5, 0.0), (0.1, 90.0), (0.0, 90.0)])
def test_a_cloud_all_round_is_seen_where_things_stand(ahead: float, bearing_deg: float) -> None:
    """Rings on the ground, a wall on the left and a part of one ahead: forward, unless little stands there."""
    turn = np.linspace(0.0, 2.0 * np.pi, 4000, endpoint=False)
    rings = [np.stack([r * np.cos(turn), r * np.sin(turn), np.full(4000, -1.7)], 1) for r in (4.0, 6.0, 9.0, 15.0)]
    across, up = (grid.ravel() for grid in np.meshgrid(np.linspace(-5, 5, 40), np.linspace(-1, 2, 20)))
    left = np.stack([across, np.full(800, 12.0), up], 1)
    front = np.stack([np.full(800, 12.0), across, up], 1)[: int(800 * ahead)]
    xyz_m = np.concatenate([*rings, left, front]).astype(np.float32)
    camera = camera_for(small_cloud(len(xyz_m), xyz_m=xyz_m, status=np.zeros(len(xyz_m), int)), shape=(1280, 720))
    look = camera.axes[2]
    turned_deg = np.degrees(np.arctan2(look[1], look[0])) - bearing_deg
    assert abs(turned_deg) < 20.0
    assert camera.eye_m[2] < 8.0
    column, row, depth = camera.project(front if ahead > 0.3 else left, width=1280, height=720)
    inside = (depth > 0) & (row >= 0) & (row < 720) & (column >= 0) & (column < 1280)
    assert inside.mean() > 0.9


def test_a_camera_looks_towards_the_nearest_of_what_is_far() -> None:
    """Rationale: of a cloud without an echo within 60 m the view was not a number, and NumPy warned of it."""
    xyz_m = np.array([[0.0, 80.0, 0.0], [90.0, 0.0, 0.0]], np.float32)
    camera = camera_for(small_cloud(2, xyz_m=xyz_m, status=np.zeros(2, int)))
    assert camera.axes[2, 1] > 0.8


def test_camera_that_sees_nothing_is_refused(cloud: PointCloud) -> None:
    for options in ({"eye_m": (0, 0, 5), "target_m": (0, 0, 0)}, {"fov_deg": 180.0}, {"fov_deg": 0.0}):
        with told("view | z up"):
            camera_for(cloud, **options)
    with told("view | z up"):
        camera_for(cloud, eye_m=(1, 2, 3), target_m=(1, 2, 3))


def test_projection_against_trigonometry() -> None:
    """Reference: with 90 degrees across, a point 30 degrees to the left is tan 30 of the half width to the left."""
    camera = camera_for(PointCloud(**CloudBuilder().fields()), eye_m=(1, 2, 3), target_m=(11, 2, 3), fov_deg=90.0)
    points = np.array([[11, 2, 3], [11, 2 + 10 * math.tan(math.pi / 6), 3], [11, 2, 5], [-9, 2, 3]])
    u, v, depth = camera.project(points, width=200, height=100)
    np.testing.assert_allclose(u[:3], [100, 100 - 100 * math.tan(math.pi / 6), 100], atol=1e-4)
    np.testing.assert_allclose(v[:3], [50, 50, 50 - 20], atol=1e-4)
    np.testing.assert_allclose(depth, [10, 10, 10, -10], atol=1e-5)


def test_nearest_point_is_on_top_whatever_the_order() -> None:
    camera = camera_for(PointCloud(**CloudBuilder().fields()), eye_m=(0, 0, 0), target_m=(1, 0, 0))
    for x in ([10.0, 5.0, -5.0, 20.0], [5.0, 10.0, 20.0, -5.0]):
        front = splat(camera, np.array([[d, 0, 0] for d in x]), size=(101, 51))
        ranks = set(np.unique(front.rank)) - {NOTHING}
        assert [front.point[rank] for rank in ranks] == [x.index(5.0)]
        assert front.depth_m[front.rank[25, 50]] == 5.0
        assert front.rank[0, 0] == NOTHING


def test_a_disc_is_cut_at_the_edge() -> None:
    """A point in a corner, and one just outside: what is drawn of both is what a larger picture shows there."""
    camera = camera_for(PointCloud(**CloudBuilder().fields()), eye_m=(0, 0, 0), target_m=(1, 0, 0), fov_deg=90.0)
    xyz_m = np.array([[10.0, 10.0, 4.99], [10.0, -10.02, 0.0], [10.0, 0.0, -5.02]])
    rank = splat(camera, xyz_m, size=(400, 200)).rank
    drawn = {k: np.argwhere(rank == k) for k in range(3)}
    assert all(len(pixels) > 5 for pixels in drawn.values())
    assert drawn[0].max() <= 8
    assert drawn[1][:, 1].min() >= 392
    assert drawn[2][:, 0].min() >= 192


@pytest.mark.parametrize("shift_m", [0.0, 4e5])
@pytest.mark.parametrize("turn", [0.0, 2.0])
def test_default_camera_frames_the_bulk(cloud: PointCloud, shift_m: float, turn: float) -> None:
    """Rationale: wherever the sensor stands and looks, most of what is near is in the picture.

    Tolerance: the scan is 120 degrees wide, the picture 60.
    """
    c, s = math.cos(turn), math.sin(turn)
    shift = np.array([shift_m, -shift_m, 10.0])
    xyz_m = cloud.xyz_m.astype(np.float64) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + shift
    columns = cloud._arrays() | {"xyz_m": xyz_m}
    metadata = {"frame": "world", "sensor_position_m": " ".join(map(str, shift))}
    moved = PointCloud(**columns, metadata=metadata)
    near = (moved.status == 0) & (moved.range_m < 40) & (moved.range_m > 8)
    u, v, depth = camera_for(moved).project(xyz_m[near], width=1600, height=900)
    inside = (depth > 0) & (u > 0) & (u < 1600) & (v > 0) & (v < 900)
    assert inside.mean() > 0.65


def test_cells_of_a_raster_are_its_beams(cloud: PointCloud) -> None:
    cells = cells_of(cloud)
    assert cells.point.shape == (70, 240)
    assert (cells.point != NOTHING).sum() == len(cloud)
    np.testing.assert_allclose(np.diff(cells.azimuth_deg), 0.5, atol=1e-5)
    np.testing.assert_allclose(cells.elevation_deg[[0, -1]], [-25.0, 10.0], atol=1e-4)
    image = cells.image(size=(240, 70))
    np.testing.assert_array_equal(image, cells.point[::-1, ::-1])


def scan(azimuth_deg: Any, elevation_deg: Any, **changes: Any) -> PointCloud:
    azimuth, elevation = np.broadcast_arrays(azimuth_deg, elevation_deg)
    n = azimuth.size
    template = street(step_deg=5.0).select(np.zeros(n, np.int64))
    angles = {"azimuth_rad": np.radians(azimuth.ravel()), "elevation_rad": np.radians(elevation.ravel())}
    return PointCloud(**template._arrays() | angles | changes)


@pytest.mark.parametrize(
    ("azimuth", "elevation", "shape"),
    [
        (20 * np.sin(np.linspace(-1.4, 1.4, 301)), np.linspace(-5, 5, 40)[:, None], (40, 301)),
        (np.arange(0, 360, 0.4) + 0.013 * np.arange(32)[:, None] ** 1.1, np.arange(32)[:, None] * 1.0, (32, 902)),
        (np.arange(500) * 0.1, 0.0, (1, 500)),
    ],
    ids=["resonant", "staggered spinning", "one row"],
)
def test_cells_of_other_scans(azimuth: Any, elevation: Any, shape: tuple[int, int]) -> None:
    """Rationale: a full scan has a point in (nearly) each cell, and loses (nearly) none to a neighbour."""
    cloud = scan(azimuth, elevation)
    cells = cells_of(cloud)
    assert abs(cells.point.shape[1] - shape[1]) <= 0.01 * shape[1]
    assert cells.point.shape[0] == shape[0]
    filled = int((cells.point != NOTHING).sum())
    assert filled >= 0.98 * len(cloud)


def test_cells_of_a_rosette_are_mostly_filled() -> None:
    t = np.linspace(0, 200, 20000)
    cells = cells_of(scan(20 * np.cos(t) * np.cos(7.3 * t), 12 * np.sin(t) * np.cos(7.3 * t)))
    assert (cells.point != NOTHING).mean() > 0.25
    assert 5000 < cells.point.size < 40000


def test_first_return_is_shown() -> None:
    cloud = scan(np.array([1.0, 1.0, 2.0, 2.0]), 0.0, return_number=np.array([2, 1, 1, 2]))
    assert cells_of(cloud).point.tolist() == [[1, 2]]


def test_light_makes_edges_dark() -> None:
    """A wall behind a nearer one: darker right beside it, unchanged away from it."""
    rank = np.where(np.arange(40) < 20, 1, 0)[None].repeat(20, axis=0).astype(np.int32)
    rank[:, 36:] = NOTHING
    front = pixels.Front(point=np.array([1, 0]), depth_m=np.array([20.0, 5.0], np.float32), rank=rank)
    image, drawn = pixels.eye_dome_picture(
        front, np.full((2, 3), 200, np.uint8), background=np.array([9, 8, 7], np.uint8), reduction=2
    )
    rgb_image = pixels.unpack_rgb(image)
    assert rgb_image.shape == (10, 20, 3)
    assert (drawn == (np.arange(20) < 18)).all()
    assert (rgb_image[:, 18:] == [9, 8, 7]).all()
    assert rgb_image[5, 10, 0] < 150
    assert (rgb_image[5, [3, 15], 0] == 200).all()


def test_each_sensor_of_a_rig_has_its_own_range_image(cloud: PointCloud, monkeypatch: Any, tmp_path: Path) -> None:
    """Their azimuths are about different axes: three at most, each with its label and its own points."""
    labels = ("roof", "left", "right", "rear")
    numbers = (np.arange(len(cloud)) % 4).astype(np.uint8)
    drawn: list[tuple[str, int]] = []

    def record_cells(canvas: Any, box: Any, cells: Any, shades: Any, *, labels: bool, name: str) -> None:
        drawn.append((name, len(shades.rgb)))
        assert cells.point.max() < len(shades.rgb)

    monkeypatch.setattr(pictures, "_draw_range_image", record_cells)
    rig = dataclasses.replace(cloud, sensor_names=labels, sensor_index=numbers)
    frame_picture(rig, tmp_path / "rig.png", colour_by="sensor_index", size_px=(300, 250))
    assert drawn == [(label, int((numbers == labels.index(label)).sum())) for label in ("right", "left", "roof")]


def test_a_row_without_beams_stays_empty() -> None:
    """Rows at 0, 1, 2, 4 and 5 degrees are six of one step, the fourth without a point; by hand."""
    elevation, azimuth = np.meshgrid(np.radians([0.0, 1.0, 2.0, 4.0, 5.0]), np.radians(np.arange(40.0)))
    cells = cells_of_beams(azimuth.ravel(), elevation.ravel(), np.ones(azimuth.size, np.uint8))
    np.testing.assert_allclose(cells.elevation_deg, np.arange(7) - 0.5, atol=1e-9)
    assert (cells.point[3] == NOTHING).all()
    assert (np.delete(cells.point, 3, axis=0) != NOTHING).all()


def test_axes_of_a_range_image_run_as_the_sensor_looks(cloud: PointCloud, tmp_path: Path) -> None:
    """Left is positive and up is up: azimuths fall from left to right, elevations from top to bottom, by one and the
    same number of pixels for each degree; and the scale of the ranges has the far ones on top.
    """
    range_image(cloud, tmp_path / "a.svg")
    tree = ElementTree.parse(tmp_path / "a.svg").getroot()
    texts = [element for element in tree.iter() if element.tag.endswith("text") and element.text]
    placed: dict[str, list[tuple[float, float]]] = {"x": [], "y": [], "scale": []}
    numbers = []
    for element in texts:
        word = str(element.text).replace("\N{MINUS SIGN}", "-")
        if re.fullmatch(r"-?[0-9.]+", word) and not element.get("transform"):
            numbers.append((float(word), float(element.get("x", "0")), float(element.get("y", "0"))))
    below = max(y for _, _, y in numbers)
    for value, x, y in numbers:
        key = "x" if y == below else "scale" if x > 1700 else "y"
        placed[key].append((value, x if key == "x" else y))
    for key, points in placed.items():
        values, pixels = np.array(points).T
        order = np.argsort(values)
        steps = np.diff(pixels[order])
        assert len(steps) >= 1, key
        assert (steps < 0).all(), key
        if key != "scale":
            np.testing.assert_allclose(steps / np.diff(values[order]), steps[0] / np.diff(values[order])[0], rtol=0.05)


def test_uneven_rows_end_half_a_gap_beyond_their_beams() -> None:
    """Elevations of -20, -10, -4 and 0 degrees: between two rows an edge is in the middle, outside as far away."""
    elevation = np.repeat(np.radians([-20.0, -10.0, -4.0, 0.0]), 100)
    azimuth = np.tile(np.radians(np.arange(100.0)), 4)
    cells = cells_of_beams(azimuth, elevation, np.ones(400, np.uint8))
    np.testing.assert_allclose(cells.elevation_deg, [-25.0, -15.0, -7.0, -2.0, 2.0], atol=1e-9)
    np.testing.assert_allclose(cells.azimuth_deg, np.arange(-0.5, 100.0), atol=1e-9)
    assert (cells.point == np.arange(400).reshape(4, 100)).all()


def test_each_false_alarm_is_drawn_in_its_own_colour(cloud: PointCloud, tmp_path: Path) -> None:
    """The picture shows it below the head, where a square of that colour explains it; interference is not among
    them.
    """
    magenta = np.frombuffer(bytes.fromhex(pictures.ALARM[1:]), np.uint8)
    alarm_pixels = []
    for status, options in ((0, {}), (1, {}), (2, {}), (1, {"highlight_false_alarms": False})):
        marked = dataclasses.replace(cloud, status=np.full(len(cloud), status))
        perspective_picture(marked, tmp_path / "a.png", size_px=SMALL, **options)
        below = picture(tmp_path / "a.png")[SMALL[1] // 4 :].astype(int)
        alarm_pixels.append(int((np.abs(below - magenta).max(axis=2) < 3).sum()))
    assert alarm_pixels[0] == alarm_pixels[2] == alarm_pixels[3] == 0
    assert alarm_pixels[1] > 100


def test_the_head_counts_what_is_no_echo(cloud: PointCloud, tmp_path: Path) -> None:
    """One false alarm, two points of other lidars and three of the weather; aliased ones and echoes are points."""
    status = np.zeros(len(cloud), np.uint8)
    status[:10] = [1, 2, 2, 3, 3, 3, 4, 4, 4, 4]
    range_image(dataclasses.replace(cloud, status=status), tmp_path / "a.svg")
    texts = {
        element.text
        for element in ElementTree.parse(tmp_path / "a.svg").getroot().iter()
        if element.tag.endswith("text")
    }
    assert {"1 false alarm", "2 of other lidars", "3 of the weather"} <= texts


def test_the_bar_beside_a_range_image_is_far_on_top(
    cloud: PointCloud, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bars = []
    show = Canvas.show

    def record_bar(self: Canvas, image: Any, x: int, y: int) -> None:
        if image.shape[1] < 60 < image.shape[0]:
            bars.append(image)
        show(self, image, x, y)

    monkeypatch.setattr(Canvas, "show", record_bar)
    range_image(cloud, tmp_path / "a.png")
    (bar,) = bars
    scale = pictures.scale_of("range", cloud.range_m)
    low, high = scale.rgb(np.array([scale.low, scale.high]))
    assert np.abs(bar[-1, 0].astype(int) - low).max() < 12
    assert np.abs(bar[0, 0].astype(int) - high).max() < 12
