"""Write and read point clouds as LAS 1.4 or LAZ. Needs laspy, and lazrs for LAZ.

Point format 6. Standard fields: x, y, z in steps of 10 um from a round origin; intensity as 16 bits of its largest
value; return_number and number_of_returns, up to 15; gps_time, the pulse's time in the frame; classification, 64 +
class (the codes that ASPRS leaves to users), 1 where none, 7 for what is no echo; scan_angle, the azimuth, in steps
of 0.006 degrees. Every column but the positions follows exactly in extra bytes of its name (`LAS_NAMES` where LAS
has another field of that name). The `cloud_description.description` is in a VLR of the user `lidarscene`.
"""

from __future__ import annotations

import os
import struct
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import IO, Any

import numpy as np

from ..errors import InputError
from ..files.atomic import atomic_output
from ..files.inputs import require_unpacked
from ..files.optional import import_optional
from ..maths.arrays import Numbers
from .cloud_columns import Cloud, Column, Fields, pulse_changes, returns_of_pulses
from .cloud_description import described_fields, description, input_errors, unit_of

STEP_M = 1e-5
"""Choice: step of the coordinates: 32-bit numbers of it reach 21 km."""

REACH_M = STEP_M * 2**31
LAS_NAMES = {"intensity": "echo_peak", "return_number": "return"}
"""Names of extra bytes that differ from the column's, because LAS has a coarser field of that name."""

VLR_USER, VLR_RECORD, LARGEST_VLR = "lidarscene", 1, 65535
UNCLASSIFIED, LOW_NOISE, FIRST_OF_USERS, LARGEST_CLASS = 1, 7, 64, 255

SCAN_ANGLE_STEP_DEG = 0.006
"""Source: LAS 1.4; step of the scan angle in point formats 6 to 10."""

MOST_RETURNS = 15
BLOCK_POINTS = 1 << 18
PIECE_POINTS = 1 << 20
"""Records built at a time; the further points of the last pulse are added to them."""

LONGEST_HEADER = 375  # bytes, of LAS 1.4
FIRST_ITEM = 34  # byte of the record of LASzip, after the number of items
LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
"""Kind of an item (point, colour, colour with near infrared, wave packet) -> its layers in a chunk."""
BYTES_14 = 14
"""Kind of the extra bytes, each of which is a layer."""

VERSION_MINOR = 25  # byte of the header: 4 in LAS 1.4
COUNTED = ((100, 54, 0), (243, 60, 4))
"""(offset of a count in the header, least bytes of a record, first LAS 1.x that has it) for short and for extended
records."""


@contextmanager
def las_stream(path: str | os.PathLike[str], *, compressed: bool = False) -> Iterator[Callable[[Cloud], None]]:
    """Write the clouds that are appended in the block as one cloud; names and metadata are those of the first.

    The standard intensity is a share of the largest in the file, which is known last. In a LAS file it is filled in at
    the end. A LAZ file cannot be changed: the points are written to an unnamed LAS file first, which takes as much disk
    space, and are compressed from there.
    """
    laspy = _laspy(compressed)
    with atomic_output(path) as temporary, open(temporary, "r+b") as file, ExitStack() as resources:
        uncompressed = resources.enter_context(tempfile.TemporaryFile(dir=temporary.parent)) if compressed else file
        writer = _Writer(laspy, uncompressed, path, compressed=False)
        yield writer.append
        writer.close()
        if not compressed:
            for offset, block in writer.read_back():
                file.seek(offset)
                file.write(block.view(np.uint8).data)
            return
        writer_laz = _Writer(laspy, file, path, compressed=True)
        writer_laz.open(writer.first)
        for _, block in writer.read_back():
            writer_laz.write(laspy.PackedPointRecord(block, writer.point_format))
        writer_laz.close()


def _laspy(compressed: bool) -> Any:
    if compressed:
        import_optional("lazrs", extra="las")
    return import_optional("laspy", extra="las")


class _Writer:
    """Write the points of clouds into a file.

    Attributes:
        first: the first cloud, without its points
        largest: largest intensity so far
    """

    first: Cloud

    def __init__(self, laspy: Any, file: IO[bytes], path: str | os.PathLike[str], *, compressed: bool) -> None:
        self._laspy, self._file, self._path, self._compressed = laspy, file, path, compressed
        self._writer: Any = None
        self._text, self.largest = b"", 0.0

    @property
    def point_format(self) -> Any:
        """Point format of the records, with the extra bytes."""
        return self._writer.header.point_format

    def open(self, cloud: Cloud) -> None:
        """Write the header that this cloud and those of its frame have."""
        self.first = cloud.without_points()
        self._text = description(cloud).encode("ascii")
        header = _header(self._laspy, cloud)
        if len(self._text) <= LARGEST_VLR:
            header.vlrs.append(self._record())
        self._writer = self._laspy.LasWriter(
            self._file,
            header,
            do_compress=self._compressed,
            closefd=False,
            laz_backend=self._laspy.LazBackend.LazrsParallel if self._compressed else None,
        )

    def append(self, cloud: Cloud) -> None:
        """Write a cloud, without the standard intensity."""
        if self._writer is None:
            self.open(cloud)
        self.largest = max(self.largest, float(cloud.column("intensity").max(initial=0.0)))
        for piece in _whole_pulses(cloud):
            self.write(_points(self._laspy, piece, self._writer.header, self._path))

    def write(self, points: Any) -> None:
        """Write records of laspy."""
        self._writer.write_points(points)

    def close(self) -> None:
        """Write the records that follow the points, and the number of points."""
        if len(self._text) > LARGEST_VLR:
            self._writer.write_evlrs(self._laspy.vlrs.vlrlist.VLRList([self._record()]))
        self._writer.close()
        self._file.flush()

    def read_back(self) -> Iterator[tuple[int, Numbers]]:
        """Yield position in the file and records, block by block, with the standard intensity filled in."""
        header = self._writer.header
        dtype, count = header.point_format.dtype(), header.point_count
        for first in range(0, count, BLOCK_POINTS):
            offset = header.offset_to_point_data + first * dtype.itemsize
            self._file.seek(offset)
            block = np.fromfile(self._file, dtype, count=min(BLOCK_POINTS, count - first))
            block["intensity"] = _intensity(block[LAS_NAMES["intensity"]], self.largest)
            yield offset, block

    def _record(self) -> Any:
        return self._laspy.VLR(VLR_USER, VLR_RECORD, "point cloud of lidarscene", self._text)


def read_las(path: str | os.PathLike[str]) -> Fields:
    """Read a file of `las_stream`; the positions to 10 um.

    Raises:
        InputError: in one line
    """
    laspy = import_optional("laspy", extra="las")
    with input_errors(path), open(path, "rb") as file:
        las = _read(laspy, file)
        descriptions = [record for record in (*las.vlrs, *(las.evlrs or ())) if record.user_id == VLR_USER]
        if not descriptions:
            raise ValueError("not a point cloud of lidarscene: there is no description in it")
        extra = {name: np.ascontiguousarray(las[name]) for name in las.point_format.extra_dimension_names}
        columns = {column: extra.pop(name) for column, name in LAS_NAMES.items() if name in extra}
        columns |= extra | {axis: np.asarray(las[axis]) for axis in "xyz"}
        return described_fields(columns, descriptions[0].record_data_bytes().decode())


def las_columns(path: str | os.PathLike[str]) -> dict[str, Numbers]:
    """Columns of any LAS or LAZ by name, x, y and z in metres.

    Raises:
        InputError: in one line
    """
    laspy = import_optional("laspy", extra="las")
    with input_errors(path), open(path, "rb") as file:
        las = _read(laspy, file)
        names = [name for name in las.point_format.dimension_names if name not in ("X", "Y", "Z")]
        column_names = {file_name: column for column, file_name in LAS_NAMES.items()}
        columns = {column_names.get(name, name): np.ascontiguousarray(las[name]) for name in names}
        return columns | {axis: np.asarray(las[axis]) for axis in "xyz"}


def _read(laspy: Any, file: IO[bytes]) -> Any:
    """Read all points. Raises any exception of the libraries, and ValueError for what they would crash over."""
    try:
        _require_plausible(laspy, file)
        return laspy.read(file, closefd=False)
    except BaseException as error:
        # What fails within the compiled lazrs is no Exception.
        if type(error).__name__ != "PanicException":
            raise
        raise ValueError(f"damaged: {error}") from None


def _require_plausible(laspy: Any, file: IO[bytes]) -> None:
    """Raise ValueError for counts in the header that the file has no room for.

    Libraries would run out of memory, or leave the missing points out without a word.
    """
    _require_counts(file)
    with laspy.open(file, closefd=False) as reader:
        header = reader.header
    size = os.fstat(file.fileno()).st_size
    require_unpacked(size, header.point_count * header.point_format.size)
    if not header.are_points_compressed:
        room = (size - header.offset_to_point_data) // header.point_format.size
        if room < header.point_count:
            raise ValueError(f"truncated: must have {header.point_count} points, got {max(room, 0)}")
    else:
        _require_chunks(file, header.offset_to_point_data, size)
        _require_layers(file, header, size)
    file.seek(0)


def _require_layers(file: IO[bytes], header: Any, size: int) -> None:
    """Raise ValueError for chunks or layers that are longer than the file: lazrs would fill up to 4 GB for each.

    A chunk of point formats 6 and later is its first point, the number of points, the sizes of the layers, the layers
    (LASzip specification, version 3 of its items).
    """
    lazrs = import_optional("lazrs", extra="las")
    record = lazrs.LazVlr(header.vlrs.get("LasZipVlr")[0].record_data)
    if not record.chunk_size() or record.item_size() != header.point_format.size:
        raise ValueError(f"points must be compressed as of {header.point_format.size} bytes, got {record.item_size()}")
    items = [struct.unpack_from("<HH", record.record_data(), offset) for offset in _items(record.record_data())]
    layers = sum(item_size if kind == BYTES_14 else LAYERS.get(kind, 0) for kind, item_size in items)
    start = header.offset_to_point_data
    file.seek(start)
    start += 8
    for _, chunk_bytes in lazrs.read_chunk_table(file, record):
        file.seek(start + record.item_size())
        sizes = struct.unpack(f"<{1 + layers}I", file.read(4 + 4 * layers))[1:] if layers else ()
        if start + chunk_bytes > size or sum(sizes) > chunk_bytes:
            raise ValueError("the chunks of points must be within the file, got longer ones")
        start += chunk_bytes


def _items(record: bytes) -> range:
    """Offsets of the items in the record that says how a LAZ is compressed."""
    return range(FIRST_ITEM, FIRST_ITEM + 6 * struct.unpack_from("<H", record, FIRST_ITEM - 2)[0], 6)


def _require_chunks(file: IO[bytes], points: int, size: int) -> None:
    """Raise ValueError for more chunks in a LAZ than it has bytes: lazrs would end the process for want of memory.

    Eight bytes before the points are the offset of the table of chunks (-1: the last eight bytes of the file are). The
    table begins with its version and the number of chunks (LASzip specification).
    """
    file.seek(points)
    (table,) = struct.unpack("<q", file.read(8))
    if table == -1:
        file.seek(size - 8)
        (table,) = struct.unpack("<q", file.read(8))
    if not 0 <= table <= size - 8:
        raise ValueError(f"the table of chunks must be in the file, got byte {table} of {size}")
    file.seek(table)
    _, chunks = struct.unpack("<II", file.read(8))
    if chunks > size:
        raise ValueError(f"must have at most as many chunks as bytes, got {chunks}")


def _require_counts(file: IO[bytes]) -> None:
    """Raise ValueError for more records than the file has room for: laspy would look for each of 4,000,000,000."""
    start, size = file.read(LONGEST_HEADER), os.fstat(file.fileno()).st_size
    for offset, least, version in COUNTED:
        if len(start) >= offset + 4 and start[VERSION_MINOR] >= version:
            (count,) = struct.unpack_from("<I", start, offset)
            if count * least > size:
                raise ValueError(f"the header must count records that the file has room for, got {count}")
    file.seek(0)


def _header(laspy: Any, cloud: Cloud) -> Any:
    """Header of the file, without the counts of points."""
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales, header.offsets = np.full(3, STEP_M), np.rint(cloud.sensor_place.position_m)
    header.generating_software = "lidarscene"
    header.global_encoding.wkt = True  # LAS 1.4 asks it of formats 6 to 10; PDAL and QGIS refuse the file without it
    header.add_extra_dims(
        [
            laspy.ExtraBytesParams(
                name=LAS_NAMES.get(column.name, column.name),
                type=cloud.column(column.name).dtype,
                description=unit_of(cloud, column.name)[:32],
            )
            for column in _columns(cloud)
        ]
    )
    # The largest and least of extra bytes are left out: laspy 2.7 takes the first point's for them.
    for extra in header.vlrs.get("ExtraBytesVlr")[0].extra_bytes_structs:
        extra.options = 0
    return header


def _columns(cloud: Cloud) -> list[Column]:
    """Columns that are stored in extra bytes."""
    return [column for column in cloud.columns if column.name not in ("x", "y", "z")]


def _points(laspy: Any, cloud: Cloud, header: Any, path: str | os.PathLike[str]) -> Any:
    """Point records of laspy for these points."""
    if np.abs(cloud.xyz_m - header.offsets).max() >= REACH_M:
        raise InputError(f"{os.fspath(path)}: LAS holds points up to {REACH_M:.0f} m from the sensor, one is farther")
    points = laspy.ScaleAwarePointRecord.zeros(len(cloud), header=header)
    for axis, values in zip("xyz", cloud.xyz_m.T, strict=True):
        points[axis] = values
    for column in _columns(cloud):
        points[LAS_NAMES.get(column.name, column.name)] = cloud.column(column.name)
    for name, values in _standard_fields(cloud).items():
        points[name] = values
    return points


def _standard_fields(cloud: Cloud) -> dict[str, Numbers]:
    """Return LAS's own fields but the intensity, as far as they can hold our values."""
    returns = cloud.column("return_number").clip(1, MOST_RETURNS)
    angle = np.rint(np.degrees(cloud.column("azimuth").astype(np.float64)) / SCAN_ANGLE_STEP_DEG)
    return {
        "return_number": returns,
        "number_of_returns": returns_of_pulses(cloud).clip(returns, MOST_RETURNS),
        "gps_time": cloud.column("time"),
        "classification": _classification(cloud),
        "scan_angle": angle.clip(-30000, 30000).astype(np.int16),
    }


def _intensity(values: Numbers, peak: float) -> Numbers:
    """Intensity as uint16, 65535 at ``peak``."""
    return np.rint(values.clip(0, peak) * (65535.0 / (peak or 1.0))).astype(np.uint16)


def _whole_pulses(cloud: Cloud) -> Iterator[Cloud]:
    """Yield the cloud in pieces that cut no pulse: the number of returns of a pulse is one of the fields."""
    first = 0
    while first < len(cloud):
        end = min(first + PIECE_POINTS, len(cloud))
        while end < len(cloud) and not pulse_changes(cloud, slice(end - 1, end + 1)).any():
            end += 1
        yield cloud.select(slice(first, end))
        first = end


def _classification(cloud: Cloud) -> Numbers:
    classes = np.full(len(cloud), UNCLASSIFIED, np.int64)
    if cloud.has_truth:
        has_class = cloud.column("class") >= 0
        classes[has_class] = np.minimum(FIRST_OF_USERS + cloud.column("class")[has_class], LARGEST_CLASS)
    return np.where(cloud.column("status") != 0, LOW_NOISE, classes).astype(np.uint8)
