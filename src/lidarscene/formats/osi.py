"""Write point clouds as ASAM OSI 3.7: a trace file of SensorData, one for each frame.

Each point is a LidarDetection of `feature_data.lidar_sensor`, of which each sensor of a rig has one: position (range,
azimuth, elevation in the sensor's frame), existence_probability (that of detection), intensity in percent of the
largest, beam_id (the channel), classification; with the truth also object_id (body + 1, as in the ground truth of
`labels.osi_truth`), reflectivity and radial_velocity; the pulse's width if it is measured.

Where the cloud knows the vehicle, each sensor has its mounting_position there, and `sensor_view` has the host vehicle
in its ground truth: the origin of the vehicle's frame, which OSI calls the middle of the rear axle, is
``bbcenter_to_rear`` behind the centre of the vehicle's box. `host_vehicle_location` is in the sensor's frame, as OSI
says.

A frame in a trace file is its length (4 bytes, little endian) and the message. Field numbers are those of
osi_sensordata.proto, osi_featuredata.proto, osi_sensorview.proto, osi_groundtruth.proto and osi_common.proto.
"""

from __future__ import annotations

import os
import re
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import IO

import numpy as np

from ..detection.outcomes import Status
from ..files.atomic import atomic_output
from ..files.encodings.protobuf import double, double_rows, join_rows, message, message_rows, number, number_rows
from ..files.optional import import_optional
from ..maths.arrays import Numbers
from ..maths.pose import Pose
from ..maths.rotations import yaw_pitch_roll_rad
from ..physics.constants import SPEED_OF_LIGHT_M_S
from .clock import default_epoch_ns
from .cloud_columns import Cloud, frame_starts_s, parse_numbers, sensor_positions_m
from .cloud_description import library_errors

VERSION = (3, 7, 0)
PROTOBUF_VERSION = (3, 0, 0)
"""Oldest release of protobuf that reads what is written here."""

TRACE, TRACE_VERSION = "net.asam.osi.trace", "3.8.0"
"""Name of OSI's metadata in MCAP files, and the release of OSI that defines this format."""

NO_OBJECT = 2**64 - 1
OTHER, INVALID, CLUTTER = 1, 2, 3
"""Values of DetectionClassification."""

VEHICLE, HOST_ATTRIBUTES = 2, 5
"""Type of MovingObject, and its field of VehicleAttributes."""

CLASSIFICATIONS = tuple({Status.ECHO: OTHER, Status.ALIASED: INVALID}.get(status, CLUTTER) for status in Status)
"""Classification of a point by its status: an echo, one of no use for tracking, or noise, weather and stray light."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Host:
    """Host vehicle as OSI describes it.

    Attributes:
        id: of its MovingObject
        centre: pose of the centre of its box in the world, with the axes of the vehicle's frame
        to_rear_m: (3,) from there to the origin of the vehicle's frame, in its axes
    """

    id: int
    centre: Pose
    to_rear_m: Numbers

    @property
    def vehicle(self) -> Pose:
        """Pose of the vehicle's frame in the world."""
        return self.centre @ Pose(position_m=self.to_rear_m)

    @property
    def attributes(self) -> bytes:
        """Encode the VehicleAttributes of its MovingObject."""
        return message(HOST_ATTRIBUTES, vector(4, self.to_rear_m))

    @classmethod
    def without_box(cls, vehicle: Pose, bodies: int) -> Host:
        """Host of which only the frame is known; its id follows those of the bodies."""
        return cls(id=bodies + 1, centre=vehicle, to_rear_m=np.zeros(3))

    def as_object(self) -> bytes:
        """Encode its MovingObject, without a dimension."""
        base = message(2, pose_fields(self.centre, position=2, orientation=3))
        return message(5, message(1, number(1, self.id)), base, number(3, VEHICLE), self.attributes)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundTruth:
    """Objects of a frame.

    Attributes:
        objects: encoded fields of a GroundTruth, with the host
        host: host vehicle, or None
    """

    objects: bytes
    host: Host | None

    def fields(self, start_s: float) -> bytes:
        """Encode the fields of the message."""
        host = b"" if self.host is None else message(3, number(1, self.host.id))
        return b"".join((version(1), timestamp(2, start_s), host, self.objects))


Append = Callable[..., None]


@contextmanager
def osi_frames(
    path: str | os.PathLike[str], *, storage: str = "binary", epoch_ns: int | None = None
) -> Iterator[Append]:
    """Write the clouds that are appended in the block, a message each: ``append(cloud, truth=None)``.

    Args:
        storage: "binary": messages alone; "mcap": with their definitions and times, OSI's multi channel format
        epoch_ns: from 1970 to the scene's second 0, from which times of OSI count; MCAP has it in its metadata. None:
            `formats.clock.default_epoch_ns`
    """
    trace = {"binary": _binary_trace, "mcap": _mcap_trace}[storage]
    with atomic_output(path) as temporary, open(temporary, "wb") as file, trace(path, file, epoch_ns) as write:

        def append(cloud: Cloud, truth: GroundTruth | None = None) -> None:
            write(round(1e9 * cloud.frame_start_s), sensor_data(cloud, truth))

        yield append


@contextmanager
def _binary_trace(_: object, file: IO[bytes], __: object) -> Iterator[Callable[[int, bytes], None]]:
    def write(_: int, content: bytes) -> None:
        file.write(framed(content))

    yield write


@contextmanager
def _mcap_trace(
    path: str | os.PathLike[str], file: IO[bytes], epoch_ns: int | None
) -> Iterator[Callable[[int, bytes], None]]:
    """Write an MCAP file of one channel; a message is stamped with its own time, as OSI says."""
    writer = import_optional("mcap.writer", extra="osi").Writer(file)
    definitions = import_optional("betterosi", extra="osi").load_descriptor_set(_dotted(VERSION))
    versions = {"osi_version": _dotted(VERSION), "protobuf_version": _dotted(PROTOBUF_VERSION)}
    channel: list[int] = []

    def write(time_ns: int, content: bytes) -> None:
        with library_errors(path):
            if not channel:
                zero_ns = default_epoch_ns(1e-9 * time_ns) if epoch_ns is None else epoch_ns
                writer.add_metadata(TRACE, _trace_metadata(zero_ns))
                schema = writer.register_schema("osi3.SensorData", "protobuf", definitions)
                metadata = {f"{TRACE}.channel.{key}": version for key, version in versions.items()}
                channel.append(writer.register_channel("lidar", "protobuf", schema, metadata))
            # Times before 0 have no place in a trace; those of a scene may begin there.
            writer.add_message(channel[0], max(time_ns, 0), content, max(time_ns, 0))

    with library_errors(path):
        writer.start(library="lidarscene")
    yield write
    with library_errors(path):
        writer.finish()


def _trace_metadata(zero_ns: int) -> dict[str, str]:
    """Metadata that OSI requires of an MCAP file, and the date of its time 0."""
    bounds = [f"{bound}_{name}_version" for name in ("osi", "protobuf") for bound in ("min", "max")]
    numbers = (VERSION, VERSION, PROTOBUF_VERSION, PROTOBUF_VERSION)
    required = {key: _dotted(version) for key, version in zip(bounds, numbers, strict=True)}
    return {"version": TRACE_VERSION, **required, "zero_time": f"{_date(zero_ns):%Y-%m-%dT%H:%M:%SZ}"}


def _dotted(numbers: tuple[int, ...]) -> str:
    return ".".join(map(str, numbers))


def _date(time_ns: int) -> datetime:
    return datetime.fromtimestamp(time_ns // 10**9, UTC)


def trace_name(message_type: str, frames: int, name: str, epoch_ns: int, suffix: str = ".osi") -> str:
    """Name of a trace file by ASAM's convention, of the date of its time 0, without characters that end its parts."""
    versions = ("".join(map(str, numbers)) for numbers in (VERSION, PROTOBUF_VERSION))
    plain = re.sub(r"[^A-Za-z0-9-]+", "-", name).strip("-") or "lidarscene"
    return "_".join((f"{_date(epoch_ns):%Y%m%dT%H%M%SZ}", message_type, *versions, str(frames), plain)) + suffix


def sensor_data(cloud: Cloud, truth: GroundTruth | None = None) -> bytes:
    """Encode the fields of a SensorData.

    Args:
        truth: objects of the frame for its sensor view; None: the host vehicle alone
    """
    start_s, vehicle = cloud.frame_start_s, cloud.vehicle_to_world
    if vehicle is not None and (truth is None or truth.host is None):
        host = Host.without_box(vehicle, len(cloud.body_names))
        truth = GroundTruth(objects=(b"" if truth is None else truth.objects) + host.as_object(), host=host)
    mountings, starts_s = cloud.sensors_to_vehicle, frame_starts_s(cloud.metadata)
    lidars = []
    for sensor in np.unique(cloud.column("sensor_index")).tolist() or [0]:
        sensor_cloud = cloud.select(cloud.column("sensor_index") == sensor)
        header = [timestamp(1, starts_s[sensor] if sensor < len(starts_s) else start_s)]
        if sensor < len(mountings):
            header.append(_mounting(3, mountings[sensor]))
        header += [number(6, len(sensor_cloud)), message(7, number(1, sensor))]
        lidars.append(message(3, message(1, *header), _detections(sensor_cloud, sensor)))
    # Of several sensors the vehicle itself stands for the virtual sensor: all is in its frame.
    mounting = mountings[0] if len(mountings) == 1 else Pose()
    view = [] if truth is None or truth.host is None else [_placing(mounting, truth.host, truth, start_s)]
    features = message(26, version(1), *lidars)
    return b"".join(
        (version(1), timestamp(2, start_s), message(5, number(1, 0)), *view, timestamp(9, start_s), features)
    )


def _placing(mounting: Pose, host: Host, truth: GroundTruth, start_s: float) -> bytes:
    """Encode host_vehicle_location, mounting_position and sensor_view of a SensorData."""
    host_axle = mounting.inverse() @ Pose(position_m=-host.to_rear_m)
    place = pose_fields(host.centre, position=2, orientation=3)
    localization = pose_fields(host.centre, position=1, orientation=2)
    host_id = number(1, host.id)
    host_data = (version(9), timestamp(10, start_s), message(11, host_id), message(1, place), message(8, localization))
    view = (
        version(1),
        timestamp(2, start_s),
        message(3, number(1, 0)),
        _mounting(4, mounting),
        message(6, *host_data),
        message(7, truth.fields(start_s)),
        message(8, host_id),
    )
    location = message(3, pose_fields(host_axle, position=2, orientation=3))
    return location + _mounting(6, mounting) + message(8, *view)


def _mounting(field: int, pose: Pose) -> bytes:
    """Encode a MountingPosition."""
    return message(field, pose_fields(pose, position=1, orientation=2))


def framed(content: bytes) -> bytes:
    """Encode a message of a trace file: its length and its fields."""
    return struct.pack("<I", len(content)) + content


def version(field: int) -> bytes:
    """Encode an InterfaceVersion."""
    return message(field, *(number(i, value) for i, value in enumerate(VERSION, start=1)))


def timestamp(field: int, seconds: float) -> bytes:
    """Encode a Timestamp."""
    whole_seconds, nanoseconds = divmod(round(seconds * 1e9), 10**9)
    return message(field, number(1, whole_seconds), number(2, nanoseconds))


def vector(field: int, values: Numbers) -> bytes:
    """Encode a Vector3d, a Dimension3d (length, width, height), a Spherical3d or an Orientation3d."""
    return message(field, *(double(i, float(value)) for i, value in enumerate(values, start=1)))


def pose_fields(pose: Pose, *, position: int, orientation: int) -> bytes:
    """Encode position and orientation (roll, pitch, yaw) as fields with these numbers."""
    return vector(position, pose.position_m) + vector(orientation, np.array(yaw_pitch_roll_rad(pose.rotation)[::-1]))


def _spherical(cloud: Cloud, sensor: int) -> tuple[Numbers, ...]:
    """Distance, azimuth and elevation of each point in its sensor's frame: those of the position, as it is placed.

    The range and the commanded angles of clouds that do not say how the sensor stood. They lack what the beam's exit is
    off the sensor's origin.

    Args:
        sensor: index of the sensor among those of the metadata
    """
    metadata = cloud.metadata
    if metadata.get("frame", "sensor") == "sensor":
        local_m = cloud.xyz_m.astype(np.float64)
    elif "sensor_rotation" in metadata:
        rotations = parse_numbers(metadata["sensor_rotation"], "sensor_rotation", (-1, 3, 3))
        index = min(sensor, len(rotations) - 1)
        place = Pose(position_m=sensor_positions_m(metadata)[index], rotation=rotations[index])
        local_m = place.inverse_apply(cloud.xyz_m.astype(np.float64))
    else:
        return cloud.column("range"), cloud.column("azimuth"), cloud.column("elevation")
    x, y, z = local_m.T
    return np.sqrt(x * x + y * y + z * z), np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))


def _detections(cloud: Cloud, sensor: int) -> bytes:
    """Encode all detections of a sensor, one after the other."""
    detections = len(cloud)
    position = _spherical(cloud, sensor)
    peak = float(cloud.column("intensity").max(initial=0.0)) or 1.0
    fields = [
        *double_rows(1, cloud.column("detection_probability")),
        *message_rows(
            3, *(part for i, component in enumerate(position, start=1) for part in double_rows(i, component))
        ),
        *double_rows(7, 100.0 / peak * cloud.column("intensity").clip(0).astype(np.float64)),
        *number_rows(9, np.asarray(CLASSIFICATIONS)[cloud.column("status")], size=1),
        *message_rows(13, *number_rows(1, cloud.column("channel").clip(0), size=5)),
    ]
    if cloud.column("pulse_width").any():
        # OSI has the echo's width in metres of range, from the rising edge to the falling one.
        fields += double_rows(11, 0.5 * SPEED_OF_LIGHT_M_S * cloud.column("pulse_width").astype(np.float64))
    if cloud.has_truth:
        # OSI's velocity is positive towards the sensor, ours away from it.
        fields += double_rows(12, -cloud.column("radial_velocity").astype(np.float64))
    if cloud.has_truth:
        objects = np.where(
            cloud.column("body") >= 0, cloud.column("body").astype(np.uint64) + np.uint64(1), np.uint64(NO_OBJECT)
        )
        fields += [*message_rows(2, *number_rows(1, objects, size=10)), *double_rows(10, cloud.column("reflectivity"))]
    return join_rows(message_rows(2, *fields), detections)
