"""Avalanches added up: the array's output at even times, one row for each shot.

Sums are recursive (running sum, or decay from sample to sample), so the cost does not depend on the pulse's length.
"""

from __future__ import annotations

import math

import numpy as np

from lidarscene.maths.arrays import Numbers

from .cells import CellArray
from .events import Avalanches


def waveforms(array, avalanches, *, shots, start_s, step_s, samples):
    """(shots, samples) output in units of one recovered cell, exact at each sample.

    For a box shape the step must be the dead time over a whole number.

    Raises:
        ValueError: if a value is not allowed
    """
    if array.shape == "box":
        return _box(array, avalanches, shots, start_s, step_s, samples)
    fall = _exponential(avalanches, shots, start_s, step_s, samples, array.fall_s)
    if array.rise_s == 0.0:
        return fall
    rise = _exponential(avalanches, shots, start_s, step_s, samples, array.rise_s)
    ratio = array.rise_s / array.fall_s
    summit = ratio ** (ratio / (1.0 - ratio)) * (1.0 - ratio)
    return np.asarray((fall - rise) / summit)


def _binned(avalanches: Avalanches, weight: Numbers, first: Numbers, shots: int, columns: int) -> Numbers:
    """(shots, columns) sum of the weights by the first sample that shows each avalanche."""
    inside = (first >= 0) & (first < columns)
    place = avalanches.shot[inside] * columns + first[inside]
    return np.bincount(place, weights=weight[inside], minlength=shots * columns).reshape(shots, columns)


def _box(array: CellArray, avalanches: Avalanches, shots: int, start_s: float, step_s: float, samples: int) -> Numbers:
    """Sum of the gains of the last dead time: a running sum minus its value one dead time earlier."""
    length = round(array.dead_time_s / step_s)
    if not math.isclose(length * step_s, array.dead_time_s, rel_tol=1e-9):
        raise ValueError(f"the dead time {array.dead_time_s} s is no multiple of the step {step_s} s")
    first = np.ceil((avalanches.time_s - start_s) / step_s).astype(np.int64) + length
    running = np.cumsum(_binned(avalanches, avalanches.gain, first, shots, length + samples), axis=1)
    return np.asarray(running[:, length:] - running[:, :-length])


def _exponential(avalanches, shots, start_s, step_s, samples, fall_s):
    """Sum of gain exp(-age / fall), carried from sample to sample."""
    since = (avalanches.time_s - start_s) / step_s
    first = np.maximum(np.ceil(since), 0.0)
    weight = avalanches.gain * np.exp(-(first - since) * step_s / fall_s)
    new = _binned(avalanches, weight, first.astype(np.int64), shots, samples)
    decay = math.exp(-step_s / fall_s)
    for j in range(1, samples):
        new[:, j] += decay * new[:, j - 1]
    return new
