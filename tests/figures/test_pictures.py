"""Pictures and the pixels in them: size, content, colours, and what they say when there is nothing to show."""

import dataclasses
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.drawn_street import street

from lidarscene.cloud import pixels
from lidarscene.cloud.builder import CloudBuilder
from lidarscene.cloud.pixels import NOTHING, camera_for, cells_of, cells_of_beams, splat
from lidarscene.cloud.points import PointCloud
from lidarscene.errors import InputError, OutputError
from lidarscene.figures import pictures
from lidarscene.figures.pictures import frame_picture, perspective_picture, range_image

SMALL = (480, 270)


def picture(path: Path) -> Any:
    """(height, width, 3) uint8."""
    from matplotlib import image

    return np.rint(255 * image.imread(path)[..., :3]).astype(np.uint8)


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
    ("draw", "size"),
    [(perspective_picture, (1920, 1080)), (range_image, (1920, 640)), (frame_picture, (1920, 1600))],
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
def test_colours_answer_to_the_column(
    name: str, cloud: PointCloud, by_intensity: Any, tmp_path: Path
) -> None:
    """Rationale: the same points in other colours is another picture, and no column makes it fail."""
    perspective_picture(cloud, tmp_path / "b.png", colour_by=name, size_px=SMALL)
    assert (by_intensity != picture(tmp_path / "b.png")).any(axis=2).mean() > 0.1


def test_every_column_can_be_drawn(cloud: PointCloud, monkeypatch: Any, tmp_path: Path) -> None:
    """Its colours and their scale, and the scale of one value; the axes of angles are the same for all."""
    show = pictures._show

    def without_axes(*args: Any, **options: Any) -> Any:
        axes = show(*args, **options)
        axes.set_axis_on = lambda: None
        return axes

    monkeypatch.setattr(pictures, "_show", without_axes)
    few = cloud.select(slice(0, None, 40))
    for column in few.columns:
        range_image(few, tmp_path / "a.png", colour_by=column.name, size_px=(160, 80))
    for name in (
        "x",
        "range",
        "intensity",
        "detection_probability",
        "azimuth",
        "pulse_width",
        "class",
        "body",
    ):
        range_image(few.select([0]), tmp_path / "a.png", colour_by=name, size_px=(160, 80))


def test_unknown_column_lists_the_choices(cloud: PointCloud, tmp_path: Path) -> None:
    for draw in (perspective_picture, range_image, frame_picture):
        with pytest.raises(InputError, match=r"column 'colour': .* choices are x, y, z, range, intensity"):
            draw(cloud, tmp_path / "a.png", colour_by="colour")
    with pytest.raises(InputError, match="'class'"):
        perspective_picture(cloud.without_truth(), tmp_path / "a.png", colour_by="class")


def test_false_alarms_stand_out(cloud: PointCloud, tmp_path: Path) -> None:
    magenta = np.frombuffer(bytes.fromhex(pictures.ALARM[1:]), np.uint8)
    for shown, least in ((True, 20), (False, 0)):
        perspective_picture(cloud, tmp_path / "a.png", highlight_false_alarms=shown, size_px=(960, 540))
        found = int((np.abs(picture(tmp_path / "a.png").astype(int) - magenta).max(axis=2) < 3).sum())
        assert found > least if shown else found == 0


def test_svg(cloud: PointCloud, tmp_path: Path) -> None:
    range_image(cloud, tmp_path / "a.svg")
    assert re.search("<svg.*width", (tmp_path / "a.svg").read_text())


def test_other_suffix_and_bad_folder(cloud: PointCloud, tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"a\.gif: suffix '\.gif' names no picture format; known: \.png, \.svg"
    ):
        range_image(cloud, tmp_path / "a.gif")
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="is a file, not a folder"):
        range_image(cloud, tmp_path / "file" / "a.png")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_camera_that_sees_nothing_is_refused(cloud: PointCloud) -> None:
    for options in ({"eye_m": (0, 0, 5), "target_m": (0, 0, 0)}, {"fov_deg": 180.0}, {"fov_deg": 0.0}):
        with pytest.raises(InputError, match="no view with z up"):
            camera_for(cloud, **options)
    with pytest.raises(InputError, match="no view with z up"):
        camera_for(cloud, eye_m=(1, 2, 3), target_m=(1, 2, 3))


def test_projection_against_trigonometry() -> None:
    """Reference: with 90 degrees across, a point 30 degrees to the left is tan 30 of the half width to the left."""
    camera = camera_for(
        PointCloud(**CloudBuilder().fields()), eye_m=(1, 2, 3), target_m=(11, 2, 3), fov_deg=90.0
    )
    points = np.array([[11, 2, 3], [11, 2 + 10 * math.tan(math.pi / 6), 3], [11, 2, 5], [-9, 2, 3]])
    u, v, depth = camera.project(points, width=200, height=100)
    np.testing.assert_allclose(u[:3], [100, 100 - 100 * math.tan(math.pi / 6), 100], atol=1e-4)
    np.testing.assert_allclose(v[:3], [50, 50, 50 - 20], atol=1e-4)
    np.testing.assert_allclose(depth, [10, 10, 10, -10], atol=1e-5)


def test_nearest_point_is_on_top_whatever_the_order() -> None:
    camera = camera_for(PointCloud(**CloudBuilder().fields()), eye_m=(0, 0, 0), target_m=(1, 0, 0))
    for x in ([10.0, 5.0, -5.0, 20.0], [5.0, 10.0, 20.0, -5.0]):
        front, depth = splat(camera, np.array([[d, 0, 0] for d in x]), size=(101, 51))
        assert set(np.unique(front)) == {NOTHING, x.index(5.0)}
        assert depth[25, 50] == 5.0
        assert np.isinf(depth[0, 0])


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
        (np.arange(0, 90, 0.2), np.array([-7.0, -5, -4, -3.5, -3, -1, 0, 2])[:, None], (8, 450)),
        (20 * np.sin(np.linspace(-1.4, 1.4, 301)), np.linspace(-5, 5, 40)[:, None], (40, 301)),
        (
            np.arange(0, 360, 0.4) + 0.013 * np.arange(32)[:, None] ** 1.1,
            np.arange(32)[:, None] * 1.0,
            (32, 902),
        ),
        (np.arange(500) * 0.1, 0.0, (1, 500)),
    ],
    ids=["uneven rows", "resonant", "staggered spinning", "one row"],
)
def test_cells_of_other_scans(azimuth: Any, elevation: Any, shape: tuple[int, int]) -> None:
    """Rationale: a full scan has a point in (nearly) each cell, and loses (nearly) none to a neighbour."""
    cloud = scan(azimuth, elevation)
    cells = cells_of(cloud)
    assert abs(cells.point.shape[1] - shape[1]) <= 0.01 * shape[1]
    regular_rows = shape[0] != 8
    assert cells.point.shape[0] == shape[0] or not regular_rows
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
    image = np.full((20, 40, 3), 200, np.uint8)
    depth = np.where(np.arange(40) < 20, 5.0, 20.0)[None].repeat(20, axis=0).astype(np.float32)
    shown = pixels.lit(image, depth, reduction=2)
    assert shown.shape == (10, 20, 3)
    assert shown[5, 10, 0] < 150
    assert (shown[5, [3, 15], 0] == 200).all()


def test_each_sensor_of_a_rig_has_its_own_range_image(
    cloud: PointCloud, monkeypatch: Any, tmp_path: Path
) -> None:
    """Their azimuths are about different axes: three at most, each with its label and its own points."""
    labels = ("roof", "left", "right", "rear")
    numbers = (np.arange(len(cloud)) % 4).astype(np.uint8)
    drawn: list[tuple[str, int]] = []

    def noted(figure: Any, box: Any, cells: Any, shades: Any, *, labels: bool, name: str) -> None:
        drawn.append((name, len(shades.rgb)))
        assert cells.point.max() < len(shades.rgb)

    monkeypatch.setattr(pictures, "_draw_range_image", noted)
    rig = dataclasses.replace(cloud, sensor_names=labels, sensor_index=numbers)
    frame_picture(rig, tmp_path / "rig.png", colour_by="sensor_index", size_px=(300, 250))
    assert drawn == [
        (label, int((numbers == labels.index(label)).sum())) for label in ("right", "left", "roof")
    ]


def test_a_row_without_beams_stays_empty() -> None:
    """Rows at 0, 1, 2, 4 and 5 degrees are six of one step, the fourth without a point; by hand."""
    elevation, azimuth = np.meshgrid(np.radians([0.0, 1.0, 2.0, 4.0, 5.0]), np.radians(np.arange(40.0)))
    found = cells_of_beams(azimuth.ravel(), elevation.ravel(), np.ones(azimuth.size, np.uint8))
    np.testing.assert_allclose(found.elevation_deg, np.arange(7) - 0.5, atol=1e-9)
    assert (found.point[3] == NOTHING).all()
    assert (np.delete(found.point, 3, axis=0) != NOTHING).all()
