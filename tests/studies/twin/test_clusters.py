"""Clusters that two clouds share."""

import numpy as np
import pytest

from lidarscene.maths.arrays import Numbers
from lidarscene.studies.twin.clusters import density_clusters, share_found_again


def test_clusters_are_those_of_scikit_learn() -> None:
    """Cores of a cluster are the same whatever the order; points at an edge of two may go to either."""
    cluster = pytest.importorskip("sklearn.cluster")
    rng = np.random.default_rng(8)
    points_m = np.concatenate([rng.normal(centre, 0.5, (60, 3)) for centre in rng.uniform(-6.0, 6.0, (8, 3))])
    fit = cluster.DBSCAN(eps=0.4, min_samples=5).fit(points_m)
    index = density_clusters(points_m, 0.4, 5)
    assert index.max() == fit.labels_.max()
    assert ((index < 0) == (fit.labels_ < 0)).all()
    cores = fit.core_sample_indices_
    pairs = np.unique(np.column_stack([index[cores], fit.labels_[cores]]), axis=0)
    assert len(pairs) == len(set(pairs[:, 0])) == len(set(pairs[:, 1]))


def test_points_apart_are_noise() -> None:
    assert (density_clusters(np.arange(30.0).reshape(10, 3), 0.5, 2) == -1).all()


def boxes(*places_m: tuple[float, float], height_m: float = 1.5) -> Numbers:
    """Boxes filled with points 0.1 m apart, 1.2 m wide, in the cells of the cubes."""
    axis = np.arange(0.05, 1.2, 0.1)
    grid = np.stack(np.meshgrid(axis, axis, np.arange(0.05, height_m, 0.1)), axis=-1).reshape(-1, 3)
    return np.concatenate([grid + np.array([*place_m, 0.0]) for place_m in places_m])


def test_clusters_are_found_again_where_half_of_both_is_shared() -> None:
    """Boxes of 1.2 m have 2 x 2 cubes a layer: one cube off they share a third, cut to 2 of 3 layers two thirds."""
    real = boxes((0.0, 0.0), (6.0, 0.0), (12.0, 0.0), (18.0, 0.0))
    simulated = np.concatenate([boxes((0.0, 0.0), (6.6, 0.0)), boxes((12.0, 0.0), height_m=1.15)])
    assert share_found_again(real, real) == (1.0, 4)
    assert share_found_again(real, simulated) == (0.5, 4)
    assert share_found_again(real, np.zeros((0, 3))) == (0.0, 4)
    assert share_found_again(np.zeros((0, 3)), real) is None


def test_a_simulated_cluster_of_fewer_voxels_is_found_too() -> None:
    """A column of 2 x 2 x 8 voxels is counted as recorded; without 4 of its 32 it fills the same cubes."""
    x, y, z = (axis.ravel() for axis in np.meshgrid(*(0.15 * (np.arange(n) + 0.5) for n in (2, 2, 8))))
    real = np.stack([x, y, z], axis=-1)
    is_top = (z > 1.0) & (x < 0.2) & (y < 0.2)
    simulated = real[~(is_top | ((x > 0.2) & (y > 0.2) & (z < 0.5)))]
    assert (len(real), len(simulated)) == (32, 28)
    assert share_found_again(real, simulated) == (1.0, 1)
    assert share_found_again(simulated, real) is None
