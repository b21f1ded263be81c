"""ROS 2: as mcap_ros2 reads it."""

import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.clouds import small_cloud
from helpers.formats import file_of, need, rotated

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.formats.ros import structured_rows

LAYOUTS = {
    "velodyne": {"x": (0, 7), "y": (4, 7), "z": (8, 7), "intensity": (12, 7), "ring": (16, 4), "time": (18, 7)},
    "ouster": {
        "x": (0, 7),
        "y": (4, 7),
        "z": (8, 7),
        "intensity": (16, 7),
        "t": (20, 6),
        "reflectivity": (24, 4),
        "ring": (26, 4),
        "ambient": (28, 4),
        "range": (32, 6),
    },
}

NUMPY = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def messages(path: Path, library: Any) -> dict[str, Any]:
    """Messages by topic, decoded by mcap_ros2 from the definitions that the file holds."""
    if path.suffix == ".mcap":
        reader, decoder = library("mcap.reader"), library("mcap_ros2.decoder")
        with open(path, "rb") as file:
            decoded = reader.make_reader(file, decoder_factories=[decoder.DecoderFactory()])
            return {channel.topic: message for _, channel, _, message in decoded.iter_decoded_messages()}
    dynamic = library("mcap_ros2._dynamic")
    connection = sqlite3.connect(path)
    try:
        definitions = dict(connection.execute("SELECT topic_type, encoded_message_definition FROM message_definitions"))
        query = "SELECT name, type, data FROM messages JOIN topics ON topics.id = messages.topic_id"
        return {
            topic: dynamic.generate_dynamic(kind, definitions[kind])[kind](data)
            for topic, kind, data in connection.execute(query)
        }
    finally:
        connection.close()


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
def test_point_cloud_2(tmp_path: Path, library: Any, street_cloud: PointCloud, suffix: str, layout: str) -> None:
    """Reference: the fields of both drivers, and mcap_ros2 as reader; rosbags wrote."""
    name = {".mcap": "mcap", ".db3": "rosbag2"}[suffix] + ("-ouster" if layout == "ouster" else "")
    need(name)
    path = file_of(tmp_path, name)
    street_cloud.save(path, format=name)
    received = messages(path, library)
    points, in_sensor_frame = received["/points"], street_cloud.in_sensor_frame()
    fields = {field.name: (field.offset, field.datatype) for field in points.fields}
    assert {name: fields[name] for name in LAYOUTS[layout]} == LAYOUTS[layout]
    assert (points.header.frame_id, points.height, points.width) == ("lidar", 1, len(in_sensor_frame))
    assert not points.is_bigendian
    assert points.row_step == points.width * points.point_step == len(points.data)
    rows = np.frombuffer(
        bytes(points.data),
        np.dtype(
            {
                "names": list(fields),
                "formats": [NUMPY[kind] for _, kind in fields.values()],
                "offsets": [offset for offset, _ in fields.values()],
                "itemsize": points.point_step,
            }
        ),
    )
    np.testing.assert_array_equal(np.stack([rows[a] for a in "xyz"], axis=-1), in_sensor_frame.xyz_m)
    np.testing.assert_array_equal(rows["intensity"], in_sensor_frame.intensity)
    np.testing.assert_array_equal(rows["ring"], in_sensor_frame.channel)
    if layout == "velodyne":
        np.testing.assert_array_equal(rows["time"], in_sensor_frame.time_s.astype(np.float32))
    else:
        np.testing.assert_array_equal(rows["t"], np.rint(in_sensor_frame.time_s * 1e9))
        np.testing.assert_allclose(rows["range"], 1e3 * in_sensor_frame.range_m, atol=0.51)
    for column in in_sensor_frame.columns:
        if column.name not in (*LAYOUTS[layout], "channel", "time"):
            np.testing.assert_array_equal(rows[column.name], in_sensor_frame.column(column.name))
    check_transform(received["/tf"].transforms[0], street_cloud)


def check_transform(stamped: Any, cloud: PointCloud) -> None:
    """`map` to `lidar` is where the sensor stands: it takes its points into the world."""
    assert (stamped.header.frame_id, stamped.child_frame_id) == ("map", "lidar")
    t, q = stamped.transform.translation, stamped.transform.rotation
    turned = rotated((q.w, q.x, q.y, q.z), cloud.in_sensor_frame().xyz_m.astype(float))
    np.testing.assert_allclose(turned + np.array([t.x, t.y, t.z]), cloud.xyz_m, atol=2e-5)


def test_a_bag_of_several_frames(tmp_path: Path, library: Any) -> None:
    need("mcap")
    reader, decoder = library("mcap.reader"), library("mcap_ros2.decoder")
    from lidarscene.formats.ros import write_ros

    frames = [small_cloud(n, metadata={"frame_start_s": repr(0.1 * n)}) for n in (3, 5)]
    write_ros(tmp_path / "a.mcap", iter(frames))
    with open(tmp_path / "a.mcap", "rb") as file:
        decoded = reader.make_reader(file, decoder_factories=[decoder.DecoderFactory()])
        received = [(m.log_time, d.header.stamp, d.width) for _, _, m, d in decoded.iter_decoded_messages()]
    assert [(log, stamp.sec * 10**9 + stamp.nanosec, n) for log, stamp, n in received] == [
        (300_000_000, 300_000_000, 3),
        (500_000_000, 500_000_000, 5),
    ]


def test_layouts_are_those_of_the_drivers() -> None:
    """velodyne_pointcloud (datatypes.hpp: PointXYZIRT, packed) and ouster_ros (point.h: aligned to 16 bytes)."""
    velodyne, ouster = (structured_rows(small_cloud(1), layout).dtype.fields or {} for layout in ("velodyne", "ouster"))
    place = {name: (velodyne[name][1], velodyne[name][0].str) for name in ("x", "y", "z", "intensity", "ring", "time")}
    assert place == {
        "x": (0, "<f4"),
        "y": (4, "<f4"),
        "z": (8, "<f4"),
        "intensity": (12, "<f4"),
        "ring": (16, "<u2"),
        "time": (18, "<f4"),
    }
    names = ("x", "y", "z", "intensity", "t", "reflectivity", "ring", "ambient", "range")
    assert {name: (ouster[name][1], ouster[name][0].str) for name in names} == {
        "x": (0, "<f4"),
        "y": (4, "<f4"),
        "z": (8, "<f4"),
        "intensity": (16, "<f4"),
        "t": (20, "<u4"),
        "reflectivity": (24, "<u2"),
        "ring": (26, "<u2"),
        "ambient": (28, "<u2"),
        "range": (32, "<u4"),
    }
    assert min(offset for name, (_, offset, *_) in ouster.items() if name not in names) == 48


def test_numbers_of_the_ouster_driver() -> None:
    """Nanoseconds, millimetres and percent, to the nearest whole one, and to the ends of what a field holds."""
    columns = {
        "time_s": [0.0, 1.6e-9, 9.0],
        "range_m": [1.0006, 0.0, 12.3456],
        "reflectivity": [0.104, 0.0, 700.0],
        "ambient": [2.6, -1.0, 70_000.0],
    }
    rows = structured_rows(small_cloud(3, **{name: np.array(values) for name, values in columns.items()}), "ouster")
    assert rows["t"].tolist() == [0, 2, 2**32 - 1]
    assert rows["range"].tolist() == [1001, 0, 12346]
    assert rows["reflectivity"].tolist() == [10, 0, 65535]
    assert rows["ambient"].tolist() == [3, 0, 65535]
