"""Write and read point clouds as PCD 0.7 (Point Cloud Library), exact.

Text, binary, or compressed column by column (binary_compressed, needs the package `lzf`). The
`cloud_description.description` is in comment lines. `# room ...` makes headers of one length for any number of points,
which is known last where a cloud is written piece by piece. Infinity is written as 3.40282346e+38 in text files,
because common readers have no word for it.

Positions are float32, which all readers know: some give zeros for fields of 8 bytes. Far from the origin they count
from the whole metres nearest to the sensor, which are the VIEWPOINT; else that is the sensor's pose.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import IO, Any

import numpy as np

from ..errors import OptionWarning, warn
from ..files.atomic import atomic_output
from ..files.inputs import require_unpacked
from ..files.optional import import_optional
from ..maths.arrays import Numbers
from ..maths.pose import Pose
from ..maths.rotations import quaternion
from .cloud_columns import Cloud, Fields, sensor_positions_m
from .cloud_description import LARGEST, counted_stream, described_fields, description, input_errors, line_format

NEEDED = ("FIELDS", "SIZE", "TYPE", "WIDTH", "HEIGHT", "POINTS", "DATA")
FIRST_LINE = "# .PCD v0.7 - Point Cloud Data file format"
OURS = "# lidarscene "
LONGEST_TEXT = 800  # common readers stop at 1024 characters
_KINDS = {"f": "F", "i": "I", "u": "U"}
_DTYPES = {kind: dtype for dtype, kind in _KINDS.items()}
BLOCK_POINTS = 1 << 16
COUNT_DIGITS = 18
LONGEST_RUN = 32
"""Largest number of literal bytes after one control byte of LZF."""


def write_pcd(path: str | os.PathLike[str], cloud: Cloud) -> None:
    """Write the cloud compressed."""
    lzf = import_optional("lzf", extra="pcd")
    local = _about_viewpoint(cloud)
    columns = [np.ascontiguousarray(local.column(column.name)) for column in local.columns]
    with atomic_output(path) as temporary, open(temporary, "wb") as file:
        file.write(_header(cloud, points=len(cloud), data="binary_compressed"))
        file.write(_compress(b"".join(values.tobytes() for values in columns), lzf))


def pcd_stream(path: str | os.PathLike[str], *, ascii: bool = False) -> AbstractContextManager[Callable[[Cloud], None]]:
    """Write the clouds that are appended in the block as one cloud; names and metadata are those of the first.

    Args:
        ascii: text, not little-endian binary
    """
    data = "ascii" if ascii else "binary"

    def write(file: IO[bytes], cloud: Cloud) -> None:
        for start in range(0, len(cloud), BLOCK_POINTS):
            rows = _about_viewpoint(cloud.select(slice(start, start + BLOCK_POINTS))).to_numpy()
            if ascii:
                file.writelines(_lines(rows))
            else:
                file.write(rows.view(np.uint8).data)

    return counted_stream(path, header=lambda cloud, points: _header(cloud, points=points, data=data), write=write)


def read_pcd(path: str | os.PathLike[str]) -> Fields:
    """Read a file of `write_pcd` or `pcd_stream`.

    Raises:
        InputError: in one line
    """
    with input_errors(path), open(path, "rb") as file:
        header, text = _read_header(file)
        dtype = np.dtype(
            [
                (name, f"<{_DTYPES[kind]}{size}")
                for name, size, kind in zip(header["FIELDS"], header["SIZE"], header["TYPE"], strict=True)
            ]
        )
        points, data = int(header["POINTS"][0]), header["DATA"][0]
        fields = described_fields(_read_columns(file, dtype, points, data, ours=True), text)
        if fields["xyz_m"].dtype == np.float64 and dtype["x"] == np.float32:
            fields["xyz_m"] += np.array([float(word) for word in header["VIEWPOINT"][:3]])
        return fields


def _origin_m(cloud: Cloud) -> Numbers | None:
    """(3,) whole metres that the file's positions count from; None: the cloud's own origin."""
    return None if cloud.xyz_m.dtype == np.float32 else np.rint(sensor_positions_m(cloud.metadata)[0])


def _about_viewpoint(cloud: Cloud) -> Cloud:
    """The cloud with positions as the file has them, float32."""
    origin_m = _origin_m(cloud)
    return cloud if origin_m is None else replace(cloud, xyz_m=(cloud.xyz_m - origin_m).astype(np.float32))


def pcd_columns(path: str | os.PathLike[str]) -> tuple[dict[str, Numbers], tuple[int, int] | None]:
    """Columns of any PCD by name, and (rows, columns) if it is an array of them.

    Raises:
        InputError: in one line
    """
    with input_errors(path), open(path, "rb") as file:
        header, text = _header_words(file)
        counts = [int(word) for word in header.get("COUNT", ["1"] * len(header["FIELDS"]))]
        fields = zip(header["FIELDS"], header["SIZE"], header["TYPE"], counts, strict=True)
        # Padding, and fields of several numbers, get names that are no columns of a cloud.
        dtype = np.dtype(
            [
                (
                    name if count == 1 and name != "_" else f"_ {index}",
                    f"<{_DTYPES[kind]}{size}",
                    (count,) * (count > 1),
                )
                for index, (name, size, kind, count) in enumerate(fields)
            ]
        )
        width, height = (int(header[word][0]) for word in ("WIDTH", "HEIGHT"))
        columns = _read_columns(file, dtype, int(header["POINTS"][0]), header["DATA"][0], ours=bool(text))
        return columns, (height, width) if height > 1 else None


def _header(cloud: Cloud, *, points: int, data: str) -> bytes:
    """Header of the file, whose length does not depend on the number of points."""
    text, pose, origin_m = description(cloud), cloud.sensor_place, _origin_m(cloud)
    types = [_about_viewpoint(cloud).column(column.name).dtype for column in cloud.columns]
    pose = pose if origin_m is None else Pose(position_m=origin_m)
    viewpoint = (*pose.position_m, *quaternion(pose.rotation))
    lines = [FIRST_LINE]
    lines += [OURS + text[first : first + LONGEST_TEXT] for first in range(0, len(text), LONGEST_TEXT)]
    lines += [
        f"# room {2 * (COUNT_DIGITS - len(str(points))) * '.'}",
        "VERSION 0.7",
        f"FIELDS {' '.join(column.name for column in cloud.columns)}",
        f"SIZE {' '.join(str(dtype.itemsize) for dtype in types)}",
        f"TYPE {' '.join(_KINDS[dtype.kind] for dtype in types)}",
        f"COUNT {' '.join('1' for _ in types)}",
        f"WIDTH {points}",
        "HEIGHT 1",
        f"VIEWPOINT {' '.join(repr(float(number)) for number in viewpoint)}",
        f"POINTS {points}",
        f"DATA {data}\n",
    ]
    return "\n".join(lines).encode("ascii")


def _lines(rows: Numbers) -> Iterator[bytes]:
    """Yield a line of text for each point, with enough digits to be read back exactly."""
    line = line_format(rows.dtype)
    for row in rows.tolist():
        yield (line % row).replace("inf", repr(float(LARGEST))).encode("ascii")


def _compress(data: bytes, lzf: Any) -> bytes:
    """Return both lengths and the compressed bytes; uncompressed, in runs, if LZF does not make them fewer."""
    compressed = lzf.compress(data) if data else None
    compressed = _uncompressed_runs(data) if compressed is None else compressed
    return struct.pack("<II", len(compressed), len(data)) + compressed


def _uncompressed_runs(data: bytes) -> bytes:
    """Return the bytes as LZF without compression: runs of up to 32, each after its length minus one."""
    full_bytes = len(data) // LONGEST_RUN * LONGEST_RUN
    blocks = np.frombuffer(data[:full_bytes], np.uint8).reshape(-1, LONGEST_RUN)
    runs = np.insert(blocks, 0, LONGEST_RUN - 1, axis=1).tobytes()
    last_run = data[full_bytes:]
    return runs + (bytes([len(last_run) - 1]) + last_run if last_run else b"")


def _read_header(file: IO[bytes]) -> tuple[dict[str, list[str]], str]:
    """Read the header: first word of each line -> its other words, and our description."""
    if file.readline(100).decode("ascii", "replace").rstrip() != FIRST_LINE:
        raise ValueError("not a PCD file of lidarscene: the first line is another")
    header, text = _header_words(file)
    if not text:
        raise ValueError("not written by lidarscene: there is no description in its header")
    return header, text


def _header_words(file: IO[bytes]) -> tuple[dict[str, list[str]], str]:
    """Read the header: first word of each line -> its other words, and our description; "" without."""
    header: dict[str, list[str]] = {}
    text = ""
    while "DATA" not in header:
        line = file.readline(1 << 16).decode("ascii", "replace")
        if not line.endswith("\n"):
            raise ValueError("truncated or damaged in the header: must have a line 'DATA', got none")
        if line.startswith(OURS):
            text += line[len(OURS) : -1]
        elif not line.startswith("#") and line.strip():
            word, *values = line.split()
            header[word] = values
    if absent := [word for word in NEEDED if not header.get(word)]:
        raise ValueError(f"the header must have a line '{absent[0]}', got none")
    return header, text


def _read_columns(file: IO[bytes], dtype: np.dtype[Any], points: int, data: str, *, ours: bool) -> dict[str, Numbers]:
    """Read the columns by name; ValueError if the file has fewer points than its header counts.

    Bytes behind them, which some programs write, are left out, with an `OptionWarning`. The last line of ``ours`` ends.
    """
    names = dtype.names or ()
    if data == "ascii":
        lines = [line for line in file if line.strip()]
        if len(lines) != points or (ours and lines and not lines[-1].endswith(b"\n")):
            raise ValueError(f"must have {points} whole lines of points, got {len(lines)}")
        rows = np.loadtxt(lines, dtype=dtype, comments=None, ndmin=1) if lines else np.zeros(0, dtype)
        return {name: _with_infinity(np.ascontiguousarray(rows[name])) for name in names}
    if data not in ("binary", "binary_compressed"):
        raise ValueError(f"DATA must be ascii, binary or binary_compressed, got '{data}'")
    content = file.read()
    if data == "binary_compressed":
        compressed_size, size = struct.unpack_from("<II", content)
        compressed = _cut(file, content, 8 + compressed_size)[8:]
        require_unpacked(8 + len(compressed), size)
        content = import_optional("lzf", extra="pcd").decompress(compressed, size) if size else b""
    content = _cut(file, content, points * dtype.itemsize)
    if data == "binary":
        rows = np.frombuffer(content, dtype)
        return {name: np.ascontiguousarray(rows[name]) for name in names}
    ends = np.cumsum([0, *(points * dtype[name].itemsize for name in names)])
    return {name: np.frombuffer(content[ends[i] : ends[i + 1]], dtype[name]) for i, name in enumerate(names)}


def _cut(file: IO[bytes], content: bytes, size: int) -> bytes:
    """The first bytes of the content; ValueError if it has fewer."""
    if len(content) < size:
        raise ValueError(f"must have {size} bytes of points, got {len(content)}")
    if len(content) > size:
        warn(OptionWarning("{0}: {1} bytes after the points are left out", file.name, len(content) - size))
    return content[:size]


def _with_infinity(values: Numbers) -> Numbers:
    """Replace the largest float32, which stands for infinity in text files, by infinity."""
    if values.dtype == np.float32:
        values[np.abs(values) == LARGEST] *= np.float32(np.inf)
    return values
