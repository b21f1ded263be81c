"""Columns of points as PLY, whatever they are: names and arrays in, a file out."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ..files.atomic import atomic_output
from .ply import PLY_TYPES

Array = np.ndarray[Any, Any]


def write_columns(
    path: str | os.PathLike[str], columns: Mapping[str, Array], *, comments: Iterable[str] = ()
) -> None:
    """Write a property for each array, atomically, binary little-endian.

    columns   (n,) each, of a dtype in PLY_TYPES
    comments  one line each; what is not ASCII is backslash-escaped
    """
    dtype = np.dtype([(name, values.dtype.newbyteorder("<")) for name, values in columns.items()])
    points = np.zeros(len(next(iter(columns.values()))), dtype)
    for name, values in columns.items():
        points[name] = values
    lines = ["ply", "format binary_little_endian 1.0"]
    lines += [f"comment {text.encode('unicode_escape').decode('ascii')}" for text in comments]
    lines += [f"element vertex {len(points)}"]
    lines += [f"property {PLY_TYPES[values.dtype.name]} {name}" for name, values in columns.items()]
    with atomic_output(path) as temporary, open(temporary, "wb") as file:
        file.write("\n".join([*lines, "end_header", ""]).encode("ascii"))
        file.write(points.tobytes())
