"""Parquet: as DuckDB reads it, and its row groups."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.clouds import assert_same, small_cloud, small_columns
from helpers.formats import need, written

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.formats import parquet

N = 50


def test_names_come_back_as_their_codes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Clouds with few names in a row group, with none, and with names that two codes share, which stay numbers."""
    need("parquet")
    monkeypatch.setattr(parquet, "GROUP_POINTS", 7)
    whole = small_cloud(N)
    for cloud in (whole, whole[:0], whole.select(class_=1), replace(whole, body_names=("a", "a", "b"))):
        cloud.save(tmp_path / "a.parquet")
        assert_same(PointCloud.load(tmp_path / "a.parquet"), cloud)


def test_row_groups_are_of_one_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need("parquet")
    import pyarrow.parquet

    monkeypatch.setattr(parquet, "GROUP_POINTS", 30)
    written(tmp_path / "a.parquet", "parquet", [small_cloud(25)] * 4)
    file = pyarrow.parquet.ParquetFile(tmp_path / "a.parquet")
    assert [file.metadata.row_group(i).num_rows for i in range(file.num_row_groups)] == [30, 30, 30, 10]


def test_units_and_meanings_are_with_the_columns(tmp_path: Path) -> None:
    """Read by pyarrow; the unit of an intensity is the detector's."""
    need("parquet")
    import pyarrow.parquet

    small_cloud(3, metadata={"frame": "sensor", "intensity_unit": "A"}).save(tmp_path / "a.parquet")
    schema = pyarrow.parquet.read_schema(tmp_path / "a.parquet")
    units = {name: schema.field(name).metadata[b"unit"] for name in ("range", "time", "intensity", "azimuth", "body")}
    assert units == {"range": b"m", "time": b"s", "intensity": b"A", "azimuth": b"rad", "body": b"1"}
    assert schema.field("time").metadata[b"meaning"] == b"emission of the pulse, from the start of the frame"


def test_a_column_of_one_value_is_counted_by_its_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten thousand numbers that repeat take next to nothing in the file, and 80 kB for each column in memory."""
    need("parquet")
    unpacked_sizes: list[int] = []
    cloud = PointCloud(**{name: np.zeros((10_000, *v.shape[1:]), v.dtype) for name, v in small_columns(1).items()})
    cloud.save(tmp_path / "a.parquet")
    monkeypatch.setattr(parquet, "require_unpacked", lambda packed, unpacked: unpacked_sizes.append(unpacked))
    PointCloud.load(tmp_path / "a.parquet")
    assert unpacked_sizes == [8 * 10_000 * len(cloud.columns)]
