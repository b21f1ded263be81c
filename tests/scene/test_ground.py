"""Ground that is not a plane: the spectrum of its mesh, crown and kerbs, and what stands, lies and walks on it."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from helpers.scene_text import scene_of
from helpers.street import triangle
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import welch

from lidarscene.maths.pose import Pose
from lidarscene.maths.trajectory import Course
from lidarscene.physics.reference.surroundings import profile_density_m3
from lidarscene.physics.road.roughness import RoughSurface
from lidarscene.scene.ground import SPACINGS_A_WAVE, Ground, Sheet, Strip, lay
from lidarscene.scene.ground_area import Outline
from lidarscene.scene.ride import Ride
from lidarscene.scene.scene import Part, Scene
from lidarscene.scene.scene_file import load_scene

FLAT = RoughSurface.draw("flat", 0)
ROAD = (
    '[[bodies]]\nname = "road"\nprimitive = "ground"\nsize_m = [80, 8]\ncrown_m = 0.1\nspacing_m = 0.4\n'
    'material = "asphalt"\n'
)
PAVEMENT = (
    '[[bodies]]\nname = "pavement"\nprimitive = "ground"\nsize_m = [80, 2]\nkerb_m = 0.2\nmaterial = "concrete"\n'
    "position_m = [0, 5, 0.12]\n"
)
BOX = '[[bodies]]\nname = "box"\nprimitive = "box"\nsize_m = [1, 1, 1]\nmaterial = "brick"\non_ground = true\n'


def sheet(pose: Pose | None = None, *, size_m=(12.0, 5.0), crown_m=0.0, spacing_m=1.0, surface=FLAT) -> Sheet:
    laid = lay(pose or Pose(), plan=Strip.rectangle(size_m, spacing_m), crown_m=crown_m, surface=surface)
    assert isinstance(laid, Sheet)
    return laid


def bend(*, offset_m: float = 0.0, width_m: float = 5.0, climbs_m: float = 0.0) -> Strip:
    """A strip along a quarter of a circle of 30 m, with straight segments of 3 m and a longer one at its end."""
    angle = np.append(np.linspace(0.0, 0.5 * np.pi, 17), np.nan)
    line_m = np.stack([30 * np.sin(angle), 30 - 30 * np.cos(angle), np.linspace(0.0, climbs_m, 18)], axis=1)
    line_m[-1, :2] = 30.0, 42.0
    return Strip(line_m=line_m, width_m=width_m, offset_m=offset_m, spacing_m=0.7)


def mesh_of(scene: Scene, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Vertices in the world, and faces, of a body's only part."""
    body = next(body for body in scene.bodies if body.name == name)
    (part,) = body.parts
    assert isinstance(part, Part)
    return body.pose.apply(part.vertices_m), part.faces.astype(int)


def test_spectrum_of_the_mesh_is_that_of_the_class() -> None:
    """Spectrum of its vertices along a line, octave by octave: as tight as for the surface itself (`test_roughness`).

    A mesh shows no wave shorter than three spacings, so its density is G sqrt(1 - (n / k)^2) with k one over that.
    """
    rng, spacing_m, octaves = np.random.default_rng(30), 0.4, 0.022 * 2.0 ** np.arange(6)
    measured = []
    for _ in range(6):
        pose = Pose.from_degrees(position_m=(*rng.uniform(-1e4, 1e4, 2), 0.0), yaw_deg=rng.uniform(0, 360))
        surface = RoughSurface.draw("C", int(rng.integers(2**32)))
        vertices_m, _ = sheet(pose, size_m=(1000.0, 0.8), spacing_m=spacing_m, surface=surface).mesh(0.0)
        frequency, density = welch(vertices_m.reshape(2501, 3, 3)[:, 1, 2], fs=1.0 / spacing_m, nperseg=1024)
        measured.append(density)
    highest = 1.0 / (SPACINGS_A_WAVE * spacing_m)
    within = np.clip(frequency, 1e-9, highest)
    expected = profile_density_m3(within, "C") * np.sqrt(1.0 - (within / highest) ** 2)
    bands = [(frequency >= low) & (frequency < high) for low, high in itertools.pairwise(octaves)]
    ratio = [
        (np.mean(measured, axis=0) * frequency**2)[band].mean() / (expected * frequency**2)[band].mean()
        for band in bands
    ]
    assert (np.abs(np.array(ratio) - 1.0) < [0.4, 0.3, 0.2, 0.18, 0.14]).all(), ratio


def test_crown_and_kerb() -> None:
    """A parabola over the width, flat at the ends, whole one width from them; faces go down and look outward."""
    vertices_m, faces = sheet(size_m=(60.0, 8.0), crown_m=0.1, spacing_m=1.0).mesh(0.15)
    top = vertices_m[: 61 * 9].reshape(61, 9, 3)
    np.testing.assert_allclose(top[30, :, 2], 0.1 * (1 - (np.linspace(-4, 4, 9) / 4) ** 2), atol=1e-15)
    np.testing.assert_allclose(top[8:-8, 4, 2], 0.1, atol=1e-15)
    slope = CubicHermiteSpline([0.0, 8.0], [0.0, 0.1], [0.0, 0.0])(np.arange(9.0))  # level at both of its ends
    np.testing.assert_allclose([top[:9, 4, 2], top[:-10:-1, 4, 2]], [slope, slope], atol=1e-15)
    halved = Strip(line_m=np.array([[-30.0, 0, 0], [-9, 0, 0], [30, 0, 0]]), width_m=8.0, spacing_m=1.0)
    np.testing.assert_allclose(0.1 * halved.crown_share(np.arange(61.0), np.zeros(61)), top[:, 4, 2], atol=1e-15)
    np.testing.assert_allclose(top[[0, -1], :, 2], 0.0, atol=1e-15)
    np.testing.assert_allclose(top[:, [0, -1], 2], 0.0, atol=1e-15)
    assert vertices_m[:, 2].min() == pytest.approx(-0.15)
    corners = vertices_m[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    upward = normal[:, 2] > 0
    assert upward.sum() == 2 * 60 * 8
    side, middle = normal[~upward], corners[~upward].mean(axis=1)
    np.testing.assert_allclose(side[:, 2], 0.0, atol=1e-12)
    outward = np.where(np.isclose(np.abs(middle[:, 0]), 30.0), middle[:, 0] * side[:, 0], middle[:, 1] * side[:, 1])
    assert len(side) == 2 * 2 * (60 + 8)
    assert (outward > 0).all()


STAR = np.array([[0.0, 0.0, 0.2], [9.0, 1.0, 0.0], [8.0, 9.0, 0.5], [4.0, 3.0, 0.0], [1.0, 8.0, 0.0]])


@pytest.mark.parametrize(
    "plan",
    [Strip.rectangle((12.0, 5.0), 1.0), bend(offset_m=-3.0, climbs_m=2.0), Outline(corner_m=STAR, spacing_m=0.6)],
)
def test_height_of_the_mesh_is_that_of_its_triangles(plan: Strip | Outline) -> None:
    """Rays from above against each triangle."""
    pose = Pose.from_degrees(position_m=(100.0, -40.0, 0.3), yaw_deg=35.0)
    laid = lay(pose, plan=plan, crown_m=0.2, surface=RoughSurface.draw("F", 4))
    vertices_m, faces = laid.mesh(0.5)
    vertices_m = pose.apply(vertices_m)
    x_m, y_m, _ = vertices_m.mean(axis=0)
    eye_m = np.array([x_m + 0.3, y_m + 0.2, 400.0])
    rng = np.random.default_rng(5)
    a, b, c = vertices_m[faces[rng.integers(len(laid.mesh(0.0)[1]), size=300)]].transpose(1, 0, 2)
    u, v = rng.uniform(0.1, 0.4, (2, 300, 1))
    targets_m = a + u * (b - a) + v * (c - a)
    direction = targets_m - eye_m
    nearest = np.full(len(direction), np.inf)
    for a, b, c in vertices_m[faces]:
        nearest = np.minimum(nearest, triangle(eye_m, direction, a, b - a, c - a))
    hit_m = eye_m + nearest[:, None] * direction
    np.testing.assert_allclose(Ground(surface=FLAT, sheets=[laid]).height_m(hit_m[:, :2]), hit_m[:, 2], atol=1e-9)


def test_a_strip_keeps_its_distance_from_its_line() -> None:
    """Places in a ring around the circle are on it, those beside are not; a strip beside it shares its edge."""
    road, beside = bend(width_m=6.0), bend(width_m=2.0, offset_m=4.0)
    angle, radius_m = np.meshgrid(np.linspace(0.05, 1.5, 100), [26.5, 27.5, 32.5, 33.5])
    place_m = np.stack([radius_m * np.sin(angle), 30 - radius_m * np.cos(angle)], axis=-1).reshape(-1, 2)
    on_road, _, across_m = road.locate(place_m)
    assert on_road.reshape(4, 100).all(axis=1).tolist() == [False, True, True, False]
    # Segments of 3 m leave the circle by 3^2 / (8 * 30) m.
    np.testing.assert_allclose(across_m.reshape(4, 100)[1:3], [[2.5] * 100, [-2.5] * 100], atol=0.038)
    edges = [
        Sheet.lay(Pose(), strip=strip, crown_m=0.0, surface=FLAT).vertices_m[:, column]
        for strip, column in ((road, -1), (beside, 0))
    ]
    np.testing.assert_allclose(*edges, atol=1e-12)


@pytest.mark.parametrize(
    ("turn_deg", "length_m", "folds"), [(60.0, 2.4, False), (60.0, 2.2, True), (-60.0, 2.2, False), (-60.0, 0.5, False)]
)
def test_an_edge_folds_where_two_bends_one_way_are_too_near(turn_deg: float, length_m: float, folds: bool) -> None:
    """Reference: between turns of 60 degrees an edge 2 m inside is 4 tan(30 degrees) = 2.31 m shorter than the line.

    Where the second turn goes the other way (-60 degrees), each edge is as long as the line.
    """
    turns = np.cumsum([0.0, math.radians(60.0), math.radians(turn_deg)])
    steps = np.array([10.0, length_m, 10.0])[:, None] * np.column_stack([np.cos(turns), np.sin(turns), 0.0 * turns])
    line_m = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    corner_m = Strip(line_m=line_m, width_m=4.0, spacing_m=1.0).sharp_corner()
    assert (corner_m is not None) == folds
    if corner_m is not None:
        np.testing.assert_allclose(corner_m, line_m[1])


def test_a_road_climbs_as_its_line() -> None:
    """The height goes from point to point with no step of the slope; wheels meet it."""
    strip = bend(climbs_m=2.0)
    laid = Sheet.lay(Pose(), strip=strip, crown_m=0.0, surface=FLAT)
    rows = strip._first_row
    np.testing.assert_allclose(laid.vertices_m[rows, 3, 2], np.linspace(0.0, 2.0, 18), atol=1e-12)
    fine_m = strip.rise_m(np.linspace(0.0, rows[-1], 20_001), np.zeros(20_001))
    assert np.abs(np.diff(fine_m, 2)).max() < 0.05 * np.diff(fine_m).max(), "straight pieces have steps of 0.75"
    ground = Ground(surface=FLAT, sheets=[laid])
    np.testing.assert_allclose(ground.wheel_height_m(strip.line_m[1:-1, :2]), strip.line_m[1:-1, 2], atol=1e-9)


def test_a_ground_has_the_heights_of_its_grid() -> None:
    """Rows along x, heights in them along y, straight between: of z = x y on two by two cells, for mesh and wheels."""
    heights_m = np.outer([-6.0, 0.0, 6.0], [-2.0, 0.0, 2.0]) / 12.0
    strip = Strip.rectangle((12.0, 4.0), 0.5, heights_m)
    pose = Pose.from_degrees(position_m=(3.0, 1.0, 2.0), yaw_deg=90.0)
    laid = lay(pose, plan=strip, crown_m=0.0, surface=FLAT)
    assert isinstance(laid, Sheet)
    x_m, y_m, z_m = laid.vertices_m.reshape(-1, 3).T
    np.testing.assert_allclose(z_m, x_m * y_m / 12.0, atol=1e-12)
    place_m = np.array([[1.7, 1.2], [-0.6, 1.4], [-5.0, 0.3]])
    ground = Ground(surface=FLAT, sheets=[laid])
    world_m = pose.apply(np.pad(place_m, ((0, 0), (0, 1))))[:, :2]
    np.testing.assert_allclose(ground.height_m(world_m), 2.0 + place_m.prod(axis=1) / 12.0, atol=0.01)
    np.testing.assert_allclose(ground.wheel_height_m(world_m), 2.0 + place_m.prod(axis=1) / 12.0, atol=1e-12)


def test_an_outline_is_filled() -> None:
    """Its triangles look up and have the polygon's area, its sides look outward; a place in its notch is not on it."""
    laid = lay(Pose(), plan=Outline(corner_m=STAR[::-1], spacing_m=0.6), crown_m=0.0, surface=FLAT)
    vertices_m, faces = laid.mesh(0.3)
    corners = vertices_m[faces]
    normal = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    x_m, y_m, _ = STAR.T
    area_m2 = 0.5 * (x_m * np.roll(y_m, -1) - np.roll(x_m, -1) * y_m).sum()
    top = normal[:, 2] > 1e-9
    assert normal[top, 2].sum() == pytest.approx(area_m2)
    np.testing.assert_allclose(normal[~top, :2].sum(axis=0), 0.0, atol=1e-9)
    middle_m = corners[~top].mean(axis=1)[:, :2] + 1e-3 * normal[~top, :2] / np.hypot(*normal[~top, :2].T)[:, None]
    assert not laid.mesh_height_m(middle_m)[0].any()
    assert laid.mesh_height_m(np.array([[4.0, 2.9], [4.0, 3.1]]))[0].tolist() == [True, False]


def test_wheels_meet_the_surface_that_the_mesh_shows() -> None:
    """The two differ at vertices by the waves that the mesh leaves out; the highest sheet counts, and 0 beside all."""
    surface = RoughSurface.draw("C", 9)
    low = sheet(Pose(position_m=np.array([0.0, 0.0, -0.2])), size_m=(40.0, 40.0), surface=surface)
    road = sheet(size_m=(20.0, 6.0), crown_m=0.1, spacing_m=0.4, surface=surface)
    ground = Ground(surface=surface, sheets=[low, road])
    vertices_m, _ = road.mesh(0.0)
    place_m = vertices_m[:, :2]
    left_out = surface.height_m(place_m) - surface.without_short_waves(1.0 / 1.2).height_m(place_m)
    np.testing.assert_allclose(ground.wheel_height_m(place_m), vertices_m[:, 2] + left_out, atol=1e-7)
    aside_m = np.array([[0.0, 15.0], [0.0, 30.0]])
    np.testing.assert_allclose(ground.wheel_height_m(aside_m) - surface.height_m(aside_m), [-0.2, 0.0], atol=1e-9)
    assert np.isnan(ground.height_m(aside_m)).tolist() == [False, True]


def test_wheels_below_a_bridge_stay_on_their_road() -> None:
    """A sheet is the ground of wheels up to 1.5 m below it; beside all they keep their height."""
    bridge = sheet(Pose(position_m=np.array([0.0, 0.0, 5.0])))
    ground = Ground(surface=FLAT, sheets=[sheet(), bridge])
    place_m, near_m = np.zeros((5, 2)), np.array([-0.3, 3.4, 3.6, 5.1, 7.0])
    place_m[4, 1] = 30.0
    np.testing.assert_allclose(ground.wheel_height_m(place_m, near_m), [0.0, 0.0, 5.0, 5.0, 7.0], atol=1e-9)


def test_things_stand_on_the_highest_ground(tmp_path: Path) -> None:
    scene = scene_of(
        tmp_path,
        '[ground]\nroughness = "C"\n'
        + ROAD
        + PAVEMENT
        + BOX
        + "position_m = [0, 0, 0.5]\ninstances = [{ position_m = [3, 1, 0] }, { position_m = [-7, 5, 0] }]\n",
    )
    for name, level_m in (("box.0", 0.1 * (1 - (1 / 4) ** 2)), ("box.1", 0.12)):
        position_m = next(body.pose.position_m for body in scene.bodies if body.name == name)
        vertices_m, _ = mesh_of(scene, "road" if name == "box.0" else "pavement")
        near_m = vertices_m[np.hypot(*(vertices_m[:, :2] - position_m[:2]).T) < 0.5][:, 2]
        assert near_m.min() <= position_m[2] - 0.5 + 1e-12
        assert position_m[2] - 0.5 == pytest.approx(level_m, abs=0.08), "four times the rms of class C"


@pytest.mark.parametrize(
    ("name", "markings"), [("street", ["dashes.3", "bay_lines.10", "zebra.2"]), ("car", ["dashes.0", "dashes.8"])]
)
def test_markings_of_a_scene_lie_on_its_road(name: str, markings: list[str]) -> None:
    """3 mm thick: nowhere below the road's triangles, and nowhere 6 mm above, at corners, edges and middles."""
    scene = load_scene(name)
    vertices_m, faces = mesh_of(scene, "road")
    corners = vertices_m[faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    for marking in markings:
        marks_m, mark_faces = mesh_of(scene, marking)
        mark = marks_m[mark_faces]
        points = np.concatenate([mark.reshape(-1, 3), mark.mean(axis=1), (mark[:, 0] + mark[:, 1]) / 2])[::7]
        for point in points:
            inside = ((low <= point + 1e-9) & (high >= point - 1e-9))[:, :2].all(axis=1)
            up = np.array([[0.0, 0.0, 1.0]])
            below = [triangle(point - [1e-9, 2e-9, 1.0], up, a, b - a, c - a)[0] for a, b, c in corners[inside]]
            assert 0.0005 < 1.0 - min(below) < 0.006


def test_the_car_scene_stands_on_its_ground() -> None:
    """Things at the height of the highest mesh below them; houses reach into the lawn, and all is level when flat."""
    rough, flat = load_scene("car"), load_scene("car", overrides="ground.roughness=flat")
    level_m = {"car": 0.06 * (1 - 0.25), "pedestrian": 0.12, "sign": 0.12, "lamp_post": 0.12, "tree": 0.1}
    standing = [body for body in flat.bodies if body.name.split(".")[0] in level_m]
    assert len(standing) == 8
    for body in standing:
        expected_m = level_m[body.name.split(".")[0]]
        assert body.pose.position_m[2] == pytest.approx(expected_m, abs=2e-3), "the crown in steps of 0.5 m"
        here = next(other for other in rough.bodies if other.name == body.name)
        place_m = here.pose.position_m
        below_m = np.max([_mesh_height_m(rough, name, place_m) for name in ("road", "pavement", "lawn", "verge_east")])
        assert place_m[2] == pytest.approx(below_m, abs=1e-9)
        assert 0.0 < abs(place_m[2] - expected_m) < 0.08, "four times the rms of class C"
    for body in rough.bodies:
        if body.name.startswith("house"):
            assert _mesh_height_m(rough, "lawn", body.pose.position_m) > body.pose.position_m[2]


def _mesh_height_m(scene: Scene, name: str, place_m: np.ndarray) -> float:
    """Height of a body's mesh at a place; minus infinity beside it."""
    vertices_m, faces = mesh_of(scene, name)
    corners = vertices_m[faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    near = ((low[:, :2] <= place_m[:2]) & (high[:, :2] >= place_m[:2])).all(axis=1)
    eye_m, down = np.array([place_m[0] + 1e-9, place_m[1] + 2e-9, 100.0]), np.array([[0.0, 0.0, -1.0]])
    ways = [triangle(eye_m, down, a, b - a, c - a)[0] for a, b, c in corners[near]]
    return 100.0 - min(ways, default=np.inf)


def test_a_walker_follows_the_ground(tmp_path: Path) -> None:
    """Upright, every 0.1 s at (h(t - 0.1 s) + 4 h(t) + h(t + 0.1 s)) / 6, h means of 0.1 s below it, and so moves."""
    text = '[ground]\nroughness = "E"\n' + ROAD + BOX + "[bodies.motion]\nvelocity_m_s = [1, 0.5, 0]\n"
    scene = scene_of(tmp_path, text)
    motion = scene.bodies[1].motion
    assert isinstance(motion, Ride)
    time_s, h = np.array([2.9, 3.0, 3.1, 4.0, 4.7]), 1e-4
    means_m = []
    for shift in (-0.1, 0.0, 0.1):
        around_s = time_s + shift + np.array([[-0.0375], [-0.0125], [0.0125], [0.0375]])
        means_m.append(
            np.mean([motion.height_m(motion.path.at(own_s).position_m[:, :2]) for own_s in around_s], axis=0)
        )
    assert np.ptp(means_m) > 0.01
    np.testing.assert_allclose(motion.at(time_s).position_m[:, 2], np.array([1, 4, 1]) @ means_m / 6.0, atol=1e-12)
    time_s = np.linspace(3.97, 4.03, 13)
    before, here, after = (motion.at(time_s + shift) for shift in (-h, 0.0, h))
    np.testing.assert_allclose((after.position_m - before.position_m) / (2 * h), here.velocity_m_s, atol=1e-5)
    np.testing.assert_array_equal(here.rotation, np.tile(np.eye(3), (13, 1, 1)))


def test_an_ego_without_its_ride_stays_on_the_ground(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, "[ego]\non_ground = true\nride = { active = false }\n" + ROAD)
    assert scene.ego is not None
    np.testing.assert_allclose(scene.ego.at(np.zeros(1)).position_m, [[0.0, 0.0, 0.1]], atol=1e-12)
    scene = scene_of(tmp_path, "[ego]\nride = { active = false }\n" + ROAD)
    assert isinstance(scene.ego, Course)
