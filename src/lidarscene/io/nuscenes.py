"""Point clouds as nuScenes has them: a PointCloud in, a `.pcd.bin` file out. Written only.

Five float32 a point, without a header: x, y, z, intensity, ring. The axes are the sensor's own; those of the
nuScenes lidar have x to the right and y forward, so a loader that draws in its frame draws ours turned by 90
degrees.
"""

from __future__ import annotations

import os

import numpy as np

from lidarscene.cloud import PointCloud

from .files import atomic_output


def write_nuscenes(path: str | os.PathLike[str], cloud: PointCloud) -> None:
    """Write the points in the sensor's frame; the intensity keeps its unit."""
    local = cloud.in_sensor_frame()
    rows = np.column_stack([local.xyz_m, local.intensity, local.channel]).astype("<f4")
    with atomic_output(path) as temporary:
        rows.tofile(temporary)
