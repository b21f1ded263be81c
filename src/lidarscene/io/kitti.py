"""Point clouds as KITTI has them: a PointCloud in, a `.bin` file out. Written only.

Four float32 a point, without a header: x, y, z (forward, left, up, in the sensor's frame, as KITTI's Velodyne) and
intensity.
"""

from __future__ import annotations

import os

import numpy as np

from lidarscene.cloud import PointCloud

from .files import atomic_output


def write_kitti(path: str | os.PathLike[str], cloud: PointCloud) -> None:
    """Write the points in the sensor's frame; the intensity keeps its unit."""
    local = cloud.in_sensor_frame()
    rows = np.column_stack([local.xyz_m, local.intensity]).astype("<f4")
    with atomic_output(path) as temporary:
        rows.tofile(temporary)
