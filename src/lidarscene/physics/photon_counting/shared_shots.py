"""Noise of columns that share shots: a window that moves along the ring (docs/photon_counting.md, T177, T178)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...maths.arrays import Numbers


def correlation(weights: Sequence[float], columns: Numbers | int) -> Numbers:
    """Correlation of the noise of two points so many columns apart (T177).

    sum_k w_k w_(k+m) / sum_k w_k^2: 1 - m / n for n equal weights, a^m for weights a^k.

    Args:
        weights: of the shots of a point's own column and of those before it
    """
    w = np.asarray(weights, np.float64)
    products = np.correlate(w, w, "full")[len(w) - 1 :] / (w @ w)
    return np.where(np.abs(columns) < len(w), products[np.minimum(np.abs(columns), len(w) - 1)], 0.0)


def scatter_share(weights: Sequence[float], *, points: int, step: int) -> float:
    """Scatter about a parabola through points of a ring, over the whole scatter of their noise (T178).

    Args:
        points: of the parabola
        step: columns from one to the next
    """
    place = np.arange(points)
    covariance = correlation(weights, step * (place[:, None] - place))
    bend = np.vander(place - place.mean(), 3)
    rest = np.eye(points) - bend @ np.linalg.pinv(bend)
    return float(np.sqrt(np.trace(rest @ covariance) / (points - 3)))
