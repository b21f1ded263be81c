"""Rotations as quaternions, and as other programs write them.

File formats (ROS, OSI, KITTI) have conventions of their own; the conversions are here, and their signs with them.
"""

from __future__ import annotations

import math

import numpy as np

from .arrays import Numbers


def quaternions(rotation: Numbers) -> Numbers:
    """(..., 4) unit quaternions (w, x, y, z) of (..., 3, 3) rotations.

    The entries of a rotation give 4 q q^T. Each of its rows is q times a number; the row of the largest element of q
    is precise at every angle (Shepperd, J. Guidance and Control 1 (1978), 223).
    """
    r = rotation.reshape(-1, 9).T.copy().reshape(3, 3, -1)
    k = np.zeros((4, 4, r.shape[2]))
    k[0, 0] = 1.0 + r[0, 0] + r[1, 1] + r[2, 2]
    for i, j, m in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        k[1 + i, 1 + i] = 1.0 + r[i, i] - r[j, j] - r[m, m]
        k[1 + i, 1 + j] = k[1 + j, 1 + i] = r[i, j] + r[j, i]
        k[0, 1 + i] = k[1 + i, 0] = r[m, j] - r[j, m]
    largest = np.stack([k[i, i] for i in range(4)]).argmax(axis=0)
    w, x, y, z = rows = np.take_along_axis(k, largest[None, None], axis=0)[0]
    return np.asarray(rows / np.sqrt(w * w + x * x + y * y + z * z)).T.reshape(*rotation.shape[:-2], 4)


def quaternion(rotation: Numbers) -> tuple[float, float, float, float]:
    """Unit quaternion (w, x, y, z), w >= 0, of a (3, 3) rotation."""
    row = quaternions(np.asarray(rotation, dtype=np.float64))
    w, x, y, z = (math.copysign(1.0, row[0]) * row).tolist()
    return w, x, y, z


def yaw_pitch_roll_rad(rotation: Numbers) -> tuple[float, float, float]:
    """Angles of Rz(yaw) Ry(pitch) Rx(roll), positive pitch looks down, as in ROS, OSI and ISO 8855."""
    r = np.asarray(rotation, dtype=np.float64)
    pitch = math.asin(min(1.0, max(-1.0, -float(r[2, 0]))))
    return math.atan2(r[1, 0], r[0, 0]), pitch, math.atan2(r[2, 1], r[2, 2])
