"""Write bags of ROS 2: a folder with `metadata.yaml` and a file in MCAP or SQLite, as rosbag2 does. Needs no ROS.

MCAP is written by the package `mcap`. Tables of SQLite and keys of the metadata are those of rosbag2's version 8, which
ROS 2 Humble, Iron and later read.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from .._version import __version__
from ..files.optional import import_optional
from .ros_messages import HASHES, MessageTypes

VERSION = 8
"""Version of rosbag2's metadata."""

_FOREVER = "{sec: 9223372036, nsec: 854775807}"
LATCHED = "\n".join(
    (
        "- history: 1",  # keep last
        "  depth: 1",
        "  reliability: 1",  # reliable
        "  durability: 1",  # transient local
        f"  deadline: {_FOREVER}",
        f"  lifespan: {_FOREVER}",
        "  liveliness: 1",  # automatic
        f"  liveliness_lease_duration: {_FOREVER}",
        "  avoid_ros_namespace_conventions: false",
    )
)
"""Quality of service of a topic whose last message is kept for those who subscribe later."""

_TABLES = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL,
  offered_qos_profiles TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
  encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
  data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
INSERT INTO schema VALUES (4, 'lidarscene');
"""


@dataclass(frozen=True, slots=True)
class Topic:
    """Topic of a bag: number from 1, name, type of its messages, quality of service as YAML ("" for the default)."""

    number: int
    name: str
    type: str
    qos: str

    def metadata(self) -> dict[str, Any]:
        """Entry of the bag's metadata."""
        return {
            "name": self.name,
            "type": self.type,
            "serialization_format": "cdr",
            "offered_qos_profiles": self.qos,
            "type_description_hash": HASHES.get(self.type, ""),
        }


class _Storage(Protocol):
    def add_type(self, name: str, text: str) -> None: ...
    def add_topic(self, topic: Topic) -> None: ...
    def write(self, topic: Topic, time_ns: int, data: bytes) -> None: ...
    def finish(self, metadata: str) -> None: ...
    def close(self) -> None: ...


class _McapFile:
    """MCAP file, its chunks not compressed."""

    def __init__(self, path: Path) -> None:
        mcap = import_optional("mcap.writer", extra="ros")
        self._file = open(path, "xb")  # noqa: SIM115
        self._writer = mcap.Writer(self._file, compression=mcap.CompressionType.NONE)
        self._writer.start(profile="ros2", library=f"lidarscene-{__version__}")
        self._schemas: dict[str, int] = {}
        self._channels: dict[int, int] = {}

    def add_type(self, name: str, text: str) -> None:
        self._schemas[name] = self._writer.register_schema(name, "ros2msg", text.encode())

    def add_topic(self, topic: Topic) -> None:
        metadata = {"offered_qos_profiles": topic.qos}
        self._channels[topic.number] = self._writer.register_channel(
            topic.name, "cdr", self._schemas[topic.type], metadata
        )

    def write(self, topic: Topic, time_ns: int, data: bytes) -> None:
        self._writer.add_message(self._channels[topic.number], time_ns, data, time_ns)

    def finish(self, metadata: str) -> None:
        self._writer.add_metadata("rosbag2", {"serialized_metadata": metadata})
        self._writer.finish()

    def close(self) -> None:
        self._file.close()


class _SqliteFile:
    """Database of SQLite."""

    def __init__(self, path: Path) -> None:
        self._connection = sqlite3.connect(path)
        try:
            self._connection.executescript(_TABLES)
        except BaseException:
            self._connection.close()
            raise

    def add_type(self, name: str, text: str) -> None:
        row = (name, "ros2msg", text, HASHES.get(name, ""))
        self._connection.execute("INSERT INTO message_definitions VALUES (NULL, ?, ?, ?, ?)", row)

    def add_topic(self, topic: Topic) -> None:
        values = (topic.number, *topic.metadata().values())
        self._connection.execute("INSERT INTO topics VALUES (?, ?, ?, ?, ?, ?)", values)

    def write(self, topic: Topic, time_ns: int, data: bytes) -> None:
        self._connection.execute("INSERT INTO messages VALUES (NULL, ?, ?, ?)", (topic.number, time_ns, data))

    def finish(self, metadata: str) -> None:
        self._connection.execute("INSERT INTO metadata VALUES (NULL, ?, ?)", (VERSION, metadata))
        self._connection.commit()

    def close(self) -> None:
        self._connection.close()


STORAGES: dict[str, tuple[Callable[[Path], _Storage], str]] = {
    "mcap": (_McapFile, ".mcap"),
    "sqlite3": (_SqliteFile, ".db3"),
}
"""Storage -> its class, and the suffix of its file."""


class BagWriter:
    """Open bag in a new folder; `close` writes its metadata, without which it is incomplete.

    custom_data  texts by key, for the metadata
    """

    def __init__(self, folder: Path, storage: str) -> None:
        kind, suffix = STORAGES[storage]
        folder.mkdir()
        self._folder, self._name, self._plugin = folder, f"{folder.name}{suffix}", storage
        self._storage: _Storage = kind(folder / self._name)
        self._types: set[str] = set()
        self._counts: dict[Topic, int] = {}
        self._first_ns, self._last_ns = (1 << 63) - 1, 0
        self.custom_data: dict[str, str] = {}

    def add_topic(self, name: str, message_type: str, types: MessageTypes, *, qos: str = "") -> Topic:
        """Add a topic, whose messages have this type."""
        topic = Topic(len(self._counts) + 1, name, message_type, qos)
        if message_type not in self._types:
            self._types.add(message_type)
            self._storage.add_type(message_type, types.text_of(message_type))
        self._storage.add_topic(topic)
        self._counts[topic] = 0
        return topic

    def write(self, topic: Topic, time_ns: int, data: bytes) -> None:
        """Append a message."""
        self._storage.write(topic, time_ns, data)
        self._counts[topic] += 1
        self._first_ns, self._last_ns = min(time_ns, self._first_ns), max(time_ns, self._last_ns)

    def close(self) -> None:
        """Write the metadata, and close the file."""
        information = self._information()
        self._storage.finish("\n".join(_yaml(information)))
        self._storage.close()
        text = "\n".join(_yaml({"rosbag2_bagfile_information": information}))
        (self._folder / "metadata.yaml").write_text(f"{text}\n", encoding="utf-8")

    def abort(self) -> None:
        """Close the file as it is."""
        self._storage.close()

    def _information(self) -> dict[str, Any]:
        """Metadata of the bag."""
        count = sum(self._counts.values())
        span = {
            "starting_time": {"nanoseconds_since_epoch": self._first_ns},
            "duration": {"nanoseconds": max(0, self._last_ns - self._first_ns)},
            "message_count": count,
        }
        return {
            "version": VERSION,
            "storage_identifier": self._plugin,
            **span,
            "topics_with_message_count": [
                {"topic_metadata": topic.metadata(), "message_count": count} for topic, count in self._counts.items()
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self._name],
            "files": [{"path": self._name, **span}],
            "custom_data": self.custom_data or None,
            "ros_distro": "lidarscene",
        }


def _yaml(value: Any) -> Iterator[str]:
    """Lines of block YAML; texts and numbers are those of JSON, which YAML reads too."""
    if isinstance(value, dict) and value:
        for key, item in value.items():
            first, *rest = _yaml(item)
            is_block = isinstance(item, dict | list) and item
            yield from (f"{key}:", f"  {first}") if is_block else (f"{key}: {first}",)
            yield from (f"  {line}" for line in rest)
    elif isinstance(value, list) and value:
        for item in value:
            first, *rest = _yaml(item)
            yield f"- {first}"
            yield from (f"  {line}" for line in rest)
    else:
        yield json.dumps(value)
