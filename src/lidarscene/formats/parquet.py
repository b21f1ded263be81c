"""Write and read point clouds as Apache Parquet: one table, exact. Needs pyarrow.

The `cloud_description.description` is in the file's key-value metadata under `lidarscene`; units are in those of the
columns.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from ..files.atomic import atomic_output
from ..files.inputs import require_unpacked
from ..files.optional import import_optional
from .cloud_columns import Cloud, Fields
from .cloud_description import described_fields, description, input_errors, unit_of

KEY = b"lidarscene"
WIDEST = 8  # bytes of a number
GROUP_POINTS = 1 << 20  # rows of a row group: some 100 MB


def write_parquet(path: str | os.PathLike[str], cloud: Cloud) -> None:
    """Write one column of the table for each of the cloud's, compressed with Zstandard."""
    with parquet_stream(path) as append:
        append(cloud)


@contextmanager
def parquet_stream(path: str | os.PathLike[str]) -> Iterator[Callable[[Cloud], None]]:
    """Write the clouds that are appended in the block as one cloud; names and metadata are those of the first.

    Row groups have one size, however the cloud was cut: so the bytes of the file do not depend on the pieces.
    """
    arrow, parquet = _arrow()
    with atomic_output(path) as temporary, open(temporary, "wb") as file, ExitStack() as open_writer:
        buffered: list[Any] = []  # tables with fewer points in all than a row group
        writer: Any = None

        def append(cloud: Cloud) -> None:
            nonlocal writer
            if writer is None:
                schema = _schema(arrow, cloud)
                writer = open_writer.enter_context(parquet.ParquetWriter(file, schema, compression="zstd"))
            for first in range(0, max(len(cloud), 1), GROUP_POINTS):
                piece = cloud.select(slice(first, first + GROUP_POINTS))
                buffered.append(_table(arrow, piece, writer.schema))
                table = arrow.concat_tables(buffered)
                full_rows = len(table) - len(table) % GROUP_POINTS
                buffered[:] = [table.slice(full_rows)]
                if full_rows:
                    write(table.slice(0, full_rows))

        def write(table: Any) -> None:
            # In one piece, or the pages would begin where the pieces did.
            writer.write_table(table.combine_chunks(), row_group_size=GROUP_POINTS)

        yield append
        if len(buffered[0]):
            write(buffered[0])


def _schema(arrow: Any, cloud: Cloud) -> Any:
    fields = []
    for column in cloud.columns:
        text = {"unit": unit_of(cloud, column.name), "meaning": column.meaning}
        kind = arrow.from_numpy_dtype(cloud.column(column.name).dtype)
        fields.append(arrow.field(column.name, kind, nullable=False, metadata=text))
    return arrow.schema(fields, metadata={KEY: description(cloud)})


def _table(arrow: Any, cloud: Cloud, schema: Any) -> Any:
    # The positions are every third number of an array; Arrow needs contiguous memory.
    return arrow.table([arrow.array(cloud.column(name).copy()) for name in schema.names], schema=schema)


def read_parquet(path: str | os.PathLike[str]) -> Fields:
    """Read a file of `write_parquet`.

    Raises:
        InputError: in one line
    """
    _, parquet = _arrow()
    with input_errors(path), open(path, "rb") as file:
        file_metadata = parquet.read_metadata(file)
        # By rows too: a column that repeats one value has next to no bytes before it is unpacked.
        groups = sum(file_metadata.row_group(number).total_byte_size for number in range(file_metadata.num_row_groups))
        rows = file_metadata.num_rows * file_metadata.num_columns * WIDEST
        require_unpacked(os.fstat(file.fileno()).st_size, max(groups, rows))
        file.seek(0)
        table = parquet.read_table(file)
        metadata = table.schema.metadata or {}
        if KEY not in metadata:
            raise ValueError("not a point cloud of lidarscene: there is no description in its metadata")
        columns = {name: table[name].to_numpy() for name in table.column_names}
        return described_fields(columns, metadata[KEY].decode())


def _arrow() -> tuple[Any, Any]:
    return import_optional("pyarrow", extra="parquet"), import_optional("pyarrow.parquet", extra="parquet")
