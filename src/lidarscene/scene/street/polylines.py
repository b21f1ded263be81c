"""Lines through points, (k, 3), as road networks have them: ways along them, and places beside them."""

from __future__ import annotations

import numpy as np

from ...maths.arrays import Numbers


def ways_m(line_m: Numbers) -> Numbers:
    """(k,) way along a line in the plane up to each of its points."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line_m[:, :2], axis=0).T))])


def way_length_m(line_m: Numbers) -> float:
    """Length of a line in the plane."""
    return float(ways_m(line_m)[-1])


def along(line_m: Numbers, way_m: Numbers, left_m: float = 0.0) -> Numbers:
    """(n, 3) x, y [m] and heading [rad] at places along a line, and to the left of it."""
    step, at_m = np.diff(line_m[:, :2], axis=0), ways_m(line_m)
    segment = np.clip(np.searchsorted(at_m, way_m, side="right") - 1, 0, len(step) - 1)
    heading = np.arctan2(step[segment, 1], step[segment, 0])
    x_m, y_m = (np.interp(way_m, at_m, line_m[:, axis]) for axis in (0, 1))
    return np.stack([x_m - left_m * np.sin(heading), y_m + left_m * np.cos(heading), heading], axis=1)


def on_line(line_m: Numbers, way_m: Numbers) -> Numbers:
    """(n, 3) places along a line."""
    return np.stack([np.interp(way_m, ways_m(line_m), column) for column in line_m.T], axis=1)
