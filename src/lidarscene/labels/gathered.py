"""Gather the boxes of a frame that comes in pieces, in memory that does not grow with the frame.

If something moves, the place of a box is known only when all its points have come, and only then can the points inside
be counted. Until then the points are stored on disk.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from ..cloud.point_cloud import PointCloud
from ..files.spool import Spool
from ..scene.scene import Scene
from .boxes import PIECE_POINTS, Box, BoxTally, truth_of


class GatheredBoxes:
    """Boxes of one frame, from at least one cloud.

    first   the first cloud, without its points
    points  number of points of all clouds
    """

    first: PointCloud

    def __init__(self, folder: str | os.PathLike[str], scene: Scene, *, as_seen: bool = True) -> None:
        """Begin a frame; points are stored in ``folder`` if something moves."""
        self._folder, self._scene, self._as_seen = folder, scene, as_seen
        self._tally: BoxTally | None = None
        self._spool: Spool | None = None
        self.points = 0

    def __enter__(self) -> GatheredBoxes:
        return self

    def __exit__(self, *_: object) -> None:
        if self._spool is not None:
            self._spool.__exit__()

    def append(self, cloud: PointCloud) -> None:
        """Add the points of a cloud."""
        if self._tally is None:
            self._begin(cloud)
        self.points += len(cloud)
        for first in range(0, len(cloud), PIECE_POINTS):
            self._add(cloud.select(slice(first, first + PIECE_POINTS)))

    def boxes(self) -> list[Box]:
        """Boxes of all clouds that were appended; call it once."""
        assert self._tally is not None
        if self._spool is not None:
            self._tally.place_boxes()
            for rows in self._spool.blocks():
                xyz_m = np.stack([rows["x"], rows["y"], rows["z"]], axis=-1)
                self._tally.count_points(xyz_m, rows["true_range"], rows["status"], rows["sensor_index"])
        return self._tally.boxes()

    def _begin(self, cloud: PointCloud) -> None:
        self.first = cloud.without_points()
        self._tally = BoxTally(cloud, self._scene, as_seen=self._as_seen)
        if self._tally.moves:
            position: list[tuple[str, Any]] = [(axis, cloud.xyz_m.dtype) for axis in "xyz"]
            row = [*position, ("true_range", "f4"), ("status", "u1"), ("sensor_index", "u1")]
            self._spool = Spool(self._folder, row)
        else:
            self._tally.place_boxes()

    def _add(self, cloud: PointCloud) -> None:
        assert self._tally is not None
        self._tally.add_echoes(cloud)
        if self._spool is None:
            self._tally.count_points(cloud.xyz_m, truth_of(cloud)[0], cloud.status, cloud.sensor_index)
            return
        self._spool.append(
            **dict(zip("xyz", cloud.xyz_m.T, strict=True)),
            true_range=truth_of(cloud)[0],
            status=cloud.status,
            sensor_index=cloud.sensor_index,
        )
