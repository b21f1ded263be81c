"""Read bags of ROS 2: messages by topic from files in SQLite or MCAP, compressed or not. Needs no ROS.

A bag's metadata.yaml is not read: its files say all that is needed, also where a recorder left it incomplete.
"""

from __future__ import annotations

import re
import sqlite3
import struct
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol
from urllib.parse import quote

from ..files.optional import import_optional
from ..formats.ros_messages import MessageTypes

SUFFIXES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")
"""Files of a bag."""

_MAGIC = b"\x89MCAP0\r\n"
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 3, 4, 5, 6, 15
"""Kinds of records of an MCAP (mcap.dev/spec)."""

_ZSTD = b"\x28\xb5\x2f\xfd"
"""First bytes of a frame of Zstandard."""


class Message(NamedTuple):
    """Message of a bag: when it was written [ns], its topic, and its place in its file."""

    time_ns: int
    topic: str
    file: BagFile
    place: Any


@dataclass(slots=True)
class Contents:
    """What a file of a bag holds: types by topic, definitions by type, messages in order of time."""

    topics: dict[str, str] = field(default_factory=dict)
    definitions: dict[str, str] = field(default_factory=dict)
    messages: list[Message] = field(default_factory=list)


class BagFile(Protocol):
    """File of a bag."""

    contents: Contents

    def read(self, place: Any) -> bytes:
        """Bytes of a message."""
        ...

    def close(self) -> None:
        """Close it."""
        ...


class Bag:
    """Open bag: ``topics`` has the type of each topic. Raises whatever a damaged file causes."""

    def __init__(self, path: Path, types: MessageTypes) -> None:
        paths = bag_files(path) if path.is_dir() else [path]
        if not paths:
            raise ValueError(f"a bag's folder must have files that end in {', '.join(SUFFIXES)}, got none")
        self._types, self._files = types, list[BagFile]()
        self.topics: dict[str, str] = {}
        try:
            for file_path in paths:
                file = _open(file_path)
                self._files.append(file)
                self.topics |= file.contents.topics
                for name, text in file.contents.definitions.items():
                    types.add(text, name)
        except BaseException:
            self.close()
            raise

    def messages(self, topic: str) -> list[Message]:
        """Messages of a topic, in order of time; `read` gives what they say."""
        return [message for file in self._files for message in file.contents.messages if message.topic == topic]

    def read(self, message: Message) -> Any:
        """Fields of a message."""
        data = message.file.read(message.place)
        if data[:4] == _ZSTD:
            data = _decompress("zstd", data)
        return self._types.deserialize(data, self.topics[message.topic])

    def close(self) -> None:
        """Close its files."""
        for file in self._files:
            file.close()


def bag_files(folder: Path) -> list[Path]:
    """Files of a bag's folder, by the numbers in their names."""
    paths = [path for path in folder.iterdir() if path.name.endswith(SUFFIXES)]
    return sorted(
        paths, key=lambda path: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path.name)]
    )


def _open(path: Path) -> BagFile:
    """Open a file of a bag, a compressed one decompressed beside the system's temporary files."""
    if path.suffix == ".zstd":
        with tempfile.NamedTemporaryFile(suffix=path.with_suffix("").suffix, delete=False) as unpacked:
            unpacked_path = Path(unpacked.name)
            try:
                with open(path, "rb") as packed:
                    import_optional("zstandard", extra="ros").ZstdDecompressor().copy_stream(packed, unpacked)
                unpacked.close()
                return _open(unpacked_path)
            finally:
                with suppress(OSError):  # an open file cannot be removed on Windows
                    unpacked_path.unlink()
    return _McapFile(path) if path.suffix.lower() == ".mcap" else _SqliteFile(path)


class _SqliteFile:
    """Database of SQLite."""

    def __init__(self, path: Path) -> None:
        self._connection = sqlite3.connect(f"file:{quote(str(path))}?mode=ro", uri=True, check_same_thread=False)
        try:
            self.contents = self._contents()
        except BaseException:
            self.close()
            raise

    def _contents(self) -> Contents:
        rows = self._connection.execute("SELECT id, name, type FROM topics").fetchall()
        names = {number: name for number, name, _ in rows}
        has_definitions = self._connection.execute(
            "SELECT count(*) FROM sqlite_master WHERE name = 'message_definitions'"
        ).fetchone()[0]
        definitions = (
            self._connection.execute(
                "SELECT topic_type, encoded_message_definition FROM message_definitions WHERE encoding = 'ros2msg'"
            ).fetchall()
            if has_definitions
            else []
        )
        messages = self._connection.execute("SELECT timestamp, topic_id, id FROM messages ORDER BY timestamp, id")
        return Contents(
            topics={name: kind for _, name, kind in rows},
            definitions=dict(definitions),
            messages=[Message(time_ns, names[topic], self, place) for time_ns, topic, place in messages],
        )

    def read(self, place: int) -> bytes:
        row = self._connection.execute("SELECT data FROM messages WHERE id = ?", (place,)).fetchone()
        return bytes(row[0])

    def close(self) -> None:
        self._connection.close()


class _McapFile:
    """MCAP file: all of its records are passed once, and where each message is, is remembered."""

    def __init__(self, path: Path) -> None:
        self._file = open(path, "rb")  # noqa: SIM115
        self._chunk: tuple[int, bytes] = (-1, b"")
        self._types: dict[int, str] = {}
        self._channels: dict[int, str] = {}
        self.contents = Contents()
        try:
            self._pass_records()
        except BaseException:
            self.close()
            raise

    def _pass_records(self) -> None:
        size = self._file.seek(0, 2)
        self._file.seek(0)
        if self._file.read(len(_MAGIC)) != _MAGIC:
            raise ValueError("not an MCAP file")
        kind = 0
        while kind != _DATA_END:
            head = self._file.read(9)
            if len(head) < 9:
                raise ValueError("an MCAP ends before its end")
            kind, length = struct.unpack("<BQ", head)
            begin = self._file.tell()
            if begin + length > size:
                raise ValueError("an MCAP ends within a record")
            if kind == _CHUNK:
                for inner_kind, inner_begin, record in _records(self._unpacked(begin)):
                    self._take(inner_kind, record, (begin, inner_begin, len(record)))
            elif kind in (_SCHEMA, _CHANNEL, _MESSAGE):
                self._take(kind, self._file.read(length), (-1, begin, length))
            self._file.seek(begin + length)
        self.contents.messages.sort(key=lambda message: message.time_ns)

    def _take(self, kind: int, record: bytes, place: tuple[int, int, int]) -> None:
        """Take what a record says."""
        if kind == _SCHEMA:
            cursor = _RecordCursor(record)
            number, name, encoding = cursor.number("H"), cursor.text(), cursor.text()
            if encoding == "ros2msg":
                self.contents.definitions[name] = cursor.bytes_of("I").decode(errors="replace")
            self._types[number] = name
        elif kind == _CHANNEL:
            cursor = _RecordCursor(record)
            number, schema, topic = cursor.number("H"), cursor.number("H"), cursor.text()
            self._channels[number] = topic
            self.contents.topics[topic] = self._types.get(schema, "")
        elif kind == _MESSAGE:
            channel, _, time_ns, _ = struct.unpack_from("<HIQQ", record)
            self.contents.messages.append(Message(time_ns, self._channels[channel], self, place))

    def _unpacked(self, begin: int) -> bytes:
        """Records of the chunk that begins here, behind its length."""
        if self._chunk[0] != begin:
            self._file.seek(begin - 8)
            (length,) = struct.unpack("<Q", self._file.read(8))
            cursor = _RecordCursor(self._file.read(length))
            _, _, size, _ = (cursor.number(kind) for kind in "QQQI")
            self._chunk = (begin, _decompress(cursor.text(), cursor.bytes_of("Q"), size))
        return self._chunk[1]

    def read(self, place: tuple[int, int, int]) -> bytes:
        chunk, begin, length = place
        if chunk >= 0:
            record = self._unpacked(chunk)[begin : begin + length]
        else:
            self._file.seek(begin)
            record = self._file.read(length)
        return record[22:]  # behind channel, number and times

    def close(self) -> None:
        self._file.close()


def _records(data: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Kind, place and bytes of the records of a chunk."""
    begin = 0
    while begin < len(data):
        kind, length = struct.unpack_from("<BQ", data, begin)
        begin += 9
        if begin + length > len(data):
            raise ValueError("a chunk of an MCAP ends within a record")
        yield kind, begin, data[begin : begin + length]
        begin += length


class _RecordCursor:
    """Place in a record."""

    def __init__(self, record: bytes) -> None:
        self._record, self._at = record, 0

    def number(self, kind: str) -> int:
        (value,) = struct.unpack_from(f"<{kind}", self._record, self._at)
        self._at += struct.calcsize(f"<{kind}")
        return int(value)

    def bytes_of(self, kind: str) -> bytes:
        length = self.number(kind)
        begin, self._at = self._at, self._at + length
        return self._record[begin : self._at]

    def text(self) -> str:
        return self.bytes_of("I").decode(errors="replace")


def _decompress(compression: str, data: bytes, size: int = 0) -> bytes:
    """Decompress a chunk or a message; ``size`` is that of a chunk. Raises ValueError for another compression."""
    if compression == "zstd":
        # Frames may leave out their size: a chunk of MCAP has it, and so has a message of rosbag2.
        unpack = import_optional("zstandard", extra="ros").ZstdDecompressor()
        return bytes(unpack.decompress(data, max_output_size=size))
    if compression == "lz4":
        return bytes(import_optional("lz4.frame", extra="ros").decompress(data))
    if compression:
        raise ValueError(f"chunks must be compressed by zstd or lz4, got '{compression}'")
    return data
