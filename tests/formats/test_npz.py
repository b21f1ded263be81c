"""NPZ: an archive of columns for numpy alone."""

from pathlib import Path

import numpy as np
from helpers.clouds import small_cloud

N = 50


def test_npz_is_an_archive_of_columns(tmp_path: Path) -> None:
    cloud = small_cloud(N)
    cloud.save(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as archive:
        assert set(archive.files) == {"lidarscene", *(c.name for c in cloud.columns)}
        np.testing.assert_array_equal(archive["snr"], cloud.snr)
