"""Files of what moved the sensor, as the programs read them that they are for."""

from pathlib import Path

import numpy as np
import pytest

from lidarscene.formats.motion_files import write_imu, write_poses
from lidarscene.maths.pose import Pose
from lidarscene.scene.poses import read_poses
from lidarscene.sensor.imu import ImuSamples

EPOCH_NS = 1_767_225_600 * 10**9
TIMES_S = (0.0, 0.099975168, 0.2)
POSES = tuple(
    Pose.from_degrees(position_m=(1.0 + n, -2.0, 0.5), yaw_deg=100.0 * n, pitch_deg=5.0, roll_deg=-20.0)
    for n in range(3)
)


def test_imu_as_euroc(tmp_path: Path) -> None:
    """Reference: the columns of EuRoC MAV, which Kalibr, OpenVINS and VINS read: ns, then rad/s, then m/s2."""
    rates, forces = np.arange(9.0).reshape(3, 3) / 7.0, 9.8 + np.arange(9.0).reshape(3, 3) / 3.0
    samples = ImuSamples(time_s=np.array(TIMES_S), angular_velocity_rad_s=rates, specific_force_m_s2=forces)
    write_imu(tmp_path / "imu.csv", samples, epoch_ns=EPOCH_NS)
    header, *lines = (tmp_path / "imu.csv").read_text().splitlines()
    assert header.split(",")[:2] == ["#timestamp [ns]", "w_RS_S_x [rad s^-1]"]
    assert [int(line.split(",")[0]) - EPOCH_NS for line in lines] == [0, 99_975_168, 200_000_000]
    read = np.loadtxt(tmp_path / "imu.csv", delimiter=",")[:, 1:]
    np.testing.assert_allclose(read, np.hstack([rates, forces]), rtol=1e-8)


def test_poses_as_tum(tmp_path: Path) -> None:
    """Our own scenes read them too; stamps keep the nanoseconds that a double loses."""
    write_poses(tmp_path / "poses.tum", TIMES_S, POSES, epoch_ns=EPOCH_NS)
    stamps = [line.split()[0] for line in (tmp_path / "poses.tum").read_text().splitlines()]
    assert stamps == ["1767225600.000000000", "1767225600.099975168", "1767225600.200000000"]
    path = read_poses(tmp_path / "poses.tum")
    for pose, written in zip(path.poses, POSES, strict=True):
        np.testing.assert_allclose(pose.position_m, written.position_m, atol=1e-11)
        np.testing.assert_allclose(pose.rotation, written.rotation, atol=1e-11)


def test_poses_as_kitti(tmp_path: Path) -> None:
    """Reference: KITTI's odometry: the upper three rows of the matrix, as pykitti reads them."""
    write_poses(tmp_path / "00.txt", TIMES_S, POSES, epoch_ns=0)
    for line, pose in zip((tmp_path / "00.txt").read_text().splitlines(), POSES, strict=True):
        matrix = np.fromstring(line, dtype=float, sep=" ").reshape(3, 4)  # as pykitti.odometry
        np.testing.assert_allclose(matrix[:, :3], pose.rotation, atol=1e-12)
        np.testing.assert_allclose(matrix[:, 3], pose.position_m, atol=1e-12)


@pytest.mark.parametrize("name", ["imu.csv", "poses.tum"])
def test_no_samples_are_a_file(tmp_path: Path, name: str) -> None:
    none = np.zeros((0, 3))
    if name.startswith("imu"):
        samples = ImuSamples(time_s=none[:, 0], angular_velocity_rad_s=none, specific_force_m_s2=none)
        write_imu(tmp_path / name, samples, epoch_ns=0)
    else:
        write_poses(tmp_path / name, (), (), epoch_ns=0)
    assert (tmp_path / name).is_file()
