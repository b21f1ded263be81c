"""What users call: names, files and objects alike; overrides as people write them; mistakes in one line."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lidarscene
from lidarscene.errors import InputError, LidarSceneError
from lidarscene.maths.pose import Pose
from lidarscene.rendering.render_options import FrameOptions

COARSE = {"scanner": {"azimuth_step_deg": 2.0, "elevation_step_deg": np.float32(2.0)}}


def test_a_simulator_takes_names(mi: Any) -> None:
    simulator = lidarscene.Simulator("edges", "table1-sipm", pose=(1, 0, 1.8, 0, -2))
    scene, sensor = lidarscene.load_scene("edges"), lidarscene.load_sensor("table1-sipm")
    assert (simulator.scene.name, simulator.sensor.name) == (scene.name, sensor.name)
    expected = Pose.from_degrees(position_m=(1, 0, 1.8), pitch_deg=-2)
    np.testing.assert_array_equal(simulator.pose.position_m, expected.position_m)
    np.testing.assert_array_equal(simulator.pose.rotation, expected.rotation)
    assert lidarscene.Simulator(scene, world=simulator.world).sensor.name == scene.sensor_name


def test_overrides_of_scene_and_sensor(mi: Any) -> None:
    """Overrides make, as text, as a list and as a mapping, the same cloud; the scene's change its light."""
    steps = ["scanner.azimuth_step_deg=2.0", "scanner.elevation_step_deg=2.0"]
    dusk = lidarscene.render("edges", overrides=steps, scene_overrides="sun.illuminance_klux=1")
    same_dusk = lidarscene.render("edges", overrides=COARSE, scene_overrides={"sun": {"illuminance_klux": 1}})
    noon = lidarscene.render("edges", overrides=COARSE, scene_overrides=["sun.illuminance_klux=100"])
    np.testing.assert_array_equal(dusk.xyz_m, same_dusk.xyz_m)
    assert np.median(dusk.snr) > np.median(noon.snr)


@pytest.mark.parametrize("pose", [(1.0, 2.0, 3.0), [1, 2, 3, 40, 5], np.array([1.0, 2.0, 3.0, 40.0, 5.0, 6.0])])
def test_a_pose_in_numbers(pose: Any) -> None:
    six_numbers = [*pose] + [0.0] * (6 - len(pose))
    expected = Pose.from_degrees(
        position_m=tuple(six_numbers[:3]), yaw_deg=six_numbers[3], pitch_deg=six_numbers[4], roll_deg=six_numbers[5]
    )
    pose_from_numbers = FrameOptions(pose=pose).pose
    assert pose_from_numbers is not None
    np.testing.assert_array_equal(pose_from_numbers.position_m, expected.position_m)
    np.testing.assert_array_equal(pose_from_numbers.rotation, expected.rotation)


MISTAKES: list[tuple[Callable[..., object], tuple[object, ...], dict[str, object], str]] = [
    (lidarscene.load_sensor, (3,), {}, "sensor: must be a name, a file or a Sensor, got int"),
    (lidarscene.load_sensor, ("vlp-16",), {"overrides": 3}, 'overrides: must be "key=value", a list of these, or'),
    (lidarscene.load_scene, (3,), {}, "scene: must be a name, a file, a Scene, .*, got int"),
    (lidarscene.load_scene, ("car",), {"overrides": [1]}, 'scene_overrides: must be "key=value", a list'),
    (lidarscene.load_rig, (3,), {}, "rig: must be a file or a Rig, got int"),
    (lidarscene.render, ("edges",), {"pose": (1, 2)}, r"must be a Pose, a \(4, 4\) matrix, or x, .*, got \(1, 2\)"),
    (lidarscene.render, ("edges",), {"pose": "here"}, "pose: must be a Pose"),
    (lidarscene.render, ("edges",), {"pose": (0, 0, float("nan"))}, "pose: must be a Pose"),
    (lidarscene.render, ("edges",), {"seed": 1.5}, "seed: must be a whole number"),
    (lidarscene.render_frames, ("edges",), {"frames": 2.0}, "frames: must be a whole number"),
    (lidarscene.record, ("edges",), {"outputs": 3}, "outputs: must be a file or Outputs, got int"),
    (lidarscene.PointCloud.load, (3,), {}, "path: must be the name of a file, got int"),
]


@pytest.mark.parametrize(("call", "arguments", "options", "message"), MISTAKES)
def test_a_slip_is_one_line(call: Any, arguments: Any, options: Any, message: str) -> None:
    """Told by the call itself, also where frames come one by one."""
    with pytest.raises(LidarSceneError, match=message) as error:
        call(*arguments, **options)
    assert "\n" not in str(error.value)


def test_keys_of_a_sensors_file_are_replaced() -> None:
    """Keys have the file's units and checks; what follows from a key follows, and changes add up."""
    sensor = lidarscene.load_sensor("table1-apd", overrides="detector.gain=60")
    for changed in (
        sensor.replace("laser.peak_power_w=30"),
        sensor.replace({"laser.peak_power_w": 30}),
        sensor.replace(laser={"peak_power_w": 30}),
        lidarscene.load_sensor(sensor, overrides={"laser.peak_power_w": 30}),
    ):
        assert (changed.laser.peak_power_w, changed.detector.gain) == (30.0, 60.0)
        assert changed.sources["laser.peak_power_w"] == "--set laser.peak_power_w=30"
    with pytest.raises(InputError, match=r"laser.peak_power_w: must be >"):
        sensor.replace("laser.peak_power_w=-1")
    changed = dataclasses.replace(sensor, name="mine")
    with pytest.raises(InputError, match=r"^'mine': must be as `load_sensor` gave it .* dataclasses.replace"):
        changed.replace("laser.peak_power_w=30")


def test_names_of_the_catalogue() -> None:
    assert "table1-apd" in lidarscene.sensors()
    assert "car" in lidarscene.scenes()


def test_an_unknown_keyword_names_the_right_one() -> None:
    with pytest.raises(InputError, match=r"unknown option 'sensors'; did you mean sensor[?] known here: rays, "):
        lidarscene.render("car", sensors="table1-apd")
    for keyword, call in (
        ("illuminance", r'scene_overrides=\{"sun.illuminance_klux": ...\}'),
        ("peak_power_w", r' overrides=\{"laser.peak_power_w": ...\}'),
        ("frames", r"render_frames\(scene, sensor, frames=N\)"),
        ("output", r"cloud.save\(path\)"),
    ):
        with pytest.raises(InputError, match=rf"^unknown option '{keyword}'; .*{call}; known here: rays, "):
            lidarscene.render("car", **{keyword: 1})


def test_bodies_by_name() -> None:
    scene = lidarscene.load_scene("car")
    bodies: Any = scene.bodies
    assert bodies["car"] is bodies["car.0"]
    assert bodies["road"] is next(body for body in scene.bodies if body.name == "road")
    smaller = scene.remove("car")
    assert [body.name for body in smaller.bodies] == [body.name for body in scene.bodies if body.name != "car.0"]
    for name, message in (
        ("roed", "no body of this name; did you mean road[?]"),
        ("dashes", "must be one of dashes.0, dashes.1"),
        ("xyz", "no body of this name; the scene has road, side_road, .*, ..."),
    ):
        with pytest.raises(InputError, match=rf"^scene.bodies\['{name}'\]: {message}"):
            scene.remove(name)


def test_a_file_is_outputs_enough(mi: Any, tmp_path: Path) -> None:
    recorded = lidarscene.record("edges", outputs=tmp_path / "a.ply", overrides=COARSE)
    assert recorded.files == (tmp_path / "a.ply",)


def test_a_line_and_a_table_about_each() -> None:
    """Short: a scene or a sensor holds arrays of millions of numbers."""
    for described in (lidarscene.load_scene("car"), lidarscene.load_sensor("vlp-16")):
        assert len(repr(described)) < 200
        assert described.name in repr(described)
        assert described._repr_html_().count("<tr>") == len(described.facts())
