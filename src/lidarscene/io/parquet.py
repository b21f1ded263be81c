"""Point clouds as Apache Parquet: a PointCloud in, a table out, and back, exactly. Needs pyarrow.

The `described.description` is in the file's key-value metadata under `lidarscene`; units are in the columns' own.
"""

from __future__ import annotations

import os
from typing import Any

from lidarscene.cloud import PointCloud

from .described import described_cloud, description, reading, unit_of
from .files import atomic_output
from .optional import optional

KEY = b"lidarscene"


def write_parquet(path: str | os.PathLike[str], cloud: PointCloud) -> None:
    """Write one column of the table for each of the cloud's, compressed with Zstandard."""
    arrow, parquet = _arrow()
    fields, arrays = [], []
    for column in cloud.columns:
        # The positions are every third number of an array; Arrow wants them side by side.
        array = arrow.array(cloud.column(column.name).copy())
        text = {"unit": unit_of(cloud, column.name), "meaning": column.meaning}
        fields.append(arrow.field(column.name, array.type, nullable=False, metadata=text))
        arrays.append(array)
    schema = arrow.schema(fields, metadata={KEY: description(cloud)})
    with atomic_output(path) as temporary:
        parquet.write_table(arrow.table(arrays, schema=schema), temporary, compression="zstd")


def read_parquet(path: str | os.PathLike[str]) -> PointCloud:
    """Read a file of `write_parquet`. Raises InputError, in one line."""
    _, parquet = _arrow()
    with reading(path), open(path, "rb") as file:
        table = parquet.read_table(file)
        metadata = table.schema.metadata or {}
        if KEY not in metadata:
            raise ValueError("not a point cloud of lidarscene: there is no description in its metadata")
        columns = {name: table[name].to_numpy() for name in table.column_names}
        return described_cloud(columns, metadata[KEY].decode())


def _arrow() -> tuple[Any, Any]:
    return optional("pyarrow", extra="parquet"), optional("pyarrow.parquet", extra="parquet")
