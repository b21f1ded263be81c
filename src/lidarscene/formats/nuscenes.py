"""Point clouds as nuScenes has them: a PointCloud in, a `.pcd.bin` file out. Written only.

Five float32 a point, without a header: x, y, z, intensity, ring. The axes are the sensor's own; those of the
nuScenes lidar have x to the right and y forward, so a loader that draws in its frame draws ours turned by 90
degrees.
"""

from __future__ import annotations

import os
from contextlib import AbstractContextManager

from ..cloud.points import PointCloud
from .kitti import Append, rows_stream


def write_nuscenes(path: str | os.PathLike[str], cloud: PointCloud) -> None:
    """Write the points in the sensor's frame; the intensity keeps its unit."""
    with nuscenes_stream(path) as append:
        append(cloud)


def nuscenes_stream(path: str | os.PathLike[str]) -> AbstractContextManager[Append]:
    """Write the clouds that are appended in the block one after the other."""
    return rows_stream(path, ("intensity", "channel"))
