"""ROS 2: as rosbags reads it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.clouds import small_cloud
from helpers.formats import file_of, need, rotated

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.cloud.rig_clouds import merge_clouds
from lidarscene.formats.ros import ros_frames, structured_rows, write_ros
from lidarscene.maths.pose import Pose

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

NEW_YEAR_NS = 1_767_225_600_000_000_000
"""2026-01-01T00:00:00Z, by `date -u -d 2026-01-01 +%s`: the default date of the scene's second 0."""

NUMPY = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def stamped_messages(path: Path, library: Any) -> list[tuple[str, int, Any]]:
    """Topic, time [ns] and fields of each message, as rosbags reads them by the definitions that the bag holds."""
    with library("rosbags.highlevel").AnyReader([path]) as bag:
        return [
            (connection.topic, time_ns, bag.deserialize(raw, connection.msgtype))
            for connection, time_ns, raw in bag.messages()
        ]


def messages(path: Path, library: Any) -> dict[str, Any]:
    """Last message of each topic."""
    return {topic: message for topic, _, message in stamped_messages(path, library)}


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
def test_point_cloud_2(tmp_path: Path, library: Any, street_cloud: PointCloud, suffix: str, layout: str) -> None:
    """Reference: the fields of both drivers, and rosbags as reader."""
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
    np.testing.assert_array_equal(rows["ring"], in_sensor_frame.ring)
    if layout == "velodyne":
        np.testing.assert_array_equal(rows["time"], in_sensor_frame.time_s.astype(np.float32))
    else:
        np.testing.assert_array_equal(rows["t"], np.rint(in_sensor_frame.time_s * 1e9))
        np.testing.assert_allclose(rows["range"], 1e3 * in_sensor_frame.range_m, atol=0.51)
    for column in in_sensor_frame.columns:
        if column.name not in (*LAYOUTS[layout], "time"):
            np.testing.assert_array_equal(rows[column.name], in_sensor_frame.column(column.name))
    check_transform(received["/tf"].transforms[0], street_cloud)


def check_transform(stamped: Any, cloud: PointCloud) -> None:
    """`map` to `lidar` is where the sensor stands: it takes its points into the world."""
    assert (stamped.header.frame_id, stamped.child_frame_id) == ("map", "lidar")
    moved_m = placed(stamped, cloud.in_sensor_frame().xyz_m.astype(float))
    np.testing.assert_allclose(moved_m, cloud.xyz_m, atol=2e-5)


def placed(stamped: Any, points_m: np.ndarray) -> np.ndarray:
    """Points of a frame in its parent."""
    t, q = stamped.transform.translation, stamped.transform.rotation
    return rotated((q.w, q.x, q.y, q.z), points_m) + np.array([t.x, t.y, t.z])


def on_vehicle(cloud: PointCloud, mounting: Pose) -> PointCloud:
    """The cloud, with the pose of its sensor on the vehicle."""
    text = " ".join(map(repr, np.column_stack([mounting.rotation, mounting.position_m]).ravel().tolist()))
    return replace(cloud, metadata=dict(cloud.metadata) | {"sensor_to_vehicle": text})


MOUNTINGS = (
    Pose.from_degrees(position_m=(1.0, 0.5, 1.8), yaw_deg=30.0),
    Pose.from_degrees(position_m=(-1.0, -0.5, 1.6), yaw_deg=-100.0, pitch_deg=5.0, roll_deg=-3.0),
)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_rig_in_one_bag(tmp_path: Path, library: Any, street_cloud: PointCloud, storage: str) -> None:
    """Reference: rosbags. Two mountings of one sensor: each chain of transforms ends where the cloud has its points.

    Of two frames that begin at once the vehicle's pose is there once, and a late reader of `/tf_static` finds both
    places in its last message, which the bag keeps for it (durability 1, transient local).
    """
    need("rosbag2")
    highlevel, typesys = library("rosbags.highlevel"), library("rosbags.typesys")
    path = tmp_path / ("a.mcap" if storage == "mcap" else "bag")
    with ros_frames(path, storage=storage) as append:
        for label, mounting in zip(("left", "2-right"), MOUNTINGS, strict=True):
            append(on_vehicle(street_cloud, mounting), label)
    if storage == "sqlite3":
        assert sorted(file.name for file in path.iterdir()) == ["bag.db3", "metadata.yaml"]
    received: dict[str, list[Any]] = {}
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    with highlevel.AnyReader([path], default_typestore=store) as bag:
        profiles = {connection.topic: connection.ext.offered_qos_profiles for connection in bag.connections}
        for connection, _, raw in bag.messages():
            received.setdefault(connection.topic, []).append(bag.deserialize(raw, connection.msgtype))
    assert sorted(received) == ["/left/points", "/sensor_2_right/points", "/tf", "/tf_static"]
    assert [qos.durability.value for qos in profiles["/tf_static"]] == [1]
    (vehicle,) = received["/tf"][0].transforms
    assert (len(received["/tf"]), vehicle.header.frame_id, vehicle.child_frame_id) == (1, "map", "base_link")
    fixed = {stamped.child_frame_id: stamped for stamped in received["/tf_static"][-1].transforms}
    in_sensor_frame = street_cloud.in_sensor_frame().xyz_m.astype(float)
    for stamped, frame, mounting in zip(fixed.values(), ("left", "sensor_2_right"), MOUNTINGS, strict=True):
        assert (stamped.header.frame_id, stamped.child_frame_id) == ("base_link", frame)
        assert received[f"/{frame}/points"][0].header.frame_id == frame
        np.testing.assert_allclose(placed(stamped, in_sensor_frame), mounting.apply(in_sensor_frame), atol=1e-9)
    moved_m = placed(vehicle, placed(fixed["left"], in_sensor_frame))
    np.testing.assert_allclose(moved_m, street_cloud.xyz_m, atol=2e-5)


def test_a_merged_cloud_is_in_the_vehicles_frame(tmp_path: Path, library: Any, street_cloud: PointCloud) -> None:
    """The second sensor's frame begins 30 ms later: the times of its points count from the first one's stamp."""
    need("mcap")
    first = on_vehicle(street_cloud, MOUNTINGS[0])
    first = replace(first, metadata=dict(first.metadata) | {"frame_start_s": "0.7"})
    later = replace(first, metadata=dict(first.metadata) | {"frame_start_s": repr(first.frame_start_s + 0.03)})
    merged = merge_clouds([first, later], ["a", "b"])
    merged.save(tmp_path / "a.mcap")
    received = messages(tmp_path / "a.mcap", library)
    points, (vehicle,) = received["/points"], received["/tf"].transforms
    assert (points.header.frame_id, vehicle.child_frame_id) == ("base_link", "base_link")
    offsets = {field.name: field.offset for field in points.fields}
    rows = np.frombuffer(bytes(points.data), np.uint8).reshape(points.width, -1)

    def column(name: str) -> np.ndarray:
        return rows[:, offsets[name] : offsets[name] + 4].copy().view(np.float32)[:, 0].astype(float)

    xyz_m = np.stack([column(name) for name in "xyz"], axis=1)
    np.testing.assert_allclose(placed(vehicle, xyz_m), merged.xyz_m, atol=2e-5)
    np.testing.assert_allclose(column("time"), merged.time_s + 0.03 * merged.sensor_index, atol=1e-7)


def test_a_bag_of_several_frames(tmp_path: Path, library: Any) -> None:
    need("mcap")
    frames = [small_cloud(n, metadata={"frame_start_s": repr(0.1 * n)}) for n in (3, 5)]
    write_ros(tmp_path / "a.mcap", iter(frames))
    received = [(log, d.header.stamp, d.width) for _, log, d in stamped_messages(tmp_path / "a.mcap", library)]
    assert [(log, stamp.sec * 10**9 + stamp.nanosec, n) for log, stamp, n in received] == [
        (NEW_YEAR_NS + 300_000_000, NEW_YEAR_NS + 300_000_000, 3),
        (NEW_YEAR_NS + 500_000_000, NEW_YEAR_NS + 500_000_000, 5),
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
