"""Messages of ROS 2 as bytes: definitions in its own language, and their serialization (CDR).

Source of the serialization: OMG DDSI-RTPS 2.3, chapter 10, and DDS-XTYPES 1.3, 7.4.1 (version 1): four bytes that say
the byte order, then every number at a multiple of its size.
"""

from __future__ import annotations

import re
from collections import namedtuple
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from ..maths.arrays import Numbers

DEFINITIONS = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "sensor_msgs/msg/PointField": "string name\nuint32 offset\nuint8 datatype\nuint32 count",
    "sensor_msgs/msg/PointCloud2": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\n"
        "uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense"
    ),
    "geometry_msgs/msg/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/msg/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/msg/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/msg/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "sensor_msgs/msg/Imu": (
        "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance"
    ),
}
"""Type of a message -> definition, without constants, comments and defaults."""

HASHES = {
    "sensor_msgs/msg/PointCloud2": "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
    "sensor_msgs/msg/Imu": "RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b",
    "tf2_msgs/msg/TFMessage": "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
}
"""Hashes of the types that we write, by which ROS 2 from Iron on knows them (REP 2016)."""

NUMBERS = {"bool": "?", "byte": "u1", "char": "u1", "float32": "f4", "float64": "f8"} | {
    f"{sign}int{8 * size}": f"{sign or 'i'}{size}" for sign in ("", "u") for size in (1, 2, 4, 8)
}
"""Type of a number -> dtype without byte order."""

_RULE = f"\n{'=' * 80}\nMSG: "
_FIELD = re.compile(r"([\w/]+)(?:<=\d+)?(?:\[((?:<=)?\d*)\])?\Z")
_LITTLE_ENDIAN = b"\x00\x01\x00\x00"


class MessageField(NamedTuple):
    """Field of a message. ``length`` is None for one value, 0 for a sequence, else that of an array."""

    name: str
    type: str
    length: int | None


class MessageTypes:
    """Types of messages by name: ``types["std_msgs/msg/Header"](stamp=..., frame_id="lidar")`` is a named tuple."""

    def __init__(self, definitions: Mapping[str, str] = DEFINITIONS) -> None:
        self._definitions = dict(definitions)
        self._parsed: dict[str, tuple[Callable[..., Any], list[MessageField]]] = {}

    def __getitem__(self, name: str) -> Callable[..., Any]:
        return self._type_of(name)[0]

    def add(self, text: str, name: str) -> None:
        """Add the definition of a message, and those of its parts that follow in the text, as in a bag."""
        first, *parts = text.replace("\r\n", "\n").split(_RULE)
        self._definitions[name] = first
        for part in parts:
            part_name, _, definition = part.partition("\n")
            self._definitions[_full_name(part_name.strip(), "")] = definition
        self._parsed.clear()

    def text_of(self, name: str) -> str:
        """Definition of a message with those of all its parts, as a bag holds it."""
        names = [name]
        for part in names:  # grows
            names += [
                field.type
                for field in self._type_of(part)[1]
                if field.type in self._definitions and field.type not in names
            ]
        parts = [f"{part.replace('/msg/', '/')}\n{self._definitions[part]}" for part in names[1:]]
        return _RULE.join([self._definitions[name], *parts])

    def serialize(self, message: Any, name: str) -> bytes:
        """Bytes of a message, little-endian."""
        out = bytearray(_LITTLE_ENDIAN)
        self._put(out, message, name)
        return bytes(out)

    def deserialize(self, data: bytes, name: str) -> Any:
        """Message of these bytes. Raises ValueError if they are too few."""
        if len(data) < 4 or data[0] or data[1] > 1:
            raise ValueError(f"a message of {name} must be plain CDR, got {bytes(data[:4]).hex(' ') or 'no bytes'}")
        return self._get(_Cursor(memoryview(data)[4:], "<" if data[1] else ">"), name)

    def _type_of(self, name: str) -> tuple[Callable[..., Any], list[MessageField]]:
        """Constructor and fields of a message."""
        if name not in self._parsed:
            if name not in self._definitions:
                raise ValueError(f"there is no definition of the message {name}")
            fields = list(_fields(self._definitions[name], name.partition("/")[0]))
            message_type = namedtuple(name.rpartition("/")[2], [field.name for field in fields], rename=True)  # type: ignore[misc]
            self._parsed[name] = (message_type, fields)
        return self._parsed[name]

    def _put(self, out: bytearray, message: Any, name: str) -> None:
        """Append a message."""
        for field, value in zip(self._type_of(name)[1], message, strict=True):
            if field.length == 0:
                _put_number(out, len(value), "u4")
            if field.length is not None and field.type in NUMBERS:
                _put_array(out, value, NUMBERS[field.type])
                continue
            for item in value if field.length is not None else (value,):
                if field.type in NUMBERS:
                    _put_number(out, item, NUMBERS[field.type])
                elif field.type == "string":
                    text = item.encode() + b"\0"
                    _put_number(out, len(text), "u4")
                    out += text
                else:
                    self._put(out, item, field.type)

    def _get(self, cursor: _Cursor, name: str) -> Any:
        """Take a message."""
        message_type, fields = self._type_of(name)
        return message_type(*(self._get_field(cursor, field) for field in fields))

    def _get_field(self, cursor: _Cursor, field: MessageField) -> Any:
        count = cursor.length() if field.length == 0 else field.length
        if field.type in NUMBERS:
            values = cursor.numbers(1 if count is None else count, NUMBERS[field.type])
            return values[0].item() if count is None else values
        if count is not None:
            return [self._get_field(cursor, field._replace(length=None)) for _ in range(count)]
        return cursor.text() if field.type == "string" else self._get(cursor, field.type)


class _Cursor:
    """Place in the bytes of a message."""

    def __init__(self, data: memoryview, order: str) -> None:
        self._data, self._order, self._at = data, order, 0

    def take(self, size: int) -> memoryview:
        """Next bytes, as many."""
        end = self._at + size
        if end > len(self._data):
            raise ValueError("a message ends within a field")
        taken, self._at = self._data[self._at : end], end
        return taken

    def numbers(self, count: int, kind: str) -> Numbers:
        """(count,) numbers at a multiple of their size; a view."""
        dtype = np.dtype(kind if kind == "?" else self._order + kind)
        if count:
            self._at += -self._at % dtype.itemsize
        return np.frombuffer(self.take(count * dtype.itemsize), dtype)

    def length(self) -> int:
        """Length of a sequence or a text. Each item has a byte at least."""
        count = int(self.numbers(1, "u4")[0])
        if count > len(self._data) - self._at:
            raise ValueError("a message ends within a sequence")
        return count

    def text(self) -> str:
        """Text, of which a zero marks the end."""
        return bytes(self.take(self.length())).rstrip(b"\0").decode(errors="replace")


def _fields(definition: str, package: str) -> Iterator[MessageField]:
    """Fields of a message, constants left out. Raises ValueError for what is not in ROS 2's language."""
    for line in definition.splitlines():
        words = line.partition("#")[0].split()
        if not words or "=" in "".join(words[1:]):
            continue
        match = _FIELD.match(words[0])
        if match is None or len(words) < 2:
            raise ValueError(f"a definition must have types and names of fields, got {line.strip()!r}")
        bounds = match[2]
        count = None if bounds is None else int(bounds) if bounds.isdigit() else 0
        yield MessageField(words[1], _full_name(match[1], package), count)


def _full_name(name: str, package: str) -> str:
    """Name of a type as bags have it, "std_msgs/msg/Header", from "std_msgs/Header", "Header" or a part's own."""
    if name in NUMBERS or name == "string":
        return name
    if name == "Header":
        return "std_msgs/msg/Header"
    words = name.split("/")
    return f"{words[0] if len(words) > 1 else package}/msg/{words[-1]}"


def _align(out: bytearray, size: int) -> None:
    out += bytes(-(len(out) - len(_LITTLE_ENDIAN)) % size)


def _put_number(out: bytearray, value: Any, kind: str) -> None:
    _put_array(out, [value], kind)


def _put_array(out: bytearray, values: Any, kind: str) -> None:
    array = np.asarray(values, kind if kind == "?" else f"<{kind}")
    if array.size:
        _align(out, array.itemsize)
        out += array.tobytes()
