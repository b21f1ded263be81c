"""KITTI and nuScenes: blocks, and the order of coordinates; readers of theirs are in test_oracles.py."""

from pathlib import Path

import numpy as np
import pytest
from helpers.clouds import small_cloud

from lidarscene.formats import kitti


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
