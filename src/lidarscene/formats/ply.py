r"""Write and read point clouds as PLY, exact.

The header names lidarscene, the metadata, the units and the names behind the numbers in comments. Text that
would not survive there (line breaks, non-ASCII) is backslash-escaped; long text goes on in lines that start
with `comment +`, because common readers stop at 1024 characters. `comment room ...` makes headers of one length
whatever the number of points, which is known last where a cloud is written piece by piece. In ASCII files infinity
is written as 3.40282346e+38, the largest float, because they have no word for it.
"""

from __future__ import annotations

import functools
import itertools
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import IO, Any

import numpy as np

from ..errors import InputError
from ..files.atomic import atomic_output
from ..files.encodings.ply import NUMPY_TYPES
from ..files.inputs import require_file
from ..maths.arrays import Numbers
from .cloud_columns import COLUMNS, Cloud, Fields, columns_of
from .cloud_description import counted_stream, input_errors, line_format, unit_of

VERSION_LINE = "lidarscene 2"
PLY_TYPES = {np.dtype(size).name: word for word, size in reversed(NUMPY_TYPES.items())}
"""Name of a numpy dtype -> the older word for it, which all readers take."""

BLOCK_POINTS = 1 << 16  # a few MB: stays in the cache
LONGEST_TEXT = 800
LARGEST = "3.40282346e+38"
COUNT_DIGITS = 18
RGB = ("red", "green", "blue")
_NAMES = {column.name: column.names for column in COLUMNS if column.names}
_RESERVED = ("lidarscene", "unit", "+", "room", *_NAMES)


def ply_stream(
    path: str | os.PathLike[str], *, ascii: bool = False, colours: Numbers | None = None
) -> AbstractContextManager[Callable[[Cloud], None]]:
    """Write the clouds that are appended in the block as one cloud; names and metadata are those of the first.

    Args:
        ascii: text, not little-endian binary
        colours: (n, 3) uint8: red, green and blue of each point of the only cloud, which viewers show; reading leaves
            them out
    """

    def write(file: IO[bytes], cloud: Cloud) -> None:
        for block in _blocks(cloud, colours):
            file.write(_as_text(block) if ascii else block.view(np.uint8).data)

    coloured = colours is not None
    return counted_stream(
        path, header=lambda cloud, points: _header(cloud, points=points, ascii=ascii, coloured=coloured), write=write
    )


def read_ply(path: str | os.PathLike[str]) -> Fields:
    """Read a file of `ply_stream`, exactly.

    Raises:
        InputError: in one line, for a file that is missing, truncated or by another program
    """
    require_file(path, "a point cloud")
    try:
        with open(path, "rb") as file:
            header = _read_header(file)
            blocks = _text_blocks(file, header) if header.ascii else _binary_blocks(file, header)
            # Text has two bytes or more for each number.
            most = os.fstat(file.fileno()).st_size // (2 * len(header.dtype.names or ()))
            return _gather_fields(blocks, header, most)
    except OSError as error:
        raise InputError(f"{os.fspath(path)}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise InputError(f"{os.fspath(path)}: {error}") from error


@dataclass(kw_only=True)
class _Header:
    """Content of a file's header."""

    ascii: bool
    points: int
    dtype: np.dtype[Any]
    metadata: dict[str, str] = field(default_factory=dict)
    names: dict[str, list[str]] = field(default_factory=lambda: {word: [] for word in _NAMES})


@functools.cache
def _dtype(*, has_truth: bool, has_vectors: bool, double: bool, coloured: bool = False) -> np.dtype[Any]:
    """Structured type of a point in a file."""
    position = "float64" if double else "float32"
    columns = columns_of(truth=has_truth, vectors=has_vectors)
    pairs = ((column.name, np.dtype(position if column.attribute == "xyz_m" else column.dtype)) for column in columns)
    colours = [(name, np.dtype("u1")) for name in RGB] if coloured else []
    return np.dtype([(name, dtype.newbyteorder("<")) for name, dtype in [*pairs, *colours]])


@functools.cache
def _properties(dtype: np.dtype[Any]) -> list[str]:
    """Lines `property` of the header for this type of point."""
    return [f"property {PLY_TYPES[dtype[name].name]} {name}" for name in dtype.names or ()]


def _cloud_dtype(cloud: Cloud, *, coloured: bool) -> np.dtype[Any]:
    double = cloud.xyz_m.dtype == np.float64
    return _dtype(has_truth=cloud.has_truth, has_vectors=cloud.has_vectors, double=double, coloured=coloured)


def _blocks(cloud: Cloud, colours: Numbers | None) -> Iterator[Numbers]:
    """Yield the points in blocks as in a file; all blocks share one memory."""
    columns = {column.name: cloud.column(column.name) for column in cloud.columns}
    if colours is not None:
        columns |= {name: colours[:, channel] for channel, name in enumerate(RGB)}
    block = np.zeros(min(BLOCK_POINTS, len(cloud)), _cloud_dtype(cloud, coloured=colours is not None))
    for first in range(0, len(cloud), BLOCK_POINTS):
        points = block[: len(cloud) - first]
        for name, values in columns.items():
            points[name] = values[first : first + len(points)]
        yield points


def ply_columns(path: str | os.PathLike[str]) -> dict[str, Numbers]:
    """Scalar properties of the vertices of any PLY by name.

    Raises:
        InputError: in one line
    """
    with input_errors(path), open(path, "rb") as file:
        lines = _header_lines(file)
        words = [line.split() for line in lines if line.split()[:1] not in (["comment"], ["obj_info"])]
        kind = words[0][1] if words and words[0][0] == "format" and len(words[0]) > 1 else ""
        orders = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
        elements = [index for index, word in enumerate(words) if word[0] == "element"]
        if kind not in orders or not elements or words[elements[0]][1] != "vertex":
            raise ValueError("must be a PLY whose first element is 'vertex'")
        end = elements[1] if len(elements) > 1 else len(words) - 1
        properties = words[elements[0] + 1 : end]
        unknown = [" ".join(word) for word in properties if word[1] not in NUMPY_TYPES]
        if unknown:
            raise ValueError(f"properties of vertices must be scalars, got '{unknown[0]}'")
        dtype = np.dtype([(word[-1], orders[kind] + NUMPY_TYPES[word[1]]) for word in properties])
        count = int(words[elements[0]][2])
        if kind == "ascii":
            rows = np.loadtxt(list(itertools.islice(file, count)), dtype=dtype, comments=None, ndmin=1)
        else:
            rows = np.frombuffer(file.read(count * dtype.itemsize), np.uint8)
            rows = rows[: len(rows) // dtype.itemsize * dtype.itemsize].view(dtype)
        if len(rows) != count:
            raise ValueError(f"truncated: must have {count} points, got {len(rows)}")
        return {name: rows[name] for name in dtype.names or ()}


def _header(cloud: Cloud, *, points: int, ascii: bool, coloured: bool) -> bytes:
    """Header of the file, whose length does not depend on the number of points."""
    lines = ["ply", f"format {'ascii' if ascii else 'binary_little_endian'} 1.0", f"comment {VERSION_LINE}"]
    for key, value in cloud.metadata.items():
        lines += _comment_lines(_escape_key(key), value)
    for column in cloud.columns:
        lines += _comment_lines(f"unit {column.name}", unit_of(cloud, column.name))
    for word, attribute in _NAMES.items():
        for index, name in enumerate(getattr(cloud, attribute)):
            lines += _comment_lines(f"{word} {index}", name)
    lines += [f"comment room {'.' * (COUNT_DIGITS - len(str(points)))}", f"element vertex {points}"]
    lines += [*_properties(_cloud_dtype(cloud, coloured=coloured)), "end_header", ""]
    return "\n".join(lines).encode("ascii")


def _comment_lines(start: str, text: str) -> Iterator[str]:
    """Yield the comment line for this text, and its continuation lines."""
    text = _escape(text)
    yield f"comment {start} {text[:LONGEST_TEXT]}"
    for first in range(LONGEST_TEXT, len(text), LONGEST_TEXT):
        yield f"comment + {text[first : first + LONGEST_TEXT]}"


def _escape(text: str) -> str:
    """Escape text to one line of ASCII, without words that other readers take for more than a comment."""
    text = text.encode("unicode_escape").decode("ascii")
    return re.sub("(?i)(?<=end)_(?=header)|(?<=texture)f(?=ile)", lambda match: f"\\x{ord(match[0]):02x}", text)


def _escape_key(key: str) -> str:
    """Escape a key to one word that is not in `_RESERVED`."""
    key = _escape(key).replace(" ", r"\x20")
    return f"\\x{ord(key[0]):02x}{key[1:]}" if key in _RESERVED else key


def _as_text(points: Numbers) -> bytes:
    """Format points as lines of text with enough digits to be read back exactly."""
    names, line = points.dtype.names or (), line_format(points.dtype)
    text = "".join(line % row for row in zip(*(points[name].tolist() for name in names), strict=True))
    return text.replace("inf", LARGEST).encode("ascii")


def _header_lines(file: IO[bytes]) -> list[str]:
    """Read the lines as far as `end_header`, without the first; ValueError if the file is no PLY."""
    if file.readline(16).rstrip() != b"ply":
        raise ValueError("not a PLY file: the first line must be 'ply'")
    lines: list[str] = []
    while not lines or lines[-1] != "end_header":
        line = file.readline(4 * LONGEST_TEXT)
        if not line.endswith(b"\n"):
            raise ValueError("truncated or damaged in the PLY header: must have 'end_header', got none")
        lines.append(line.rstrip(b"\r\n").decode("ascii", errors="replace"))
    return lines


def _read_header(file: IO[bytes]) -> _Header:
    """Read as far as `end_header`; ValueError if the file is not one of ours."""
    lines = _header_lines(file)
    if f"comment {VERSION_LINE}" not in lines:
        raise ValueError(f"not written by this version of lidarscene: no 'comment {VERSION_LINE}' in the header")
    declared = [line for line in lines if not line.startswith("comment ")]
    counted = re.fullmatch("element vertex ([0-9]{1,18})", declared[1] if len(declared) > 1 else "")
    ascii = declared[0] == "format ascii 1.0"
    if not counted or not (ascii or declared[0] == "format binary_little_endian 1.0"):
        raise ValueError(f"damaged PLY header near '{' / '.join(declared[:2])}'")
    header = _Header(ascii=ascii, points=int(counted[1]), dtype=_declared_dtype(declared[2:-1]))
    _read_comments(lines, header)
    return header


def _declared_dtype(properties: list[str]) -> np.dtype[Any]:
    """Type of point that has these `property` lines; ValueError if lidarscene writes none of that kind."""
    for has_truth, has_vectors, double, coloured in itertools.product((True, False), repeat=4):
        dtype = _dtype(has_truth=has_truth, has_vectors=has_vectors, double=double, coloured=coloured)
        if _properties(dtype) == properties:
            return dtype
    raise ValueError(
        f"the properties must be those of lidarscene (changed by another program?), got {len(properties)}: "
        f"{', '.join(line.split(' ')[-1] for line in properties)}"
    )


def _read_comments(lines: list[str], header: _Header) -> None:
    """Fill in the header's metadata and names from its comment lines."""
    texts: list[tuple[str, str]] = []
    for line in lines:
        start, _, content = line.partition(" ")
        word, _, text = content.partition(" ")
        if start == "comment" and word == "+" and texts:
            texts[-1] = (texts[-1][0], texts[-1][1] + text)
        elif start == "comment":
            texts.append((word, text))
    for word, text in texts:
        if word in header.names:
            header.names[word].append(_unescape(text.partition(" ")[2]))
        elif word not in _RESERVED:
            header.metadata[_unescape(word)] = _unescape(text)


def _unescape(text: str) -> str:
    """Undo `_escape`."""
    return text.encode("ascii", errors="replace").decode("unicode_escape")


def _binary_blocks(file: IO[bytes], header: _Header) -> Iterator[Numbers]:
    """Yield the points in blocks.

    Raises:
        ValueError: unless the size of the file is right to the byte
    """
    start = file.tell()
    expected = start + header.points * header.dtype.itemsize
    size = file.seek(0, os.SEEK_END)
    file.seek(start)
    if size != expected:
        problem = "truncated" if size < expected else "longer than its header says"
        raise ValueError(f"{problem}: must have {expected} bytes for {header.points} points, got {size}")
    for first in range(0, header.points, BLOCK_POINTS):
        yield np.fromfile(file, header.dtype, count=min(BLOCK_POINTS, header.points - first))


def _text_blocks(file: IO[bytes], header: _Header) -> Iterator[Numbers]:
    """Yield the points in blocks.

    Raises:
        ValueError: unless every line is there and whole
    """
    for first in range(0, header.points, BLOCK_POINTS):
        count = min(BLOCK_POINTS, header.points - first)
        lines = list(itertools.islice(file, count))
        if len(lines) < count or not lines[-1].endswith(b"\n"):
            whole_lines = first + sum(line.endswith(b"\n") for line in lines)
            raise ValueError(f"truncated: must have {header.points} lines of points, got {whole_lines}")
        block = np.loadtxt(lines, dtype=header.dtype, comments=None, ndmin=1)
        if len(block) != count:
            raise ValueError(
                f"must have no empty line among the points, got one in lines {first + 1} to {first + count}"
            )
        for name in header.dtype.names or ():
            if header.dtype[name] == np.float32:
                block[name][np.abs(block[name]) == np.finfo(np.float32).max] *= np.float32(np.inf)
        yield block
    if file.read(1):
        raise ValueError(f"longer than its header says: must have {header.points} lines of points, got more")


def _gather_fields(blocks: Iterator[Numbers], header: _Header, most: int) -> Fields:
    """Return the fields of the cloud in these blocks; ``most`` is the number of points that the file has room for."""
    names_in_file = header.dtype.names or ()
    scalars = [column for column in COLUMNS[3:] if column.name in names_in_file]
    rows = min(header.points, most)  # a damaged header may promise more than any memory holds
    fields: Fields = {column.attribute: np.zeros(rows, column.dtype) for column in scalars}
    fields["xyz_m"] = np.zeros((rows, 3), header.dtype["x"].newbyteorder("="))
    first = 0
    for block in blocks:
        last = first + len(block)
        for column in scalars:
            fields[column.attribute][first:last] = block[column.name]
        for axis, name in enumerate("xyz"):
            fields["xyz_m"][first:last, axis] = block[name]
        first = last
    names = {_NAMES[word]: tuple(names) for word, names in header.names.items()}
    return fields | {"metadata": header.metadata} | names


def write_columns(
    path: str | os.PathLike[str],
    columns: Mapping[str, Numbers],
    *,
    comments: Iterable[str] = (),
    faces: Numbers | None = None,
) -> None:
    """Write a property for each array, atomically, binary little-endian, and the triangles between these points.

    Args:
        columns: (n,) each, of a dtype in PLY_TYPES
        comments: one line each; what is not ASCII is backslash-escaped
        faces: (m, 3) indices of points; None: there are none
    """
    dtype = np.dtype([(name, values.dtype.newbyteorder("<")) for name, values in columns.items()])
    points = np.zeros(len(next(iter(columns.values()))), dtype)
    for name, values in columns.items():
        points[name] = values
    lines = ["ply", "format binary_little_endian 1.0"]
    lines += [f"comment {text.encode('unicode_escape').decode('ascii')}" for text in comments]
    lines += [f"element vertex {len(points)}"]
    lines += [f"property {PLY_TYPES[values.dtype.name]} {name}" for name, values in columns.items()]
    triangles = np.zeros(0 if faces is None else len(faces), [("count", "u1"), ("corners", "<i4", 3)])
    if faces is not None:
        lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        triangles["count"], triangles["corners"] = 3, faces
    with atomic_output(path) as temporary, open(temporary, "wb") as file:
        file.write("\n".join([*lines, "end_header", ""]).encode("ascii"))
        file.write(points.tobytes() + triangles.tobytes())
