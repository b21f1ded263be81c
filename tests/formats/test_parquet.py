"""Parquet: as DuckDB reads it, and its row groups."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.clouds import small_cloud, small_columns
from helpers.formats import need, written

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.formats import parquet

N = 50


def test_parquet_in_duckdb(tmp_path: Path, library: Any) -> None:
    need("parquet")
    duckdb = library("duckdb")
    cloud = small_cloud(N)
    cloud.save(tmp_path / "a.parquet")
    columns = duckdb.sql(f"SELECT * FROM '{tmp_path / 'a.parquet'}'").fetchnumpy()
    assert list(columns) == [c.name for c in cloud.columns]
    for name, values in columns.items():
        np.testing.assert_array_equal(np.asarray(values), cloud.column(name), strict=True)


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
