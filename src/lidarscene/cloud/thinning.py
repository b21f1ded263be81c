"""Keep every k-th point of a frame that comes in pieces: as many as a picture can show.

A picture has some two million pixels, a frame may have a hundred million points. k grows while points come, and those
kept before are thinned to it: the result does not depend on how the frame was cut, and memory stays small.
"""

from __future__ import annotations

import numpy as np

from ..detection.outcomes import Status
from .point_cloud import PointCloud

MOST_POINTS = 1 << 22
"""More are drawn one over the other: a picture has some two million pixels."""

FACTOR = 3
"""k is a power of it. Odd, because scanners fire 2^n channels in turn: an even k would drop whole channels."""


class Thinned:
    """The points whose number in the frame is a multiple of ``step``, the least that leaves `MOST_POINTS` at most.

    However the frame is cut, the points are the same.

    statuses  how many points of each `Status` there are, all of them counted
    """

    def __init__(self) -> None:
        self.step = 1
        self.statuses = np.zeros(len(Status), np.int64)
        self._pieces: list[PointCloud] = []

    @classmethod
    def of_cloud(cls, cloud: PointCloud) -> Thinned:
        """Of a whole cloud."""
        thinned = cls()
        thinned.append(cloud)
        return thinned

    @property
    def points(self) -> int:
        """How many there are, all of them counted."""
        return int(self.statuses.sum())

    def append(self, cloud: PointCloud) -> None:
        """Add the points of a cloud, which is not kept itself unless it is small."""
        before = self.points
        self.statuses += np.bincount(cloud.status, minlength=len(Status))
        while -(-self.points // self.step) > MOST_POINTS:
            self.step *= FACTOR
            self._thin_out()
        self._pieces.append(_strided(cloud, self.step, -before % self.step))

    def cloud(self) -> PointCloud:
        """The points that are left, of at least one cloud."""
        if len(self._pieces) > 1:
            self._pieces = [PointCloud.concatenate(self._pieces, consume=True)]
        return self._pieces[0]

    def _thin_out(self) -> None:
        """Keep every third of those that were kept."""
        points_before = 0
        for number, piece in enumerate(self._pieces):
            self._pieces[number] = _strided(piece, FACTOR, -points_before % FACTOR)
            points_before += len(piece)


def _strided(cloud: PointCloud, step: int, first: int) -> PointCloud:
    """The points ``first``, ``first + step`` and so on: copies, where these are not all."""
    return cloud if step == 1 else cloud.select(np.arange(first, len(cloud), step))
