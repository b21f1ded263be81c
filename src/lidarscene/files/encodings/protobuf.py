"""Encode Protocol Buffers, value by value or as rows of an array.

An OSI frame has a message for each of a million points: generated classes would take minutes. Here all messages are
written by NumPy at once. That needs rows of one length, so numbers in rows have a fixed number of bytes: a varint may
have leading zero groups. Only what OSI files need is here (https://protobuf.dev/programming-guides/encoding).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np

from ...maths.arrays import Numbers

VARINT, FIXED64, BYTES = 0, 1, 2
"""Wire types."""


def varint(value: int) -> bytes:
    """Encode a number from 0 to 2^64 - 1, seven bits a byte, lowest first; the eighth bit is set if more follow."""
    groups = []
    while True:
        value, low = value >> 7, value & 0x7F
        groups.append(low | (0x80 if value else 0))
        if not value:
            return bytes(groups)


def tag(field: int, wire: int) -> bytes:
    """Encode what stands before a value: field number and wire type."""
    return varint(field << 3 | wire)


def number(field: int, value: int) -> bytes:
    """Encode a field that is a whole number, an enum or a bool."""
    return tag(field, VARINT) + varint(value)


def double(field: int, value: float) -> bytes:
    """Encode a field that is a double."""
    return tag(field, FIXED64) + struct.pack("<d", value)


def message(field: int, *parts: bytes) -> bytes:
    """Encode a field that is a message, a text or bytes."""
    content = b"".join(parts)
    return tag(field, BYTES) + varint(len(content)) + content


Rows = Sequence["bytes | Numbers"]
"""Parts of a message: bytes that are the same in each row, and (n, k) arrays of bytes."""


def double_rows(field: int, values: Numbers) -> Rows:
    """Encode a double for each row."""
    return tag(field, FIXED64), np.ascontiguousarray(values, "<f8").view(np.uint8).reshape(-1, 8)


def number_rows(field: int, values: Numbers, *, size: int) -> Rows:
    """Encode a whole number for each row, in ``size`` bytes: up to 2^(7 size) - 1, and 2^64 - 1 in ten."""
    shifts = 7 * np.arange(size, dtype=np.uint64)
    groups = (values.astype(np.uint64)[:, None] >> shifts & np.uint64(0x7F)).astype(np.uint8)
    groups[:, :-1] |= 0x80
    return tag(field, VARINT), groups


def message_rows(field: int, *parts: bytes | Numbers) -> Rows:
    """Encode a message for each row, made of parts."""
    size = sum(len(part) if isinstance(part, bytes) else part.shape[1] for part in parts)
    return tag(field, BYTES) + varint(size), *parts


def join_rows(rows: Rows, count: int) -> bytes:
    """Join the n rows to bytes, one after the other."""
    columns = [np.tile(np.frombuffer(part, np.uint8), (count, 1)) if isinstance(part, bytes) else part for part in rows]
    return np.concatenate(columns, axis=1).tobytes()
