"""Write point clouds as a bag of ROS 2 messages: one file, MCAP or SQLite. Needs rosbags, no ROS.

Topic `/points` has a sensor_msgs/PointCloud2 for each frame, in the sensor's frame (frame_id `lidar`); where the
cloud has the pose of its sensor, `/tf` has it as the transform from `map` to `lidar`. The fields of the driver that
the layout names come first, with its offsets and types; all other columns follow by their own names.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, cast

import numpy as np

from ..files.atomic import atomic_output, folder_beside
from ..files.optional import import_optional
from ..maths.arrays import Numbers
from ..maths.rotations import quaternion
from .cloud_columns import Cloud
from .cloud_description import description, library_errors

POINTS, TRANSFORMS, SENSOR_FRAME, WORLD_FRAME = "/points", "/tf", "lidar", "map"
BAG_VERSION = 8
"""Version of rosbag2's metadata, which ROS 2 Humble, Iron and later read."""

# Offset and type of each field of a point, and its bytes in all.
LAYOUTS: dict[str, tuple[dict[str, tuple[int, str]], int]] = {
    # velodyne_pointcloud of the ROS driver: x y z intensity ring time, time in seconds.
    "velodyne": (
        {
            "x": (0, "<f4"),
            "y": (4, "<f4"),
            "z": (8, "<f4"),
            "intensity": (12, "<f4"),
            "ring": (16, "<u2"),
            "time": (18, "<f4"),
        },
        22,
    ),
    # ouster_ros::Point: t in nanoseconds, range in millimetres, aligned to 16 bytes.
    "ouster": (
        {
            "x": (0, "<f4"),
            "y": (4, "<f4"),
            "z": (8, "<f4"),
            "intensity": (16, "<f4"),
            "t": (20, "<u4"),
            "reflectivity": (24, "<u2"),
            "ring": (26, "<u2"),
            "ambient": (28, "<u2"),
            "range": (32, "<u4"),
        },
        48,
    ),
}

_REPLACED = {"velodyne": ("channel",), "ouster": ("channel", "time")}
"""Columns that a layout has under another name only."""

_DATATYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
"""Constants of sensor_msgs/PointField."""


def write_ros(
    path: str | os.PathLike[str], clouds: Cloud | Iterable[Cloud], *, storage: str = "mcap", layout: str = "velodyne"
) -> None:
    """Write a bag of one frame, or of each that comes.

    storage  "mcap" or "sqlite3", one file in both cases
    layout   "velodyne" or "ouster"
    """
    frames = [cast(Cloud, clouds)] if hasattr(clouds, "columns") else clouds
    with ros_frames(path, storage=storage, layout=layout) as append:
        for cloud in frames:
            append(cloud)


@contextmanager
def ros_frames(
    path: str | os.PathLike[str], *, storage: str = "mcap", layout: str = "velodyne"
) -> Iterator[Callable[[Cloud], None]]:
    """Write a bag of the clouds that are appended in the block: a message each, at the start of its frame."""
    rosbag2 = import_optional("rosbags.rosbag2", extra="ros")
    typesys = import_optional("rosbags.typesys", extra="ros")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    plugin = rosbag2.StoragePlugin[storage.upper()]
    # A bag is a folder with one file of the folder's name, which the file's own metadata repeat. It is made where a
    # killed process leaves its unfinished files, so that the next write removes it.
    with atomic_output(path) as temporary, folder_beside(temporary) as folder:
        bag = folder / Path(path).stem
        # Errors between two frames come from the caller, not from the library: they stay as they are.
        writer = rosbag2.Writer(bag, version=BAG_VERSION, storage_plugin=plugin)
        with library_errors(path), _closed_on_error(writer):
            _open(writer)
            append_cloud = _open_topics(writer, store, layout)

        def append(cloud: Cloud) -> None:
            with library_errors(path):
                append_cloud(cloud)

        try:
            yield append
        finally:
            with library_errors(path), _closed_on_error(writer):
                writer.close()
        os.replace(next(file for file in bag.iterdir() if file.suffix != ".yaml"), temporary)


def _open(writer: Any) -> None:
    """Open the writer's file as its own `open` does, but so that a full disk leaves no open SQLite file."""
    writer.path.mkdir()
    kind = writer.STORAGE_PLUGINS[writer.storage_plugin]
    writer.storage = kind.__new__(kind)  # known to the writer before it opens the file, so that `abort` closes it
    writer.storage.__init__(writer.path, writer.compression_mode)


@contextmanager
def _closed_on_error(writer: Any) -> Iterator[None]:
    """Close the file if the block fails: without room, rosbags leaves it open."""
    try:
        yield
    except Exception:
        with suppress(Exception):
            writer.abort()
        raise


def _open_topics(writer: Any, store: Any, layout: str) -> Callable[[Cloud], None]:
    message, transform = "sensor_msgs/msg/PointCloud2", "tf2_msgs/msg/TFMessage"
    points = writer.add_connection(POINTS, message, typestore=store)
    transforms = writer.add_connection(TRANSFORMS, transform, typestore=store)

    def append(cloud: Cloud) -> None:
        writer.set_custom_data("lidarscene", description(cloud))
        stamp_ns = round(1e9 * cloud.frame_start_s)
        transforms_message = _transform_message(cloud, store, stamp_ns)
        if transforms_message is not None:
            writer.write(transforms, stamp_ns, store.serialize_cdr(transforms_message, transform))
        rows = structured_rows(cloud.in_sensor_frame(), layout)
        writer.write(points, stamp_ns, store.serialize_cdr(_points_message(rows, store, stamp_ns), message))

    return append


def structured_rows(cloud: Cloud, layout: str) -> Numbers:
    """(n,) structured points of the message: the driver's fields, then every other column."""
    fields, size = LAYOUTS[layout]
    driver_columns = {"x", "y", "z", *fields, *_REPLACED[layout]}
    other_columns = [column.name for column in cloud.columns if column.name not in driver_columns]
    dtypes = {name: cloud.column(name).dtype.newbyteorder("<") for name in other_columns}
    offsets = size + np.cumsum([0, *(dtype.itemsize for dtype in dtypes.values())])
    dtype = np.dtype(
        {
            "names": [*fields, *other_columns],
            "formats": [*(kind for _, kind in fields.values()), *dtypes.values()],
            "offsets": [*(offset for offset, _ in fields.values()), *offsets[:-1].tolist()],
            "itemsize": int(offsets[-1]),
        }
    )
    rows = np.zeros(len(cloud), dtype)
    for name in other_columns:
        rows[name] = cloud.column(name)
    for name in fields:
        rows[name] = _driver_value(cloud, name, rows.dtype[name])
    return rows


def _driver_value(cloud: Cloud, name: str, dtype: np.dtype[Any]) -> Numbers:
    """Values of a driver's field, in its unit; zero where the cloud has no such column."""
    scales = {"t": ("time", 1e9), "range": ("range", 1e3), "reflectivity": ("reflectivity", 100.0)}
    column, scale = scales.get(name, ("channel" if name == "ring" else name, 1.0))
    if column not in ("range", *(column.name for column in cloud.columns)):
        return np.zeros(len(cloud), dtype)
    values = cloud.column(column)
    if dtype.kind == "f":
        return values.astype(dtype)
    limits = np.iinfo(str(dtype))
    return np.clip(np.rint(scale * values.astype(np.float64)), limits.min, limits.max).astype(dtype)


def _points_message(rows: Numbers, store: Any, stamp_ns: int) -> Any:
    types = store.types
    fields = [
        types["sensor_msgs/msg/PointField"](name=name, offset=offset, datatype=_DATATYPES[kind.str[1:]], count=1)
        for name, (kind, offset, *_) in (rows.dtype.fields or {}).items()
    ]
    return types["sensor_msgs/msg/PointCloud2"](
        header=_header(store, stamp_ns, SENSOR_FRAME),
        height=1,
        width=len(rows),
        fields=fields,
        is_bigendian=False,
        point_step=rows.dtype.itemsize,
        row_step=rows.nbytes,
        data=np.frombuffer(rows.tobytes(), np.uint8),
        is_dense=True,
    )


def _transform_message(cloud: Cloud, store: Any, stamp_ns: int) -> Any:
    """Message of the sensor's pose in the world; None if the cloud has none."""
    pose, types = cloud.sensor_to_world, store.types
    if pose is None:
        return None
    x, y, z = pose.position_m.tolist()
    qw, qx, qy, qz = quaternion(pose.rotation)
    stamped = types["geometry_msgs/msg/TransformStamped"](
        header=_header(store, stamp_ns, WORLD_FRAME),
        child_frame_id=SENSOR_FRAME,
        transform=types["geometry_msgs/msg/Transform"](
            translation=types["geometry_msgs/msg/Vector3"](x=x, y=y, z=z),
            rotation=types["geometry_msgs/msg/Quaternion"](x=qx, y=qy, z=qz, w=qw),
        ),
    )
    return types["tf2_msgs/msg/TFMessage"](transforms=[stamped])


def _header(store: Any, stamp_ns: int, frame: str) -> Any:
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    stamp = store.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    return store.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)
