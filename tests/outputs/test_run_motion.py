"""IMUs and poses of a run: one process over all frames, in files, bags and packets."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import COARSE, Run
from helpers.walls import rig_text
from scipy.spatial.transform import Rotation

from lidarscene.maths.pose import Pose

SCENE = """
name = "bend"
[ego]
position_m = [0, 0, 0]
yaw_deg = 30
pitch_deg = 4
speed_m_s = 8
yaw_rate_deg_s = 25
[sensor]
name = "table1-apd"
position_m = [1, 0.5, 1.8]
yaw_deg = -20
[[bodies]]
name = "wall"
primitive = "box"
size_m = [1, 60, 10]
position_m = [30, 0, 0]
material = "concrete"
"""
IMU = ("--set=imu.rate_hz=100", "--set=imu.position_m=[0.1,-0.2,0.3]")
NEW_YEAR_NS = 1_767_225_600 * 10**9


@pytest.fixture
def bend(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bend.toml").write_text(SCENE)
    return "bend.toml"


def imu_file(path: str) -> tuple[np.ndarray, np.ndarray]:
    """Stamps [ns], and rates and forces, of a file as EuRoC's."""
    stamps = np.loadtxt(path, delimiter=",", usecols=0, dtype=np.int64)
    return stamps, np.loadtxt(path, delimiter=",", usecols=range(1, 7))


def test_poses_and_imu_are_of_one_motion(mi: Any, run: Run, bend: str) -> None:
    """Dead reckoning: the IMU of a bend, integrated from the first pose, ends where the last one is.

    Means of neighbouring samples, 100 a second, without noise: over a bend of w = 0.44 rad/s each step is off by
    (w dt)^2 / 8 of it, 0.1 mm in 28 m; the rest of the last step adds a dt^2 / 2, 0.2 mm.
    """
    length = ("--set=scanner.azimuth_fov_deg=40", "--set=laser.repetition_rate_khz=0.4", *COARSE[1:])
    ran = run("render", bend, "-o", "out", "--frames", "8", "--imu", "i.csv", "--poses", "p.tum", *IMU, *length)
    assert ran.code == 0, ran.err
    stamps, values = imu_file("i.csv")
    poses = np.loadtxt("p.tum")
    assert len(poses) == 8
    assert stamps[0] == NEW_YEAR_NS
    assert (np.diff(stamps) == 10_000_000).all()
    end_ns = round((poses[-1, 0] - poses[0, 0]) * 1e9)
    assert stamps[-1] - NEW_YEAR_NS >= end_ns
    rotation, positions = rotation_of(poses[0]), [lever(poses[0])]
    # The bend is even, so its state at the start follows from the first pose: 8 m/s along the vehicle.
    velocity = velocity_at_start(poses[0])
    for row in (0.5 * (values[1:] + values[:-1]))[: end_ns // 10_000_000]:
        middle = rotation @ turn(0.5 * 0.01 * row[:3])
        acceleration = middle @ row[3:] - [0.0, 0.0, 9.80665]
        positions.append(positions[-1] + 0.01 * velocity + 0.5e-4 * acceleration)
        velocity = velocity + 0.01 * acceleration
        rotation = rotation @ turn(0.01 * row[:3])
    rest_s = 1e-9 * (end_ns % 10_000_000)
    end_m = positions[-1] + rest_s * velocity
    assert np.linalg.norm(lever(poses[-1]) - lever(poses[0])) > 10.0
    np.testing.assert_allclose(end_m, lever(poses[-1]), atol=5e-4)


def rotation_of(row: np.ndarray) -> np.ndarray:
    return np.asarray(Rotation.from_quat(row[4:]).as_matrix())


def turn(angle_rad: np.ndarray) -> np.ndarray:
    return np.asarray(Rotation.from_rotvec(angle_rad).as_matrix())


def lever(row: np.ndarray) -> np.ndarray:
    """Place of the IMU, of a pose of the sensor."""
    return np.asarray(row[1:4] + rotation_of(row) @ [0.1, -0.2, 0.3])


def velocity_at_start(row: np.ndarray) -> np.ndarray:
    """Velocity of the IMU in the world at the first pose: v along the vehicle, and w x arm."""
    vehicle = Pose.from_degrees(yaw_deg=30.0, pitch_deg=4.0).rotation
    return np.asarray(8.0 * vehicle[:, 0] + np.cross(np.radians(25.0) * vehicle[:, 2], lever(row)))


def test_a_bag_has_the_samples_of_the_file(mi: Any, run: Run, bend: str, library: Callable[[str], Any]) -> None:
    """Reference: rosbags. Each sample once, between the frames, in the frame of the IMU and with its covariances."""
    highlevel, typesys = library("rosbags.highlevel"), library("rosbags.typesys")
    noise = ("--set=imu.model=bmi088", *IMU)
    options = ("--frames", "3", "--imu", "i.csv", *noise, *COARSE, "--set=laser.repetition_rate_khz=2")
    ran = run("render", bend, "-o", "a.mcap", *options)
    assert ran.code == 0, ran.err
    stamps, values = imu_file("i.csv")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    with highlevel.AnyReader([Path("a.mcap")], default_typestore=store) as bag:
        received = [
            (connection.topic, stamp, bag.deserialize(raw, connection.msgtype))
            for connection, stamp, raw in bag.messages()
        ]
    samples = [(stamp, message) for topic, stamp, message in received if topic == "/imu"]
    assert [stamp for stamp, _ in samples] == stamps.tolist()
    read = [
        [*(getattr(m.angular_velocity, a) for a in "xyz"), *(getattr(m.linear_acceleration, a) for a in "xyz")]
        for _, m in samples
    ]
    np.testing.assert_allclose(read, values, rtol=1e-8)
    message = samples[0][1]
    assert (message.header.frame_id, message.orientation_covariance[0]) == ("imu", -1.0)
    # 0.014 deg/s/sqrt(Hz) up to 50 Hz.
    assert message.angular_velocity_covariance[0] == pytest.approx(np.radians(0.014) ** 2 * 50.0)
    transforms = [message for topic, _, message in received if topic == "/tf_static"][-1].transforms
    places = {stamped.child_frame_id: stamped.transform.translation for stamped in transforms}
    on_vehicle = [1.0, 0.5, 1.8] + turn(np.radians([0.0, 0.0, -20.0])) @ [0.1, -0.2, 0.3]
    assert [getattr(places["imu"], axis) for axis in "xyz"] == pytest.approx(on_vehicle.tolist(), abs=1e-9)


def test_packets_of_an_ousters_imu(mi: Any, run: Run, bend: str, library: Callable[[str], Any]) -> None:
    """Reference: ouster-sdk, which reads 48 bytes in g and degrees per second, on a port of their own."""
    library("ouster.sdk")
    from ouster.sdk import core
    from ouster.sdk.pcap import PcapPacketSource

    options = ("--sensor", "os1-128", "--set=scanner.columns_per_turn=512", "--frames", "2", "--imu", "i.csv")
    ran = run("render", bend, "-o", "a.pcap", *options)
    assert ran.code == 0, ran.err
    stamps, values = imu_file("i.csv")
    info = core.SensorInfo(Path("a.json").read_text())
    assert info.imu_to_sensor_transform[:3, 3].tolist() == [6.253, -11.775, 7.645]
    reader, received = core.PacketFormat.from_info(info), []
    for _, packet in PcapPacketSource("a.pcap", meta=["a.json"]):
        if isinstance(packet, core.ImuPacket):
            times = int(packet.accel_ts()), int(packet.gyro_ts())
            rates = [getattr(reader, f"imu_av_{axis}")(packet.buf) for axis in "xyz"]
            received.append((*times, *rates, *(getattr(reader, f"imu_la_{axis}")(packet.buf) for axis in "xyz")))
    table = np.array(received)
    assert len(table) == len(stamps) == 20
    # Stamps of packets are doubles: 0.24 us today.
    np.testing.assert_allclose(table[:, :2] - stamps[:, None], 0.0, atol=300.0)
    np.testing.assert_allclose(np.radians(table[:, 2:5]), values[:, :3], rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(9.80665 * table[:, 5:], values[:, 3:], rtol=1e-6, atol=1e-6)


def test_synchronous_packets_of_an_ousters_imu(mi: Any, run: Run, bend: str, library: Callable[[str], Any]) -> None:
    """Reference: ouster-sdk, whose frames hold the samples that its own SLAM uses: 64 a turn, by column, in SI units.

    The run begins between two samples: 1/640 s has no whole number of periods in 33 ms.
    """
    sdk = library("ouster.sdk")
    sensor = ("--sensor", "os1-128", "--set=scanner.columns_per_turn=512", "--set=imu.rate_hz=640")
    ran = run("render", bend, "-o", "a.pcap", *sensor, "--frames", "3", "--begin", "0.033", "--imu", "i.csv")
    assert ran.code == 0, ran.err
    stamps, values = imu_file("i.csv")
    assert len(stamps) == 3 * 64
    source = sdk.open_source("a.pcap", meta=["a.json"], collate=False)
    frames = [frame_set[0] for frame_set in source]
    source.close()
    assert len(frames) == 3
    for index, frame in enumerate(frames):
        part = slice(64 * index, 64 * (index + 1))
        np.testing.assert_allclose(frame.field("IMU_GYRO"), values[part, :3], rtol=1e-6, atol=1e-7)
        np.testing.assert_allclose(frame.field("IMU_ACC"), values[part, 3:], rtol=1e-6, atol=1e-6)
        read_ns = np.asarray(frame.field("IMU_TIMESTAMP"), np.int64)
        np.testing.assert_allclose(read_ns - stamps[part], 0.0, atol=300.0)
        # The column that was measured then began before the sample, and the next one later.
        columns = np.asarray(frame.field("IMU_MEASUREMENT_ID"), int)
        since_ns = read_ns - np.asarray(frame.timestamp, np.int64)[columns]
        assert since_ns.min() >= -300
        assert since_ns.max() <= 0.1e9 / 512 + 300
        assert (np.asarray(frame.field("IMU_STATUS")) == 1).all()


def test_a_rig_has_files_of_each_imu(mi: Any, run: Run, bend: str) -> None:
    """The vehicle's without a label; poses of each sensor, or of the vehicle where all are merged."""
    sensor = "table1-apd", 'set = ["imu.rate_hz=100", "laser.repetition_rate_khz=2"]', "position_m = [0, 0, 1.8]"
    Path("rig.toml").write_text(
        '[imu]\nmodel = "adis16470"\nposition_m = [0, 0, 0.4]\n' + rig_text(("a", *sensor), ("b", *sensor))
    )
    options = ("--rig", "rig.toml", "--frames", "2", "--imu", "i.csv", "--poses", "p.txt", *COARSE)
    assert run("render", bend, "-o", "out", *options).code == 0
    assert sorted(path.name for path in Path().glob("*.[ct][sx][vt]")) == [
        "i.csv",
        "i_a.csv",
        "i_b.csv",
        "p_a.txt",
        "p_b.txt",
    ]
    assert np.loadtxt("p_a.txt")[0, 11] == pytest.approx(1.8 * np.cos(np.radians(4.0)), abs=1e-9)
    assert run("render", bend, "-o", "a.mcap", "--merge", *options).code == 0
    assert np.loadtxt("p.txt")[0, [3, 7, 11]].tolist() == [0.0, 0.0, 0.0]
