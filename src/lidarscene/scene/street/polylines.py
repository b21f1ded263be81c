"""Lines through points, (k, 3), as road networks have them: ways along them, and places beside them."""

from __future__ import annotations

import math

import numpy as np

from ...maths.arrays import Numbers
from .pieces import Tables, placed


def ways_m(line_m: Numbers) -> Numbers:
    """(k,) way along a line in the plane up to each of its points."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line_m[:, :2], axis=0).T))])


def integral(at: Numbers, node: Numbers, value: Numbers) -> Numbers:
    """Integral of straight lines between values at nodes, from the first of them to (n,) places."""
    number = np.clip(np.searchsorted(node, at, side="right") - 1, 0, len(node) - 2)
    beyond = 0.5 * (at - node[number]) * (value[number] + np.interp(at, node, value))
    # `scipy.integrate` has this sum, too, but takes 0.2 s to import.
    sums = np.cumsum(0.5 * np.diff(node) * (value[1:] + value[:-1]))
    return np.asarray(np.concatenate([[0.0], sums])[number] + beyond)


def way_length_m(line_m: Numbers) -> float:
    """Length of a line in the plane."""
    return float(ways_m(line_m)[-1])


def along(line_m: Numbers, way_m: Numbers, left_m: Numbers | float = 0.0) -> Numbers:
    """(n, 3) x, y [m] and heading [rad] at places along a line, and to the left of it."""
    step, at_m = np.diff(line_m[:, :2], axis=0), ways_m(line_m)
    segment = np.clip(np.searchsorted(at_m, way_m, side="right") - 1, 0, len(step) - 1)
    heading = np.arctan2(step[segment, 1], step[segment, 0])
    x_m, y_m = (np.interp(way_m, at_m, line_m[:, axis]) for axis in (0, 1))
    return np.stack([x_m - left_m * np.sin(heading), y_m + left_m * np.cos(heading), heading], axis=1)


def poses_along(
    line_m: Numbers, way_m: Numbers, left_m: float = 0.0, *, z_m: float = 0.0, turn_deg: float = 0.0
) -> list[Tables]:
    """Poses at places along a line and to the left of it, turned against it."""
    places = along(line_m, way_m, left_m).tolist()
    return [placed(x_m, y_m, z_m, math.degrees(heading) + turn_deg) for x_m, y_m, heading in places]


def beside(line_m: Numbers, way_m: Numbers, left_m: Numbers | float) -> Numbers:
    """(n, 3) places to the left of a line, at its height."""
    return np.column_stack([along(line_m, way_m, left_m)[:, :2], on_line(line_m, way_m)[:, 2]])


def runs(flags: Numbers) -> list[list[int]]:
    """Begin and end of each run of true flags, the end left out."""
    ends: list[list[int]] = np.flatnonzero(np.diff(flags, prepend=False, append=False)).reshape(-1, 2).tolist()
    return ends


def on_line(line_m: Numbers, way_m: Numbers) -> Numbers:
    """(n, 3) places along a line."""
    return np.stack([np.interp(way_m, ways_m(line_m), column) for column in line_m.T], axis=1)
