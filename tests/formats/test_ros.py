"""ROS 2: as rosbags reads it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.clouds import small_cloud
from helpers.formats import file_of, need, rotated, write_bag
from helpers.mistakes import told

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.cloud.rig_clouds import merge_clouds
from lidarscene.formats.ros import ros_frames, structured_rows
from lidarscene.maths.pose import Pose

XYZ = {"x": (0, 7), "y": (4, 7), "z": (8, 7)}
LAYOUTS = {
    "velodyne": XYZ | {"intensity": (12, 7), "ring": (16, 4), "time": (18, 7)},
    "ouster": XYZ
    | {
        "intensity": (16, 7),
        "t": (20, 6),
        "reflectivity": (24, 4),
        "ring": (26, 4),
        "ambient": (28, 4),
        "range": (32, 6),
    },
    "hesai": XYZ | {"intensity": (12, 7), "ring": (16, 4), "timestamp": (18, 8)},
    "robosense": XYZ | {"intensity": (12, 7), "ring": (16, 4), "timestamp": (18, 8)},
    "livox": XYZ | {"intensity": (12, 7), "tag": (16, 2), "line": (17, 2), "timestamp": (18, 8)},
}
"""Offset and type (sensor_msgs/PointField) of the fields of each driver: velodyne_pointcloud (pointcloudXYZIRT.cpp),
ouster_ros (os_point.h), HesaiLidar_ROS_2.0 (source_driver_ros2.hpp), rslidar_sdk (doc/howto/05) and livox_ros_driver2
(lddc.cpp, PointXYZRTLT)."""

NAMES = {
    "velodyne": ("/velodyne_points", "velodyne"),
    "ouster": ("/ouster/points", "os_sensor"),
    "hesai": ("/lidar_points", "hesai_lidar"),
    "robosense": ("/rslidar_points", "rslidar"),
    "livox": ("/livox/lidar", "livox_frame"),
}
"""Topic and frame by the configuration that comes with each driver."""

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


def rows_of(message: Any) -> np.ndarray:
    """Points of a PointCloud2 by the fields that it names."""
    return np.frombuffer(
        bytes(message.data),
        np.dtype(
            {
                "names": [field.name for field in message.fields],
                "formats": [NUMPY[field.datatype] for field in message.fields],
                "offsets": [field.offset for field in message.fields],
                "itemsize": message.point_step,
            }
        ),
    )


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("by_sensor", [False, True])
def test_point_cloud_2(tmp_path: Path, library: Any, street_cloud: PointCloud, by_sensor: bool, layout: str) -> None:
    """Reference: the fields of the drivers, and rosbags as reader. The sensor chooses them, or the format's name."""
    name = "mcap" if by_sensor else f"rosbag2-{layout}"
    need(name)
    cloud = replace(street_cloud, metadata=dict(street_cloud.metadata) | ({"driver": layout} if by_sensor else {}))
    path = file_of(tmp_path, name)
    cloud.save(path, format=name)
    received = messages(path, library)
    topic, frame = NAMES[layout]
    points, local = received[topic], cloud.in_sensor_frame()
    fields = {field.name: (field.offset, field.datatype) for field in points.fields}
    assert {name: fields[name] for name in LAYOUTS[layout]} == LAYOUTS[layout]
    assert (points.header.frame_id, points.height, points.width) == (frame, 1, len(local))
    assert not points.is_bigendian
    assert points.row_step == points.width * points.point_step == len(points.data)
    rows = rows_of(points)
    np.testing.assert_array_equal(np.stack([rows[a] for a in "xyz"], axis=-1), local.xyz_m)
    np.testing.assert_array_equal(rows["line" if layout == "livox" else "ring"], local.ring)
    for column in local.columns:
        if column.name not in (*LAYOUTS[layout], "time"):
            np.testing.assert_array_equal(rows[column.name], local.column(column.name))
    check_transform(received["/tf"].transforms[0], cloud, frame)


def test_the_vehicles_poses_are_there_once(tmp_path: Path, library: Any, street_cloud: PointCloud) -> None:
    """Poses of two sensors whose frames begin together, and poses between: no stamp comes twice.

    A sensor may be called map.
    """
    need("mcap")
    with ros_frames(tmp_path / "a.mcap") as append:
        append(on_vehicle(street_cloud, MOUNTINGS[0]), "map")
        append.append_motion([street_cloud.frame_start_s + 0.01 * step for step in range(3)], [Pose()] * 3)
        append(on_vehicle(street_cloud, MOUNTINGS[1]), "left")
    received = stamped_messages(tmp_path / "a.mcap", library)
    assert len([1 for topic, *_ in received if topic == "/tf"]) == 3
    placed_frames = [message.transforms for topic, _, message in received if topic == "/tf_static"][-1]
    assert [stamped.child_frame_id for stamped in placed_frames] == ["sensor_map", "left"]


def test_times_of_each_driver(tmp_path: Path, library: Any) -> None:
    """Seconds from the stamp, nanoseconds from it, seconds since 1970, nanoseconds since 1970."""
    need("mcap")
    time_s = np.array([0.0, 1e-3, 0.0999])
    cloud = small_cloud(3, time_s=time_s, metadata={"frame_start_s": "2.0"})
    stamp_ns = NEW_YEAR_NS + 2 * 10**9
    expected = {
        "velodyne": ("time", time_s, 1e-8),
        "ouster": ("t", 1e9 * time_s, 0.5),
        "hesai": ("timestamp", 1e-9 * stamp_ns + time_s, 1e-6),
        "robosense": ("timestamp", 1e-9 * stamp_ns + time_s, 1e-6),
        "livox": ("timestamp", stamp_ns + 1e9 * time_s, 300.0),
    }
    for layout, (name, times, close) in expected.items():
        cloud.save(tmp_path / "a.mcap", format=f"mcap-{layout}")
        rows = rows_of(messages(tmp_path / "a.mcap", library)[NAMES[layout][0]])
        np.testing.assert_allclose(rows[name], times, rtol=0.0, atol=close)


def test_livoxs_own_message(tmp_path: Path, library: Any) -> None:
    """Reference: rosbags, by the definition that livox_ros_driver2 publishes."""
    need("mcap")
    columns = {
        "time_s": [0.0, 1.25e-3, 0.05],
        "intensity": [0.4, 255.0, 300.0],
        "return_number": [1, 2, 1],
        "ring": [0, 3, 5],
    }
    cloud = small_cloud(3, **{name: np.array(values) for name, values in columns.items()})
    write_bag(tmp_path / "a.mcap", cloud, layout="livox-custom")
    (message,) = messages(tmp_path / "a.mcap", library).values()
    assert (message.header.frame_id, message.point_num, message.timebase) == ("livox_frame", 3, NEW_YEAR_NS)
    assert [point.offset_time for point in message.points] == [0, 1_250_000, 50_000_000]
    assert [(point.reflectivity, point.tag, point.line) for point in message.points] == [
        (0, 0, 0),
        (255, 16, 3),
        (255, 0, 5),
    ]
    np.testing.assert_array_equal([[p.x, p.y, p.z] for p in message.points], cloud.xyz_m)


def test_an_ousters_reflectivity_is_measured(tmp_path: Path, library: Any) -> None:
    """It is what the sensor reports, with the truth or without, and 0 where the sensor has no such scale."""
    need("mcap")
    metadata = {"intensity_unit": "of 255"}
    intensity, signal = np.array([7.0, 99.6, 255.0]), np.array([20.0, 300.0, 9.0])
    for truth in (True, False):
        cloud = small_cloud(3, truth=truth, intensity=intensity, signal=signal, metadata=metadata)
        rows = structured_rows(cloud, "ouster")
        assert rows["reflectivity"].tolist() == [7, 100, 255]
        assert rows["intensity"].tolist() == signal.tolist()
    assert (
        structured_rows(replace(cloud, metadata={"intensity_unit": "A"}), "ouster")["reflectivity"].tolist() == [0] * 3
    )


def test_topics_and_frames_of_ones_own(tmp_path: Path, library: Any, street_cloud: PointCloud) -> None:
    need("mcap")
    write_bag(tmp_path / "a.mcap", street_cloud, topic="/lidar/top", frame_id="top")
    received = messages(tmp_path / "a.mcap", library)
    assert received["/lidar/top"].header.frame_id == "top"
    assert received["/tf"].transforms[0].child_frame_id == "top"
    with told("frame_id | 'map'"):
        write_bag(tmp_path / "b.mcap", street_cloud, frame_id="map")
    assert not (tmp_path / "b.mcap").exists()


def test_stamps_end_in_2038(tmp_path: Path, library: Any) -> None:
    """A frame that begins 5e8 s after the scene's second 0, in 2026, would be of 2041."""
    late = replace(small_cloud(), metadata=small_cloud().metadata | {"frame_start_s": "5e8"})
    with told("to 2038 | 2267225600 s | epoch"):
        late.save(tmp_path / "a.mcap")
    assert not (tmp_path / "a.mcap").exists()


def test_no_frame_is_placed_in_itself(tmp_path: Path, library: Any, street_cloud: PointCloud) -> None:
    """A merged cloud in the world, of sensors of no vehicle: its points are in the map already."""
    need("mcap")
    metadata = {key: value for key, value in street_cloud.metadata.items() if key != "sensor_to_vehicle"}
    bare = replace(street_cloud, metadata=metadata)
    merge_clouds([bare, bare], ["a", "b"]).save(tmp_path / "a.mcap")
    received = messages(tmp_path / "a.mcap", library)
    assert received["/points"].header.frame_id == "map"
    assert "/tf" not in received


def check_transform(stamped: Any, cloud: PointCloud, frame: str) -> None:
    """`map` to the frame is where the sensor stands: it takes its points into the world."""
    assert (stamped.header.frame_id, stamped.child_frame_id) == ("map", frame)
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


def test_a_frame_has_one_place(tmp_path: Path, street_cloud: PointCloud) -> None:
    """Labels of two sensors that are one name in ROS."""
    need("mcap")
    with told("'top_a' | one place | - from _"), ros_frames(tmp_path / "a.mcap") as append:
        for label, mounting in zip(("top-a", "top_a"), MOUNTINGS, strict=True):
            append(on_vehicle(street_cloud, mounting), label)


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
    write_bag(tmp_path / "a.mcap", *frames)
    received = [(log, d.header.stamp, d.width) for _, log, d in stamped_messages(tmp_path / "a.mcap", library)]
    assert [(log, stamp.sec * 10**9 + stamp.nanosec, n) for log, stamp, n in received] == [
        (NEW_YEAR_NS + 300_000_000, NEW_YEAR_NS + 300_000_000, 3),
        (NEW_YEAR_NS + 500_000_000, NEW_YEAR_NS + 500_000_000, 5),
    ]


def test_numbers_of_the_ouster_driver() -> None:
    """Nanoseconds and millimetres, to the nearest whole one, and to the ends of what a field holds."""
    columns = {"time_s": [0.0, 1.6e-9, 9.0], "range_m": [1.0006, 0.0, 12.3456], "ambient": [2.6, -1.0, 70_000.0]}
    rows = structured_rows(small_cloud(3, **{name: np.array(values) for name, values in columns.items()}), "ouster")
    assert rows["t"].tolist() == [0, 2, 2**32 - 1]
    assert rows["range"].tolist() == [1001, 0, 12346]
    assert rows["ambient"].tolist() == [3, 0, 65535]
