"""KITTI and nuScenes: as their own readers read them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.clouds import small_cloud

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.formats import kitti


def test_kitti_and_nuscenes(tmp_path: Path, library: Any, street_cloud: PointCloud) -> None:
    """Reference: pykitti's reader, and the reshape of the nuScenes devkit: five float32 a point."""
    street_cloud.save(tmp_path / "a.bin")
    street_cloud.save(tmp_path / "a.pcd.bin")
    in_sensor_frame = street_cloud.in_sensor_frame()
    theirs = library("pykitti.utils").load_velo_scan(str(tmp_path / "a.bin"))
    np.testing.assert_array_equal(theirs[:, :3], in_sensor_frame.xyz_m)
    np.testing.assert_array_equal(theirs[:, 3], in_sensor_frame.intensity)
    nuscenes = np.fromfile(tmp_path / "a.pcd.bin", dtype=np.float32).reshape(-1, 5)
    np.testing.assert_array_equal(nuscenes[:, :4], theirs)
    np.testing.assert_array_equal(nuscenes[:, 4], in_sensor_frame.ring)


def test_blocks_do_not_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kitti, "BLOCK_POINTS", 8)
    for n in (7, 8, 9, 24):
        cloud = small_cloud(n)
        cloud.save(tmp_path / "a.bin")
        rows = np.fromfile(tmp_path / "a.bin", "<f4").reshape(-1, 4)
        np.testing.assert_array_equal(rows, np.column_stack([cloud.xyz_m, cloud.intensity]))


def test_the_order_of_coordinates_in_memory_does_not_show(tmp_path: Path) -> None:
    """A device gives all x, then all y, then all z; the file has point after point."""
    cloud = small_cloud(9)
    by_columns = small_cloud(9, xyz_m=np.asfortranarray(cloud.xyz_m))
    for suffix in ("bin", "pcd.bin"):
        for name, ordered_cloud in (("a", cloud), ("b", by_columns)):
            ordered_cloud.save(tmp_path / f"{name}.{suffix}")
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()
