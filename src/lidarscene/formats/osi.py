"""Write point clouds as ASAM OSI 3.7: a trace file of one SensorData.

Each point is a LidarDetection of `feature_data.lidar_sensor`, of which each sensor of a rig has one: position (range,
azimuth, elevation in the sensor's frame), existence_probability (that of detection), intensity in percent of the
largest, beam_id (the channel), classification CLUTTER for what is no echo; with the truth also object_id (body + 1, as
in the ground truth of `osi_truth`), reflectivity and radial_velocity; the pulse's width if it is measured.

A frame in a trace file is its length (4 bytes, little endian) and the message. Field numbers are those of
osi_sensordata.proto, osi_featuredata.proto and osi_common.proto.
"""

from __future__ import annotations

import os
import struct

import numpy as np

from ..files.atomic import atomic_output
from ..files.encodings.protobuf import double, double_rows, join_rows, message, message_rows, number, number_rows
from ..maths.arrays import Numbers
from ..maths.pose import Pose
from ..maths.rotations import yaw_pitch_roll_rad
from ..physics.constants import SPEED_OF_LIGHT_M_S
from .cloud_columns import Cloud

VERSION = (3, 7, 0)
NO_OBJECT = 2**64 - 1
UNKNOWN, CLUTTER = 0, 3
"""Values of DetectionClassification."""


def write_osi(path: str | os.PathLike[str], cloud: Cloud) -> None:
    """Write one frame."""
    start_s = cloud.frame_start_s
    lidars = []
    for sensor in np.unique(cloud.column("sensor_index")).tolist() or [0]:
        sensor_cloud = cloud.select(cloud.column("sensor_index") == sensor)
        header = (timestamp(1, start_s), number(6, len(sensor_cloud)), message(7, number(1, sensor)))
        lidars.append(message(3, message(1, *header), _detections(sensor_cloud)))
    features = message(26, version(1), *lidars)
    content = trace_file(version(1), timestamp(2, start_s), message(5, number(1, 0)), features)
    with atomic_output(path) as temporary:
        temporary.write_bytes(content)


def trace_file(*parts: bytes) -> bytes:
    """Encode a trace file of one message."""
    content = b"".join(parts)
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


def _detections(cloud: Cloud) -> bytes:
    """Encode all detections, one after the other."""
    detections = len(cloud)
    position = (cloud.column("range"), cloud.column("azimuth"), cloud.column("elevation"))
    peak = float(cloud.column("intensity").max(initial=0.0)) or 1.0
    fields = [
        *double_rows(1, cloud.column("detection_probability")),
        *message_rows(
            3, *(part for i, component in enumerate(position, start=1) for part in double_rows(i, component))
        ),
        *double_rows(7, 100.0 / peak * cloud.column("intensity").clip(0).astype(np.float64)),
        *number_rows(9, np.where(cloud.column("status") != 0, CLUTTER, UNKNOWN), size=1),
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
