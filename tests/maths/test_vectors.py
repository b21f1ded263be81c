"""Vectors across a beam."""

import numpy as np

from lidarscene.maths.vectors import box_around, cross, perpendicular_pair


def test_vectors_across_a_beam():
    for direction in ([1, 0, 0], [0, 0, 1], [0, 0, -1], [0.6, -0.48, 0.64], [0, 1, 0]):
        u, v = perpendicular_pair(tuple(np.array([float(c)]) for c in direction))
        matrix = np.array([direction, np.ravel(u), np.ravel(v)], dtype=float)
        np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-15)


def test_a_cross_product_is_numpys():
    a, b = np.random.default_rng(3).normal(size=(2, 3, 7))
    np.testing.assert_allclose(cross(tuple(a), tuple(b)), np.cross(a, b, axis=0))


def test_the_box_around_points_is_their_lowest_and_highest():
    for shape in ((1, 3), (7, 3), (7, 2)):
        points = np.random.default_rng(5).normal(size=shape)
        np.testing.assert_array_equal(box_around(points), [points.min(axis=0), points.max(axis=0)])
