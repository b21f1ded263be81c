"""Who was hit, and what the light does around thin things."""

import dataclasses
import math

import numpy as np
import pytest
from helpers import chain
from helpers.mistakes import told

from lidarscene import Pose, Simulator
from lidarscene.kernel.rays.onward import START_OFFSET_M
from lidarscene.kernel.world.mitsuba_world import build_world
from lidarscene.scene.scene import Body, Part, Sun

pytestmark = pytest.mark.usefixtures("mi")

MIDDLE = 4
WIDE = chain.raster(60, 20, 0.5)


def with_name(body, name, class_name):
    return dataclasses.replace(body, name=name, class_name=class_name)


def test_identity_of_interleaved_bodies():
    """Bodies that share materials, interleaved, with an exact sphere between: each point knows its own.

    Bodies stand in rows of known azimuth, unlike each other in size, material and class.
    """
    materials = [chain.diffuse(name, rho) for name, rho in (("dark", 0.05), ("bright", 0.7), ("mid", 0.3))]
    bodies, expected = [], {}
    for i, azimuth_deg in enumerate((-25.0, -15.0, -5.0, 5.0, 15.0, 25.0)):
        azimuth = math.radians(azimuth_deg)
        position_m = (20.0 * math.cos(azimuth), 20.0 * math.sin(azimuth), 0.0)
        material = ("dark", "bright", "mid")[i % 3]
        if i == 3:
            body = chain.ball(at=position_m, radius_m=0.8, material=material)
        else:
            body = chain.box(at=position_m, size_m=(0.5 + 0.2 * i, 1.0, 0.7), yaw_deg=10.0 * i, material=material)
        bodies.append(with_name(body, f"body_{i}", ("car", "person")[i % 2]))
        expected[azimuth_deg] = (f"body_{i}", ("car", "person")[i % 2], material)
    cloud = Simulator(chain.scene(*bodies, materials=materials), chain.sensor("table1-apd", *WIDE)).render()
    echoes = cloud.select(cloud.status == 0)
    azimuth_deg = np.degrees(echoes.azimuth_rad)
    for centre, (name, class_name, material) in expected.items():
        points = echoes.select(np.abs(azimuth_deg - centre) < 1.0)
        assert len(points) > 5
        assert {cloud.body_names[i] for i in points.body} == {name}
        assert {cloud.class_names[i] for i in points.class_id} == {class_name}
        assert {cloud.material_names[i] for i in points.material} == {material}
        reflectivity = {"dark": 0.05, "bright": 0.7, "mid": 0.3}[material]
        np.testing.assert_allclose(points.reflectivity, reflectivity, rtol=1e-6)


def test_faces_of_one_body_with_two_materials():
    """A mesh whose upper half is one material and lower half another, split at z = 0."""
    upper = np.array([[0, -5, 0], [0, 5, 0], [0, 5, 5], [0, -5, 5]], dtype=float)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    parts = (
        Part(vertices_m=upper, faces=faces, material="sky_side"),
        Part(vertices_m=upper * [1, 1, -1], faces=faces, material="ground_side"),
    )
    body = Body(name="wall", class_name="wall", parts=parts, pose=Pose(position_m=np.array([20.0, 0, 0])))
    materials = [chain.diffuse("sky_side", 0.2), chain.diffuse("ground_side", 0.6)]
    cloud = Simulator(chain.scene(body, materials=materials), chain.sensor("table1-apd", *WIDE)).render()
    echoes = cloud.select((cloud.status == 0) & (np.abs(cloud.elevation_rad) > 1e-3))
    names = np.array(cloud.material_names)[echoes.material]
    assert (names == np.where(echoes.elevation_rad > 0, "sky_side", "ground_side")).all()


def test_shadow_rays_do_not_jump_through_thin_gaps():
    """A pane 5 mm before a wall at 250 m shades it: Mitsuba's own offset of 22 mm would jump past the pane."""
    wall = chain.facing(range_m=250.0, size_m=10.0)
    strip = chain.box(at=(249.995 - 0.0005, 0.503, 0.0), size_m=(0.001, 1.0, 2.0))
    oblique = Sun(azimuth_rad=math.radians(120.0), elevation_rad=0.0)
    sensor = chain.sensor("table1-apd", *chain.NARROW)
    assert START_OFFSET_M < 0.005
    shaded = chain.run_stages(chain.scene(wall, strip, sun=oblique), sensor).hits
    assert shaded.range_m[MIDDLE] == pytest.approx(250.0, abs=1e-3)
    assert not shaded.lit[MIDDLE]
    assert chain.run_stages(chain.scene(wall, sun=oblique), sensor).hits.lit[MIDDLE]


@pytest.mark.parametrize("range_m", [1.0, 50.0, 250.0, 500.0])
def test_no_surface_shades_itself(range_m):
    """Every beam on a plane under a grazing sun is lit, at every range."""
    sensor = chain.sensor("table1-apd", *WIDE, *chain.raster(8, 8, 0.05))
    grazing = Sun(azimuth_rad=math.radians(95.0), elevation_rad=0.0)
    body = chain.facing(range_m=range_m, size_m=0.3 * range_m)
    hits = chain.run_stages(chain.scene(body, sun=grazing), sensor).hits
    assert hits.has_surface.all()
    assert hits.lit.all()


def test_clear_glass_sends_nothing():
    """A beam that may meet no pane ends at the first, without an echo."""
    from lidarscene.materials.material_file import catalogue_material

    pane = chain.facing(range_m=10.0, theta_deg=30.0, material="clear_glass")
    board = with_name(chain.facing(range_m=20.0), "board", "board")
    scene = chain.scene(pane, board, materials=(catalogue_material("clear_glass"),))
    lanes = chain.run_stages(scene, chain.sensor("table1-apd", *chain.NARROW), interactions=0)
    assert lanes.hits.has_surface.all()
    assert lanes.hits.range_m[MIDDLE] == pytest.approx(10.0, rel=1e-6)
    assert (lanes.light.peak_power_w == 0.0).all()


def test_a_scene_without_triangles_is_an_error():
    empty = Part(vertices_m=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.uint32), material="grey")
    scene = chain.scene(Body(name="nothing", class_name="x", parts=(empty,)))
    with told("nothing to trace"):
        build_world(scene, wavelength_m=905e-9)


def test_points_in_both_frames_and_far_from_the_origin():
    """World points less the pose are sensor points; at a UTM northing they are doubles, good to a millimetre."""
    place = Pose.from_degrees(position_m=(4.5e5, 5.1e6, 300.0), yaw_deg=30.0, pitch_deg=5.0, roll_deg=-3.0)
    wall = chain.facing(range_m=40.0, size_m=60.0)
    world_wall = dataclasses.replace(wall, pose=place @ wall.pose)
    simulator = Simulator(chain.scene(world_wall, pose=place), chain.sensor("table1-apd", *WIDE, "tdc.walk='none'"))
    world, sensor = (simulator.render(seed=2, coordinates=frame) for frame in ("world", "sensor"))
    assert world.xyz_m.dtype == np.float64
    assert sensor.xyz_m.dtype == np.float32
    np.testing.assert_allclose(place.inverse_apply(world.xyz_m), sensor.xyz_m, atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(sensor.xyz_m, axis=1), sensor.range_m, rtol=1e-6)
    flat = sensor.select(sensor.status == 0)
    expected = flat.range_m * np.cos(flat.elevation_rad) * np.cos(flat.azimuth_rad)
    np.testing.assert_allclose(flat.xyz_m[:, 0], expected, rtol=1e-5)


def test_mounting_and_pose_compose():
    """A sensor turned left on a car that is turned left again looks back; its truth says how far the wall is."""
    behind = chain.facing(range_m=30.0)
    wall = dataclasses.replace(behind, pose=Pose.from_degrees(yaw_deg=180.0) @ behind.pose)
    sensor = chain.sensor("table1-apd", *chain.NARROW, "mounting.yaw_deg=90", "mounting.position_m=[0,2,0]")
    scene = chain.scene(wall, pose=Pose.from_degrees(yaw_deg=90.0))
    cloud = Simulator(scene, sensor).render()
    # The car's left is -x: the sensor stands at x = -2, and the wall's plane at x = -30.
    np.testing.assert_allclose(cloud.true_range_m, 28.0, rtol=1e-5)
    assert cloud.metadata["sensor_position_m"].split()[0].startswith("-2.0")


@pytest.mark.parametrize("step_deg", [2.0, 0.1])
def test_no_ray_passes_between_two_triangles(step_deg):
    """Rays that meet the shared edges of a closed mesh exactly (here all those at azimuth 0) stop there."""
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=2, radius=3.0)
    part = Part(vertices_m=mesh.vertices, faces=mesh.faces, material="grey")
    body = Body(name="ball", class_name="ball", parts=(part,), pose=Pose.from_degrees(position_m=(12.0, 0.0, 0.0)))
    steps = [
        f"scanner.{axis}_{setting}"
        for axis in ("azimuth", "elevation")
        for setting in (f"step_deg={step_deg}", "fov_deg=20")
    ]
    hits = chain.run_stages(chain.scene(body), chain.sensor("table1-apd", *steps)).hits
    assert hits.has_surface.sum() > 50
    assert (hits.range_m[hits.has_surface] < 12.0).all()
