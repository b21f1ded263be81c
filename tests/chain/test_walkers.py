"""Walkers in the chain: against linear blend skinning in NumPy, triangle by triangle, at the time of each pulse."""

from pathlib import Path

import numpy as np
import pytest
from helpers import chain, walker
from helpers.traffic import SENSOR, direction

from lidarscene import load_scene
from lidarscene.rendering.simulator import Simulator
from lidarscene.scene.scene import Scene

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
[[bodies.instances]]
position_m = [6, -0.6, 0]
motion = {{ speed_m_s = {speed} }}
[[bodies.instances]]
position_m = [5, 0.9, 0]
yaw_deg = 80
motion = {{ speed_m_s = {speed}, yaw_rate_deg_s = 20 }}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("walker")
    walker.write_walker(path / "walker.glb")
    return path


def scene_at(folder: Path, speed: float) -> Scene:
    path = folder / f"at_{speed:g}.toml"
    path.write_text(SCENE.format(speed=speed), encoding="utf-8")
    return load_scene(path)


def natural_speed(folder: Path) -> float:
    gait = scene_at(folder, 1.0).bodies[1].gait
    assert gait is not None
    return gait.speed_m_s


def test_points_are_on_the_walker_as_skinning_has_it_at_their_time(folder: Path) -> None:
    """The shape at the speed of the animation is that of the key frames. Tolerance: 1 mm along the
    beam, but for a beam in a hundred that grazes a leg, which may fall to its other side.
    """
    scene = scene_at(folder, natural_speed(folder))
    simulator = Simulator(scene, chain.sensor("table1-apd", *SENSOR))
    cloud = simulator.render(seed=1)
    cloud = cloud.select((cloud.status == 0) & (cloud.body > 0))
    assert np.bincount(cloud.body)[1:].min() > 50
    faces = walker.FACES
    off_m, speed_off = [], []
    for beam, time_s, body, range_m, radial in zip(
        direction(cloud), cloud.time_s, cloud.body, cloud.true_range_m, cloud.radial_velocity_m_s, strict=True
    ):
        shown = scene.bodies[body]
        assert shown.motion is not None
        assert shown.gait is not None
        hits = []
        for shift_s in (0.0, 1e-4):
            time = np.array([time_s + shift_s])
            phase, level = shown.gait.at(shown.motion, time)[0]
            assert level == pytest.approx(1.0, abs=1e-6)
            pose = shown.motion.at(time).pose()
            corners = pose.apply(walker.skinned(phase))[faces]
            hits.append((corners, *first_hit(np.array([0.0, 0.0, 1.0]), beam, corners)))
        corners, t, face, shares = hits[0]
        off_m.append(abs(t - range_m))
        if np.isfinite(t):
            before, after = (shares @ hit[0][face] for hit in hits)
            speed_off.append(abs((after - before) @ beam / 1e-4 - radial))
    assert np.mean(np.array(off_m) < 1e-3) > 0.99
    # Linear between the instants of the stride, in which a foot changes its speed by some cm/s.
    assert np.mean(np.array(speed_off) < 0.05) > 0.97


def first_hit(origin: np.ndarray, beam: np.ndarray, corners: np.ndarray) -> tuple[float, int, np.ndarray]:
    """Distance, triangle and shares of its corners (Moeller and Trumbore)."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(beam, second)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = 1.0 / np.einsum("ij,ij->i", first, across)
        offset = origin - corners[:, 0]
        u = np.einsum("ij,ij->i", offset, across) * share
        normal = np.cross(offset, first)
        v, t = normal @ beam * share, np.einsum("ij,ij->i", normal, second) * share
        t = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf)
    face = int(t.argmin())
    return float(t[face]), face, np.array([1 - u[face] - v[face], u[face], v[face]])
