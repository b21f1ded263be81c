"""ROS 2 bags, SQLite or MCAP: PointCloud2 of any driver, and packets of Velodyne's and Hesai's, read by rosbags."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..files.optional import optional
from ..formats.described import reading
from ..maths.pose import Pose, rotation_numbers
from . import hesai_reader, velodyne_reader
from .pcap_reader import Packet
from .recording import Recording
from .sweep import Sweep
from .sweep_from_columns import sweep_of

POINTS, TRANSFORMS = "sensor_msgs/msg/PointCloud2", "tf2_msgs/msg/TFMessage"
SCANS: dict[str, Callable[..., Recording]] = {
    "velodyne_msgs/msg/VelodyneScan": velodyne_reader.recording_of_scans,
    "pandar_msgs/msg/PandarScan": hesai_reader.recording_of_scans,
}
"""Messages of packets, and who reads them."""

DEFINITIONS = {
    "velodyne_msgs/msg/VelodynePacket": "builtin_interfaces/Time stamp\nuint8[1206] data",
    "velodyne_msgs/msg/VelodyneScan": "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets",
    "pandar_msgs/msg/PandarPacket": "builtin_interfaces/Time stamp\nuint8[1500] data\nuint32 size",
    "pandar_msgs/msg/PandarScan": "std_msgs/Header header\npandar_msgs/PandarPacket[] packets",
}
"""As the drivers define them, for bags that do not say."""

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""Constants of sensor_msgs/PointField."""


def open_bag(path: Path, metadata: Path | None) -> Recording:
    """Open the first topic of a lidar; a pose is the transform of the cloud's frame, if the bag has it."""
    highlevel, typesys = optional("rosbags.highlevel", extra="ros"), optional("rosbags.typesys", extra="ros")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    for name, text in DEFINITIONS.items():
        store.register(typesys.get_types_from_msg(text, name))
    with reading(path, folder=True):
        bag = _opened(lambda file: highlevel.AnyReader([file], default_typestore=store), path)
    connections = [one for one in bag.connections if one.msgtype in (POINTS, *SCANS)]
    if not connections:
        topics = ", ".join(f"{one.topic} ({one.msgtype})" for one in bag.connections) or "none"
        bag.close()
        raise InputError(f"{path}: must have a topic of PointCloud2 or of Velodyne's or Hesai's packets, got {topics}")
    chosen = connections[0]
    if chosen.msgtype in SCANS:
        scans = _Scans(bag, path, chosen)
        kind = chosen.msgtype.partition("_")[0]
        return SCANS[chosen.msgtype](path, metadata, scans, name=f"{kind} {path.suffix[1:] or 'bag'}")
    if metadata is not None:
        raise InputError(f"--metadata {metadata}: goes with recordings of packets, not with PointCloud2")
    with reading(path, folder=True):
        stamps = _stamps(bag, chosen)
        transforms = _transforms(bag)
    about = {"format": f"ros {path.suffix[1:] or 'bag'}", "sensor": "", "topic": chosen.topic}

    def read(frame: int) -> Sweep:
        with reading(path, folder=True):
            return _sweep(_message(bag, chosen, stamps, frame), transforms, about | {"frame": str(frame)})

    return Recording(path=path, count=len(stamps), read=read, close_file=bag.close, metadata=about)


def _opened(reader: Callable[[Path], Any], path: Path) -> Any:
    """The bag; of a folder whose metadata.yaml leaves out what it needs, as some recorders do, the file in it."""
    bag = reader(path)
    try:
        bag.open()
    except Exception:
        inside = [one for one in path.iterdir() if one.suffix in (".db3", ".mcap")] if path.is_dir() else []
        if len(inside) != 1:
            raise
        bag = reader(inside[0])
        bag.open()
    return bag


def _stamps(bag: Any, connection: Any) -> list[int]:
    """When each message of a topic was written [ns]."""
    return [stamp for _, stamp, _ in bag.messages(connections=[connection])]


def _message(bag: Any, connection: Any, stamps: Sequence[int], number: int) -> Any:
    """The message of this number."""
    # Of several at one instant, as many are passed over as came before.
    before = sum(stamp == stamps[number] for stamp in stamps[:number])
    there = bag.messages(connections=[connection], start=stamps[number], stop=stamps[number] + 1)
    for place, (_, _, raw) in enumerate(there):
        if place == before:
            return bag.deserialize(raw, connection.msgtype)
    raise ValueError(f"message {number} of {connection.topic} is missing")


class _Scans(Sequence[list[Packet]]):
    """The packets of each message, read when asked for."""

    def __init__(self, bag: Any, path: Path, connection: Any) -> None:
        self._bag, self._connection = bag, connection
        with reading(path, folder=True):
            self._stamps = _stamps(bag, connection)

    def __len__(self) -> int:
        return len(self._stamps)

    def __getitem__(self, number: Any) -> Any:
        message = _message(self._bag, self._connection, self._stamps, number)
        return [
            Packet(one.stamp.sec + 1e-9 * one.stamp.nanosec, bytes(one.data)[: getattr(one, "size", None)])
            for one in message.packets
        ]


def _sweep(message: Any, transforms: dict[str, list[tuple[float, Pose]]], metadata: dict[str, str]) -> Sweep:
    order = ">" if message.is_bigendian else "<"
    scalars = [one for one in message.fields if one.count == 1 and one.datatype in _TYPES]
    dtype = np.dtype(
        {
            "names": [one.name for one in scalars],
            "formats": [order + _TYPES[one.datatype] for one in scalars],
            "offsets": [one.offset for one in scalars],
            "itemsize": message.point_step,
        }
    )
    rows, columns = message.height, message.width
    data = np.asarray(message.data, np.uint8)
    if len(data) < rows * message.row_step or message.row_step < columns * dtype.itemsize:
        raise ValueError(f"a cloud must have {rows} rows of {message.row_step} bytes, got {len(data)} bytes")
    used = data[: rows * message.row_step].reshape(rows, -1)[:, : columns * dtype.itemsize]
    points = np.ascontiguousarray(used).reshape(-1).view(dtype)
    start_s = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
    known = [pose for at_s, pose in transforms.get(message.header.frame_id, ()) if at_s <= start_s]
    return sweep_of(
        {name: points[name] for name in dtype.names or ()},
        shape=(rows, columns) if rows > 1 else None,
        start_s=start_s,
        pose=known[-1] if known else None,
        metadata=metadata,
    )


def _transforms(bag: Any) -> dict[str, list[tuple[float, Pose]]]:
    """Instants and poses of each frame in its parent."""
    found: dict[str, list[tuple[float, Pose]]] = {}
    connections = [one for one in bag.connections if one.msgtype == TRANSFORMS]
    for connection, _, raw in bag.messages(connections=connections) if connections else ():
        for one in bag.deserialize(raw, connection.msgtype).transforms:
            at, turn = one.transform.translation, one.transform.rotation
            pose = Pose(
                position_m=np.array([at.x, at.y, at.z]),
                rotation=np.array(rotation_numbers(turn.w, turn.x, turn.y, turn.z)).reshape(3, 3),
            )
            stamp = one.header.stamp
            found.setdefault(one.child_frame_id, []).append((stamp.sec + 1e-9 * stamp.nanosec, pose))
    return found
