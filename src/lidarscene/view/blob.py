"""Blobs: a header and named arrays packed into bytes that the page reads (`static/blob.js`).

Little-endian: the length of the header as uint32, the header as JSON in UTF-8, padded to four bytes, and the arrays one
after the other, each padded to four bytes. The header's key "arrays" gives the type, start and count of each.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..maths.arrays import Numbers

TYPES = {"float32": "<f4", "uint8": "u1", "int32": "<i4", "uint32": "<u4"}
"""Types of array that the page can read, NumPy name -> byte format."""


def pack_blob(header: Mapping[str, Any], arrays: Mapping[str, Numbers]) -> bytes:
    """Pack one blob.

    Raises:
        KeyError: for an array whose type is not in TYPES
    """
    start, places, parts = 0, {}, []
    for name, array in arrays.items():
        data = np.ascontiguousarray(array, dtype=TYPES[array.dtype.name]).tobytes()
        places[name] = {"type": array.dtype.name, "start": start, "count": array.size}
        parts.append(data + bytes(-len(data) % 4))
        start += len(parts[-1])
    text = json.dumps({**header, "arrays": places}, allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    return b"".join([len(text).to_bytes(4, "little"), text, *parts])


def unpack_blob(blob: bytes) -> tuple[dict[str, Any], dict[str, Numbers]]:
    """Unpack a blob: header, without its "arrays", and arrays by name."""
    end = 4 + int.from_bytes(blob[:4], "little")
    header = json.loads(blob[4:end])
    arrays = {
        name: np.frombuffer(blob, TYPES[place["type"]], place["count"], end + place["start"])
        for name, place in header.pop("arrays").items()
    }
    return header, arrays
