"""Clusters of points above the ground, as perception finds them, and how many of them two clouds share.

Points are thinned to one in each voxel and clustered by density (DBSCAN; M. Ester, H.-P. Kriegel, J. Sander and X. Xu,
A density-based algorithm for discovering clusters, KDD 1996): a voxel with `LEAST_NEIGHBOURS` voxels within `REACH_M`,
its own among them, is a core; cores within reach of each other are one cluster, and so is what is in reach of a core.
"""

from __future__ import annotations

import numpy as np

from ...maths.arrays import Numbers
from .ground import ground_plane, height_above
from .tuning import ABOVE_GROUND_M, LEAST_OVERLAP, REACH_M, VOXEL_M

LEAST_NEIGHBOURS = 5
"""Least number of voxels within reach, its own among them, that make a core. This project's choice."""

LEAST_VOXELS = 30
"""Least number of voxels of a recorded cluster that is counted. This project's choice."""


def share_found_again(real_m: Numbers, simulated_m: Numbers) -> tuple[float, int] | None:
    """Share of the clusters of a recorded cloud that a simulated one has, too, and their number; None without clusters.

    Two clusters are the same if the cubes of edge `REACH_M` that both fill are at least `LEAST_OVERLAP` of those that
    one of them fills: finer than what joins them clusters have no shape.

    Args:
        real_m: (n, 3) points in the sensor's axes [m]
        simulated_m: (n, 3) points in the sensor's axes [m]
    """
    plane = ground_plane(real_m)
    real = _clusters(_above(real_m, plane), LEAST_VOXELS)
    if not real:
        return None
    simulated = _clusters(_above(simulated_m, plane))  # one voxel too few does not hide a cluster
    best = [max((len(cubes & others) / len(cubes | others) for others in simulated), default=0.0) for cubes in real]
    return float(np.mean(np.array(best) >= LEAST_OVERLAP)), len(real)


def density_clusters(points_m: Numbers, reach_m: float, least: int) -> Numbers:
    """Cluster index of each point by DBSCAN, (n,); -1 for noise."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    n = len(points_m)
    first, second = KDTree(points_m).query_pairs(reach_m, output_type="ndarray").reshape(-1, 2).T
    core = 1 + np.bincount(first, minlength=n) + np.bincount(second, minlength=n) >= least
    joined = core[first] & core[second]
    graph = coo_array((np.ones(joined.sum(), bool), (first[joined], second[joined])), shape=(n, n))
    label = np.asarray(connected_components(graph, directed=False)[1])
    for border, middle in ((first, second), (second, first)):
        at_edge = ~core[border] & core[middle]
        label[border[at_edge]] = label[middle[at_edge]]
    in_cluster = core.copy()
    in_cluster[first[core[second]]] = True
    in_cluster[second[core[first]]] = True
    index = np.full(n, -1)
    index[in_cluster] = np.unique(label[in_cluster], return_inverse=True)[1]
    return index


def _above(points_m: Numbers, plane: Numbers | None) -> Numbers:
    """Points more than `ABOVE_GROUND_M` from the ground's plane; all of them without a plane."""
    if plane is None:
        return points_m
    return np.asarray(points_m[np.abs(height_above(plane, points_m)) > ABOVE_GROUND_M])


def _clusters(points_m: Numbers, least_voxels: int = 1) -> list[set[tuple[int, ...]]]:
    """Cubes of edge `REACH_M` that each cluster of at least so many voxels fills."""
    middles_m = VOXEL_M * (np.unique(np.floor(points_m / VOXEL_M), axis=0) + 0.5)
    if not len(middles_m):
        return []
    index = density_clusters(middles_m, REACH_M, LEAST_NEIGHBOURS)
    cubes = np.floor(middles_m / REACH_M).astype(int)
    members = [cubes[index == number] for number in range(index.max() + 1)]
    return [set(map(tuple, voxels.tolist())) for voxels in members if len(voxels) >= least_voxels]
