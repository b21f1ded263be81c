"""Messages of ROS 2 as bytes. Reference: rosbags, and by hand."""

from typing import Any

import numpy as np
import pytest

from lidarscene.formats.ros_messages import DEFINITIONS, HASHES, MessageTypes

CLOUD, IMU, TRANSFORMS = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Imu", "tf2_msgs/msg/TFMessage"


def message(types: Any, name: str) -> Any:
    """A message with texts of several lengths, so that numbers behind them are aligned in several ways."""
    stamp = types["builtin_interfaces/msg/Time"](sec=-3, nanosec=4)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="Straße")
    vector = types["geometry_msgs/msg/Vector3"](x=1.0, y=-2.5, z=np.pi)
    turn = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.6, w=0.8)
    if name == CLOUD:
        field = types["sensor_msgs/msg/PointField"]
        fields = [field(name="xyz"[:n], offset=4 * n, datatype=7, count=1) for n in range(4)]
        data = np.arange(35, dtype=np.uint8)
        return types[name](header, 1, 5, fields, False, 7, 35, data, True)
    if name == IMU:
        covariance = np.arange(9.0)
        return types[name](header, turn, covariance, vector, covariance + 1, vector, covariance + 2)
    transform = types["geometry_msgs/msg/Transform"](translation=vector, rotation=turn)
    stamped = types["geometry_msgs/msg/TransformStamped"]
    return types[name](transforms=[stamped(header, child, transform) for child in ("", "a", "lidar_7")])


@pytest.mark.parametrize("name", [CLOUD, IMU, TRANSFORMS])
def test_bytes_hash_and_definition_are_those_of_rosbags(library: Any, name: str) -> None:
    typesys = library("rosbags.typesys")
    store, types = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE), MessageTypes()
    data = types.serialize(message(types, name), name)
    assert data == bytes(store.serialize_cdr(message(store.types, name), name))
    assert types.serialize(types.deserialize(data, name), name) == data
    big = bytes(store.serialize_cdr(message(store.types, name), name, little_endian=False))
    assert types.serialize(types.deserialize(big, name), name) == data
    assert HASHES[name] == store.hash_rihs01(name)
    fields = lambda parsed: {name: definition[1] for name, definition in parsed.items()}  # noqa: E731  (not constants)
    theirs = typesys.get_types_from_msg(store.generate_msgdef(name, ros_version=2)[0], name)
    assert fields(typesys.get_types_from_msg(types.text_of(name), name)) == fields(theirs)


def test_a_definition_with_all_that_the_language_has() -> None:
    text = """
# A comment = no constant
uint8 LEFT=1
string NAME = "a # b"
Header header
byte[] bytes_
float64[<=3] bounded
int16[2] pair   # two
string<=10[] names
Part part
uint32 count 7
================================================================================
MSG: other_msgs/Part
bool flag
float32 value
"""
    types = MessageTypes()
    types.add(text.replace("Part part", "other_msgs/Part part"), "my_msgs/msg/Mine")
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](1, 2), "f")
    part = types["other_msgs/msg/Part"](flag=True, value=0.5)
    mine = types["my_msgs/msg/Mine"](header, [1, 2, 3], [1.5], [-1, 2], ["a", "bc"], part, 9)
    data = types.serialize(mine, "my_msgs/msg/Mine")
    read = types.deserialize(data, "my_msgs/msg/Mine")
    assert (read.header, read.names, read.part, read.count) == (header, ["a", "bc"], part, 9)
    assert [read.bytes_.tolist(), read.bounded.tolist(), read.pair.tolist()] == [[1, 2, 3], [1.5], [-1, 2]]


@pytest.mark.parametrize("cut", [0, 3, 4, 11, 40, -1])
def test_bytes_that_are_too_few_are_refused(cut: int) -> None:
    types = MessageTypes()
    data = types.serialize(message(types, CLOUD), CLOUD)
    with pytest.raises(ValueError, match=r"ends within|must be plain CDR"):
        types.deserialize(data[:cut], CLOUD)


def test_lengths_beyond_the_message_take_no_memory() -> None:
    types = MessageTypes()
    with pytest.raises(ValueError, match="ends within a sequence"):
        types.deserialize(b"\0\1\0\0\xff\xff\xff\xff", TRANSFORMS)


def test_unknown_messages_and_definitions_are_refused() -> None:
    types = MessageTypes(DEFINITIONS | {"a/msg/Odd": "what[ever x", "a/msg/Lone": "uint8"})
    for name, complaint in (("a/msg/None", "no definition"), ("a/msg/Odd", "got 'what"), ("a/msg/Lone", "got 'uint8'")):
        with pytest.raises(ValueError, match=complaint):
            types.deserialize(b"\0\1\0\0", name)
