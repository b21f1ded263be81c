"""Poses: which way yaw, pitch and roll turn, and in which order."""

import math

import numpy as np
import pytest

from lidarscene.maths.pose import Pose, direction_from_angles, rotation_matrix


@pytest.mark.parametrize(("yaw", "pitch", "roll"), [(0.3, 0.4, 0.0), (-2.0, 0.9, 0.7), (1.1, -0.6, -2.5)])
def test_forward_looks_along_yaw_and_pitch_whatever_the_roll(yaw: float, pitch: float, roll: float) -> None:
    """Positive is to the left and up; then the frame rolls about that, its left side up if positive."""
    turned = rotation_matrix(yaw_rad=yaw, pitch_rad=pitch, roll_rad=roll)
    ahead = direction_from_angles(azimuth_rad=np.array(yaw), elevation_rad=np.array(pitch))
    np.testing.assert_allclose(turned[:, 0], ahead, atol=1e-12)
    level = (-math.sin(yaw), math.cos(yaw), 0.0)
    above = np.cross(turned[:, 0], level)
    np.testing.assert_allclose(turned[:, 1], math.cos(roll) * np.array(level) + math.sin(roll) * above, atol=1e-12)


def test_there_and_back() -> None:
    """A pose after its inverse is none; points of a frame in a frame go through both."""
    outer = Pose.from_degrees(position_m=(1.0, 2.0, 3.0), yaw_deg=40.0, pitch_deg=-20.0, roll_deg=10.0)
    inner = Pose.from_degrees(position_m=(-4.0, 0.5, 1.0), yaw_deg=-100.0, roll_deg=60.0)
    points = np.random.default_rng(1).normal(size=(5, 3))
    np.testing.assert_allclose((outer @ inner).apply(points), outer.apply(inner.apply(points)), atol=1e-12)
    np.testing.assert_allclose(outer.inverse_apply(outer.apply(points)), points, atol=1e-12)
    np.testing.assert_allclose((outer @ outer.inverse()).apply(points), points, atol=1e-12)


@pytest.mark.parametrize("shape", [(3,), (1, 3), (4, 3), (4, 5, 3)])
def test_points_turn_and_move_whatever_their_shape(shape: tuple[int, ...]) -> None:
    """R p + t for each of them, in double precision; the points themselves stay."""
    pose = Pose.from_degrees(position_m=(1.0, -2.0, 3.0), yaw_deg=40.0, pitch_deg=-20.0, roll_deg=10.0)
    points = np.random.default_rng(1).normal(size=shape).astype(np.float32)
    before = points.copy()
    moved = np.einsum("ij,...j->...i", pose.rotation, points.astype(np.float64)) + pose.position_m
    np.testing.assert_allclose(pose.apply(points), moved, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(pose.inverse_apply(moved), points, rtol=0.0, atol=1e-14)
    np.testing.assert_array_equal(points, before)
