"""Read bags: messages by topic from files of ROS 2 in SQLite or MCAP, compressed or not, and of ROS 1. Needs no ROS.

A bag's metadata.yaml is not read: its files say all that is needed, also where a recorder left it incomplete. Nor are
the definitions of its messages: those that are read here are the same everywhere, and older bags have none. Messages of
ROS 1 become those of ROS 2.
"""

from __future__ import annotations

import itertools
import os
import sqlite3
import tempfile
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from ..files.inputs import NOT_HIDDEN, by_numbers
from ..files.optional import import_optional
from ..formats.ros_bag import decoder

SUFFIXES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")
"""Files of a bag of ROS 2, whose folder may have several."""

_RENAMED = {
    "tf/msg/tfMessage": "tf2_msgs/msg/TFMessage",
    "livox_ros_driver/msg/CustomMsg": "livox_ros_driver2/msg/CustomMsg",
}
"""Types of messages of ROS 1 -> those with the same fields of ROS 2."""

_ZSTD = b"\x28\xb5\x2f\xfd"
"""First bytes of a frame of Zstandard."""


class Message(NamedTuple):
    """Message of a bag: when it was written [ns], its topic, and a function that reads its bytes."""

    time_ns: int
    topic: str
    read: Callable[[], bytes]


class BagReader:
    """Open bag: ``topics`` has the type of each topic. Raises whatever a damaged file causes."""

    def __init__(self, path: Path) -> None:
        self.topics: dict[str, str] = {}
        self._messages: list[Message] = []
        self._files = ExitStack()
        paths = _bag_files(path) if path.is_dir() else [path]
        if not paths:
            raise ValueError(f"a bag's folder must have files that end in {', '.join(SUFFIXES)}, got none")
        try:
            for file_path in paths:
                # Files follow each other; in a file messages may be out of order.
                self._messages += sorted(self._open(file_path), key=lambda message: message.time_ns)
        except BaseException:
            self.close()
            raise

    def messages(self, topic: str) -> list[Message]:
        """Messages of a topic, in order of time."""
        return [message for message in self._messages if message.topic == topic]

    def read(self, message: Message) -> Any:
        """Fields of a message."""
        data = message.read()
        if data[:4] == _ZSTD:
            data = import_optional("zstandard", extra="ros").decompress(data)
        return decoder(self.topics[message.topic])(data)

    def close(self) -> None:
        """Close its files."""
        self._files.close()

    def _open(self, path: Path) -> list[Message]:
        """Open a file and list its messages; a compressed one is decompressed among the system's temporary files."""
        if path.suffix != ".zstd":
            opened_by = {".mcap": self._open_mcap, ".bag": self._open_ros1}
            return opened_by.get(path.suffix.lower(), self._open_sqlite)(path)
        with tempfile.NamedTemporaryFile(suffix=path.with_suffix("").suffix, delete=False) as unpacked:
            unpacked_path = Path(unpacked.name)
            try:
                with open(path, "rb") as packed:
                    import_optional("zstandard", extra="ros").ZstdDecompressor().copy_stream(packed, unpacked)
                unpacked.close()
                return self._open(unpacked_path)
            finally:
                with suppress(OSError):  # an open file cannot be removed on Windows
                    unpacked_path.unlink()

    def _open_sqlite(self, path: Path) -> list[Message]:
        database = sqlite3.connect(f"file:{quote(str(path))}?mode=ro", uri=True, check_same_thread=False)
        self._files.callback(database.close)
        self.topics |= dict(database.execute("SELECT name, type FROM topics"))
        query = "SELECT timestamp, name, messages.id FROM messages JOIN topics ON topics.id = topic_id"

        def read(row_id: int) -> bytes:
            return bytes(database.execute("SELECT data FROM messages WHERE id = ?", (row_id,)).fetchone()[0])

        return [Message(time_ns, topic, partial(read, row_id)) for time_ns, topic, row_id in database.execute(query)]

    def _open_ros1(self, path: Path) -> list[Message]:
        """List the messages of a bag of ROS 1 by its index; each becomes one of ROS 2 when it is read."""
        typesys = import_optional("rosbags.typesys", extra="ros")
        bag = import_optional("rosbags.rosbag1", extra="ros").Reader(path)
        bag.open()
        self._files.callback(bag.close)
        types = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)

        def read(connection: Any, time_ns: int, later: int) -> bytes:
            at_once = bag.messages([connection], time_ns, time_ns + 1)
            _, _, data = next(itertools.islice(at_once, later, None))
            return bytes(types.ros1_to_cdr(data, connection.msgtype))

        messages = []
        for connection in bag.connections:
            text = getattr(connection.msgdef, "data", connection.msgdef)  # a text before rosbags 0.10
            defined = typesys.get_types_from_msg(text, connection.msgtype)
            types.register({name: fields for name, fields in defined.items() if name not in types.types})
            self.topics[connection.topic] = _RENAMED.get(connection.msgtype, connection.msgtype)
            for time_ns, together in itertools.groupby(entry.time for entry in bag.indexes[connection.id]):
                parts = (partial(read, connection, time_ns, later) for later, _ in enumerate(together))
                messages += [Message(time_ns, connection.topic, part) for part in parts]
        return messages

    def _open_mcap(self, path: Path) -> list[Message]:
        """Pass all records of an MCAP once, and note the place of each message: its record's, and its index in it."""
        reader = import_optional("mcap.stream_reader", extra="ros")
        records = import_optional("mcap.records", extra="ros")
        file = self._files.enter_context(open(path, "rb"))  # noqa: SIM115
        file.seek(-min(reader.MAGIC_SIZE, path.stat().st_size), os.SEEK_END)
        if file.read() != import_optional("mcap.writer", extra="ros").MCAP0_MAGIC:
            raise ValueError("must end as an MCAP does; one whose recorder was stopped is mended by 'mcap recover'")
        file.seek(0)

        def parts_of(record: Any) -> list[Any]:
            return reader.breakup_chunk(record, validate_crc=True) if isinstance(record, records.Chunk) else [record]

        @lru_cache(maxsize=1)  # messages of one chunk are read one after the other
        def parts_at(place: int) -> list[Any]:
            file.seek(place)
            return parts_of(next(reader.StreamReader(file, skip_magic=place > 0, emit_chunks=True).records))

        def read(place: int, index: int) -> bytes:
            return bytes(parts_at(place)[index].data)

        messages, schemas, channels, place = [], {}, {}, 0
        for record in reader.StreamReader(file, emit_chunks=True, validate_crcs=True).records:
            for index, part in enumerate(parts_of(record)):
                if isinstance(part, records.Schema):
                    schemas[part.id] = part.name
                elif isinstance(part, records.Channel):
                    channels[part.id] = part.topic
                    self.topics[part.topic] = schemas.get(part.schema_id, "")
                elif isinstance(part, records.Message):
                    if part.channel_id not in channels:
                        raise ValueError(f"an MCAP has a message of channel {part.channel_id}, but not the channel")
                    messages.append(Message(part.log_time, channels[part.channel_id], partial(read, place, index)))
            place = file.tell()
        return messages


def _bag_files(folder: Path) -> list[Path]:
    """Files of a bag's folder, by the numbers in their names."""
    return sorted((path for path in folder.glob(NOT_HIDDEN) if path.name.endswith(SUFFIXES)), key=by_numbers)
