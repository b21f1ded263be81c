"""Thinning: every k-th point of a frame that comes in pieces, as many as a picture can show.

A picture has some two million pixels, a frame may have a hundred million points. k grows as points arrive, and the
points kept so far are thinned to it. So the result does not depend on how the frame was cut, and memory stays small.
"""

from __future__ import annotations

import numpy as np

from ..detection.outcomes import Status
from .point_cloud import PointCloud

MOST_POINTS = 1 << 22
"""Most points that are kept: a picture has some two million pixels, and more would hide each other."""

FACTOR = 3
"""Base of k. It is odd because scanners fire 2^n channels in turn: an even k would drop whole channels."""


class Thinned:
    """Points whose number in the frame is a multiple of ``step``: at most `MOST_POINTS` of them.

    The points do not depend on how the frame is cut.

    Attributes:
        statuses: number of points of each `Status` before thinning
    """

    def __init__(self) -> None:
        self.step = 1
        self.statuses = np.zeros(len(Status), np.int64)
        self._pieces: list[PointCloud] = []

    @classmethod
    def of_cloud(cls, cloud: PointCloud) -> Thinned:
        """Thin a whole cloud."""
        thinned = cls()
        thinned.append(cloud)
        return thinned

    @property
    def points(self) -> int:
        """Number of points before thinning."""
        return int(self.statuses.sum())

    def append(self, cloud: PointCloud) -> None:
        """Add the points of a cloud. The cloud itself is kept only if all of its points are."""
        before = self.points
        self.statuses += np.bincount(cloud.status, minlength=len(Status))
        while -(-self.points // self.step) > MOST_POINTS:
            self.step *= FACTOR
            self._thin_out()
        # The first point of this cloud whose number in the frame is a multiple of the step.
        self._pieces.append(_take_every(cloud, self.step, -before % self.step))

    def cloud(self) -> PointCloud:
        """The points kept. At least one cloud must have been appended."""
        if len(self._pieces) > 1:
            self._pieces = [PointCloud.concatenate(self._pieces, consume=True)]
        return self._pieces[0]

    def _thin_out(self) -> None:
        """Drop two thirds of the points kept so far."""
        points_before = 0
        for index, piece in enumerate(self._pieces):
            self._pieces[index] = _take_every(piece, FACTOR, -points_before % FACTOR)
            points_before += len(piece)


def _take_every(cloud: PointCloud, step: int, first: int) -> PointCloud:
    """Every ``step``-th point from ``first`` on, as copies unless these are all points."""
    return cloud if step == 1 else cloud.select(np.arange(first, len(cloud), step))
