"""Rotations as other programs write them: quaternions and angles of a rotation matrix.

File formats (ROS, OSI, KITTI) have conventions of their own; the conversions are here, and their signs with them.
"""

from __future__ import annotations

import math

import numpy as np

from .arrays import Numbers


def quaternion(rotation: Numbers) -> tuple[float, float, float, float]:
    """Unit quaternion (w, x, y, z), w >= 0, of a (3, 3) rotation.

    Its largest component is computed first, so that the others follow without cancellation (Shepperd, J. Guidance and
    Control 1, 223, 1978).
    """
    r = np.asarray(rotation, dtype=np.float64)
    trace = float(np.trace(r))
    # Four times the outer product of the quaternion with itself. Any row is a multiple of the quaternion; the one with
    # the largest diagonal is the most precise.
    products = np.array(
        [
            [1 + trace, r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], 1 + 2 * r[0, 0] - trace, r[0, 1] + r[1, 0], r[0, 2] + r[2, 0]],
            [r[0, 2] - r[2, 0], r[0, 1] + r[1, 0], 1 + 2 * r[1, 1] - trace, r[1, 2] + r[2, 1]],
            [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], 1 + 2 * r[2, 2] - trace],
        ]
    )
    row = products[int(np.argmax(np.diag(products)))]
    w, x, y, z = (math.copysign(1.0, row[0]) * row / np.linalg.norm(row)).tolist()
    return w, x, y, z


def yaw_pitch_roll_rad(rotation: Numbers) -> tuple[float, float, float]:
    """Angles of Rz(yaw) Ry(pitch) Rx(roll), positive pitch looks down, as in ROS, OSI and ISO 8855."""
    r = np.asarray(rotation, dtype=np.float64)
    pitch = math.asin(min(1.0, max(-1.0, -float(r[2, 0]))))
    return math.atan2(r[1, 0], r[0, 0]), pitch, math.atan2(r[2, 1], r[2, 2])
