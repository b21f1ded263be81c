"""Bags: our own, those of rosbags and of ROS 1, and bags of packets."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.clouds import small_cloud
from helpers.formats import PLACED, need, write_bag
from helpers.mistakes import told
from helpers.recordings import copy_to_mcap, hesai_packet, scan_bag

from lidarscene.errors import InputError, OptionWarning
from lidarscene.formats.clock import EPOCH, to_ns
from lidarscene.formats.ros import ros_frames
from lidarscene.formats.ros_bag import definition
from lidarscene.recordings.bag_files import BagReader
from lidarscene.recordings.bags import _Scans, _sweep
from lidarscene.recordings.opening import open_recording

ROS_1 = {"tf2_msgs/msg/TFMessage": "tf/msg/tfMessage"} | {
    f"livox_ros_driver2/msg/{name}": f"livox_ros_driver/msg/{name}" for name in ("CustomMsg", "CustomPoint")
}
"""Types of ROS 2 -> names in older bags."""


@pytest.mark.parametrize(("suffix", "storage"), [("mcap", "mcap"), ("db3", "sqlite3")])
def test_frames_fields_and_poses_of_our_own_bag(tmp_path: Path, suffix: str, storage: str) -> None:
    need("mcap")
    clouds = [small_cloud(seed=seed, metadata=PLACED | {"frame_start_s": f"{seed}.0"}) for seed in (1, 2)]
    pose_text = "0 -1 0 1  1 0 0 2  0 0 1 3"
    clouds[1] = small_cloud(seed=2, metadata=PLACED | {"frame_start_s": "2.0", "sensor_to_world": pose_text})
    path = tmp_path / f"a.{suffix}"
    write_bag(path, *clouds, storage=storage)
    with open_recording(path) as recording:
        assert (len(recording), recording.metadata["topic"]) == (2, "/points")
        first, second = recording[0], recording[1]
    local = clouds[1].in_sensor_frame()
    np.testing.assert_allclose(second.xyz_m, local.xyz_m, rtol=1e-6)
    assert second.intensity is not None
    np.testing.assert_array_equal(second.intensity, local.intensity)
    assert second.ring is not None
    np.testing.assert_array_equal(second.ring, local.ring)
    assert first.pose is None
    assert second.pose is not None
    np.testing.assert_allclose(second.pose.rotation, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    np.testing.assert_array_equal(second.pose.position_m, [1.0, 2.0, 3.0])
    epoch_s = to_ns(EPOCH) / 1e9
    assert first.start_s == pytest.approx(epoch_s + 1.0 + float(clouds[0].time_s.min()), abs=1e-6)


@pytest.mark.parametrize("layout", ["livox", "livox-custom"])
def test_points_of_livoxs_driver(tmp_path: Path, layout: str) -> None:
    """Stamps in nanoseconds, as whole numbers or as floats, and the laser as the line."""
    need("mcap")
    time_s, intensity = np.array([0.0, 0.04, 0.09]), np.array([1.0, 20.0, 255.0])
    cloud = small_cloud(3, time_s=time_s, intensity=intensity, ring=np.array([0, 3, 1]))
    write_bag(tmp_path / "a.mcap", cloud, layout=layout)
    with open_recording(tmp_path / "a.mcap") as recording:
        sweep = recording[0]
    assert sweep.ring is not None
    assert sweep.time_s is not None
    assert sweep.ring.tolist() == [0, 3, 1]
    np.testing.assert_allclose(sweep.time_s, time_s, atol=1e-6)
    assert sweep.start_s == pytest.approx(to_ns(EPOCH) / 1e9, abs=1e-6)
    np.testing.assert_allclose(sweep.xyz_m, cloud.xyz_m, rtol=1e-6)
    strength = sweep.reflectivity if layout == "livox-custom" else sweep.intensity
    assert strength is not None
    assert strength.tolist() == [1.0, 20.0, 255.0]


def test_the_pose_of_a_rig_follows_the_vehicle(tmp_path: Path) -> None:
    """The place on the vehicle by `/tf_static`, the vehicle's by `/tf`: together where the sensor stood."""
    need("mcap")
    metadata = PLACED | {
        "frame_start_s": "2.0",
        "sensor_to_world": "0 -1 0 1  1 0 0 2  0 0 1 3",
        "sensor_to_vehicle": "0 -1 0 0.5  1 0 0 0  0 0 1 1.8",
    }
    with ros_frames(tmp_path / "a.mcap") as append:
        append(small_cloud(metadata=metadata), "roof")
    with open_recording(tmp_path / "a.mcap") as recording:
        pose = recording[0].pose
    assert pose is not None
    np.testing.assert_allclose(pose.rotation, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(pose.position_m, [1.0, 2.0, 3.0], atol=1e-12)


@pytest.mark.parametrize("mode", ["FILE", "MESSAGE", "STORAGE"])
@pytest.mark.parametrize("plugin", ["SQLITE3", "MCAP"])
def test_bags_compressed_by_rosbag2(tmp_path: Path, library: Callable[[str], Any], plugin: str, mode: str) -> None:
    """Reference: rosbags, which writes what rosbag2 does: whole files, each message, or chunks of an MCAP."""
    rosbag2 = library("rosbags.rosbag2")
    if (plugin, mode) == ("SQLITE3", "STORAGE"):
        return  # rosbag2 has none
    writer = rosbag2.Writer(tmp_path / "bag", version=8, storage_plugin=rosbag2.StoragePlugin[plugin])
    writer.set_compression(rosbag2.CompressionMode[mode], rosbag2.CompressionFormat.ZSTD)
    with writer:
        write_cloud_bag(writer, library)
    with open_recording(tmp_path / "bag") as recording:
        assert [sweep.xyz_m[0, 0, 0] for sweep in recording] == pytest.approx([1.0, 11.0])
        pose = recording[1].pose
        assert pose is not None
        assert pose.position_m.tolist() == [4.0, 0.0, 0.0]


@pytest.mark.parametrize(("what", "compression"), [("clouds", "LZ4"), ("livox", None), ("packets", "BZ2")])
def test_bags_of_ros_1(tmp_path: Path, library: Callable[[str], Any], what: str, compression: str | None) -> None:
    """Reference: rosbags, which writes the messages of a bag of ROS 2 as ROS 1 does."""
    bag = tmp_path / "bag"
    if what == "clouds":
        cloud_bag(bag, library)
    elif what == "livox":
        write_bag(bag, small_cloud(5), small_cloud(4), layout="livox-custom", storage="sqlite3")
    else:
        library("velodyne_decoder")
        scan_bag(bag, 150, 2)
    path = as_ros_1(bag, tmp_path / "a.bag", library, compression)
    with open_recording(bag) as expected, open_recording(path) as recording:
        assert len(recording) == len(expected) == 2
        for sweep, other in zip(recording, expected, strict=True):
            np.testing.assert_array_equal(sweep.xyz_m, other.xyz_m)
            assert sweep.start_s == other.start_s
            if other.pose is not None:
                assert sweep.pose is not None
                np.testing.assert_array_equal(sweep.pose.position_m, other.pose.position_m)


def as_ros_1(bag: Path, path: Path, library: Callable[[str], Any], compression: str | None = None) -> Path:
    """A bag of ROS 2 as one of ROS 1, of which some types have other names."""
    rosbag1, typesys = library("rosbags.rosbag1"), library("rosbags.typesys")
    store, writer = typesys.get_typestore(typesys.Stores.ROS1_NOETIC), rosbag1.Writer(path)
    if compression is not None:
        writer.set_compression(rosbag1.Writer.CompressionFormat[compression])
    with library("rosbags.highlevel").AnyReader([bag]) as messages, writer:
        connections = {}
        for connection in messages.connections:
            text, _ = messages.typestore.generate_msgdef(connection.msgtype)
            for kind, old in ROS_1.items():
                text = text.replace(kind.replace("/msg", ""), old.replace("/msg", ""))
            kind = ROS_1.get(connection.msgtype, connection.msgtype)
            own = typesys.get_types_from_msg(text, kind)
            store.register({name: fields for name, fields in own.items() if name not in store.types})
            connections[connection.id] = writer.add_connection(connection.topic, kind, typestore=store)
        for connection, time_ns, data in messages.messages():
            message = messages.typestore.cdr_to_ros1(data, connection.msgtype)
            writer.write(connections[connection.id], time_ns, message)
    return path


@pytest.mark.parametrize("compression", ["NONE", "LZ4", "ZSTD"])
def test_mcaps_of_another_writer(tmp_path: Path, library: Callable[[str], Any], compression: str) -> None:
    """Reference: the writer of mcap, with and without chunks. Cut off, or with a changed bit, it is refused."""
    mcap = library("mcap.writer")
    for use_chunking in (True, False):
        path = tmp_path / f"{use_chunking}.mcap"
        kind = mcap.CompressionType[compression]
        copy_to_mcap(path, use_chunking=use_chunking, compression=kind, chunk_size=100, enable_data_crcs=True)
        with open_recording(path) as recording:
            assert [sweep.intensity.size for sweep in recording if sweep.intensity is not None] == [3, 5]
        content = path.read_bytes()
        for size in (3, 40, len(content) // 2):
            path.write_bytes(content[:size])
            with told(f"{path.name} | MCAP"):
                open_recording(path)
        if not use_chunking or compression == "NONE":  # else what unpacks it may tell
            at = content.index(b"lidar\0")  # the frame of a message
            path.write_bytes(content[:at] + b"X" + content[at + 1 :])
            with told(f"{path.name} | crc"):
                open_recording(path)


@pytest.mark.filterwarnings("ignore::lidarscene.errors.OptionWarning")  # returns beyond 10 km are left out
@pytest.mark.parametrize("suffix", ["mcap", "db3", "bag"])
def test_a_spoilt_bag_is_refused_in_one_line(tmp_path: Path, library: Callable[[str], Any], suffix: str) -> None:
    """Bytes changed at random, in lengths, sizes and definitions too, where they do not only change values."""
    library("mcap.writer")
    path = tmp_path / "a.mcap"
    if suffix == "mcap":
        copy_to_mcap(path)
    else:
        write_bag(tmp_path / "a", small_cloud(3), small_cloud(5), storage="sqlite3")
        path = tmp_path / "a" / "a.db3"
    if suffix == "bag":
        path = as_ros_1(tmp_path / "a", tmp_path / "a.bag", library)
    content, rng = path.read_bytes(), np.random.default_rng(1)
    complaints = []
    for _ in range(150):
        spoilt = np.frombuffer(content, np.uint8).copy()
        spoilt[rng.integers(0, len(spoilt), 8)] = rng.integers(0, 256, 8)
        path.write_bytes(spoilt.tobytes())
        try:
            with open_recording(path) as recording:
                assert all(sweep.range_m.size >= 0 for sweep in recording)
        except InputError as error:
            complaints.append(str(error))
    assert complaints
    assert not any("\n" in complaint for complaint in complaints)


def test_a_bag_split_into_files(tmp_path: Path) -> None:
    """Their order is that of their numbers, and they need no metadata."""
    for number, points in ((10, 5), (9, 3), (2, 4)):
        write_bag(tmp_path / "one", small_cloud(points), storage="sqlite3")
        folder = tmp_path / "bag"
        folder.mkdir(exist_ok=True)
        (tmp_path / "one" / "one.db3").rename(folder / f"bag_{number}.db3")
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    (folder / "._bag_1.db3").write_bytes(b"\0\5\x16\7")  # of macOS
    with open_recording(folder) as recording:
        assert [sweep.range_m.size for sweep in recording] == [4, 3, 5]


def test_packets_of_a_driver(tmp_path: Path, library: Callable[[str], Any]) -> None:
    library("velodyne_decoder")
    library("rosbags.rosbag2")
    bag = scan_bag(tmp_path / "bag", packets=75, scans=2)
    for path in (bag, bag / "bag.db3"):
        with open_recording(path) as recording:
            assert (len(recording), recording.metadata["sensor"]) == (2, "VLP16")
            assert recording[1].has_return.sum() == 75 * 24 * 16


def test_metadata_that_leave_out_what_they_must_say(tmp_path: Path, library: Callable[[str], Any]) -> None:
    """Rationale: recorders are about that write no serialization; the one file in the folder says it itself."""
    library("rosbags.rosbag2")
    path = scan_bag(tmp_path / "a", packets=75, scans=2)
    described = path / "metadata.yaml"
    text = described.read_text(encoding="utf-8")
    assert "serialization_format: cdr" in text
    described.write_text(text.replace("serialization_format: cdr", 'serialization_format: ""'), encoding="utf-8")
    with open_recording(path) as recording:
        assert len(recording) == 2


def test_a_bag_without_a_lidar_is_told(tmp_path: Path, library: Callable[[str], Any]) -> None:
    rosbag2, typesys = library("rosbags.rosbag2"), library("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    with rosbag2.Writer(tmp_path / "bag", version=8) as writer:
        writer.add_connection("/te\nxt", "std_msgs/msg/String", typestore=store)
    with told("/te xt | std_msgs/msg/String"):
        open_recording(tmp_path / "bag")
    path = tmp_path / "a.db3"
    path.write_bytes((tmp_path / "bag" / "bag.db3").read_bytes()[:5000])
    with told("a.db3"):
        open_recording(path)


POINT = np.dtype(
    {
        "names": ["x", "y", "z", "ring", "signal"],
        "formats": [">f4", ">f4", ">f4", ">u2", (">f4", 2)],
        "offsets": [4, 8, 12, 16, 18],
        "itemsize": 28,
    }
)
"""As of a driver on a big-endian machine, with four bytes before the first field and two behind the last."""


def cloud_bag(path: Path, library: Callable[[str], Any], tf: str = "/tf") -> Path:
    """A bag of `write_cloud_bag`."""
    with library("rosbags.rosbag2").Writer(path, version=8) as writer:
        write_cloud_bag(writer, library, tf)
    return path


def write_cloud_bag(writer: Any, library: Callable[[str], Any], tf: str = "/tf") -> None:
    """Two clouds of one instant, of two rows and three columns that are filled up to 90 bytes; and where the lidar was
    after 1 s, 4 s and 9 s, by rounded quaternions. Another topic before them has no messages.
    """
    typesys = library("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    types, kind, transform = store.types, "sensor_msgs/msg/PointCloud2", "tf2_msgs/msg/TFMessage"

    def header(seconds: int, frame_id: str) -> Any:
        stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=250_000_000)
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)

    constants = {"x": (7, 1), "y": (7, 1), "z": (7, 1), "ring": (4, 1), "signal": (7, 2)}
    fields = [
        types["sensor_msgs/msg/PointField"](name=name, offset=POINT.fields[name][1], datatype=datatype, count=count)
        for name, (datatype, count) in constants.items()
    ]
    for topic in ("/camera", "/lidar"):
        points = writer.add_connection(topic, kind, typestore=store)
    moves = writer.add_connection(tf, transform, typestore=store)
    for seconds in (1, 4, 9):
        stamped = types["geometry_msgs/msg/TransformStamped"](
            header=header(seconds, "/base_link"),
            child_frame_id="/lidar",
            transform=types["geometry_msgs/msg/Transform"](
                translation=types["geometry_msgs/msg/Vector3"](x=float(seconds), y=0.0, z=0.0),
                rotation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.7, w=0.7),
            ),
        )
        message = types[transform](transforms=[stamped])
        writer.write(moves, seconds, store.serialize_cdr(message, transform))
    for number in range(2):
        data = np.full((2, 90), 255, np.uint8)
        rows = np.zeros((2, 3), POINT)
        rows["x"] = 1.0 + 10 * number + np.arange(6).reshape(2, 3)
        rows["y"], rows["z"], rows["ring"] = 20.0, 30.0, np.arange(6).reshape(2, 3) + 258
        data[:, : 3 * 28] = rows.view(np.uint8).reshape(2, -1)
        message = types[kind](
            header=header(6, "lidar"),
            height=2,
            width=3,
            fields=fields,
            is_bigendian=True,
            point_step=28,
            row_step=90,
            data=data.ravel(),
            is_dense=True,
        )
        writer.write(points, 100, store.serialize_cdr(message, kind))


def test_clouds_of_a_driver_of_its_own_ways(tmp_path: Path, library: Callable[[str], Any]) -> None:
    """The definition of PointCloud2 allows it: offsets, order of bytes, steps of points and rows; a field of several
    numbers is no scalar. Of two messages at one instant each is read, and the pose is the last one before.
    """
    with open_recording(cloud_bag(tmp_path / "bag", library)) as recording:
        assert len(recording) == 2
        for number, sweep in enumerate(recording):
            assert sweep.shape == (2, 3)
            ahead_m = 1.0 + 10 * number + np.arange(6).reshape(2, 3)
            np.testing.assert_allclose(sweep.xyz_m[..., 0], ahead_m, rtol=1e-12)  # range times direction
            aside_m = np.broadcast_to([20.0, 30.0], (2, 3, 2))
            np.testing.assert_allclose(sweep.xyz_m[..., 1:], aside_m, rtol=1e-12)
            assert sweep.ring is not None
            assert sweep.ring.tolist() == [[258, 259, 260], [261, 262, 263]]
            assert sweep.signal is None
            assert sweep.start_s == 6.25
            assert sweep.pose is not None
            assert sweep.pose.position_m.tolist() == [4.0, 0.0, 0.0]
            np.testing.assert_allclose(sweep.pose.rotation, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)


@pytest.mark.parametrize(("height", "row_step"), [(1, 0), (0, 24)])
def test_clouds_without_rows_or_their_step(height: int, row_step: int) -> None:
    """Rationale: writers leave the step of rows out, and an empty cloud may have none; each was refused."""
    message = SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=6, nanosec=0), frame_id="lidar"),
        height=height,
        width=2,
        fields=[SimpleNamespace(name=name, offset=4 * place, datatype=7, count=1) for place, name in enumerate("xyz")],
        is_bigendian=False,
        point_step=12,
        row_step=row_step,
        data=np.arange(6 * height, dtype="<f4").tobytes(),
    )
    np.testing.assert_allclose(_sweep(message, {}, {}).xyz_m, np.arange(6.0 * height).reshape(-1, 3))


def test_a_place_on_the_vehicle_is_no_pose(tmp_path: Path, library: Callable[[str], Any]) -> None:
    """Rationale: a bag of a drive may have nothing but the mounting; all frames would be from one place."""
    with open_recording(cloud_bag(tmp_path / "bag", library, "/tf_static")) as recording:
        assert recording[0].pose is None


def test_other_topics_of_lidars_are_told(tmp_path: Path) -> None:
    need("mcap")
    with ros_frames(tmp_path / "a.mcap") as append:
        append(small_cloud(5, metadata=PLACED), "front")
        append(small_cloud(3, metadata=PLACED), "rear")
    with (
        pytest.warns(OptionWarning, match="read is the topic /front/points; others of lidars are /rear/points"),
        open_recording(tmp_path / "a.mcap") as recording,
    ):
        assert recording[0].shape == (5,)


def test_packets_of_hesais_driver(tmp_path: Path, library: Callable[[str], Any]) -> None:
    """They have room for 1500 bytes, of which as many count as the message says; and a time of their own."""
    rosbag2, typesys = library("rosbags.rosbag2"), library("rosbags.typesys")
    store, kind = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE), "pandar_msgs/msg/PandarScan"
    store.register(typesys.get_types_from_msg(definition(kind), kind))
    payload = hesai_packet(0, 2500)
    stamp = store.types["builtin_interfaces/msg/Time"](sec=9, nanosec=125_000_000)
    data = np.frombuffer(payload.ljust(1500, b"\xff"), np.uint8)
    packet = store.types["pandar_msgs/msg/PandarPacket"](stamp=stamp, data=data, size=len(payload))
    header = store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="pandar")
    with rosbag2.Writer(tmp_path / "bag", version=8) as writer:
        connection = writer.add_connection("/pandar", kind, typestore=store)
        message = store.types[kind](header=header, packets=[packet])
        writer.write(connection, 1, store.serialize_cdr(message, kind))
    bag = BagReader(tmp_path / "bag")
    (stored_packet,) = _Scans(bag, tmp_path / "bag", bag.messages("/pandar"))[0]
    bag.close()
    assert (stored_packet.time_s, stored_packet.payload) == (9.125, payload)
