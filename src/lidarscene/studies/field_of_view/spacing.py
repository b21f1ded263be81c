"""Angle from each direction to its nearest neighbour. Unit vectors are close exactly if their angles are."""

from __future__ import annotations

import numpy as np

from ...maths.arrays import Numbers

QUERIES = 20_000
PERCENTILES = (5, 25, 50, 75, 95)


def nearest_deg(direction: Numbers, *, queries: int = QUERIES) -> Numbers:
    """Angle in degrees from unit vectors (n, 3) to their nearest other one.

    Args:
        queries: number of evenly chosen vectors whose neighbours are wanted; they are searched among all n
    """
    from scipy.spatial import KDTree

    count = len(direction)
    if count < 2:
        return np.zeros(0)
    queried = np.unique(np.linspace(0, count - 1, min(count, queries)).astype(np.int64))
    # The nearest of all is the vector itself, or one like it.
    chord = KDTree(direction).query(direction[queried], k=2)[0][:, 1]
    return np.asarray(np.degrees(2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0))))
