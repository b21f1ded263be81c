"""Write what moved the sensor, for programs of odometry: samples of an IMU, and true poses.

IMU samples are a CSV as the EuRoC data sets have them (Burri and others, IJRR 2016); poses are lines of the TUM RGB-D
benchmark (Sturm and others, IROS 2012) or of KITTI's odometry (Geiger and others, CVPR 2012), by the suffix.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..files.atomic import put_text
from ..maths.pose import Pose
from ..maths.rotations import quaternion
from ..sensor.imu import ImuSamples
from .clock import stamp_ns

EUROC_COLUMNS = (
    "#timestamp [ns]",
    *(f"w_RS_S_{axis} [rad s^-1]" for axis in "xyz"),
    *(f"a_RS_S_{axis} [m s^-2]" for axis in "xyz"),
)


def write_imu(path: str | os.PathLike[str], samples: ImuSamples, *, epoch_ns: int) -> None:
    """Write a line for each sample: stamp in ns, angular velocity, specific force.

    Args:
        epoch_ns: from 1970 to the scene's second 0
    """
    values = np.hstack([samples.angular_velocity_rad_s, samples.specific_force_m_s2])
    lines = [
        ",".join([str(stamp_ns(time_s, epoch_ns)), *(f"{value:.9g}" for value in row)])
        for time_s, row in zip(samples.time_s.tolist(), values.tolist(), strict=True)
    ]
    put_text(path, "\n".join([",".join(EUROC_COLUMNS), *lines]) + "\n")


def write_poses(
    path: str | os.PathLike[str], times_s: Sequence[float], poses: Sequence[Pose], *, epoch_ns: int
) -> None:
    """Write a line for each pose in the world, in TUM's format, or in KITTI's if the name ends in .txt."""
    if Path(path).suffix.lower() == ".txt":
        matrices = [np.column_stack([pose.rotation, pose.position_m]) for pose in poses]
        lines = [" ".join(f"{value:.12e}" for value in matrix.ravel()) for matrix in matrices]
    else:
        lines = [_tum_line(stamp_ns(time_s, epoch_ns), pose) for time_s, pose in zip(times_s, poses, strict=True)]
    put_text(path, "".join(line + "\n" for line in lines))


def _tum_line(time_ns: int, pose: Pose) -> str:
    """Stamp in seconds, x, y, z, qx, qy, qz, qw."""
    seconds, nanoseconds = divmod(time_ns, 10**9)
    w, x, y, z = quaternion(pose.rotation)
    numbers = " ".join(f"{value:.12g}" for value in (*pose.position_m.tolist(), x, y, z, w))
    return f"{seconds}.{nanoseconds:09d} {numbers}"
