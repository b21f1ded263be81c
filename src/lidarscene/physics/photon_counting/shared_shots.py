"""Noise of columns that share shots: a window that moves along the ring (docs/photon_counting.md, T176 to T178)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ...maths.arrays import Lanes, Numbers, xp


def shares(window: Mapping[int, Lanes], step: Lanes) -> tuple[dict[int, Lanes], Lanes]:
    """Share of each column's noise in a point's, and the noise of the point over that on a level surface (T176a).

    On a surface that leans along the row the ranges of two columns differ by m steps, and a column counts less the more
    they do: g_m = w_m exp(-(m step)^2 / 2). The mean with these weights has the noise sqrt(sum g^2) / sum g.

    Args:
        window: weights by the number of columns from the point's own
        step: difference of the ranges of two neighbouring columns over noise and `Histogram.column_range_sigmas`

    Returns:
        factors on standard normal numbers of the columns, whose squares add up to the square of the noise, and it
    """
    weights = list(window.values())
    ops = xp(step, *weights)
    level = ops.sqrt(sum(weight * weight for weight in weights)) / sum(weights)
    counted = {column: weight * ops.exp(-0.5 * (column * step) ** 2) for column, weight in window.items()}
    scale = 1.0 / (level * sum(counted.values()))
    noise = scale * ops.sqrt(sum(weight * weight for weight in counted.values()))
    return {column: scale * weight for column, weight in counted.items()}, noise


def correlation(weights: Sequence[float], columns: Numbers | int) -> Numbers:
    """Correlation of the noise of two points so many columns apart (T177).

    sum_k w_k w_(k+m) / sum_k w_k^2: 1 - m / n for n equal weights, a^m for weights a^k. Weak returns have it, too,
    though real ones that take more columns (T176b) share more.

    Args:
        weights: of the shots of columns that follow each other
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
