"""Write point clouds as a bag of ROS 2 messages: an MCAP file, or a folder with SQLite. Needs no ROS.

A message for each frame has the fields of the maker's driver first, with its offsets, types and units; all other
columns follow by their own names. It is a sensor_msgs/PointCloud2 in the sensor's frame, or a
livox_ros_driver2/CustomMsg. Topics and frames have the driver's names (`sensor.driver.DRIVERS`); of a rig they are
`/LABEL/points` (the last part of the driver's) and `LABEL`. A merged cloud is in the vehicle's frame. `/tf` has the
vehicle's pose, from `map` to `base_link`, at the start of each frame and, where it moves, at `TRANSFORM_HZ`;
`/tf_static` has the sensors' places on it (names as in REP 105). The IMU's sensor_msgs/Imu are in a frame of its own.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, OptionError
from ..files.atomic import atomic_folder, atomic_output, folder_beside
from ..maths.arrays import Numbers
from ..maths.pose import Pose
from ..maths.rotations import quaternion
from ..sensor.driver import DRIVERS, Driver
from ..sensor.imu import ImuSamples
from .clock import LAST, default_epoch_ns, stamp_ns, to_ns
from .cloud_columns import Cloud, frame_starts_s, sensor_positions_m
from .cloud_description import description, is_new_place, library_errors
from .ros_bag import LATCHED, BagWriter, MessageFields

TRANSFORMS, STATIC_TRANSFORMS = "/tf", "/tf_static"
VEHICLE_FRAME, WORLD_FRAME = "base_link", "map"

TRANSFORM_HZ = 100.0
"""Choice: poses of a moving vehicle on `/tf`, per second: at 130 km/h it goes on by 0.4 m between two of them."""

_XYZ = {"x": (0, "<f4"), "y": (4, "<f4"), "z": (8, "<f4")}
_XYZIRT = _XYZ | {"intensity": (12, "<f4"), "ring": (16, "<u2"), "timestamp": (18, "<f8")}

# Offset and type of each field of a point, and its bytes in all.
LAYOUTS: dict[str, tuple[dict[str, tuple[int, str]], int]] = {
    # velodyne_pointcloud, PointcloudXYZIRT: time in seconds from the stamp.
    "velodyne": (_XYZ | {"intensity": (12, "<f4"), "ring": (16, "<u2"), "time": (18, "<f4")}, 22),
    # ouster_ros::Point: t in nanoseconds from the stamp, range in millimetres, aligned to 16 bytes. The intensity is
    # the signal in photons; the reflectivity is calibrated, 100 of a white surface.
    "ouster": (
        _XYZ
        | {
            "intensity": (16, "<f4"),
            "t": (20, "<u4"),
            "reflectivity": (24, "<u2"),
            "ring": (26, "<u2"),
            "ambient": (28, "<u2"),
            "range": (32, "<u4"),
        },
        48,
    ),
    # HesaiLidar_ROS_2.0, source_driver_ros2.hpp: timestamp in seconds since 1970.
    "hesai": (_XYZIRT, 26),
    # rslidar_sdk, doc/howto/05_how_to_change_point_type.md, XYZIRT: the same fields.
    "robosense": (_XYZIRT, 26),
    # livox_ros_driver2, lddc.cpp, PointXYZRTLT: the intensity is the reflectivity, timestamp in nanoseconds since 1970.
    "livox": (_XYZ | {"intensity": (12, "<f4"), "tag": (16, "u1"), "line": (17, "u1"), "timestamp": (18, "<f8")}, 26),
}
CUSTOM = "livox-custom"
"""Layout that is a message of its own, livox_ros_driver2/CustomMsg."""

_DATATYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
"""Constants of sensor_msgs/PointField."""


@contextmanager
def ros_frames(
    path: str | os.PathLike[str],
    *,
    storage: str = "mcap",
    layout: str = "",
    epoch_ns: int | None = None,
    topic: str | None = None,
    frame_id: str | None = None,
) -> Iterator[Bag]:
    """Write a bag of the clouds that are appended in the block: a message each, stamped at the start of its frame.

    Args:
        storage: "mcap": one file; "sqlite3": a folder with `metadata.yaml` and one file
        layout: key of `LAYOUTS`, or `CUSTOM`; "": that of the sensor's driver
        topic: of the points, in place of the driver's
        frame_id: of the points, in place of the driver's
        epoch_ns: from 1970 to the scene's second 0; None: `formats.clock.default_epoch_ns` of the first cloud
    """
    if frame_id in (VEHICLE_FRAME, WORLD_FRAME):
        raise InputError(f"{os.fspath(path)}: frame_id: must not be '{frame_id}', the frame that its pose is in")
    # A bag is a folder with one file of the folder's name, which the file's own metadata repeat. It is made where a
    # killed process leaves its unfinished files, so that the next write removes it.
    with _bag_folder(path, storage) as folder:
        # Errors between two frames come from the caller, not from the library: they stay as they are.
        with library_errors(path):
            writer = BagWriter(folder, storage)
        with closing(writer):
            yield Bag(path, writer, layout, epoch_ns, topic=topic, frame_id=frame_id)
            with library_errors(path):
                writer.finish()


@contextmanager
def _bag_folder(path: str | os.PathLike[str], storage: str) -> Iterator[Path]:
    """Yield a folder that does not exist yet, for the bag; what it holds appears at ``path`` when the block ends."""
    name = Path(path).stem
    if storage == "sqlite3":
        with atomic_folder(path) as temporary:
            bag = temporary / f".{name}"
            yield bag.with_name(name)
            for file in bag.with_name(name).rename(bag).iterdir():  # the file in it may have the folder's name
                os.replace(file, temporary / file.name)
            bag.rmdir()
        return
    with atomic_output(path) as temporary, folder_beside(temporary) as folder:
        yield folder / name
        os.replace(next(file for file in (folder / name).iterdir() if file.suffix != ".yaml"), temporary)


class Bag:
    """Open bag: a function that appends clouds. Topics are made when their first message comes."""

    def __init__(
        self,
        path: str | os.PathLike[str],
        writer: BagWriter,
        layout: str,
        epoch_ns: int | None,
        *,
        topic: str | None = None,
        frame_id: str | None = None,
    ) -> None:
        self._path, self._writer, self._layout, self._epoch_ns = path, writer, layout, epoch_ns
        self._topic, self._frame_id = topic, frame_id
        self._mountings: dict[str, Pose] = {}
        self._static: list[MessageFields] = []
        self._drivers: dict[str, Driver] = {}
        self._vehicle_ns: set[int] = set()

    def __call__(self, cloud: Cloud, label: str = "") -> None:
        """Append a frame of the sensor with this label; "" without a rig, and for merged clouds."""
        with library_errors(self._path):
            self._append(cloud, label)

    def _append(self, cloud: Cloud, label: str) -> None:
        if self._epoch_ns is None:
            self._epoch_ns = default_epoch_ns(cloud.frame_start_s)
        time_ns = stamp_ns(cloud.frame_start_s, self._epoch_ns)
        self._writer.custom_data["/".join(filter(None, ("lidarscene", label)))] = description(cloud)
        maker = self._layout.partition("-")[0] or cloud.metadata.get("driver", "")
        is_merged = len(sensor_positions_m(cloud.metadata)) > 1
        driver = self._drivers[label] = DRIVERS["" if is_merged or maker not in DRIVERS else maker]
        topic, frame = self._topic or driver.points, self._frame_id or driver.frame
        if is_merged:
            cloud, frame = _in_vehicle_frame(cloud)
        else:
            cloud = cloud.in_sensor_frame()
            frame = "_".join(filter(None, (_ros_name(label), self._frame_id))) if label else frame
        self._append_transforms(cloud, frame, time_ns)
        header, layout = _header(time_ns, frame), self._layout or (maker if maker in LAYOUTS else "velodyne")
        if layout == CUSTOM:
            message_type, message = "livox_ros_driver2/msg/CustomMsg", _custom_message(cloud, header, time_ns)
        else:
            rows = structured_rows(cloud, layout, time_ns)
            message_type, message = "sensor_msgs/msg/PointCloud2", _points_message(rows, header)
        self._writer.write(topic_of(topic, label), message_type, time_ns, message)

    def append_imu(self, samples: ImuSamples, *, label: str, mounting: Pose) -> None:
        """Append samples of the IMU with this label; ``mounting`` is its pose on the vehicle."""
        with library_errors(self._path):
            if self._epoch_ns is None:
                self._epoch_ns = default_epoch_ns(float(samples.time_s[0])) if len(samples) else None
            driver = self._drivers.get(label, DRIVERS[""])
            frame = f"{_ros_name(label)}_imu" if label else driver.imu_frame
            rows = zip(
                samples.time_s.tolist(), samples.angular_velocity_rad_s, samples.specific_force_m_s2, strict=True
            )
            for time_s, angular_velocity, force in rows:
                time_ns = stamp_ns(time_s, self._epoch_ns or 0)
                self._append_mounting(mounting, frame, time_ns)
                message = _imu_message(_header(time_ns, frame), angular_velocity, force, samples.sigmas)
                self._writer.write(topic_of(driver.imu, label), "sensor_msgs/msg/Imu", time_ns, message)

    def _append_transforms(self, cloud: Cloud, frame: str, time_ns: int) -> None:
        """Append the vehicle's pose, once for sensors whose frames begin together, and a sensor's place on it."""
        vehicle = cloud.vehicle_to_world
        if vehicle is None:
            # Of a recording, which knows no vehicle; a merged cloud may be in the world's frame itself.
            if cloud.sensor_to_world is not None and frame != WORLD_FRAME:
                transform = _transform(cloud.sensor_to_world, WORLD_FRAME, frame, time_ns)
                self._write_transforms(TRANSFORMS, time_ns, [transform])
            return
        if frame != VEHICLE_FRAME:
            self._append_mounting(cloud.sensors_to_vehicle[0], frame, time_ns)
        self._append_vehicle(vehicle, time_ns)

    def append_motion(self, times_s: Sequence[float], poses: Sequence[Pose]) -> None:
        """Append poses of the vehicle in the world, at these times by the scene's clock."""
        with library_errors(self._path):
            for time_s, pose in zip(times_s, poses, strict=True):
                self._append_vehicle(pose, stamp_ns(time_s, self._epoch_ns or 0))

    def _append_vehicle(self, pose: Pose, time_ns: int) -> None:
        if time_ns not in self._vehicle_ns:
            self._vehicle_ns.add(time_ns)
            transform = _transform(pose, WORLD_FRAME, VEHICLE_FRAME, time_ns)
            self._write_transforms(TRANSFORMS, time_ns, [transform])

    def _append_mounting(self, mounting: Pose, frame: str, time_ns: int) -> None:
        """Append the place of a frame on the vehicle, once.

        Raises:
            InputError: for a frame that has another place already
        """
        where, note = f"{os.fspath(self._path)}: frame '{frame}'", "; in labels, ROS does not tell - from _"
        if is_new_place(self._mountings, frame, mounting, where=where, note=note):
            self._static.append(_transform(mounting, VEHICLE_FRAME, frame, time_ns))
            # The last message is all that a late subscriber gets: it has every frame so far.
            self._write_transforms(STATIC_TRANSFORMS, time_ns, self._static, qos=LATCHED)

    def _write_transforms(self, topic: str, time_ns: int, transforms: list[MessageFields], *, qos: str = "") -> None:
        self._writer.write(topic, "tf2_msgs/msg/TFMessage", time_ns, {"transforms": transforms}, qos=qos)


def topic_of(name: str, label: str) -> str:
    """Topic of a sensor of a rig, or of the only one (label "")."""
    name = name.strip("/")
    return f"/{_ros_name(label)}/{name.rpartition('/')[2]}" if label else f"/{name}"


def _ros_name(label: str) -> str:
    """Label as a name in ROS: letters, digits and _, no digit first, and no frame that sensors are placed in."""
    name = label.replace("-", "_")
    return f"sensor_{name}" if name[:1].isdigit() or name in (VEHICLE_FRAME, WORLD_FRAME) else name


def _in_vehicle_frame(cloud: Cloud) -> tuple[Cloud, str]:
    """Merged cloud in the vehicle's frame, if it says where that is, with times from the first sensor's frame on.

    Returns the name of its frame, too.
    """
    starts_s = np.resize(frame_starts_s(cloud.metadata), len(sensor_positions_m(cloud.metadata)))
    time_s = cloud.time_s + (starts_s - starts_s[0])[cloud.sensor_index]
    vehicle = cloud.vehicle_to_world
    if cloud.metadata["frame"] == "vehicle" or vehicle is None:
        frame = VEHICLE_FRAME if cloud.metadata["frame"] == "vehicle" else WORLD_FRAME
        return replace(cloud, time_s=time_s), frame
    xyz_m = vehicle.inverse_apply(cloud.xyz_m.astype(np.float64)).astype(np.float32)
    return replace(cloud, xyz_m=xyz_m, time_s=time_s, **cloud.vectors_turned(vehicle.rotation.T)), VEHICLE_FRAME


def structured_rows(cloud: Cloud, layout: str, time_ns: int = 0) -> Numbers:
    """(n,) structured points of the message: the driver's fields, then every other column.

    Args:
        layout: key of `LAYOUTS`
        time_ns: stamp of the message, since 1970
    """
    fields, size = LAYOUTS[layout]
    # The time that a driver counts in nanoseconds replaces ours in seconds.
    driver_columns = {"x", "y", "z", *fields, *(("time",) if "t" in fields else ())}
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
        rows[name] = _fitted(_driver_value(cloud, layout, name, time_ns), rows.dtype[name])
    return rows


def _driver_value(cloud: Cloud, layout: str, name: str, time_ns: int) -> Numbers:
    """Values of a driver's field, in its unit."""
    # What the truth knows of a surface is in no driver's field: a reflectivity is what the sensor reports.
    is_calibrated = cloud.metadata.get("intensity_unit") == "of 255"
    match layout, name:
        case "ouster", "reflectivity":
            return cloud.intensity if is_calibrated else np.zeros(len(cloud))
        case "ouster", "intensity":
            return cloud.signal if np.any(cloud.signal) else cloud.intensity
        case _, "t":
            return 1e9 * cloud.time_s
        case _, "range":
            return 1e3 * cloud.range_m.astype(np.float64)
        case "livox", "timestamp":
            return time_ns + 1e9 * cloud.time_s
        case _, "timestamp":
            return 1e-9 * time_ns + cloud.time_s
        case _, "tag":
            return (cloud.return_number.astype(np.int32) - 1) << 4  # bits 4 and 5: number of the return
        case _, "line":
            return cloud.ring
        case _:
            return cloud.column(name)


def _fitted(values: Numbers, dtype: np.dtype[Any]) -> Numbers:
    """Values of this type: the nearest whole numbers that it can hold, where it holds such."""
    if dtype.kind == "f":
        return values.astype(dtype)
    limits = np.iinfo(str(dtype))
    return np.clip(np.rint(values.astype(np.float64)), limits.min, limits.max).astype(dtype)


def _custom_message(cloud: Cloud, header: MessageFields, time_ns: int) -> MessageFields:
    """Message of Livox's own type: times from its stamp, in nanoseconds."""
    byte = np.dtype("u1")
    columns = {
        "offset_time": _fitted(1e9 * cloud.time_s, np.dtype("u4")),
        **{axis: cloud.column(axis).astype(np.float32) for axis in "xyz"},
        "reflectivity": _fitted(cloud.intensity, byte),
        **{name: _fitted(_driver_value(cloud, "livox", name, time_ns), byte) for name in ("tag", "line")},
    }
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    return {
        "header": header,
        "timebase": time_ns,
        "point_num": len(cloud),
        "lidar_id": 0,
        "rsvd": [0, 0, 0],
        "points": [dict(zip(columns, row, strict=True)) for row in rows],
    }


def _points_message(rows: Numbers, header: MessageFields) -> MessageFields:
    fields = [
        {"name": name, "offset": offset, "datatype": _DATATYPES[kind.str[1:]], "count": 1}
        for name, (kind, offset, *_) in (rows.dtype.fields or {}).items()
    ]
    return {
        "header": header,
        "height": 1,
        "width": len(rows),
        "fields": fields,
        "is_bigendian": False,
        "point_step": rows.dtype.itemsize,
        "row_step": rows.nbytes,
        "data": rows.tobytes(),
        "is_dense": True,
    }


def _imu_message(
    header: MessageFields, angular_velocity: Numbers, force: Numbers, sigmas: tuple[float, float]
) -> MessageFields:
    """Message of one sample; a first covariance of -1 says that it has no orientation."""
    identity = np.eye(3).ravel()
    return {
        "header": header,
        "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        "orientation_covariance": [-1.0, *(0.0,) * 8],
        "angular_velocity": _vector(angular_velocity),
        "angular_velocity_covariance": (sigmas[0] ** 2 * identity).tolist(),
        "linear_acceleration": _vector(force),
        "linear_acceleration_covariance": (sigmas[1] ** 2 * identity).tolist(),
    }


def _transform(pose: Pose, parent: str, child: str, time_ns: int) -> MessageFields:
    """Stamped pose of a frame in its parent."""
    rotation = dict(zip("wxyz", quaternion(pose.rotation), strict=True))
    return {
        "header": _header(time_ns, parent),
        "child_frame_id": child,
        "transform": {"translation": _vector(pose.position_m), "rotation": rotation},
    }


def _vector(xyz: Numbers) -> MessageFields:
    return dict(zip("xyz", xyz.tolist(), strict=True))


def _header(time_ns: int, frame: str) -> MessageFields:
    seconds, nanoseconds = divmod(time_ns, 10**9)
    if abs(time_ns) > to_ns(LAST):
        message = "bags hold stamps to {0:%Y}, got {1} s after 1970: frames must begin earlier, or {epoch} be earlier"
        raise OptionError(message, LAST, seconds)
    return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame}
