"""Quaternions and angles of rotation matrices, and the matrices of them."""

import math

import numpy as np
import pytest
from helpers.formats import rotated
from scipy.spatial.transform import Rotation

from lidarscene.maths import rotations


@pytest.mark.parametrize("degrees", [0.0, 1e-7, 0.5, 90.0, 119.9, 120.0, 179.999, 180.0, 240.0, 359.9])
def test_quaternions_of_every_angle(degrees: float) -> None:
    """The turns are around 50 axes, among them those of the frame and of the cube's diagonals, against SciPy's
    matrices.
    """
    rng = np.random.default_rng(3)
    axes = np.concatenate([np.eye(3), -np.eye(3), np.sign(rng.normal(size=(8, 3))), rng.normal(size=(36, 3))])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    turns = Rotation.from_rotvec(axes * math.radians(degrees)).as_matrix()
    q = rotations.quaternions(turns)
    recovered = Rotation.from_quat(q[:, [1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(recovered, turns, atol=1e-14)


def test_quaternions_and_angles() -> None:
    """Reference: the quaternion turns vectors as the matrix does, and the angles make the matrix again.

    Turns by 180 degrees about each axis are in, where a formula by w alone fails. Tolerance: float64 rounding.
    """
    rng = np.random.default_rng(7)
    turns = [np.diag(d) for d in ([1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1])]
    for _ in range(50):
        drawn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        turns.append(drawn * np.sign(np.linalg.det(drawn)))
    for turn in turns:
        q = rotations.quaternion(turn)
        assert q[0] >= 0
        np.testing.assert_allclose(rotated(q, np.eye(3)), np.asarray(turn).T, atol=1e-14)
        yaw, pitch, roll = rotations.yaw_pitch_roll_rad(turn)
        cy, sy, cp, sp, cr, sr = (f(a) for a in (yaw, pitch, roll) for f in (np.cos, np.sin))
        z, y = (np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]]), np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]))
        np.testing.assert_allclose(z @ y @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]]), turn, atol=1e-14)
