"""Recordings in ROS 2 bags, SQLite or MCAP: clouds of any driver, packets of Velodyne and Hesai."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, OptionError, OptionWarning, warn
from ..formats.cloud_description import input_errors
from ..formats.packets.layouts import Packet
from ..maths.pose import Pose, rotation_numbers
from . import hesai_reader, velodyne_reader
from .bag_files import BagReader, Message
from .recording import Recording
from .sweep import Sweep
from .sweep_from_columns import sweep_of

POINTS, TRANSFORMS = "sensor_msgs/msg/PointCloud2", "tf2_msgs/msg/TFMessage"
CUSTOM = "livox_ros_driver2/msg/CustomMsg"
SCANS: dict[str, Callable[..., Recording]] = {
    "velodyne_msgs/msg/VelodyneScan": velodyne_reader.recording_of_scans,
    "pandar_msgs/msg/PandarScan": hesai_reader.recording_of_scans,
}
"""Types of messages that hold packets -> their reader."""

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""Types of numpy by the constants of sensor_msgs/PointField."""


def open_bag(path: Path, metadata: Path | None) -> Recording:
    """Open the first topic of a lidar; a pose is the last transform of the cloud's frame before it."""
    with input_errors(path, folder=True):
        bag = BagReader(path)
    try:
        return _recording_of(bag, path, metadata)
    except BaseException:
        bag.close()
        raise


def _recording_of(bag: BagReader, path: Path, metadata: Path | None) -> Recording:
    lidars = [topic for topic, kind in bag.topics.items() if kind in (POINTS, CUSTOM, *SCANS) and bag.messages(topic)]
    if not lidars:
        topics = ", ".join(f"{topic} ({kind})" for topic, kind in bag.topics.items()) or "an empty bag"
        must = "must have messages of PointCloud2, of Livox or of Velodyne's or Hesai's packets"
        raise InputError(f"{path}: {must}, got none in {' '.join(topics.split())}")
    topic, *others = lidars
    if others:
        warn(OptionWarning("{0}: read is the topic {1}; others of lidars are {2}", path, topic, ", ".join(others)))
    messages, kind = bag.messages(topic), bag.topics[topic]
    if kind in SCANS:
        maker = kind.partition("_")[0]
        scans, name = _Scans(bag, path, messages), f"{maker} {path.suffix[1:] or 'bag'}"
        return replace(SCANS[kind](path, metadata, scans, name=name), close_file=bag.close)
    if metadata is not None:
        raise OptionError("{metadata} {0}: needs a recording of packets, got clouds", metadata)
    with input_errors(path, folder=True):
        transforms = _transforms(bag)
    recording_metadata = {"format": f"ros {path.suffix[1:] or 'bag'}", "sensor": "", "topic": topic}

    sweep = _sweep_of_livox if kind == CUSTOM else _sweep

    def read(frame: int) -> Sweep:
        with input_errors(path, folder=True):
            return sweep(bag.read(messages[frame]), transforms, recording_metadata | {"frame": str(frame)})

    return Recording(path=path, count=len(messages), read=read, close_file=bag.close, metadata=recording_metadata)


class _Scans(Sequence[list[Packet]]):
    """Packets of each message, read when it is indexed."""

    def __init__(self, bag: BagReader, path: Path, messages: Sequence[Message]) -> None:
        self._bag, self._path, self._messages = bag, path, messages

    def __len__(self) -> int:
        return len(self._messages)

    def __getitem__(self, number: Any) -> Any:
        with input_errors(self._path, folder=True):
            message = self._bag.read(self._messages[number])
        return [
            Packet(packet.stamp.sec + 1e-9 * packet.stamp.nanosec, bytes(packet.data)[: getattr(packet, "size", None)])
            for packet in message.packets
        ]


def _sweep(message: Any, transforms: Transforms, metadata: dict[str, str]) -> Sweep:
    order = ">" if message.is_bigendian else "<"
    scalars = [field for field in message.fields if field.count == 1 and field.datatype in _TYPES]
    dtype = np.dtype(
        {
            "names": [field.name for field in scalars],
            "formats": [order + _TYPES[field.datatype] for field in scalars],
            "offsets": [field.offset for field in scalars],
            "itemsize": message.point_step,
        }
    )
    rows, columns = message.height, message.width
    step = message.row_step or columns * dtype.itemsize  # some writers leave it out
    data = np.frombuffer(message.data, np.uint8)
    if len(data) < rows * step or step < columns * dtype.itemsize:
        raise ValueError(f"a cloud must have {rows} rows of {step} bytes, got {len(data)} bytes")
    rows_bytes = data[: rows * step].reshape(rows, step)[:, : columns * dtype.itemsize]
    points = np.ascontiguousarray(rows_bytes).reshape(-1).view(dtype)
    start_s = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
    return sweep_of(
        {name: points[name] for name in dtype.names or ()},
        shape=(rows, columns) if rows > 1 else None,
        start_s=start_s,
        pose=_pose_at(transforms, message.header.frame_id, start_s),
        metadata=metadata,
    )


def _sweep_of_livox(message: Any, transforms: Transforms, metadata: dict[str, str]) -> Sweep:
    names = ("offset_time", "x", "y", "z", "reflectivity", "line")
    columns = {name: np.array([getattr(point, name) for point in message.points]) for name in names}
    columns["offset_time"] = columns["offset_time"].astype(np.int64)  # nanoseconds
    start_s = 1e-9 * message.timebase
    pose = _pose_at(transforms, message.header.frame_id, start_s)
    return sweep_of(columns, start_s=start_s, pose=pose, metadata=metadata)


Transforms = dict[str, list[tuple[float, str, Pose]]]
"""Name of a frame -> stamps [s], names of its parent, and poses in it; of static ones the stamp is -inf."""


WORLDS = ("earth", "map", "odom", "world")
"""Source: REP 105, and `world` as many robots have it; frames that do not move with a vehicle."""


def _pose_at(transforms: Transforms, frame: str, time_s: float) -> Pose | None:
    """Pose of a frame in the last of its parents by the last transforms before a time; None if one is missing.

    None, too, if nothing moves and the last is no world: that is the place on a vehicle, which may drive.
    """
    pose, visited, moves = None, set[str](), False
    frame = frame.lstrip("/")
    while frame in transforms and frame not in visited:
        visited.add(frame)
        earlier = [entry for entry in transforms[frame] if entry[0] <= time_s]
        if not earlier:
            return None
        stamp_s, frame, step = earlier[-1]
        moves |= stamp_s > -math.inf
        pose = step if pose is None else step @ pose
    return pose if moves or frame in WORLDS else None


def _transforms(bag: BagReader) -> Transforms:
    """Transforms of all frames, those of `/tf_static` for all times."""
    transforms: Transforms = {}
    topics = [topic for topic, kind in bag.topics.items() if kind == TRANSFORMS]
    messages = [message for topic in topics for message in bag.messages(topic)]
    for message in sorted(messages, key=lambda message: message.time_ns):
        for stamped in bag.read(message).transforms:
            translation, rotation = stamped.transform.translation, stamped.transform.rotation
            quaternion = np.array([rotation.w, rotation.x, rotation.y, rotation.z])
            quaternion /= np.linalg.norm(quaternion) or 1.0  # some are rounded, or all zero
            pose = Pose(
                position_m=np.array([translation.x, translation.y, translation.z]),
                rotation=np.array(rotation_numbers(*quaternion)).reshape(3, 3),
            )
            stamp, is_static = stamped.header.stamp, message.topic.endswith("tf_static")
            stamp_s = -math.inf if is_static else stamp.sec + 1e-9 * stamp.nanosec
            # ROS 1 wrote names with a slash before them.
            child, parent = (name.lstrip("/") for name in (stamped.child_frame_id, stamped.header.frame_id))
            transforms.setdefault(child, []).append((stamp_s, parent, pose))
    return transforms
