"""Which frames, which light, and what is refused."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.mistakes import told
from helpers.twins import recording_of, room_sweep, unit_json
from scipy.optimize import brentq

from lidarscene.files.toml import validate
from lidarscene.maths.pose import Pose
from lidarscene.recordings.units.unit_file import read_unit, write_unit
from lidarscene.scene.poses import read_poses
from lidarscene.scene.scene_file import load_scene
from lidarscene.scene.tables import SceneFile
from lidarscene.sensor.sensor_file import load_sensor
from lidarscene.studies.ranging.plane import Target, echoes_of_plane
from lidarscene.studies.recorded import background_w
from lidarscene.studies.twin import twin_files
from lidarscene.studies.twin.apparent_reflectivity import ReflectivityGauge
from lidarscene.studies.twin.surfels import Surfels
from lidarscene.studies.twin.twin_files import (
    COLUMNS,
    TwinFrames,
    build_twin,
    choose_frames,
    frame_pose,
    illuminance_klux,
    read_provenance,
    scene_text,
)


def test_frames_without_the_one_held_out(tmp_path: Path) -> None:
    recording = recording_of(tmp_path / "four.pcap", *[room_sweep()] * 4)
    assert choose_frames(recording, None, 2) == TwinFrames(frames=(0, 1, 3), held_out=2)
    assert choose_frames(recording, (1, 3), None).judged_frame == 1
    assert choose_frames(recording, (1, 3), 0).judged_frame == 0
    for frames, held_out, named in (
        (None, 4, "four.pcap | frame | 0 | 3 | 4"),
        ((2,), 2, "leave a frame"),
        (None, COLUMNS, "held_out columns | 4 frames"),
    ):
        with told(named):
            choose_frames(recording, frames, held_out)


def test_light_is_such_that_surfaces_have_the_recorded_background() -> None:
    """Rationale: two ways to the same count: the sensor's background by bisection, and the plane's by its echo."""
    sensor = load_sensor("os1-128", overrides=["scanner.columns_per_turn=1024"])
    plain = room_sweep()
    near_ir = 500.0 * np.asarray(plain.reflectivity) / 20.0
    recorded_w = float(background_w(sensor, 500.0)[0])
    target = Target(reflectivity=0.2, illuminance_klux=30.0, cos_sun=0.0, diffuse_share=1.0)
    klux = 30.0 * recorded_w / float(echoes_of_plane(sensor, target, 20.0 * np.ones(1)).background_power_w[0])
    sweep = room_sweep(near_ir=near_ir)
    klux_found = illuminance_klux(sweep, ReflectivityGauge.from_sweep(sweep), sensor)
    # Counts of the dark do not scale with the reflectivity; they are some 100 of 500.
    assert klux_found == pytest.approx(klux, rel=0.25)
    assert illuminance_klux(plain, ReflectivityGauge.from_sweep(plain), sensor) is None
    assert illuminance_klux(sweep, ReflectivityGauge.from_sweep(sweep), load_sensor("vlp-16")) is None


def test_the_files_of_a_twin(tmp_path: Path) -> None:
    signal = np.array(room_sweep().signal)
    signal[6, 0] *= 40.0  # brighter than white
    sweep = room_sweep(signal=signal)
    unit = unit_json(tmp_path / "unit.json")
    recording = recording_of(tmp_path / "room.pcap", sweep)
    text = build_twin(recording, TwinFrames(frames=(0,)), tmp_path / "twin", metadata=unit)
    assert "quads of 1 frame, 20 klux" in text
    scene = load_scene(tmp_path / "twin" / "scene.toml")
    assert {body.class_name for body in scene.bodies} >= {"smooth", "rough", "bright"}
    assert scene.sun.illuminance_klux == 20.0
    assert load_sensor(scene.sensor_name).scanner.pulses == 24 * 512
    provenance = read_provenance(tmp_path / "twin" / "scene.toml")
    assert sum(n for kind, n in provenance["quads"].items() if kind != "ground") == sweep.range_m.size
    assert (provenance["frames"], provenance["held_out"], provenance["illuminance_assumed"]) == ([0], None, True)
    bright = next(body for body in scene.bodies if body.class_name == "bright")
    material = scene.materials[bright.parts[0].material]
    # R_A of a retro-reflector by its sheet, so that what it returns is pi R_A of a matt board, with the diffuse part.
    returned = 0.8 + np.pi * float(material.parameters["retro_coefficient_cd_per_lx_m2"])
    gauge = ReflectivityGauge.from_sweep(sweep, load_sensor(scene.sensor_name))
    assert gauge is not None
    assert returned == pytest.approx(float(gauge.apparent(sweep, sweep.range_m)[6, 0]), rel=0.1)


def test_the_sensor_stands_where_the_held_out_frame_was_recorded(tmp_path: Path) -> None:
    start = Pose.from_degrees(position_m=(5e5, 5e6, 100.0), yaw_deg=90.0)
    moved = Pose.from_degrees(position_m=(0.6, -0.3, 0.05), yaw_deg=3.0, pitch_deg=-2.0, roll_deg=1.0)
    sweeps = (room_sweep(), room_sweep(pose=moved))
    frames = [
        replace(sweep, pose=pose, start_s=at_s)
        for sweep, pose, at_s in zip(sweeps, (start, start @ moved), (100.0, 100.1), strict=True)
    ]
    recording = recording_of(tmp_path / "two.osf", *frames)
    build_twin(recording, choose_frames(recording, None, 1), tmp_path / "twin", sensor="os1-128")
    scene = load_scene(tmp_path / "twin" / "scene.toml")
    assert np.allclose(scene.sensor_pose.position_m, moved.position_m, atol=1e-5)
    assert np.allclose(scene.sensor_pose.rotation, moved.rotation, atol=1e-6)
    held_out_pose = frame_pose(read_provenance(tmp_path / "twin" / "scene.toml"), 1, tmp_path)
    assert np.allclose(held_out_pose.rotation, moved.rotation)
    assert len(read_poses(tmp_path / "twin" / "poses.csv").poses) == 2


@pytest.mark.parametrize(("times", "is_possible"), [(0.9, True), (1.2, False)])
def test_light_that_no_sun_gives_is_a_line(tmp_path: Path, times: float, is_possible: bool) -> None:
    """Rationale: twins had 203, 359 and 876 klux without a word. The counts for ``times`` 130 klux are sought."""
    unit, plain = unit_json(tmp_path / "unit.json"), room_sweep()
    write_unit(read_unit(unit), unit, tmp_path / "unit.toml")
    sensor, reflectivity = load_sensor(tmp_path / "unit.toml"), np.asarray(plain.reflectivity)

    def excess_klux(counts: float) -> float:
        lit = room_sweep(near_ir=counts * reflectivity)
        klux = illuminance_klux(lit, ReflectivityGauge.from_sweep(lit, sensor), sensor)
        assert klux is not None
        return klux - 130.0 * times

    counts = float(brentq(excess_klux, 1.0, 1e5))
    recording = recording_of(tmp_path / "room.pcap", room_sweep(near_ir=counts * reflectivity))
    text = build_twin(recording, TwinFrames(frames=(0,)), tmp_path / "twin", metadata=unit)
    assert f"{130.0 * times:.0f} klux\n" in text
    assert ("more than the sun gives" in text) is not is_possible


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_strengths_that_are_no_numbers_are_in_no_file(tmp_path: Path, value: float) -> None:
    """A damaged recording: a few intensities and background counts that are not finite."""
    plain = room_sweep()
    intensity, near_ir = np.array(plain.reflectivity), np.full(plain.shape, 500.0)
    intensity[3:20, 7], near_ir[3:20, 9] = value, value
    sweep = room_sweep(signal=None, reflectivity=None, intensity=intensity, near_ir=near_ir)
    recording = recording_of(tmp_path / "room.pcap", sweep)
    build_twin(recording, TwinFrames(frames=(0,)), tmp_path / "twin", metadata=unit_json(tmp_path / "unit.json"))
    scene = load_scene(tmp_path / "twin" / "scene.toml")
    assert "bright" not in {body.class_name for body in scene.bodies}
    with_columns = replace(sweep, intensity=plain.reflectivity, near_ir=np.full(plain.shape, 500.0))
    klux = illuminance_klux(with_columns, ReflectivityGauge.from_sweep(with_columns), load_sensor(scene.sensor_name))
    # 34 of 8640 pixels are out of two medians, which they cannot move by more than their neighbours in rank.
    assert scene.sun.illuminance_klux == pytest.approx(klux, rel=0.01)


@pytest.mark.parametrize(("firmware", "is_calibrated"), [("v2.0.0-rc.2", False), ("v2.1.1", True), ("767798045", True)])
def test_reflectivities_of_old_firmware_are_a_line(tmp_path: Path, firmware: str, is_calibrated: bool) -> None:
    sweep = room_sweep(near_ir=np.full(room_sweep().shape, 50.0))
    recording = replace(recording_of(tmp_path / "room.pcap", sweep), metadata={"firmware": firmware})
    text = build_twin(recording, TwinFrames(frames=(0,)), tmp_path / "twin", sensor="os1-128")
    assert ("firmware 2.0 does not calibrate REFLECTIVITY" in text) is not is_calibrated
    last = text.splitlines()[-1]
    assert last.startswith("reflectivities: by the recording's signal, over the photons that the sensor file has of ")
    assert last.endswith(" times the recorded: fit finds the unit's photons")


def test_signals_alone_are_of_the_sensor_files_scale(tmp_path: Path) -> None:
    sweep = room_sweep(reflectivity=None, near_ir=np.full(room_sweep().shape, 50.0))
    text = build_twin(recording_of(tmp_path / "room.pcap", sweep), TwinFrames(frames=(0,)), tmp_path, sensor="os1-128")
    assert text.endswith("by the recording's signal, over the photons that the sensor file has of a white target")


def test_what_is_missing_is_one_line(tmp_path: Path) -> None:
    recording = recording_of(tmp_path / "room.pcap", room_sweep())
    with told("room.pcap | metadata"):
        build_twin(recording, TwinFrames(frames=(0,)), tmp_path / "twin")
    with told("sensor no.toml | no such file"):
        build_twin(recording, TwinFrames(frames=(0,)), tmp_path / "twin", sensor="no.toml")
    empty = recording_of(
        tmp_path / "empty.pcap",
        replace(room_sweep(), recorded=np.zeros(room_sweep().shape, bool), range_m=np.full(room_sweep().shape, np.nan)),
    )
    with told("empty.pcap | returns | none"):
        build_twin(empty, TwinFrames(frames=(0,)), tmp_path / "twin", sensor="os1-128")
    assert not (tmp_path / "twin" / "sensor.toml").exists()
    with told("scene.toml | twin.json"):
        read_provenance(tmp_path / "scene.toml")


@pytest.mark.parametrize("broken", ["place_frames", "write_columns", "scene_text", "json_text"])
def test_a_twin_that_is_broken_off_leaves_no_file(broken: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C between its files; what was there before stays as it was."""

    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    recording = recording_of(tmp_path / "room.pcap", room_sweep())
    old = tmp_path / "old" / "sensor.toml"
    old.parent.mkdir()
    old.write_text("old")
    monkeypatch.setattr(twin_files, broken, interrupt)
    for folder in ("new", "old"):
        with pytest.raises(KeyboardInterrupt):
            build_twin(recording, TwinFrames(frames=(0,)), tmp_path / folder, sensor="os1-128")
    assert {*tmp_path.rglob("*")} == {old, old.parent, *tmp_path.glob("room.*")}
    assert old.read_text() == "old"


@pytest.mark.parametrize("apparent", [0.79, 0.8, 0.801, 50.0, 1e9])
def test_bright_quads_of_any_strength_make_a_scene_that_can_be_read(apparent: float) -> None:
    """What is hardly brighter than matt white too, and what no sheet is: a material file takes 0.001 to 1e7."""
    text = scene_text("twin", [("bright0", "bright", apparent)], Pose(), 50.0)
    scene_file = validate(SceneFile, tomllib.loads(text), "scene.toml")
    coefficient = scene_file.materials["bright0"].retro_coefficient_cd_per_lx_m2
    assert coefficient == pytest.approx(np.clip((apparent - 0.8) / np.pi, 1e-3, 1e7), rel=1e-5)


def test_a_sky_of_so_much_light_is_found_again() -> None:
    """Surfaces of 20 % counted under 20 klux by the stages of `render`, dark counts included."""
    sensor = load_sensor("os1-128", overrides=["scanner.columns_per_turn=1024"])
    sky = Target(reflectivity=0.2, illuminance_klux=20.0, cos_sun=0.0, diffuse_share=1.0, transmittance=1.0)
    power_w = echoes_of_plane(sensor, sky, np.full(1, 20.0)).background_power_w
    counts = float(np.ravel(sensor.background_counts(power_w)[0])[0]) * float(sensor.tdc.ambient_s)
    sweep = room_sweep(signal=None, near_ir=np.full((24, 360), counts), reflectivity=np.full((24, 360), 20.0))
    assert illuminance_klux(sweep, ReflectivityGauge.from_sweep(sweep), sensor) == pytest.approx(20.0, rel=1e-4)
    dark = room_sweep(signal=None, near_ir=np.zeros((24, 360)), reflectivity=np.full((24, 360), 20.0))
    assert illuminance_klux(dark, ReflectivityGauge.from_sweep(dark), sensor) == 0.0


def test_quads_of_several_frames_are_where_each_frame_saw_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each frame sees one square ahead of it, under lights of 10, 90 and 20 klux: the median counts."""
    square = Surfels(
        corners_m=np.array([[[2.0, 1.0, 1.0], [2.0, -1.0, 1.0], [2.0, -1.0, -1.0], [2.0, 1.0, -1.0]]]),
        reflectivity=np.full(1, 0.3),
        kind=np.zeros(1, int),
    )
    klux = iter((10.0, 90.0, 20.0))
    monkeypatch.setattr(twin_files, "surfels_of_grid", lambda *_: square)
    monkeypatch.setattr(twin_files, "illuminance_klux", lambda *_: next(klux))
    poses = [Pose.from_degrees(position_m=(3.0 * k, k, 0.1 * k), yaw_deg=40.0 * k, pitch_deg=5.0 * k) for k in range(3)]
    frames = [room_sweep() for _ in poses]
    frames = [replace(frame, pose=poses[k], start_s=50.0 + k) for k, frame in enumerate(frames)]
    recording = recording_of(tmp_path / "three.osf", *frames)
    build_twin(recording, TwinFrames(frames=(0, 1, 2)), tmp_path / "twin", sensor="os1-128")
    scene = load_scene(tmp_path / "twin" / "scene.toml")
    assert scene.sun.illuminance_klux == 20.0
    (body,) = scene.bodies
    part = body.parts[0]
    triangles = np.asarray(part.vertices_m)[np.asarray(part.faces)]
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    # Two triangles of each square: of the same side, two square metres each, their mean is the square's middle.
    np.testing.assert_allclose(np.linalg.norm(across, axis=1), 4.0, rtol=1e-6)
    middles = triangles.mean(axis=1).reshape(3, 2, 3).mean(axis=1)
    for pose, middle, normal in zip(poses, middles, across.reshape(3, 2, 3), strict=True):
        np.testing.assert_allclose(middle, pose.rotation @ [2.0, 0.0, 0.0] + pose.position_m, atol=1e-6)
        np.testing.assert_allclose(normal[0], normal[1], atol=1e-6)
    assert read_poses(tmp_path / "twin" / "poses.csv").span_s == pytest.approx((0.0, 2.0))


def test_a_twin_of_columns_sees_the_even_ones() -> None:
    """`fit --scene` and `compare` take the odd ones: none is in both."""
    sweep = room_sweep()
    part = TwinFrames(frames=(0,), held_out=COLUMNS).visible_part(sweep)
    assert np.array_equal(part.range_m, sweep.range_m[:, ::2])
    assert TwinFrames(frames=(0,), held_out=3).visible_part(sweep) is sweep
