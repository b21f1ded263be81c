"""Logs for the Rerun viewer, read again by Rerun's own reader."""

import os
import shutil
import signal
import socket
import subprocess
import sys
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.mistakes import told
from helpers.waiting import wait_until
from helpers.walls import write_moving_rig

from lidarscene.cloud.pixels import images
from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.errors import OutputError
from lidarscene.formats import rerun as rerun_format
from lidarscene.formats.clock import EPOCH, stamp_ns, to_ns
from lidarscene.formats.cloud_columns import SENSOR_TO_VEHICLE
from lidarscene.labels.boxes import boxes
from lidarscene.maths.pose import Pose
from lidarscene.outputs.output_options import Outputs
from lidarscene.outputs.record import record
from lidarscene.rendering.simulator import Simulator
from lidarscene.scene.scene_file import load_scene
from lidarscene.sensor.imu import ImuSamples
from lidarscene.sensor.rig_file import load_rig
from lidarscene.sensor.sensor_file import load_sensor

COARSE = [
    f"scanner.{axis}_{key}_deg={value}"
    for axis, fov in (("azimuth", 40), ("elevation", 20))
    for key, value in (("fov", fov), ("step", 2.0))
]


@pytest.fixture(autouse=True)
def _rerun(library: Any) -> None:
    library("rerun")


def rows_of(path: Path) -> dict[str, list[dict[str, Any]]]:
    """Entity -> its rows in order of time: component -> value."""
    from rerun import chunk

    rows = defaultdict(list)
    for part in chunk.RrdReader(path).stream():
        batch = part.to_record_batch()
        columns = {name: batch[name] for name in batch.schema.names if name != "log_time"}
        if "scene_time" in columns:
            columns["scene_time"] = columns["scene_time"].cast("int64")  # nanoseconds
        rows[str(part.entity_path)] += [
            {name: column[row].as_py() for name, column in columns.items()} for row in range(batch.num_rows)
        ]
    for entity_rows in rows.values():
        entity_rows.sort(key=lambda row: row.get("scene_time", 0))
    return rows


def vectors(row: dict[str, Any], name: str) -> np.ndarray:
    return np.array(row[name], np.float64)


def listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def test_a_drive_is_there_again(mi: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Reference: the frames by `Simulator.render`. Tolerance: float32 of places up to 20 m."""
    monkeypatch.chdir(tmp_path)
    scene_name = write_moving_rig(tmp_path)
    record(scene_name, "table1-apd", outputs=Outputs("drive.rrd"), frames=3, overrides=COARSE)
    rows = rows_of(tmp_path / "drive.rrd")
    scene = load_scene(scene_name)
    simulator = Simulator(scene, load_sensor("table1-apd", overrides=COARSE), pose=scene.sensor_pose)
    (mounting,) = rows["/world/vehicle/lidar"]
    to_vehicle = vectors(mounting, "Transform3D:mat3x3")[0].reshape(3, 3).T
    for number in range(3):
        cloud = simulator.render(number=number)
        points, vehicle = rows["/world/vehicle/lidar/points"][number], rows["/world/vehicle"][number]
        assert points["scene_time"] == stamp_ns(cloud.frame_start_s, to_ns(EPOCH))
        # From the sensor over the vehicle into the world: matrices are stored column by column.
        xyz_m = vectors(points, "Points3D:positions") @ to_vehicle.T + vectors(mounting, "Transform3D:translation")
        to_world = vectors(vehicle, "Transform3D:mat3x3")[0].reshape(3, 3).T
        xyz_m = xyz_m @ to_world.T + vectors(vehicle, "Transform3D:translation")
        np.testing.assert_allclose(xyz_m, cloud.xyz_m, atol=1e-5)
        for name in ("range", "intensity", "status", "true_range", "body"):
            np.testing.assert_array_equal(points[name], cloud.column(name))
        (box,) = boxes(cloud, scene)
        logged = rows["/world/boxes"][number]
        np.testing.assert_allclose(vectors(logged, "Boxes3D:centers"), [box.pose.position_m], atol=1e-5)
        np.testing.assert_allclose(2 * vectors(logged, "Boxes3D:half_sizes"), [box.size_m], atol=1e-5)
        assert (logged["Boxes3D:labels"], logged["class_name"]) == (["wall"], ["car"])
        way_m = vectors(rows["/world/vehicle_path"][number], "LineStrips3D:strips")[0]
        assert way_m.shape == (number + 1, 3)
        np.testing.assert_allclose(way_m[-1], vectors(vehicle, "Transform3D:translation")[0], atol=1e-6)
        expected = images(cloud)["range"]
        image = np.frombuffer(bytes(rows["/images/lidar/range"][number]["DepthImage:buffer"][0]), np.float32)
        np.testing.assert_array_equal(image.reshape(expected.shape), expected)


def test_sensors_of_a_rig_share_a_log(mi: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each has its points, its place on the vehicle and its image; an IMU has its curves."""
    monkeypatch.chdir(tmp_path)
    scene = write_moving_rig(tmp_path)
    with open("rig.toml", "a") as file:
        file.write('[imu]\nmodel = "bmi088"\n')
    record(scene, load_rig("rig.toml"), outputs=Outputs("rig.rrd"), frames=2)
    rows = rows_of(tmp_path / "rig.rrd")
    for label, left_m in (("left", 1.0), ("right", -1.0)):
        assert len(rows[f"/world/vehicle/{label}/points"]) == len(rows[f"/images/{label}/range"]) == 2
        (mounting,) = rows[f"/world/vehicle/{label}"]
        np.testing.assert_allclose(mounting["Transform3D:translation"], [[0.0, left_m, 1.8]], atol=1e-6)
        assert "scene_time" not in mounting, "of all times"
    forces = np.array([row["Scalars:scalars"] for row in rows["/imu/vehicle/specific_force_m_s2"]])
    assert forces.shape[1] == 3
    # At rest on the vertical axis; the noise of the data sheet is 0.02 m/s2, biases are 0.2.
    assert forces[:, 2] == pytest.approx(9.81, abs=1.0)


def test_the_points_of_merged_sensors_are_in_the_world(mi, tmp_path, monkeypatch):
    """Reference: the merged cloud in a file of its own. They share no range image."""
    monkeypatch.chdir(tmp_path)
    scene = write_moving_rig(tmp_path)
    record(scene, load_rig("rig.toml"), outputs=Outputs("rig.rrd", merge=True, truth=False), frames=1)
    rows = rows_of(tmp_path / "rig.rrd")
    (points,) = rows["/world/lidar/points"]
    assert "true_range" not in points
    assert "range" in points
    assert set(points["sensor_index"]) == {0, 1}
    record(scene, load_rig("rig.toml"), outputs=Outputs("rig.npz", merge=True))
    np.testing.assert_array_equal(np.float32(points["Points3D:positions"]), PointCloud.load("rig.npz").xyz_m)
    assert not any(entity.startswith("/images") for entity in rows)


def test_an_entity_has_one_place(street_cloud: PointCloud, tmp_path: Path) -> None:
    """The sensor `a_imu` and the IMU of `a` are one entity."""
    pytest.importorskip("rerun")
    samples = ImuSamples(
        time_s=np.zeros(0), angular_velocity_rad_s=np.zeros((0, 3)), specific_force_m_s2=np.zeros((0, 3))
    )
    cloud = replace(street_cloud, metadata=dict(street_cloud.metadata) | {SENSOR_TO_VEHICLE: "1 0 0 1 0 1 0 0 0 0 1 2"})
    with told("a_imu | one place"), rerun_format.rerun_frames(tmp_path / "a.rrd") as append:
        append.append_imu(samples, label="a", mounting=Pose())
        append(cloud, "a_imu")


def test_a_disk_without_room_for_the_points_is_told(
    street_cloud: PointCloud, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: Rerun's thread waited for ever where a full disk refused its first large write."""
    room = rerun_format.PROBE_BYTES + 12 * len(street_cloud)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=room))
    with told("a.rrd | No space left", OutputError):
        street_cloud.save(tmp_path / "a.rrd")
    assert not list(tmp_path.iterdir())


def test_colours_without_classes_rise_with_the_intensity(street_cloud: Any, tmp_path: Path) -> None:
    cloud = street_cloud.without_truth()
    cloud.save(tmp_path / "a.rrd")
    (points,) = rows_of(tmp_path / "a.rrd")["/world/vehicle/lidar/points"]
    greys = np.array(points["Points3D:colors"], np.uint32) >> 24
    order = np.argsort(cloud.intensity, kind="stable")
    assert (np.diff(greys[order].astype(int)) >= 0).all()
    assert greys.max() > greys.min() + 150


def test_the_colours_of_classes_differ() -> None:
    log = object.__new__(rerun_format.RerunLog)
    log._colours = {}
    colours = [log._class_colour(f"class {number}") for number in range(12)]
    assert colours == [log._class_colour(f"class {number}") for number in range(12)]
    apart = [np.abs(np.subtract(a, b)).sum() for i, a in enumerate(colours) for b in colours[:i]]
    assert min(apart) > 30


def test_frames_go_to_a_viewer_as_they_come(mi, run, wall, tmp_path, monkeypatch):
    """Reference: Rerun's own server, which saves what it gets. Without one a line says how to start it."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    monkeypatch.setattr(rerun_format, "PORT", port)
    options = ["render", wall, "-o", "a.ply", "--rrd", "-q", *(f"--set={change}" for change in COARSE)]
    refused = run(*options)
    assert refused.code != 0
    assert refused.err.startswith(f"lidarscene: error: no Rerun viewer listens at 127.0.0.1:{port}")
    assert refused.err.endswith("; start one with the command: rerun\n")
    assert not Path("a.ply").exists()
    saved = tmp_path / "saved.rrd"
    command = [sys.executable, "-m", "rerun", "--port", str(port), "--save", str(saved)]
    environment = {"HOME": str(tmp_path), "PATH": "/usr/bin:/bin"}
    quiet = subprocess.DEVNULL
    server = subprocess.Popen(command, env=environment, stdout=quiet, stderr=quiet, start_new_session=True)
    try:
        wait_until(lambda: listens(port))
        assert run(*options).code == 0
        wait_until(lambda: b"/world/vehicle/lidar/points" in saved.read_bytes())
    finally:
        os.killpg(server.pid, signal.SIGKILL)  # Python starts the server as a child of its own
        server.wait()
