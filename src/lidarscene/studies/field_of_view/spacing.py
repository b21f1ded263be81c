"""Angle from each direction to its nearest neighbour: an exact search on a grid of voxels, numpy only.

The nearest direction is the one whose unit vector is nearest: a chord c spans the angle 2 asin(c / 2). A sorted list of
voxel numbers replaces a tree: the neighbours of a point are in the 27 voxels around it, and voxels along z are
consecutive in the list.
"""

from __future__ import annotations

import itertools

import numpy as np

from ...maths.arrays import Numbers

QUERIES = 20_000
PERCENTILES = (5, 25, 50, 75, 95)

_AT_ONCE = 4_000_000  # candidates compared together, which bounds the memory


def nearest_deg(direction: Numbers, *, queries: int = QUERIES) -> Numbers:
    """Angles in degrees from unit vectors (n, 3) to their nearest other one; empty for fewer than two vectors.

    queries  number of vectors, taken evenly, whose neighbours are searched among all n

    The 27 voxels around a point hold every other point within one side of a voxel. If the nearest of them is within
    that distance, it is the nearest of all; else the search is repeated with voxels of twice the side.
    """
    count = len(direction)
    if count < 2:
        return np.zeros(0)
    pending = np.unique(np.linspace(0, count - 1, min(count, queries)).astype(np.int64))
    queried, chord = pending, np.full(count, np.inf)
    # First a 64th of the mean distance of evenly spread points: scan lines are far denser along than across.
    side = 0.25 * float(np.sqrt(4.0 * np.pi / count)) / 16.0
    while len(pending):
        squared = _nearest_squared(direction, pending, side)
        is_nearest = squared <= side * side
        chord[pending[is_nearest]] = np.sqrt(squared[is_nearest])
        pending = pending[~is_nearest]
        side *= 2.0
    return np.asarray(np.degrees(2.0 * np.arcsin(np.minimum(0.5 * chord[queried], 1.0))))


def _nearest_squared(points: Numbers, lanes: Numbers, side: float) -> Numbers:
    """Squared distance from the points ``lanes`` to the nearest other one in the 27 voxels around; inf without one."""
    stride = int(2.0 / side) + 4
    voxel = np.floor((points + 1.0) / side).astype(np.int64) + 1
    key = (voxel[:, 0] * stride + voxel[:, 1]) * stride + voxel[:, 2]
    order = np.argsort(key)
    sorted_key = key[order]
    best = np.full(len(lanes), np.inf)
    for dx, dy in itertools.product((-1, 0, 1), repeat=2):
        # Three voxels along z have consecutive keys: one search for all three.
        row = key[lanes] + (dx * stride + dy) * stride
        first_candidate = np.searchsorted(sorted_key, row - 1, side="left")
        count = np.searchsorted(sorted_key, row + 1, side="right") - first_candidate
        total = np.cumsum(count)
        begin = 0
        while begin < len(lanes):
            before = int(total[begin - 1]) if begin else 0
            stop = max(int(np.searchsorted(total, before + _AT_ONCE, side="right")), begin + 1)
            part = slice(begin, stop)
            _lower_to_nearest(points, lanes[part], order, first_candidate[part], count[part], best[part])
            begin = stop
    return best


def _lower_to_nearest(
    points: Numbers, lanes: Numbers, order: Numbers, low: Numbers, count: Numbers, best: Numbers
) -> None:
    """Lower ``best`` in place where one of ``count`` candidates, from ``low`` on in ``order``, is nearer."""
    with_candidates = np.flatnonzero(count)
    if len(with_candidates) == 0:
        return
    counts = count[with_candidates]
    starts = np.cumsum(counts) - counts
    query = np.repeat(with_candidates, counts)
    # All candidates of all queries in a row: each query's run starts at its own ``low``.
    candidate = order[
        np.arange(int(counts.sum())) - np.repeat(starts, counts) + np.repeat(low[with_candidates], counts)
    ]
    offset = points[candidate] - points[lanes[query]]
    squared = np.einsum("ij,ij->i", offset, offset)
    squared[candidate == lanes[query]] = np.inf  # a point is not its own neighbour
    best[with_candidates] = np.minimum(best[with_candidates], np.minimum.reduceat(squared, starts))
