"""KITTI and nuScenes: as their own readers read them."""

from pathlib import Path
from typing import Any

import numpy as np

from lidarscene.cloud.points import PointCloud


def test_kitti_and_nuscenes(tmp_path: Path, library: Any, street_cloud: PointCloud) -> None:
    """Reference: pykitti's reader, and the reshape of the nuScenes devkit: five float32 a point."""
    street_cloud.save(tmp_path / "a.bin")
    street_cloud.save(tmp_path / "a.pcd.bin")
    own = street_cloud.in_sensor_frame()
    kitti = library("pykitti.utils").load_velo_scan(str(tmp_path / "a.bin"))
    np.testing.assert_array_equal(kitti[:, :3], own.xyz_m)
    np.testing.assert_array_equal(kitti[:, 3], own.intensity)
    nuscenes = np.fromfile(tmp_path / "a.pcd.bin", dtype=np.float32).reshape(-1, 5)
    np.testing.assert_array_equal(nuscenes[:, :4], kitti)
    np.testing.assert_array_equal(nuscenes[:, 4], own.channel)
