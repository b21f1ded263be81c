"""Point clouds as KITTI has them: a PointCloud in, a `.bin` file out. Written only.

Four float32 a point, without a header: x, y, z (forward, left, up, in the sensor's frame, as KITTI's Velodyne) and
intensity.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

import numpy as np

from ..cloud.points import PointCloud
from ..files.atomic import atomic_output

BLOCK_POINTS = 1 << 18

Append = Callable[[PointCloud], None]


def write_kitti(path: str | os.PathLike[str], cloud: PointCloud) -> None:
    """Write the points in the sensor's frame; the intensity keeps its unit."""
    with kitti_stream(path) as append:
        append(cloud)


def kitti_stream(path: str | os.PathLike[str]) -> AbstractContextManager[Append]:
    """Write the clouds that are appended in the block one after the other."""
    return rows_stream(path, ("intensity",))


@contextmanager
def rows_stream(path: str | os.PathLike[str], columns: tuple[str, ...]) -> Iterator[Append]:
    """Rows of float32 without a header: the place in the sensor's frame, and these columns."""
    with atomic_output(path) as temporary, open(temporary, "wb") as file:

        def append(cloud: PointCloud) -> None:
            for first in range(0, len(cloud), BLOCK_POINTS):
                local = cloud.select(slice(first, first + BLOCK_POINTS)).in_sensor_frame()
                values = [local.xyz_m, *(local.column(name) for name in columns)]
                file.write(np.column_stack(values).astype("<f4").data)

        yield append
