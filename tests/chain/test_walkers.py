"""Walkers in the chain: against linear blend skinning in NumPy and Open3D's rays, at the time of each pulse."""

import dataclasses
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from helpers import chain, launches, walker
from helpers.run_seed import chosen
from helpers.scene_text import scene_of
from helpers.traffic import SENSOR, direction, frozen

from lidarscene import catalog, load_scene
from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.labels.boxes import boxes
from lidarscene.maths.pose import Pose
from lidarscene.maths.trajectory import Course
from lidarscene.rendering.simulator import Simulator
from lidarscene.scan import Pattern
from lidarscene.scene.scene import Body, Part, Scene

pytestmark = pytest.mark.usefixtures("mi")

SCENE = """
[sun]
azimuth_deg = 120
elevation_deg = 40
[sensor]
position_m = [0, 0, 1]
[[bodies]]
name = "ground"
primitive = "plane"
material = "asphalt"
size_m = [60, 60]
[[bodies]]
name = "walker"
mesh = "walker.glb"
class = "pedestrian"
material = "denim"
animation = "walk"
standing = "stand"
instances = [
    {{ position_m = [6, -0.6, 0], motion = {{ speed_m_s = {speed} }} }},
    {{ position_m = [5, 0.9, 0], yaw_deg = 80, motion = {{ speed_m_s = {speed}, yaw_rate_deg_s = 20 }} }},
]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("walker")
    walker.write_walker(path / "walker.glb")
    return path


def scene_at(folder: Path, speed: float, more: str = "") -> Scene:
    return scene_of(folder, SCENE.format(speed=speed) + more)


def natural_speed(folder: Path) -> float:
    gait = scene_at(folder, 1.0).bodies[1].gait
    assert gait is not None
    return gait.speed_m_s


def on_walkers(cloud: PointCloud) -> PointCloud:
    cloud = cloud.select((cloud.status == 0) & (cloud.body > 0))
    assert np.bincount(cloud.body)[1:3].min() > 50
    return cloud


def skinned_m(body: Body, time_s: float) -> np.ndarray:
    """(f, 3, 3) corners of all triangles in the world, by linear blend skinning at this very time."""
    assert body.motion is not None
    assert body.gait is not None
    ((phase, level),) = body.gait.at(body.motion, np.array([time_s]))
    standing, walking = walker.skinned(phase, amount=0.0), walker.skinned(phase)
    pose = body.motion.at(np.array([time_s])).pose()
    return pose.apply(standing + level * (walking - standing))[walker.FACES]


@pytest.mark.parametrize("share", chosen(1, [1.0, 0.55]))
def test_points_are_on_the_skin_at_their_time(folder: Path, open3d: ModuleType, share: float) -> None:
    """The shape at the speed of the animation is that of its key frames; at about half of it, between that and the one
    that stands. Tolerance: 1 mm along the beam, but for a beam in a hundred that grazes a leg and may pass it; 0.05 m/s
    for the velocity along the beam, which a key frame changes.
    """
    scene = scene_at(folder, share * natural_speed(folder))
    cloud = on_walkers(Simulator(scene, chain.sensor("table1-apd", *SENSOR)).render(seed=1))
    off_m, off_m_s = [], []
    for beam, time_s, body, range_m, radial in zip(
        direction(cloud), cloud.time_s, cloud.body, cloud.true_range_m, cloud.radial_velocity_m_s, strict=True
    ):
        corners, later = (skinned_m(scene.bodies[body], time_s + shift_s) for shift_s in (0.0, 1e-4))
        rays = open3d.t.geometry.RaycastingScene()
        faces = np.arange(corners.size // 3, dtype=np.uint32).reshape(-1, 3)
        rays.add_triangles(open3d.core.Tensor(corners.reshape(-1, 3).astype(np.float32)), open3d.core.Tensor(faces))
        ray = np.concatenate([[0.0, 0.0, 1.0], beam]).astype(np.float32)
        hit = rays.cast_rays(open3d.core.Tensor(ray[None]))
        off_m.append(abs(float(hit["t_hit"].numpy()[0]) - range_m))
        if off_m[-1] < 1e-2:
            face, (u, v) = int(hit["primitive_ids"].numpy()[0]), hit["primitive_uvs"].numpy()[0]
            moved_m = np.array([1 - u - v, u, v]) @ (later[face] - corners[face])
            off_m_s.append(abs(moved_m @ beam / 1e-4 - radial))
    assert np.mean(np.array(off_m) < 1e-3) > 0.99
    assert np.mean(np.array(off_m_s) < 0.05) > 0.97


def test_wheels_are_met_as_they_turn(tmp_path: Path, open3d: ModuleType) -> None:
    """A car crosses at 5 m: points of its wheels are where Open3D's rays meet them at their time, within a millimetre.

    Their velocity is that of the car and of a turn about the hub, v + w x r, whose lowest point stands still.
    """
    kind, name = catalog.shipped_meshes()["saloon_469"], catalog.path_of("meshes", "saloon_469")
    materials = ", ".join(f'{part} = "{value}"' for part, value in kind["materials"].items())
    (tmp_path / "scene.toml").write_text(
        f'[sensor]\nposition_m = [0, 0, 0.6]\n[[bodies]]\nname = "car"\nmesh = "{name}"\nclass = "car"\n'
        f'material = "car_paint_red"\nmaterials = {{ {materials} }}\nanimation = "{kind["animation"]}"\n'
        "position_m = [6, -1.2, 0]\nyaw_deg = 90\nmotion = { speed_m_s = 12 }\n"
    )
    scene = load_scene(tmp_path / "scene.toml")
    (body,) = scene.bodies
    steps = "scanner.azimuth_step_deg=0.2", "scanner.elevation_step_deg=0.2"
    cloud = Simulator(scene, chain.sensor("table1-apd", *SENSOR, *steps)).render(seed=1)
    of_wheels = [number for number, n in enumerate(cloud.material_names) if n in ("tyre_rubber", "brushed_aluminium")]
    cloud = cloud.select((cloud.status == 0) & np.isin(cloud.material, of_wheels))
    assert len(cloud) > 200
    tyres_m = np.concatenate([part.vertices_m for part in body.parts if part.name == "tyre"])
    radius_m = 0.5 * tyres_m[:, 2].max()
    hubs_m = np.unique(np.round(tyres_m[tyres_m[:, 2] > 1.9999 * radius_m][:, 0], 3))
    beams = direction(cloud)
    off_m, off_m_s = [], []
    for number in range(0, len(cloud), len(cloud) // 60):
        time_s, beam = float(cloud.time_s[number]), beams[number]
        rays = open3d.t.geometry.RaycastingScene()
        pose = body.motion.at(np.array([time_s])).pose()
        for part in body.posed(time_s, 0.0).parts:
            if part.name in ("tyre", "rim"):
                corners = pose.apply(part.vertices_m)[part.faces].reshape(-1, 3).astype(np.float32)
                faces = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
                rays.add_triangles(open3d.core.Tensor(corners), open3d.core.Tensor(faces))
        ray = np.concatenate([[0.0, 0.0, 0.6], beam]).astype(np.float32)
        hit_m = float(rays.cast_rays(open3d.core.Tensor(ray[None]))["t_hit"].numpy()[0])
        off_m.append(abs(hit_m - cloud.true_range_m[number]))
        x, _, z = pose.inverse_apply(np.array([[0.0, 0.0, 0.6]]) + hit_m * beam)[0]
        arm_m = np.array([x - hubs_m[np.abs(hubs_m - x).argmin()], z - radius_m])
        velocity_m_s = pose.rotation @ (12.0 * np.array([1.0 + arm_m[1] / radius_m, 0.0, -arm_m[0] / radius_m]))
        off_m_s.append(abs(velocity_m_s @ beam - cloud.radial_velocity_m_s[number]))
    assert np.quantile(off_m, 0.97) < 1e-3
    assert np.quantile(off_m_s, 0.97) < 0.1


def test_normals_and_shadows_are_those_of_the_body_posed(folder: Path) -> None:
    """Reference: rigid bodies of the shape and at the place of that time. All beams leave at once."""
    scene = scene_at(folder, natural_speed(folder))
    azimuth, elevation = np.meshgrid(np.radians(np.arange(-12, 18, 0.2)), np.radians(np.arange(-12, 2, 0.2)))
    beams = Pattern.create(
        azimuth_rad=azimuth.ravel(),
        elevation_rad=elevation.ravel(),
        time_s=np.zeros(azimuth.size),
        channel=None,
        frame_s=1e-3,
        jitter_rad=None,
        encoder_rad=None,
    )
    sensor = dataclasses.replace(chain.sensor("table1-apd", *SENSOR), scanner=beams)
    still = tuple(body.posed(0.2, 0.2) for body in scene.bodies)
    assert all(part.stride_m is None for body in still for part in body.parts if isinstance(part, Part))
    posed = frozen(dataclasses.replace(scene, bodies=still), 0.2)
    expected, cloud = (Simulator(each, sensor).render(seed=1, begin_s=0.2) for each in (posed, scene))
    assert np.bincount(cloud.body[cloud.status == 0])[1:].min() > 100
    np.testing.assert_array_equal(cloud.azimuth_rad, expected.azimuth_rad)
    echoes = (cloud.status == 0) & (expected.status == 0)
    assert echoes.mean() > 0.9
    expected, cloud = expected.select(echoes), cloud.select(echoes)
    agree = (cloud.body == expected.body) & (np.abs(cloud.true_range_m - expected.true_range_m) < 1e-3)
    assert agree.mean() > 0.999
    for name in ("incidence_angle_rad", "sun_angle_rad", "in_shadow"):
        apart = np.abs(getattr(cloud, name)[agree].astype(float) - getattr(expected, name)[agree])
        assert np.mean(apart < 2e-3) > 0.998, name


def test_a_walker_beside_an_image_is_met_where_it_walks(folder: Path) -> None:
    """A ball makes Mitsuba compute all hits itself, which has walkers as they stand."""
    ball = '[[bodies]]\nname = "ball"\nprimitive = "sphere"\nradius_m = 0.1\nmaterial = "concrete"\n'
    ball += "position_m = [9, 9, 5]\n"
    clouds = [
        on_walkers(Simulator(scene_at(folder, 1.2, more), chain.sensor("table1-apd", *SENSOR)).render(seed=1))
        for more in ("", ball)
    ]
    plain, other = clouds
    np.testing.assert_array_equal(plain.time_s, other.time_s)
    np.testing.assert_allclose(plain.true_range_m, other.true_range_m, atol=1e-6)
    np.testing.assert_allclose(plain.incidence_angle_rad, other.incidence_angle_rad, atol=1e-4)
    np.testing.assert_allclose(plain.xyz_m, other.xyz_m, atol=1e-4)


def test_a_box_encloses_its_walker_as_the_points_are(folder: Path) -> None:
    """Hardly any point is outside: a foot goes 3 cm while the sensor sees its body."""
    scene = scene_at(folder, 1.4)
    cloud = Simulator(scene, chain.sensor("os1-128", "scanner.columns_per_turn=2048")).render(seed=1)
    found = {box.name: box for box in boxes(cloud, scene)}
    standing_m = np.ptp(np.concatenate([part.vertices_m for part in scene.bodies[1].parts]), axis=0)
    for name in ("walker.0", "walker.1"):
        box = found[name]
        assert box.points_on > 100
        assert box.size_m[0] > standing_m[0] + 0.2
        on = cloud.xyz_m[(cloud.status == 0) & (np.array(cloud.body_names)[cloud.body] == name)]
        inside = np.abs(box.pose.inverse_apply(on)) <= 0.5 * box.size_m + 0.05
        assert inside.all(axis=1).mean() > 0.98


def test_a_later_frame_compiles_nothing(folder: Path) -> None:
    """Other frames, other speeds and other numbers of walkers are data."""
    sensor = chain.sensor("table1-apd", *SENSOR)
    scene = scene_at(folder, 1.2)
    with launches.launched() as before:
        Simulator(scene, sensor).render(seed=0)
    third = dataclasses.replace(scene.bodies[1], name="third", motion=Course(start=Pose(), speed_m_s=1.0))
    crowd = dataclasses.replace(scene_at(folder, 1.5), bodies=(*scene_at(folder, 1.5).bodies, third))
    with launches.launched(after=before):
        Simulator(crowd, sensor).render(seed=2, number=1)
