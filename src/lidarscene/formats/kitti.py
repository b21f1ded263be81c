"""Write point clouds as KITTI (`.bin`) and nuScenes (`.pcd.bin`): float32 rows without a header.

KITTI has four numbers a point: x, y, z (forward, left, up, in the sensor's frame, as KITTI's Velodyne) and intensity.
nuScenes has five: ring too, which rises with the elevation as that of its HDL-32E. The axes of both are the sensor's
own. Those of the nuScenes lidar have x to the right and y forward, so a loader that draws in its frame draws ours
turned by 90 degrees; data sets have its axes (`labels.nuscenes_dataset`).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from ..files.atomic import atomic_output
from ..maths.arrays import Numbers
from .cloud_columns import RING_ROWS, Cloud

BLOCK_POINTS = 1 << 18

Append = Callable[[Cloud], None]


@contextmanager
def kitti_stream(
    path: str | os.PathLike[str], columns: tuple[str, ...], axes: Numbers | None = None
) -> Iterator[Append]:
    """Write the clouds that are appended in the block one after the other: the positions, and these columns.

    Args:
        axes: (3, 3) rows x, y and z of the file in the sensor's frame; None: the sensor's own
    """
    with atomic_output(path) as temporary, open(temporary, "wb") as file:

        def append(cloud: Cloud) -> None:
            for first in range(0, len(cloud), BLOCK_POINTS):
                file.write(kitti_rows(cloud.select(slice(first, first + BLOCK_POINTS)), columns, axes).data)

        yield append


def kitti_rows(cloud: Cloud, columns: tuple[str, ...], axes: Numbers | None = None) -> Numbers:
    """(n, 3 + columns) rows of `kitti_stream`."""
    local = cloud.in_sensor_frame()
    xyz_m = local.xyz_m if axes is None else local.xyz_m @ axes.T.astype(local.xyz_m.dtype)
    values = [xyz_m, *(_values(local, name) for name in columns)]
    return np.column_stack(values).astype("<f4", order="C")


def _values(cloud: Cloud, name: str) -> Numbers:
    """Column of a file; rings count from the lowest row, whatever the maker's driver does."""
    values, rows = cloud.column(name), cloud.metadata.get(RING_ROWS)
    if name != "ring" or rows is None:
        return values
    return np.array([int(word) for word in rows.split()])[values]
