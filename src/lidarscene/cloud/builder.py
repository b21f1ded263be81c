"""Builder of a point cloud from chunks.

A frame comes in chunks. Joining many small arrays at the end would take twice the memory of the cloud, since the
allocator keeps the holes that they leave. So each column is one array that is reserved once and then filled.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..formats.cloud_columns import (
    NAMES,
    OF_VECTORS,
    TRUTH,
    Cloud,
    Fields,
    attributes,
    columns_of,
    freeze_column,
    is_constant,
)
from ..maths.arrays import Numbers

MOST_RESERVED = 2**25
"""Points: a larger cloud would leave its gigabytes with whoever gave the memory."""


class CloudBuilder:
    """Columns of a cloud, filled chunk after chunk. A single chunk is used as it is, without a copy.

    A column that is one broadcast value (all strides 0), the same in every chunk, stays one value.

    Args:
        capacity: largest number of points, if known: reserved room takes no memory until it is used. Beyond it, and
            without it, columns grow by a quarter
        vectors: True if a cloud without chunks has the columns of vectors
        memory: gives so many bytes, (n,) uint8 of any value; called now for a capacity up to `MOST_RESERVED`
    """

    def __init__(
        self, *, capacity: int = 0, vectors: bool = False, memory: Callable[[int], Numbers] | None = None
    ) -> None:
        self._vectors = vectors
        self._reserved: dict[str, Numbers] = {}
        if memory is not None and capacity <= MOST_RESERVED:
            for column in columns_of(truth=True, vectors=vectors):
                # Positions may be in double precision.
                width = 24 if column.attribute == "xyz_m" else np.dtype(column.dtype).itemsize
                if column.attribute not in self._reserved:
                    self._reserved[column.attribute] = memory(width * capacity)
        self._columns: dict[str, Numbers] = {}
        self._description: dict[str, Any] = {}
        self._capacity, self._points, self._chunks = capacity, 0, 0

    def append(self, columns: Mapping[str, Any]) -> None:
        """Add points: arrays by attribute of PointCloud (xyz_m, range_m, ...), with or without TRUTH and vectors.

        The arrays must not change afterwards: a single chunk's become the cloud's own.
        """
        expected = self._columns or attributes(truth=TRUTH[0] in columns, vectors=OF_VECTORS[0] in columns)
        if set(columns) != set(expected):
            differing = ", ".join(sorted(set(columns) ^ set(expected)))
            raise ValueError(f"CloudBuilder.append: columns missing, unknown or not as before: {differing}")
        points = len(columns["xyz_m"])
        # Only shapes and types are checked here; the values once, when the cloud is made.
        checked = {name: freeze_column(name, columns[name], points) for name in expected}
        self._chunks += 1
        if self._chunks == 1:
            self._columns, self._points = checked, points
            return
        end = self._points + points
        for name, values in checked.items():
            if is_constant(column := self._columns[name]) and is_constant(values) and (column[0] == values[0]).all():
                self._columns[name] = np.broadcast_to(column[0], (end, *column.shape[1:]))
                continue
            self._columns[name] = self._with_room(name, end)
            self._columns[name][self._points : end] = values
        self._points = end

    def add(self, cloud: Cloud) -> None:
        """Add the points of a cloud; names and metadata are those of the first cloud added."""
        if not self._description:
            self._description = {name: getattr(cloud, name) for name in (*NAMES.values(), "metadata")}
        names = attributes(truth=cloud.has_truth, vectors=cloud.has_vectors)
        self.append({name: getattr(cloud, name) for name in names})

    def _with_room(self, name: str, end: int) -> Numbers:
        """Return the column, or a longer copy if it is too short or still the first chunk's own array."""
        column = self._columns[name]
        if self._chunks > 2 and len(column) >= end:
            return column
        # Growth by a quarter keeps the total cost of copying linear in the number of points.
        room = max(self._capacity, end) if self._chunks == 2 else end * 5 // 4
        shape = room, *column.shape[1:]
        size = math.prod(shape) * column.itemsize
        reserved = self._reserved.pop(name, None)
        if reserved is None or len(reserved) < size:
            longer = np.zeros(shape, column.dtype)
        else:
            longer = reserved[:size].view(column.dtype).reshape(shape)
        longer[: self._points] = column[: self._points]
        return longer

    def fields(self, **description: Any) -> Fields:
        """Everything appended, as keyword arguments of PointCloud, with names and metadata if given.

        Empties the builder. Without chunks they are those of a cloud of no points, with truth.
        """
        columns: dict[str, Any] = {name: column[: self._points] for name, column in self._columns.items()}
        if not columns:
            names = attributes(truth=True, vectors=self._vectors)
            columns = {name: np.zeros((0, 3) if name == "xyz_m" else 0) for name in names}
        described = self._description | description
        self._columns, self._description, self._points, self._chunks = {}, {}, 0, 0
        return columns | described
