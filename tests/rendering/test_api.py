"""What users call: names, files and objects alike; overrides as people write them; mistakes in one line."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.mistakes import calls, told

import lidarscene
from lidarscene.maths.pose import Pose
from lidarscene.rendering.render_options import NUMBERS, FrameOptions

COARSE = {"scanner": {"azimuth_step_deg": 2.0, "elevation_step_deg": np.float32(2.0)}}


def test_frames_up_to_the_last_number_there_is(mi: Any) -> None:
    """None is begun behind the last; one that has no number is told by the call, before the first is rendered."""
    number = NUMBERS.high - 1
    assert len(list(lidarscene.render_frames("edges", "table1-apd", frames=2, number=number, overrides=COARSE))) == 2
    with told(f"frame number | {NUMBERS.high} | {NUMBERS.high + 1}"):
        lidarscene.render_frames("edges", "table1-apd", frames=3, number=number, overrides=COARSE)


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


test_slips = calls(
    (lambda: lidarscene.load_sensor(3), "sensor | a name, a file or a Sensor | int"),
    (lambda: lidarscene.load_sensor("vlp-16", overrides=3), 'overrides | "key=value" | 3'),
    (lambda: lidarscene.load_scene(3), "scene | a name, a file, a Scene | int"),
    (lambda: lidarscene.load_scene("car", overrides=[1]), '"key=value" | 1'),
    (lambda: lidarscene.batch("job", ""), "output | name of a file | an empty text"),
    (lambda: lidarscene.batch("job", "out", workers=0), "workers | 1 | 1024 | 0"),
    (lambda: lidarscene.load_cloud(""), "path | name of a file | an empty text"),
    (lambda: lidarscene.load_rig(3), "rig | a file or a Rig | int"),
    (lambda: lidarscene.render("edges", pose="here"), "pose | Pose | x, y, z | 'here'"),
    (lambda: lidarscene.render("edges", pose=(0, 0, float("nan"))), "pose | Pose | x, y, z | nan"),
    (lambda: lidarscene.render("edges", seed=1.5), "seed | whole number | 1.5"),
    (lambda: lidarscene.render("edges", sed=3), "option 'sed' | rays, interactions, background_rays, vectors"),
    (lambda: lidarscene.render("car", sensors="table1-apd"), "option 'sensors' | sensor? | rays"),
    *(
        (lambda wrong=wrong: lidarscene.render("car", **{wrong: 1}), f"option {wrong!r} | {meant} | rays")
        for wrong, meant in (
            ("illuminance", 'scene_overrides={"sun.illuminance_klux": ...}'),
            ("peak_power_w", 'overrides={"laser.peak_power_w": ...}'),
            ("frames", "render_frames(scene, sensor, frames=N)"),
            ("output", "cloud.save(path)"),
        )
    ),
    (lambda: lidarscene.render_frames("edges", frames=2.0), "frames | whole number | float"),
    (lambda: lidarscene.record("edges", outputs=3), "outputs | a file or Outputs | int"),
    (lambda: lidarscene.PointCloud.load(3), "path | name of a file | int"),
    (lambda: lidarscene.load_sensor("apd-905").replace("laser.peak_power_w=-1"), "laser.peak_power_w: | >= 1e-06"),
    (
        lambda: dataclasses.replace(lidarscene.load_sensor("apd-905"), name="mine").replace("laser.pulse_fwhm_ns=3"),
        "'mine' | load_sensor | dataclasses.replace",
    ),
    *(
        (lambda name=name: lidarscene.load_scene("car").remove(name), f"scene.bodies[{name!r}] | {named}")
        for name, named in (("roed", "road?"), ("dashes", "dashes.0, dashes.1"), ("xyz", "road, side_road"))
    ),
)
"""Told by the call itself, also where frames come one by one."""


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
        assert changed.sources["laser.peak_power_w"] == "override laser.peak_power_w=30"


def test_names_of_the_catalogue() -> None:
    assert "table1-apd" in lidarscene.sensors()
    assert "car" in lidarscene.scenes()


def test_bodies_by_name() -> None:
    scene = lidarscene.load_scene("car")
    bodies: Any = scene.bodies
    assert bodies["car"] is bodies["car.0"]
    assert bodies["road"] is next(body for body in scene.bodies if body.name == "road")
    smaller = scene.remove("car")
    assert [body.name for body in smaller.bodies] == [body.name for body in scene.bodies if body.name != "car.0"]


def test_a_file_is_outputs_enough(mi: Any, tmp_path: Path) -> None:
    recorded = lidarscene.record("edges", outputs=tmp_path / "a.ply", overrides=COARSE)
    assert recorded.files == (tmp_path / "a.ply",)


def test_a_line_and_a_table_about_each() -> None:
    """Short: a scene or a sensor holds arrays of millions of numbers."""
    for described in (lidarscene.load_scene("car"), lidarscene.load_sensor("vlp-16")):
        assert len(repr(described)) < 200
        assert described.name in repr(described)
        assert described._repr_html_().count("<tr>") == len(described.facts())
