"""A sensor on or in a surface: one line, before anything is traced."""

import math

import numpy as np
import pytest
from helpers import chain
from helpers.mistakes import told
from helpers.scene_text import scene_of

from lidarscene import Scene, Simulator
from lidarscene.errors import InputError
from lidarscene.maths.pose import Pose
from lidarscene.maths.trajectory import Course
from lidarscene.scene import clearance
from lidarscene.scene.clearance import Clearance
from lidarscene.scene.meshes.primitives import box_mesh, cylinder_mesh, plane_mesh
from lidarscene.scene.scene import Ball, Body, Part

GROUND = """
[[bodies]]
name = "ground"
primitive = "plane"
size_m = [100.0, 100.0]
material = "asphalt"
"""


def body(name, mesh, pose=None, motion=None):
    parts = (mesh,) if isinstance(mesh, Ball) else (Part(vertices_m=mesh[0], faces=mesh[1], material="grey"),)
    return Body(name=name, class_name=name, parts=parts, pose=pose or Pose(), motion=motion)


def pose_of(x, y, z, **turns):
    return Pose.from_degrees(position_m=(x, y, z), **turns)


def refusal(place_m, *bodies, radius_m=0.025, time_s=0.0):
    """The line, or None."""
    try:
        clearance = Clearance.of_scene(Scene(bodies=bodies))
        clearance.check(np.asarray(place_m), radius_m=radius_m, time_s=time_s, sensor="own")
    except InputError as error:
        return str(error)
    return None


PANES = [body(f"pane {x}", plane_mesh(size_m=(2, 2)), pose_of(x, 0, 0, pitch_deg=90)) for x in (0.0, 0.016)]
WALL = body("wall", box_mesh(size_m=(0.2, 4, 3)), pose_of(5, 0, 1.5, yaw_deg=30))
ROOM = body("room", box_mesh(size_m=(6, 4, 2.5)), pose_of(0, 0, 1.25))
LAMP = body("lamp", Ball(radius_m=0.4, material="grey"), pose_of(0, 0, 3))
POST = body("post", cylinder_mesh(radius_m=0.1, height_m=2.0), pose_of(1, 1, 1))


@pytest.mark.parametrize(
    ("place_m", "bodies", "expected"),
    [
        ((0.008, 0, 0), PANES, "8 mm off 'pane 0.0'"),
        ((0.030, 0, 0), PANES, "14 mm off 'pane 0.016'"),
        ((5, 0, 1.5), [WALL], "a place within 'wall'"),
        ((5 + 0.09 * math.cos(math.pi / 6), 0.045, 1.5), [WALL], "10 mm off 'wall'"),
        ((0, 0, 3.1), [LAMP], "a place within 'lamp'"),
        ((0, 0, 2.59), [LAMP], "10 mm off 'lamp'"),
        ((1, 1, 1), [POST], "a place within 'post'"),
        ((0, 0, 0.02), [ROOM], "20 mm off 'room'"),
        # Clear of them: beside a wall, in a room, over the edge of a pane.
        ((5.3, 0, 1.5), [WALL], None),
        ((0, 0, 0.05), [ROOM], None),
        ((0.008, 1.03, 0), PANES, None),
        ((0, 0, 2.5), [LAMP], None),
        ((1, 1, 2.03), [POST], None),
    ],
)
def test_on_in_and_clear_of_surfaces(place_m, bodies, expected):
    """Reference: distances by hand."""
    line = refusal(place_m, *bodies)
    if expected is None:
        assert line is None
    else:
        assert line is not None
        assert line.startswith("sensor 'own' at (")
        assert f": must stand at least 25 mm off every surface, got {expected}; " in line


def test_a_moving_body_is_where_it_is_then():
    car = body("car", box_mesh(size_m=(4, 2, 0.8)), motion=Course(start=pose_of(0, 0, 1), speed_m_s=10.0))
    assert "within 'car'" in refusal((10, 0, 1), car, time_s=1.0)
    assert refusal((10, 0, 1), car, time_s=0.0) is None


@pytest.mark.parametrize("corner", range(3))
def test_the_distance_to_a_triangle(corner):
    """Reference: the nearest of 300 x 300 points of it, which are 8 mm apart."""
    rng = np.random.default_rng(corner)
    corners = rng.normal(size=(3, 3))
    share = np.stack(np.meshgrid(*[np.linspace(0, 1, 300)] * 2), axis=-1).reshape(-1, 2)
    share = share[share.sum(axis=1) <= 1.0]
    points = corners[0] + share @ (corners[1:] - corners[0])
    triangle = body("one", (corners, np.array([[0, 1, 2]])))
    for place in rng.normal(size=(20, 3)):
        nearest = np.linalg.norm(points - place, axis=1).min()
        assert refusal(place, triangle, radius_m=nearest + 1e-9) is not None
        assert refusal(place, triangle, radius_m=nearest - 0.02) is None


def test_a_scene_file_without_a_place_stands_above_its_ground(tmp_path):
    """The first scene that a newcomer writes."""
    scene = scene_of(tmp_path, GROUND)
    np.testing.assert_array_equal(scene.sensor_pose.position_m, (0.0, 0.0, 1.8))
    turned = scene_of(tmp_path, '[sensor]\nname = "table1-sipm"\nyaw_deg = 90\n' + GROUND)
    np.testing.assert_array_equal(turned.sensor_pose.position_m, (0.0, 0.0, 1.8))


@pytest.mark.parametrize("name", ["table1-apd", "table1-sipm"])
def test_a_sensor_on_the_ground_is_told_of(mi, tmp_path, name):
    """Rationale: with an APD this was a traceback of NaN, with a SiPM 75,726 echoes at the origin."""
    simulator = Simulator(scene_of(tmp_path, "[sensor]\nposition_m = [0, 0, 0]\n" + GROUND), chain.sensor(name))
    for call in (simulator.render, lambda: simulator.check_frames([0])):
        with told("(0, 0, 0) | 0 mm | 'ground'"):
            call()


@pytest.mark.parametrize("name", ["table1-apd", "table1-sipm"])
def test_no_hit_is_nearer_than_the_housing(mi, name):
    """A sensor that drives into a wall within a frame: what is nearer than its lens is no hit, and nothing is NaN."""
    sensor = chain.sensor(
        name, "scanner.azimuth_step_deg=2", "scanner.elevation_step_deg=1", "laser.repetition_rate_khz=1"
    )
    seconds = sensor.scanner.pulses / sensor.scanner.rate_hz
    wall = chain.facing(range_m=1.0, size_m=20.0)
    ego = Course(speed_m_s=1.2 / seconds)  # 1.2 m in the frame: the last sixth of it is behind the wall
    scene = Scene(bodies=(wall,), materials={"grey": chain.diffuse()}, ego=ego)
    cloud = Simulator(scene, sensor).render()
    echoes = cloud.true_range_m[cloud.status == 0]
    assert len(echoes) > 0.6 * sensor.scanner.pulses
    assert echoes.min() >= float(sensor.housing_m)


def test_of_a_large_ground_a_few_triangles_are_looked_at(monkeypatch):
    """The distance and the height are those that all its triangles have; a frame must not go through millions."""
    side = 151
    x, y = np.meshgrid(np.linspace(-30, 30, side), np.linspace(-30, 30, side), indexing="ij")
    vertices = np.stack([x, y, np.random.default_rng(3).uniform(-0.2, 0.2, x.shape)], axis=-1).reshape(-1, 3)
    corner = np.arange(side * side).reshape(side, side)[:-1, :-1].ravel()
    lower, upper = ((corner, corner + side, corner + side + 1), (corner, corner + side + 1, corner + 1))
    faces = np.concatenate([np.stack(lower, axis=1), np.stack(upper, axis=1)]).astype(np.uint32)
    scene_clearance = Clearance.of_scene(
        Scene(bodies=(body("ground", (vertices, faces), pose_of(2, 1, 0, yaw_deg=20)),))
    )
    triangles_looked_at = []
    kernel = clearance._distance_m
    monkeypatch.setattr(
        clearance,
        "_distance_m",
        lambda corners, most_m: triangles_looked_at.append(len(corners)) or kernel(corners, most_m),
    )
    for place in ([1.0, -3.0, 0.9], [14.0, 9.0, -2.0], [0.0, 0.0, 40.0]):
        point = scene_clearance.bodies[0].pose.inverse_apply(np.array(place))
        clearances = scene_clearance.around_place(np.array(place), time_s=0.0)
        all_triangles = vertices[faces] - point
        assert clearances.nearest.distance_m == pytest.approx(kernel(all_triangles, math.inf), rel=1e-12)
        heights = clearance._along_m(all_triangles, np.array([0.0, 0.0, 1.0]), np.eye(3)[:, :2])
        side_m = clearances.below.distance_m if place[2] > 0.0 else -clearances.above.distance_m
        assert side_m == pytest.approx(-heights[0], abs=1e-9)
        assert len(heights) == 1
    scene_clearance.check(np.array([1.0, -3.0, 0.9]), radius_m=0.1, time_s=0.0, sensor="own")
    assert max(triangles_looked_at) < len(faces) / 2
    assert triangles_looked_at[-1] < len(faces) / 4


CUBE = box_mesh(size_m=(2, 2, 2))


@pytest.mark.parametrize("point", [(0.0, 0.0, 0.0), (0.5, -0.3, 0.7)])
def test_how_much_is_around_a_place(point):
    """A cube is all around what is in it, and nowhere around what is beside. From its middle each side is a sixth of
    all directions; from elsewhere it is the share of 20,000 evenly spread ones that leave through it. Of those at its
    rim, some 4 sqrt(20,000) / 20,000 of all, one in ten may be counted wrong.
    """
    vertices, faces = CUBE
    inside = np.array(point)

    def enclosed(faces, place):
        part = Part(vertices_m=vertices, faces=faces, material="grey")
        return clearance._enclosed_share([part], place)

    assert enclosed(faces, inside) == pytest.approx(1.0)
    assert enclosed(faces, inside + 3.0) == pytest.approx(0.0, abs=1e-12)
    top = np.flatnonzero((vertices[faces][:, :, 2] > 0.999).all(axis=1))
    if not any(point):
        assert enclosed(faces[top], inside) == pytest.approx(1.0 / 6.0)
    # Evenly spread directions (Fibonacci's spiral): those that leave through the top.
    k = np.arange(20_000) + 0.5
    up, turn = 1.0 - 2.0 * k / len(k), math.pi * (1.0 + math.sqrt(5.0)) * k
    level = np.sqrt(1.0 - up**2)
    direction = np.stack([level * np.cos(turn), level * np.sin(turn), up], axis=1)[up > 0.0]
    ceiling_points = inside[:2] + direction[:, :2] * ((1.0 - inside[2]) / direction[:, 2:])
    share = np.count_nonzero((np.abs(ceiling_points) <= 1.0).all(axis=1)) / len(k)
    assert enclosed(faces[top], inside) == pytest.approx(share, abs=2.8e-3)
