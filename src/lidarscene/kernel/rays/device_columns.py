"""Columns of points on the device: those of a chunk, of one frame among several, or of a whole frame.

On a CPU NumPy and other libraries read the same memory.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np

from ...formats.cloud_columns import COLUMNS, OF_VECTORS, attributes
from ...maths.arrays import Array, Mask, Numbers
from ..device import pinned, transfer
from ..device.backend import is_cuda, mitsuba
from ..device.types import DeviceArray
from .kept_lanes import more_than_one

DEFAULT_VALUES = {
    column.attribute: np.dtype(column.dtype).type(column.absent) for column in COLUMNS if column.absent is not None
}
"""Columns that only some worlds or sensors have, with their value in all others."""


@dataclass(frozen=True, slots=True, eq=False)
class DeviceColumns:
    """Some points in columns on the device.

    Attributes:
        arrays: by attribute of PointCloud, started, and perhaps longer; xyz_m is flat: x, y, z of the first point, then
            of the second
        first: place of the first of these points in the arrays
        count: number of these points
        fetched: whole columns in NumPy, which were read before: later that would wait for all that was started since
        partial: whether the arrays hold more than these points and copies of them
    """

    arrays: Mapping[str, Any]
    first: int
    count: int
    fetched: Mapping[str, Numbers] = field(default_factory=dict)
    partial: bool = False

    def fetch(self, names: Iterable[str] | None = None) -> DeviceColumns:
        """Read these columns, or all; of a chunk's own arrays."""
        chosen = self.arrays if names is None else names
        return replace(self, fetched={name: self.numpy(name) for name in chosen})

    def part(self, first: int, end: int) -> DeviceColumns:
        """Some of these points."""
        return replace(self, first=self.first + first, count=end - first, partial=True)

    def select(self, chosen: Mask) -> DeviceColumns:
        """Those of these points, (count,), for which it is true."""
        import drjit as dr

        mi, index = mitsuba(), dr.compress(chosen)
        if not (count := dr.width(index)):
            return self.part(0, 0)
        index = more_than_one(index) + transfer.opaque_uint32(self.first)
        number = dr.arange(mi.UInt32, 3 * dr.width(index))
        places = {"xyz_m": 3 * dr.gather(mi.UInt32, index, number // 3) + number % 3}
        arrays = {name: dr.gather(type(own), own, places.get(name, index)) for name, own in self.arrays.items()}
        return DeviceColumns(arrays, 0, count)

    def array(self, name: str) -> Any:
        """Array of these points alone, (count,), or a tensor (count, 3) of xyz_m, on the device."""
        import drjit as dr

        mi = mitsuba()
        if name not in self.arrays:
            kind = {"float32": mi.Float, "uint8": mi.UInt8}[DEFAULT_VALUES[name].dtype.name]
            return dr.full(kind, DEFAULT_VALUES[name].item(), self.count)
        whole, first, size = self._extent(name)
        if first == 0:
            own = dr.reshape(type(whole), whole, size, shrink=True)
        else:
            own = dr.gather(type(whole), whole, dr.arange(mi.UInt32, size) + transfer.opaque_uint32(first))
        return dr.tensor_t(type(own))(own, (self.count, 3)) if name == "xyz_m" else own

    @property
    def is_far(self) -> bool:
        """Whether positions are in double precision."""
        import drjit as dr

        return bool(dr.itemsize_v(self.arrays["xyz_m"]) == 8)

    def positions(self) -> tuple[Any, Any, Any]:
        """Each (count,): x, y and z of these points [m], in double precision, on the device."""
        import drjit as dr

        mi = mitsuba()
        flat, place = self.array("xyz_m").array, 3 * dr.arange(mi.UInt32, self.count)
        x, y, z = (mi.Float64(dr.gather(type(flat), flat, place + axis)) for axis in range(3))
        return x, y, z

    def numpy(self, name: str) -> Numbers:
        """(count,) values, or (count, 3) of xyz_m, in NumPy: on a CPU in the same memory."""
        import drjit as dr

        if name in self.fetched:
            return self.fetched[name][self.first : self.first + self.count]
        if self.first and is_cuda():  # it would copy all that is before
            return cast(DeviceArray, self.array(name)).numpy()
        whole, first, size = self._extent(name)
        shrunk = dr.reshape(type(whole), whole, first + size, shrink=True)
        values = cast(DeviceArray, shrunk).numpy()[first:]
        return values.reshape(-1, 3) if name == "xyz_m" else values

    def in_numpy(self) -> dict[str, Numbers]:
        """All columns of a PointCloud in NumPy; those that no array holds are one value that is repeated.

        On a CPU in the same memory, unless the arrays hold other frames, too: a cloud that is kept must not keep those.
        """
        names = attributes(truth=True, vectors=OF_VECTORS[0] in self.arrays)
        own = [name for name in names if name in self.arrays]
        if is_cuda() and self.count:
            values = self._unpacked(own)
        else:
            values = {name: self.numpy(name).copy() if self.partial else self.numpy(name) for name in own}
        repeated = {name: np.broadcast_to(value, self.count) for name, value in DEFAULT_VALUES.items()}
        return {name: values[name] if name in values else repeated[name] for name in names}

    def _unpacked(self, names: Sequence[str]) -> dict[str, Numbers]:
        """Columns in NumPy by one copy: each costs a GPU as long as some thousand points.

        One kernel puts the columns side by side into words of four bytes, whole and halved numbers before single bytes.
        """
        import drjit as dr

        mi = mitsuba()
        kinds = {name: np.dtype(dr.type_v(self.arrays[name]).name.lower()) for name in names}
        ordered = sorted(names, key=lambda name: -kinds[name].itemsize)
        sizes = [self._extent(name)[2] * kinds[name].itemsize for name in ordered]
        places = np.cumsum([0, *(-(-size // 4) for size in sizes)])
        # Opaque, since they differ from frame to frame.
        table = transfer.unsigned_numbers(np.array([self.first, self.count, *places[:-1]]))
        first, count, *starts = (dr.gather(mi.UInt32, table, number) for number in range(2 + len(ordered)))
        buffer = dr.empty(mi.UInt32, int(places[-1]))
        lane = dr.arange(mi.UInt32, self.count)
        for name, start in zip(ordered, starts, strict=True):
            _pack(self.arrays[name], buffer, start, lane, first=first, count=count, numbers=3 if name == "xyz_m" else 1)
        memory, values = _bytes(buffer), dict[str, Numbers]()
        for name, place, size in zip(ordered, 4 * places[:-1], sizes, strict=True):
            column = memory[place : place + size].view(kinds[name])
            values[name] = column.reshape(-1, 3) if name == "xyz_m" else column
        return values

    def _extent(self, name: str) -> tuple[Any, int, int]:
        """Array, place of the first number in it, and count of numbers."""
        numbers = 3 if name == "xyz_m" else 1
        return self.arrays[name], numbers * self.first, numbers * self.count


def copy_rows(tables: Sequence[Sequence[Array]]) -> list[Numbers]:
    """Compute tables of some columns, (n,) numbers of four or eight bytes, and copy them to NumPy together.

    Args:
        tables: those of eight bytes first

    Returns:
        (n, words) uint32 of each table, the bits of its numbers
    """
    import drjit as dr

    mi, count, before = mitsuba(), dr.width(tables[0][0]), 0
    opaque_count, lane = transfer.opaque_uint32(count), dr.arange(mi.UInt32, count)
    rows = [[word for column in columns for word in _words(column)] for columns in tables]
    buffer = dr.empty(mi.UInt32, count * sum(map(len, rows)))
    for words in rows:
        for number, word in enumerate(words):
            place = opaque_count * before + lane * len(words) + number
            dr.scatter(buffer, word, place, mode=dr.ReduceMode.Permute)
        before += len(words)
    pieces = np.split(_bytes(buffer).view(np.uint32), count * np.cumsum([len(words) for words in rows])[:-1])
    return [piece.reshape(count, -1) for piece in pieces]


def _words(values: Any) -> list[Any]:
    """Bits of numbers of four bytes, or of eight: the lower half and the upper one."""
    import drjit as dr

    mi, size = mitsuba(), dr.itemsize_v(values)
    bits = dr.reinterpret_array({4: mi.UInt32, 8: mi.UInt64}[size], values)
    return [bits] if size == 4 else [mi.UInt32(bits), mi.UInt32(bits >> 32)]


def _bytes(buffer: DeviceArray) -> Numbers:
    """(n,) bytes of a buffer that is not yet computed: a copy on a GPU, its memory on a CPU."""
    transfer.start([buffer])
    if is_cuda():
        return pinned.to_numpy(buffer)
    return buffer.numpy().view(np.uint8)


def _pack(
    whole: DeviceArray, buffer: DeviceArray, start: Array, lane: Array, *, first: Array, count: Array, numbers: int
) -> None:
    """Write ``count`` points of a column into a buffer of words, on (count,) lanes.

    Args:
        whole: array of the column
        start: place of its first word in the buffer
        lane: (count,) 0, 1, 2, ...
        first: its first point that is written
        numbers: of each point
    """
    import drjit as dr

    mi, size = mitsuba(), dr.itemsize_v(whole)
    if size == 1:  # four points are a word
        is_word = 4 * lane < count
        points = [4 * lane + byte for byte in range(4)]
        singles = [dr.gather(type(whole), whole, first + point, is_word & (point < count)) for point in points]
        word = sum((mi.UInt32(single) << 8 * byte for byte, single in enumerate(singles)), mi.UInt32(0))
        dr.scatter(buffer, word, start + lane, is_word, mode=dr.ReduceMode.Permute)
        return
    for number in range(numbers):
        words = _words(dr.gather(type(whole), whole, (first + lane) * numbers + number))
        for half, word in enumerate(words):
            place = start + (lane * numbers + number) * len(words) + half
            dr.scatter(buffer, word, place, mode=dr.ReduceMode.Permute)


def start_columns(
    columns: Mapping[str, Array], count: int, later: Iterable[tuple[Mapping[str, Array], Array]] = ()
) -> DeviceColumns:
    """Start to compute the columns of a chunk, and return them.

    Args:
        columns: `kernel.rays.point_columns.point_columns` of ``count`` returns, and perhaps more behind them
        later: columns of returns that were traced again, and the place of each, (m,), among the others; asked for once
            the others are started. A column that only these have has its value of `DEFAULT_VALUES` elsewhere
    """
    import drjit as dr

    arrays: dict[str, Any] = dict(columns) | {"xyz_m": dr.ravel(columns["xyz_m"])}
    # Started before the others are written down: else those would change this kernel.
    transfer.start([*arrays.values()])
    for again, place in later:
        for name in again.keys() - arrays.keys():
            arrays[name] = dr.full(type(again[name]), DEFAULT_VALUES[name].item(), dr.width(arrays["range_m"]))
        for name, room in arrays.items():
            values = again[name] if name in again else type(room)(DEFAULT_VALUES[name].item())
            # Three numbers of a point lie side by side, and no two lanes write to the same place: one kernel for all.
            dr.scatter(room, values, place, mode=dr.ReduceMode.Permute)
        transfer.start([*arrays.values()])
    return DeviceColumns(arrays, 0, count)


def join(parts: list[DeviceColumns]) -> DeviceColumns:
    """Join the points of several chunks on the device, in order; the list is emptied, to free them one by one."""
    import drjit as dr

    if len(parts) == 1:
        return parts.pop()
    points, written = sum(part.count for part in parts), 0
    joined: dict[str, Any] = {}
    for name in {name: None for part in parts for name in part.arrays}:
        kind = next(type(part.arrays[name]) for part in parts if name in part.arrays)
        numbers, default = 3 * points if name == "xyz_m" else points, DEFAULT_VALUES.get(name)
        joined[name] = dr.zeros(kind, numbers) if default is None else dr.full(kind, default.item(), numbers)
    transfer.start([*joined.values()])
    while parts:
        part = parts.pop(0)
        if part.count:
            behind = transfer.opaque_uint32(written)
            for name in part.arrays:
                values, numbers = dr.ravel(part.array(name)), 3 if name == "xyz_m" else 1
                place = dr.arange(mitsuba().UInt32, numbers * part.count) + numbers * behind
                dr.scatter(joined[name], values, place, mode=dr.ReduceMode.Permute)
            transfer.start([*joined.values()])
        written += part.count
    return DeviceColumns(joined, 0, points)
