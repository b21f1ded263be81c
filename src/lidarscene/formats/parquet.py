"""Write and read point clouds as Apache Parquet: one table, exact. Needs pyarrow.

The `cloud_description.description` is in the file's key-value metadata under `lidarscene`; units are in those of the
columns. Codes are dictionaries of their names, null for -1: ``SELECT * FROM 'cloud.parquet' WHERE class = 'car'``.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np

from ..files.atomic import atomic_output
from ..files.inputs import require_unpacked
from ..files.optional import import_optional
from ..maths.arrays import Numbers
from .category_array import CategoryArray
from .cloud_columns import Cloud, Fields
from .cloud_description import category_names, described_fields, description, input_errors, unit_of

KEY = b"lidarscene"
WIDEST = 8  # bytes of a number
GROUP_POINTS = 1 << 20  # rows of a row group: some 100 MB


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
        text, values = {"unit": unit_of(cloud, column.name), "meaning": column.meaning}, cloud.column(column.name)
        kind, named = arrow.from_numpy_dtype(values.dtype), isinstance(values, CategoryArray) and values.has_names
        kind = arrow.dictionary(kind, arrow.string()) if named else kind
        fields.append(arrow.field(column.name, kind, nullable=named, metadata=text))
    return arrow.schema(fields, metadata={KEY: description(cloud)})


def _table(arrow: Any, cloud: Cloud, schema: Any) -> Any:
    return arrow.table([_array(arrow, cloud.column(name)) for name in schema.names], schema=schema)


def _array(arrow: Any, values: Numbers) -> Any:
    # The positions are every third number of an array; Arrow needs contiguous memory.
    numbers = np.array(values)
    if not isinstance(values, CategoryArray) or not values.has_names:
        return arrow.array(numbers)
    return arrow.DictionaryArray.from_arrays(arrow.array(numbers, mask=numbers < 0), list(values.names))


def _codes(column: Any, names: tuple[str, ...]) -> Numbers:
    """Codes of a column of the file, which has them or their names."""
    if not hasattr(column.type, "index_type"):
        return np.asarray(column.to_numpy())
    codes = [np.zeros(0, np.int32)]
    for chunk in column.chunks:
        table = np.array([*(names.index(name) for name in chunk.dictionary.to_pylist()), -1], np.int32)
        codes.append(table[chunk.indices.fill_null(len(table) - 1).to_numpy(zero_copy_only=False)])
    return np.concatenate(codes)


def read_parquet(path: str | os.PathLike[str]) -> Fields:
    """Read a file of `parquet_stream`.

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
        text = metadata[KEY].decode()
        names = category_names(text)
        columns = {name: _codes(table[name], names.get(name, ())) for name in table.column_names}
        return described_fields(columns, text)


def _arrow() -> tuple[Any, Any]:
    return import_optional("pyarrow", extra="parquet"), import_optional("pyarrow.parquet", extra="parquet")
