"""Parquet: as DuckDB reads it, and its row groups."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.clouds import small_cloud
from helpers.formats import need, written

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
