"""Normals and velocities of points against trimesh, closed forms and differences of poses."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from helpers import chain, launches, panes
from helpers.formats import file_of, need
from helpers.mistakes import told
from helpers.run_seed import chosen
from helpers.traffic import SENSOR, traffic

from lidarscene import PointCloud, Simulator
from lidarscene.formats.cloud_columns import COLUMNS, OF_VECTORS, columns_of
from lidarscene.formats.registry import FORMATS
from lidarscene.maths.pose import Pose, direction_from_angles
from lidarscene.maths.trajectory import Course
from lidarscene.scene.scene import Body, Part

pytestmark = pytest.mark.usefixtures("mi")

FEW = ("scanner.azimuth_step_deg=0.8", "scanner.elevation_step_deg=0.8", "tdc.threshold_to_noise=4")


def echoes(cloud: PointCloud) -> PointCloud:
    return cloud.select((cloud.status == 0) & (cloud.body >= 0))


def beams(cloud: PointCloud) -> np.ndarray:
    """(n, 3) in the sensor's frame."""
    return np.stack(
        direction_from_angles(
            azimuth_rad=cloud.azimuth_rad.astype(float), elevation_rad=cloud.elevation_rad.astype(float)
        ),
        axis=1,
    )


def lumps() -> Body:
    """A rough mesh whose triangles are wound at random: an icosphere with radii of its own at each corner."""
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=2.0)
    rng = np.random.default_rng(5)
    faces = np.array(mesh.faces)
    flipped = rng.random(len(faces)) < 0.5
    faces[flipped] = faces[flipped][:, ::-1]
    part = Part(vertices_m=mesh.vertices * rng.uniform(0.8, 1.2, (len(mesh.vertices), 1)), faces=faces, material="grey")
    return Body(
        name="lumps",
        class_name="lumps",
        parts=(part,),
        pose=Pose.from_degrees(position_m=(12.0, 1.0, 0.0), yaw_deg=40.0, pitch_deg=15.0, roll_deg=-70.0),
    )


@pytest.mark.parametrize("moves", [False, True])
def test_normals_are_those_of_the_triangles(moves: bool) -> None:
    """The triangle is the one nearest to the true point, by trimesh. Single precision; one in a hundred may be beside
    an edge, where the nearest triangle is the neighbour.
    """
    trimesh = pytest.importorskip("trimesh")
    body = lumps()
    observed_body = dataclasses.replace(body, motion=Course(start=body.pose)) if moves else body
    sensor = chain.sensor("table1-apd", *FEW, "scanner.azimuth_step_deg=0.3")
    place = Pose.from_degrees(position_m=(1.0, 0.5, 0.2), yaw_deg=8.0, pitch_deg=-3.0)
    simulator = Simulator(chain.scene(observed_body), sensor, vectors=True, pose=place)
    cloud = echoes(simulator.render())
    cloud = cloud.select(slice(None, None, 3))
    assert len(cloud) > 150
    stand = simulator.motion.pose
    towards = beams(cloud) @ stand.rotation.T
    points = stand.position_m + towards * cloud.true_range_m[:, None]
    (part,) = body.parts
    assert isinstance(part, Part)
    mesh = trimesh.Trimesh(body.pose.apply(part.vertices_m), part.faces, process=False)
    _, _, nearest = trimesh.proximity.closest_point_naive(mesh, points)
    expected = np.array(mesh.face_normals)[nearest]
    expected *= -np.sign((expected * towards).sum(axis=1, keepdims=True))
    close = np.abs(cloud.normals - expected).max(axis=1) < 1e-5
    assert close.mean() > 0.99
    np.testing.assert_allclose(np.linalg.norm(cloud.normals, axis=1), 1.0, atol=1e-6)
    assert not cloud.velocities_m_s.any()
    # In the sensor's frame the same, turned.
    sensor_cloud = echoes(simulator.render(coordinates="sensor")).select(slice(None, None, 3))
    np.testing.assert_allclose(sensor_cloud.normals @ stand.rotation.T, cloud.normals, atol=1e-6)
    for name in OF_VECTORS:
        np.testing.assert_allclose(getattr(cloud.in_sensor_frame(), name), getattr(sensor_cloud, name), atol=1e-6)


def test_normals_of_a_sphere() -> None:
    """Normals lie along its radii, to single precision of 12 m over a radius of 1 m."""
    scene = chain.scene(chain.ball(at=(12.0, 0.5, 0.3), radius_m=1.0))
    cloud = echoes(Simulator(scene, chain.sensor("table1-apd", *FEW), vectors=True).render())
    assert len(cloud) > 20
    mounting = chain.sensor("table1-apd").mounting
    points = mounting.apply(beams(cloud) * cloud.true_range_m[:, None])
    np.testing.assert_allclose(cloud.normals, points - [12.0, 0.5, 0.3], atol=2e-5)


def test_velocities_are_differences_of_poses() -> None:
    """Deskewed points of what moves: where they are fixed on their bodies, 2e-4 s around the pulse. The sensor drives a
    curve: in the raw cloud they are as it saw them. Tolerances: second derivatives below 100 m/s2 of single precision
    tables, 1e-3 m/s; the true place of a point is good to 0.1 mm.
    """
    scene = traffic()
    simulator = Simulator(scene, chain.sensor("table1-apd", *SENSOR), vectors=True)
    raw = simulator.render(seed=1)
    cloud = raw.deskew(simulator.motion)
    is_echo = (cloud.status == 0) & (cloud.body >= 0)
    raw, cloud = raw.select(is_echo), cloud.select(is_echo)
    sensor = simulator.motion.at(cloud.time_s)
    towards = np.einsum("nij,nj->ni", sensor.rotation, beams(cloud))
    points = sensor.position_m + towards * cloud.true_range_m[:, None]
    step_s, expected = 1e-4, np.zeros_like(points)
    for number, body in enumerate(scene.bodies):
        of_body = np.flatnonzero(cloud.body == number)
        if body.motion is None or not len(of_body):
            continue
        before, pose_at_echo, after = (
            body.motion.at(cloud.time_s[of_body] + shift) for shift in (-step_s, 0.0, step_s)
        )
        local = np.einsum("nji,nj->ni", pose_at_echo.rotation, points[of_body] - pose_at_echo.position_m)
        shifted_points = [
            shifted_pose.position_m + np.einsum("nij,nj->ni", shifted_pose.rotation, local)
            for shifted_pose in (before, after)
        ]
        expected[of_body] = (shifted_points[1] - shifted_points[0]) / (2 * step_s)
    assert np.abs(expected).max() > 5.0
    assert len(np.unique(cloud.body)) == 4
    np.testing.assert_allclose(cloud.velocities_m_s, expected, atol=1e-3)
    # Along the beam they are the radial velocity, with the sensor's own motion.
    of_body = (sensor.velocity_m_s * towards).sum(axis=1)
    np.testing.assert_allclose((expected * towards).sum(axis=1) - of_body, cloud.radial_velocity_m_s, atol=2e-3)
    # The raw cloud is that of a sensor that thinks that it stood still.
    start = simulator.motion.at(np.zeros(1)).rotation[0]
    in_sensor_frame = np.einsum("nji,nj->ni", sensor.rotation, expected) @ start.T
    np.testing.assert_allclose(raw.velocities_m_s, in_sensor_frame, atol=1e-3)
    facing = (cloud.normals * towards).sum(axis=1)
    np.testing.assert_allclose(-facing, np.cos(cloud.incidence_angle_rad), atol=1e-5)


@pytest.mark.parametrize("options", chosen(1, [{}, {"rays": 3}]), ids=str)
def test_they_change_no_other_column_and_nothing_is_compiled_twice(options) -> None:
    """The scene has panes too, where pulses go two ways; the first frame has all kernels."""
    wall, glass = chain.facing(range_m=30.0, size_m=80.0), panes.pane(8.0, 20.0)
    scene = dataclasses.replace(chain.scene(wall, glass, materials=panes.MATERIALS))
    sensor = chain.sensor("table1-apd", *FEW)
    plain = Simulator(scene, sensor, **options)
    cloud = plain.render()
    with launches.launched() as before:
        plain.render(seed=4)
    with_vectors = Simulator(scene, sensor, vectors=True, **options)
    with launches.launched() as first:
        vector_cloud = with_vectors.render()
    with launches.launched(after=first) as later:
        with_vectors.render(seed=4)
    assert len(later) == len(before)
    assert not cloud.has_vectors
    assert [c.name for c in vector_cloud.columns] == [c.name for c in COLUMNS]
    for column in columns_of(truth=True, vectors=False):
        np.testing.assert_array_equal(vector_cloud.column(column.name), cloud.column(column.name), err_msg=column.name)
    behind_glass = echoes(vector_cloud).select(echoes(vector_cloud).interactions == 1)
    assert len(behind_glass) > 20
    np.testing.assert_allclose(behind_glass.normals, np.tile([-1.0, 0.0, 0.0], (len(behind_glass), 1)), atol=1e-6)


@pytest.mark.parametrize("name", [name for name, format_of_file in FORMATS.items() if format_of_file.read])
def test_files_have_them(name: str, tmp_path: Path) -> None:
    need(name)
    cloud = Simulator(traffic(), chain.sensor("table1-apd", *FEW), vectors=True).render(coordinates="sensor")
    cloud.save(file_of(tmp_path, name), format=name)
    read = PointCloud.load(file_of(tmp_path, name), format=name)
    assert read.has_vectors
    for name in OF_VECTORS:
        np.testing.assert_array_equal(getattr(read, name), getattr(cloud, name))
    assert not read.without_truth().has_vectors


def test_a_cloud_without_points_has_the_columns() -> None:
    simulator = Simulator(chain.scene(chain.ball(at=(-9.0, 0.0, 0.0))), chain.sensor("table1-apd", *FEW), vectors=True)
    assert simulator.empty().has_vectors
    assert set(OF_VECTORS) <= {c.attribute for c in simulator.render().columns}
    with told("vectors=True"):
        _ = Simulator(chain.scene(chain.ball(at=(9.0, 0.0, 0.0))), chain.sensor("table1-apd")).empty().normals
