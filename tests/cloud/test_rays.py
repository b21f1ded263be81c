"""Rays of every pulse: where each looked, what came of it, and the files that hold them."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from helpers.mistakes import told
from helpers.walls import WALL

from lidarscene import PointCloud, load_sensor, render
from lidarscene.formats.registry import FORMATS

COLUMNS = [*"xyz", *(f"direction_{axis}" for axis in "xyz"), "time", "range", "pulse", "channel", "ring", "outcome"]


@pytest.fixture(scope="module")
def cloud(mi: Any, tmp_path_factory: pytest.TempPathFactory) -> PointCloud:
    """A frame of a VLP-16 before a wall, its beams leaving from 16 heights, turned and away from the origin."""
    folder = tmp_path_factory.mktemp("rays")
    (folder / "wall.toml").write_text(WALL)
    return render(folder / "wall.toml", "vlp-16", pose=(1.0, 0.5, 1.5, 10.0, 0.0, 0.0), keep_rays=True)


def test_every_pulse_has_its_ray(cloud: PointCloud) -> None:
    """Reference: the scanner's own pulses, and the points, each of which ends a ray; the other rays have no end."""
    scanner, rays = load_sensor("vlp-16").scanner, cloud.rays
    assert rays.pulse.tolist() == [*range(scanner.pulses)]
    np.testing.assert_allclose(rays.time_s, scanner.time_s(rays.pulse), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(rays.direction, axis=1), 1.0, atol=1e-6)
    has_point = np.isfinite(rays.range_m)
    assert 0 < has_point.sum() == len(cloud) < len(rays)
    ends_m = (rays.origin_m + rays.range_m[:, None] * rays.direction)[has_point]
    np.testing.assert_allclose(ends_m, cloud.xyz_m, atol=2e-5)
    np.testing.assert_array_equal(rays.ring[has_point], cloud.ring)
    np.testing.assert_array_equal(rays.outcome[has_point] == 0, cloud.status == 0)
    assert (rays.outcome[~has_point] > 0).all()
    np.testing.assert_array_equal(cloud.missed.pulse, rays.pulse[~has_point])
    # 16 lasers leave from 16 heights.
    assert len(np.unique(np.round(rays.origin_m[:, 2], 5))) == 16


def test_rays_are_of_the_frame_as_it_was_rendered(cloud: PointCloud) -> None:
    for other in (cloud[:3], cloud.in_sensor_frame(), cloud.without_truth()):
        with told("cloud.rays | keep_rays=True"):
            _ = other.rays


def test_files_of_rays(tmp_path: Path, cloud: PointCloud, open3d: ModuleType, library: Callable[[str], Any]) -> None:
    """Reference: NumPy, Open3D and pyarrow read every column of each file."""
    rows = cloud.rays.to_numpy()
    assert list(rows.dtype.names or ()) == COLUMNS
    for suffix in ("npz", "ply", "parquet"):
        if suffix == "parquet":
            FORMATS["parquet"].require()
        cloud.rays.save(tmp_path / f"r.{suffix}")
    points = open3d.t.io.read_point_cloud(str(tmp_path / "r.ply")).point
    table = library("pyarrow.parquet").read_table(tmp_path / "r.parquet")
    with np.load(tmp_path / "r.npz") as archive:
        for name in COLUMNS:
            stored = points["positions"].numpy()[:, "xyz".index(name)] if name in "xyz" else points[name].numpy()[:, 0]
            for values in (archive[name], table[name].to_numpy(), stored):
                np.testing.assert_array_equal(values, rows[name])
    with told("r.csv | .npz, .parquet, .ply | '.csv'"):
        cloud.rays.save(tmp_path / "r.csv")
