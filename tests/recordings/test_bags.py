"""ROS 2 bags: our own, and bags of packets."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.clouds import small_cloud
from helpers.formats import PLACED, need
from helpers.recordings import turns

from lidarscene.errors import InputError
from lidarscene.formats.ros import write_ros
from lidarscene.recordings.bags import DEFINITIONS
from lidarscene.recordings.opening import open_recording


@pytest.mark.parametrize(("suffix", "storage"), [("mcap", "mcap"), ("db3", "sqlite3")])
def test_frames_fields_and_poses_of_our_own_bag(tmp_path: Path, suffix: str, storage: str) -> None:
    need("mcap")
    clouds = [small_cloud(seed=seed, metadata=PLACED | {"frame_start_s": f"{seed}.0"}) for seed in (1, 2)]
    known = "0 -1 0 1  1 0 0 2  0 0 1 3"
    clouds[1] = small_cloud(seed=2, metadata=PLACED | {"frame_start_s": "2.0", "sensor_to_world": known})
    path = tmp_path / f"a.{suffix}"
    write_ros(path, clouds, storage=storage)
    with open_recording(path) as recording:
        assert (len(recording), recording.metadata["topic"]) == (2, "/points")
        first, second = recording[0], recording[1]
    local = clouds[1].in_sensor_frame()
    np.testing.assert_allclose(second.xyz_m, local.xyz_m, rtol=1e-6)
    assert second.intensity is not None
    np.testing.assert_array_equal(second.intensity, local.intensity)
    assert second.ring is not None
    np.testing.assert_array_equal(second.ring, local.channel)
    assert first.pose is None
    assert second.pose is not None
    np.testing.assert_allclose(second.pose.rotation, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    np.testing.assert_array_equal(second.pose.position_m, [1.0, 2.0, 3.0])
    assert first.start_s == pytest.approx(1.0 + float(clouds[0].time_s.min()), abs=1e-6)


def scan_bag(path: Path, library: Callable[[str], Any], frames: int) -> Path:
    """A bag of VelodyneScan, a turn for each message."""
    rosbag2, typesys = library("rosbags.rosbag2"), library("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    for name, text in DEFINITIONS.items():
        store.register(typesys.get_types_from_msg(text, name))
    kind = "velodyne_msgs/msg/VelodyneScan"
    stamp = store.types["builtin_interfaces/msg/Time"](sec=9, nanosec=0)
    header = store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="velodyne")
    packets = [
        store.types["velodyne_msgs/msg/VelodynePacket"](stamp=stamp, data=np.frombuffer(one, np.uint8))
        for one in turns(75)
    ]
    with rosbag2.Writer(path, version=8) as writer:
        connection = writer.add_connection("/velodyne_packets", kind, typestore=store)
        for number in range(frames):
            message = store.types[kind](header=header, packets=packets)
            writer.write(connection, number, store.serialize_cdr(message, kind))
    return path


def test_packets_of_a_driver(tmp_path: Path, library: Callable[[str], Any]) -> None:
    library("velodyne_decoder")
    bag = scan_bag(tmp_path / "bag", library, 2)
    for path in (bag, bag / "bag.db3"):
        with open_recording(path) as recording:
            assert (len(recording), recording.metadata["sensor"]) == (2, "VLP16")
            assert recording[1].kept.sum() == 75 * 24 * 16


def test_metadata_that_leave_out_what_they_must_say(tmp_path: Path, library: Callable[[str], Any]) -> None:
    """Rationale: recorders are about that write no serialization; the one file in the folder says it itself."""
    path = scan_bag(tmp_path / "a", library, 2)
    described = path / "metadata.yaml"
    text = described.read_text(encoding="utf-8")
    assert "serialization_format: cdr" in text
    described.write_text(
        text.replace("serialization_format: cdr", 'serialization_format: ""'), encoding="utf-8"
    )
    with open_recording(path) as recording:
        assert len(recording) == 2


def test_a_bag_without_a_lidar_is_told(tmp_path: Path, library: Callable[[str], Any]) -> None:
    rosbag2, typesys = library("rosbags.rosbag2"), library("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    with rosbag2.Writer(tmp_path / "bag", version=8) as writer:
        writer.add_connection("/text", "std_msgs/msg/String", typestore=store)
    with pytest.raises(InputError, match=r"got /text \(std_msgs/msg/String\)"):
        open_recording(tmp_path / "bag")
    path = tmp_path / "a.db3"
    path.write_bytes((tmp_path / "bag" / "bag.db3").read_bytes()[:5000])
    with pytest.raises(InputError, match=r"a.db3: cannot be read: "):
        open_recording(path)
