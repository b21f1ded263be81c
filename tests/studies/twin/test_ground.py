"""The ground's plane, and its farthest return."""

import numpy as np
import pytest
from helpers.twins import towards

from lidarscene.studies.twin.ground import farthest_ground_m, ground_plane, leaning_as_ground

HEIGHT_M = 1.8


def square(half_m: float, points: int) -> np.ndarray:
    """(points^2, 2) places."""
    return np.stack(np.meshgrid(*[np.linspace(-half_m, half_m, points)] * 2), axis=-1).reshape(-1, 2)


def test_a_plane_with_a_wall_behind_it() -> None:
    """7000 beams of 1 cm of noise onto a tilted ground, with a wall at 30 m all around."""
    rng = np.random.default_rng(1)
    elevation, azimuth = np.radians(np.linspace(-25.0, -2.0, 24))[:, None], np.linspace(0.0, 2.0 * np.pi, 300)[None, :]
    direction = towards(azimuth, elevation).reshape(-1, 3)
    down = 0.02 * direction[:, 0] - direction[:, 2]
    range_m = np.minimum(HEIGHT_M / np.maximum(down, 1e-9), 30.0 / np.hypot(*direction[:, :2].T))
    range_m += rng.normal(0.0, 0.01, range_m.shape)
    xyz_m = range_m[:, None] * direction
    plane = ground_plane(xyz_m)
    assert plane is not None
    # What is near the wall's foot adds some to the noise of a millimetre.
    np.testing.assert_allclose(plane, [-HEIGHT_M, 0.02, 0.0], atol=0.005)
    on_ground = np.abs(xyz_m[:, 2] + HEIGHT_M - 0.02 * xyz_m[:, 0]) < 0.1
    assert farthest_ground_m(xyz_m) == pytest.approx(np.percentile(range_m[on_ground], 99.9), rel=0.01)
    assert farthest_ground_m(rng.normal(0.0, 5.0, (50, 3))) is None


def test_the_ground_is_the_lowest_level_not_the_fullest() -> None:
    """A platform a metre above the ground has three points of five; a few stray points lie below both."""
    place = square(20.0, 50)
    number = np.arange(len(place))
    z = np.where(number % 5 < 2, -1.8, -0.8)
    z = np.where(number % 50 == 0, -4.0, z)
    xyz_m = np.column_stack([place, z])
    plane = ground_plane(xyz_m)
    assert plane is not None
    np.testing.assert_allclose(plane, [-1.8, 0.0, 0.0], atol=1e-6)
    assert farthest_ground_m(xyz_m) == pytest.approx(np.percentile(np.linalg.norm(xyz_m[z == -1.8], axis=1), 99.9))


def test_what_is_near_the_plane_is_ground_more_so_far_away() -> None:
    """0.1 m or 0.3 % of the range: 13 cm off at 50 m is ground, 20 cm at 60 m is not."""
    plane = np.column_stack([square(15.0, 40), np.full(1600, -1.8)])
    near, far = np.array([[50.0, 0.0, -1.67]]), np.array([[60.0, 0.0, -1.6]])
    farthest = [farthest_ground_m(np.concatenate([plane, np.repeat(point, 10, axis=0)])) for point in (near, far)]
    assert farthest == [pytest.approx(np.linalg.norm(near)), pytest.approx(np.linalg.norm(plane, axis=1).max())]


def test_what_leans_much_otherwise_or_runs_along_the_ground_keeps_its_normal() -> None:
    """The ground rises by 0.1: a normal 5 degrees off becomes its own, one 25 degrees off or of a level beam stays."""
    upward = np.array([-0.1, 0.0, 1.0]) / np.hypot(0.1, 1.0)
    tilted = [np.array([np.sin(angle), 0.0, np.cos(angle)]) for angle in np.radians([-10.7, 19.3, -10.7])]
    down, along = np.array([0.0, 0.6, -0.8]), np.array([0.0, 1.0, 0.0])
    leaning = leaning_as_ground(np.array([-1.8, 0.1, 0.0]), np.array(tilted), np.array([down, down, along]))
    np.testing.assert_allclose(leaning, [upward, tilted[1], tilted[2]], atol=1e-12)
    np.testing.assert_array_equal(leaning_as_ground(None, np.array(tilted), np.array([down] * 3)), tilted)
