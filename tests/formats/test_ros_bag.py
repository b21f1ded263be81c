"""Messages and metadata of bags. Reference: rosbags."""

import json
from dataclasses import fields as dataclass_fields
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.clouds import small_cloud
from helpers.formats import PLACED, need, write_bag

from lidarscene.formats.cloud_description import description
from lidarscene.formats.ros_bag import HASHES, decoder, definition, encoder

CLOUD, IMU, TRANSFORMS = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Imu", "tf2_msgs/msg/TFMessage"

HEADER = {"stamp": {"sec": -3, "nanosec": 4}, "frame_id": "Straße"}
VECTOR = {"x": 1.0, "y": -2.5, "z": np.pi}
TURN = {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8}
COVARIANCES = np.arange(27.0).reshape(3, 9).tolist()
MESSAGES: dict[str, Any] = {
    CLOUD: {
        "header": HEADER,
        "height": 1,
        "width": 5,
        "fields": [{"name": "xyz"[:n], "offset": 4 * n, "datatype": 7, "count": 1} for n in range(4)],
        "is_bigendian": False,
        "point_step": 7,
        "row_step": 35,
        "data": bytes(range(35)),
        "is_dense": True,
    },
    IMU: {
        "header": HEADER,
        "orientation": TURN,
        "orientation_covariance": COVARIANCES[0],
        "angular_velocity": VECTOR,
        "angular_velocity_covariance": COVARIANCES[1],
        "linear_acceleration": VECTOR,
        "linear_acceleration_covariance": COVARIANCES[2],
    },
    TRANSFORMS: {
        "transforms": [
            {"header": HEADER, "child_frame_id": child, "transform": {"translation": VECTOR, "rotation": TURN}}
            for child in ("", "a", "lidar_7")
        ]
    },
}
"""Messages with texts of several lengths, so that numbers behind them are aligned in several ways."""


def fields(message: Any) -> Any:
    """Fields of a message of rosbags, as ours has them."""
    if isinstance(message, list):
        return [fields(item) for item in message]
    if isinstance(message, np.ndarray):
        return message.tobytes() if message.dtype == np.uint8 else message.tolist()
    if not is_dataclass(message):
        return message
    names = [field.name for field in dataclass_fields(message) if not field.name.startswith("_")]
    return {name: fields(getattr(message, name)) for name in names if name.islower()}  # constants are in capitals


@pytest.mark.parametrize("name", [CLOUD, IMU, TRANSFORMS])
def test_bytes_hash_and_definition_are_those_of_rosbags(library: Any, name: str) -> None:
    need("mcap")
    typesys = library("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    data = encoder(name)(MESSAGES[name])
    message = store.deserialize_cdr(data, name)
    assert fields(message) == MESSAGES[name]
    assert bytes(store.serialize_cdr(message, name)) == data
    big_endian = bytes(store.serialize_cdr(message, name, little_endian=False))
    assert encoder(name)(decoder(name)(big_endian)) == data
    assert HASHES[name] == store.hash_rihs01(name)
    without_constants = lambda parsed: {name: definition[1] for name, definition in parsed.items()}  # noqa: E731
    theirs = typesys.get_types_from_msg(store.generate_msgdef(name, ros_version=2)[0], name)
    assert without_constants(typesys.get_types_from_msg(definition(name), name)) == without_constants(theirs)


def test_metadata_are_read_as_yaml(tmp_path: Path, library: Any) -> None:
    """Reference: rosbags, which reads a folder by its metadata.yaml, and PyYAML."""
    need("rosbag2")
    rosbag2, yaml = library("rosbags.rosbag2"), library("yaml")
    cloud = small_cloud(metadata=PLACED | {"sensor_to_world": "1 0 0 1  0 1 0 2  0 0 1 3"})
    write_bag(tmp_path / "bag", cloud, storage="sqlite3")
    with rosbag2.Reader(tmp_path / "bag") as bag:
        assert bag.message_count == 2
        assert {connection.topic: connection.digest for connection in bag.connections} == {
            "/points": HASHES[CLOUD],
            "/tf": HASHES[TRANSFORMS],
        }
    text = (tmp_path / "bag" / "metadata.yaml").read_text(encoding="utf-8")
    assert yaml.safe_load(text) == json.loads(text)
    assert json.loads(text)["rosbag2_bagfile_information"]["custom_data"] == {"lidarscene": description(cloud)}
