"""Trajectory files: poses with their times, as CSV or in the TUM RGB-D format, read as a `Spline`.

Measured drives come in these two formats.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..files.encodings.csv import read_columns
from ..files.inputs import require_file
from ..maths.arrays import Numbers
from ..maths.pose import Pose, rotation_numbers
from ..maths.trajectory import Spline

PLACE = ("x_m", "y_m", "z_m")
ANGLES = ("yaw_deg", "pitch_deg", "roll_deg")
QUATERNION = ("qx", "qy", "qz", "qw")
TUM = ("time_s", *PLACE, *QUATERNION)
_KNOWN = {"time_s", *PLACE, *ANGLES, *QUATERNION}


def read_poses(path: Path) -> Spline:
    """Read the poses of a file as a spline.

    CSV: the first line names the columns time_s, x_m, y_m, z_m, and yaw_deg, pitch_deg, roll_deg (0 if left out) or qx,
    qy, qz, qw. Any other suffix: lines of time, x, y, z, qx, qy, qz, qw with # for comments, as in the TUM RGB-D
    benchmark (Sturm et al., IROS 2012).

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    columns = read_columns(path, is_wanted=_KNOWN.__contains__) if path.suffix.lower() == ".csv" else _read_tum(path)
    missing = [name for name in ("time_s", *PLACE) if name not in columns]
    if missing:
        raise InputError(f"{path}: column {missing[0]} is missing")
    for name, values in columns.items():
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            raise InputError(f"{path}: {name} of pose {bad[0] + 1} is not a finite number")
    positions_m = np.stack([columns[name] for name in PLACE], axis=1)
    poses = [
        Pose(position_m=position_m, rotation=rotation)
        for position_m, rotation in zip(positions_m, _rotations(path, columns), strict=True)
    ]
    return spline(columns["time_s"], poses, str(path))


def spline(time_s: Numbers, poses: list[Pose], where: str) -> Spline:
    """Spline through these poses.

    Raises:
        InputError: where `Spline` raises ValueError
    """
    try:
        return Spline(time_s=np.asarray(time_s), poses=tuple(poses))
    except ValueError as error:
        raise InputError(f"{where}: {error}") from None


def _read_tum(path: Path) -> dict[str, Numbers]:
    """Read columns of a file in the TUM format.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    require_file(path)
    try:
        with path.open(encoding="utf-8-sig") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about missing rows, which the caller reports
            values = np.loadtxt(file, ndmin=2, dtype=np.float64)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if values.size and values.shape[1] != len(TUM):
        raise InputError(f"{path}: lines must have 8 numbers ({' '.join(TUM)}), got {values.shape[1]}")
    return dict(zip(TUM, values.reshape(-1, len(TUM)).T, strict=True))


def _rotations(path: Path, columns: dict[str, Numbers]) -> list[Numbers]:
    """Rotation matrix of each pose, from quaternions or else angles.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    quaternion_columns = [name for name in QUATERNION if name in columns]
    if not quaternion_columns:
        zero = np.zeros(len(columns["time_s"]))
        angles = np.stack([columns.get(name, zero) for name in ANGLES], axis=1)
        return [Pose.from_degrees(yaw_deg=yaw, pitch_deg=pitch, roll_deg=roll).rotation for yaw, pitch, roll in angles]
    if len(quaternion_columns) < len(QUATERNION) or any(name in columns for name in ANGLES):
        raise InputError(f"{path}: columns must be {', '.join(QUATERNION)} or {', '.join(ANGLES)}, not a mixture")
    x, y, z, w = (columns[name] for name in QUATERNION)
    length = np.sqrt(x * x + y * y + z * z + w * w)
    wrong = np.flatnonzero(np.abs(length - 1.0) > 0.01)
    if len(wrong):
        raise InputError(f"{path}: quaternions must have length 1, got {length[wrong[0]]:.3g} for pose {wrong[0] + 1}")
    numbers = rotation_numbers(w / length, x / length, y / length, z / length)
    return list(np.stack(numbers, axis=-1).reshape(-1, 3, 3))
