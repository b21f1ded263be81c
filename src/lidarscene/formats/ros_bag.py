"""Write bags of ROS 2: a folder with `metadata.yaml` and a file in MCAP or SQLite, as rosbag2 does. Needs no ROS.

Messages become bytes by the package `mcap-ros2-support`, MCAP files by `mcap`. Tables of SQLite and keys of the
metadata are those of rosbag2's version 8, which ROS 2 Humble, Iron and later read.
"""

from __future__ import annotations

import json
import re
import sqlite3
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Protocol

from .._version import __version__
from ..files.optional import import_optional

DEFINITIONS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "sensor_msgs/PointField": "string name\nuint32 offset\nuint8 datatype\nuint32 count",
    "sensor_msgs/PointCloud2": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\n"
        "uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense"
    ),
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "sensor_msgs/Imu": (
        "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance"
    ),
    "livox_ros_driver2/CustomPoint": (
        "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line"
    ),
    "livox_ros_driver2/CustomMsg": (
        "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\n"
        "livox_ros_driver2/CustomPoint[] points"
    ),
    "velodyne_msgs/VelodynePacket": "builtin_interfaces/Time stamp\nuint8[1206] data",
    "velodyne_msgs/VelodyneScan": "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets",
    "pandar_msgs/PandarPacket": "builtin_interfaces/Time stamp\nuint8[1500] data\nuint32 size",
    "pandar_msgs/PandarScan": "std_msgs/Header header\npandar_msgs/PandarPacket[] packets",
}
"""Type of a message -> definition in ROS 2's language, without constants; those of packets are only read."""

HASHES = {
    "sensor_msgs/msg/PointCloud2": "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
    "sensor_msgs/msg/Imu": "RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b",
    "livox_ros_driver2/msg/CustomMsg": "RIHS01_2eb17e5e35bf5a2d6cd079f3c57f33abf95e5bf7d71b42cddc05daace73d815a",
    "tf2_msgs/msg/TFMessage": "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
}
"""Hashes of the types that we write, by which ROS 2 from Iron on knows them (REP 2016)."""

VERSION = 8
"""Version of rosbag2's metadata."""

_FOREVER = {"sec": 9223372036, "nsec": 854775807}
_LATCHED = {
    "history": 1,  # keep last
    "depth": 1,
    "reliability": 1,  # reliable
    "durability": 1,  # transient local
    "deadline": _FOREVER,
    "lifespan": _FOREVER,
    "liveliness": 1,  # automatic
    "liveliness_lease_duration": _FOREVER,
    "avoid_ros_namespace_conventions": False,
}
LATCHED = json.dumps([_LATCHED])
"""Quality of service of a topic whose last message is kept for those who subscribe later; JSON is YAML."""

MessageFields = dict[str, Any]
"""Message to write: values by field, messages in it as such dictionaries, uint8[] as bytes, other arrays as lists."""

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


def definition(message_type: str) -> str:
    """Return the definition of a message ("std_msgs/msg/Header") with those of all its parts, as a bag holds it."""
    names = [message_type.replace("/msg/", "/")]
    for name in names:  # grows
        parts = re.findall(r"^\w+/\w+", DEFINITIONS[name], re.MULTILINE)
        names += dict.fromkeys(part for part in parts if part not in names)
    texts = [DEFINITIONS[names[0]], *(f"MSG: {name}\n{DEFINITIONS[name]}" for name in names[1:])]
    return f"\n{'=' * 80}\n".join(texts)


Encoder = Callable[[MessageFields], bytes]


def encoder(message_type: str) -> Encoder:
    """Return the function from a message to its bytes (CDR)."""
    # Private there: the library's own writer has no SQLite, and no quality of service.
    dynamic = import_optional("mcap_ros2._dynamic", extra="ros")
    encoders: dict[str, Encoder] = dynamic.serialize_dynamic(message_type, definition(message_type))
    return encoders[message_type]


@cache
def decoder(message_type: str) -> Callable[[bytes], Any]:
    """Return the function from the bytes of a message to an object with its fields; those of uint8[] are bytes."""
    schema_type = import_optional("mcap.records", extra="ros").Schema
    schema = schema_type(id=1, name=message_type, encoding="ros2msg", data=definition(message_type).encode())
    factory = import_optional("mcap_ros2.decoder", extra="ros").DecoderFactory()
    decode: Callable[[bytes], Any] = factory.decoder_for("cdr", schema)
    return decode


class _Storage(Protocol):
    def add_topic(self, topic: dict[str, str]) -> int: ...
    def write(self, topic_id: int, time_ns: int, data: bytes) -> None: ...
    def finish(self, metadata: str) -> None: ...
    def close(self) -> None: ...


class _McapFile:
    """MCAP file, its chunks not compressed."""

    def __init__(self, path: Path) -> None:
        mcap = import_optional("mcap.writer", extra="ros")
        self._file = open(path, "xb")  # noqa: SIM115
        self._schemas: dict[str, int] = {}
        with ExitStack() as on_error:
            on_error.callback(self._file.close)
            self._writer = mcap.Writer(self._file, compression=mcap.CompressionType.NONE)
            self._writer.start(profile="ros2", library=f"lidarscene-{__version__}")
            on_error.pop_all()

    def add_topic(self, topic: dict[str, str]) -> int:
        kind, metadata = topic["type"], {"offered_qos_profiles": topic["offered_qos_profiles"]}
        if kind not in self._schemas:
            self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", definition(kind).encode())
        return int(self._writer.register_channel(topic["name"], "cdr", self._schemas[kind], metadata))

    def write(self, topic_id: int, time_ns: int, data: bytes) -> None:
        self._writer.add_message(topic_id, time_ns, data, time_ns)

    def finish(self, metadata: str) -> None:
        self._writer.add_metadata("rosbag2", {"serialized_metadata": metadata})
        self._writer.finish()

    def close(self) -> None:
        self._file.close()


class _SqliteFile:
    """Database of SQLite."""

    def __init__(self, path: Path) -> None:
        self._connection = sqlite3.connect(path)
        self._types: set[str] = set()
        with ExitStack() as on_error:  # the disk may be full
            on_error.callback(self._connection.close)
            self._connection.executescript(_TABLES)
            on_error.pop_all()

    def add_topic(self, topic: dict[str, str]) -> int:
        kind = topic["type"]
        if kind not in self._types:
            self._types.add(kind)
            row = (kind, "ros2msg", definition(kind), HASHES[kind])
            self._connection.execute("INSERT INTO message_definitions VALUES (NULL, ?, ?, ?, ?)", row)
        row_id = self._connection.execute(
            "INSERT INTO topics VALUES (NULL, ?, ?, ?, ?, ?)", tuple(topic.values())
        ).lastrowid
        return row_id or 0

    def write(self, topic_id: int, time_ns: int, data: bytes) -> None:
        self._connection.execute("INSERT INTO messages VALUES (NULL, ?, ?, ?)", (topic_id, time_ns, data))

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


@dataclass(slots=True)
class _Topic:
    """Topic of a bag: number in its file, entry of the bag's metadata, encoder and number of its messages."""

    id: int
    metadata: dict[str, str]
    encode: Encoder
    count: int = 0


class BagWriter:
    """Open bag in a new folder; `finish` writes its metadata, without which it is incomplete.

    Attributes:
        custom_data: texts by key, for the metadata
    """

    def __init__(self, folder: Path, storage: str) -> None:
        file_type, suffix = STORAGES[storage]
        folder.mkdir()
        self._folder, self._name, self._plugin = folder, f"{folder.name}{suffix}", storage
        self._file: _Storage = file_type(folder / self._name)
        self._topics: dict[str, _Topic] = {}
        self._first_ns, self._last_ns = (1 << 63) - 1, 0
        self.custom_data: dict[str, str] = {}

    def write(self, topic_name: str, message_type: str, time_ns: int, message: MessageFields, *, qos: str = "") -> None:
        """Append a message; ``qos`` is the quality of service of its topic as YAML, "" for the default."""
        if topic_name not in self._topics:
            metadata = {
                "name": topic_name,
                "type": message_type,
                "serialization_format": "cdr",
                "offered_qos_profiles": qos,
                "type_description_hash": HASHES[message_type],
            }
            self._topics[topic_name] = _Topic(self._file.add_topic(metadata), metadata, encoder(message_type))
        topic = self._topics[topic_name]
        self._file.write(topic.id, time_ns, topic.encode(message))
        topic.count += 1
        self._first_ns, self._last_ns = min(time_ns, self._first_ns), max(time_ns, self._last_ns)

    def finish(self) -> None:
        """Write the metadata."""
        information = self._information()
        self._file.finish(json.dumps(information))
        text = json.dumps({"rosbag2_bagfile_information": information}, indent=2)
        (self._folder / "metadata.yaml").write_text(f"{text}\n", encoding="utf-8")

    def close(self) -> None:
        """Close the file as it is."""
        self._file.close()

    def _information(self) -> dict[str, Any]:
        """Metadata of the bag."""
        topics = self._topics.values()
        span = {
            "starting_time": {"nanoseconds_since_epoch": self._first_ns},
            "duration": {"nanoseconds": max(0, self._last_ns - self._first_ns)},
            "message_count": sum(topic.count for topic in topics),
        }
        return {
            "version": VERSION,
            "storage_identifier": self._plugin,
            **span,
            "topics_with_message_count": [
                {"topic_metadata": topic.metadata, "message_count": topic.count} for topic in topics
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self._name],
            "files": [{"path": self._name, **span}],
            "custom_data": self.custom_data,
            "ros_distro": "lidarscene",
        }
