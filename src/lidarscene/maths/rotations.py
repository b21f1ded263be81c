"""Rotations as other programs write them: a rotation matrix in, quaternions and angles out."""

from __future__ import annotations

import math

import numpy as np

from .arrays import Numbers


def quaternion(rotation: Numbers) -> tuple[float, float, float, float]:
    """Unit quaternion (w, x, y, z), w not negative, of a (3, 3) rotation.

    By the largest of the four, from which the others follow without cancellation (Shepperd, J. Guidance and
    Control 1, 223, 1978).
    """
    r = np.asarray(rotation, dtype=np.float64)
    trace = float(np.trace(r))
    # Four times the product of each component with every other, the square of each on the diagonal.
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
    """Angles of Rz(yaw) Ry(pitch) Rx(roll), a positive pitch looking down, as ROS, OSI and ISO 8855 have it."""
    r = np.asarray(rotation, dtype=np.float64)
    pitch = math.asin(min(1.0, max(-1.0, -float(r[2, 0]))))
    return math.atan2(r[1, 0], r[0, 0]), pitch, math.atan2(r[2, 1], r[2, 2])
