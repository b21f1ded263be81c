"""OSI: as betterosi reads it."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.clouds import small_cloud
from helpers.formats import need, osi_messages, value_at
from helpers.run_seed import chosen
from helpers.walls import rig_text
from scipy.spatial.transform import Rotation

from lidarscene.formats.osi import osi_frames, timestamp, trace_name

N = 50


def cartesian(get: Any) -> np.ndarray:
    """Positions of OSI's Spherical3d: azimuth from x to y, elevation up."""
    distance, azimuth, elevation = (get("position", name) for name in ("distance", "azimuth", "elevation"))
    level = distance * np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), distance * np.sin(elevation)], axis=1)


@pytest.mark.parametrize("truth", [False, True])
def test_osi_in_betterosi(tmp_path: Path, library: Any, truth: bool) -> None:
    """Reference: betterosi, from the OSI group's own definitions. All fields are in test_oracles.py."""
    columns = {"channel": np.arange(N) * 1000, "sensor_index": np.zeros(N), "status": np.arange(N) % 7}
    cloud = small_cloud(N, truth=truth, metadata={"frame_start_s": "2.25"}, **columns)
    cloud.save(tmp_path / "a.osi")
    (data,) = osi_messages(tmp_path / "a.osi", "SensorData", library)
    assert (data.timestamp.seconds, data.timestamp.nanos) == (2, 250_000_000)
    (lidar,) = data.feature_data.lidar_sensor
    assert lidar.header.number_of_valid_detections == len(lidar.detection) == N
    # Other (an echo), clutter, and invalid for tracking (an aliased echo): DetectionClassification of OSI.
    classes = [int(value_at(detection, ("classification",))) for detection in lidar.detection]
    assert classes == np.array([1, 3, 3, 3, 2, 3, 3])[cloud.status].tolist()
    assert lidar.detection[0].has_field("object_id") == truth


def test_sensors_of_a_rig_are_apart_in_osi(tmp_path: Path, library: Any) -> None:
    """Rationale: positions are in each sensor's own frame."""
    cloud = small_cloud(N)
    assert 0 < np.count_nonzero(cloud.sensor_index) < N
    cloud.save(tmp_path / "a.osi")
    (data,) = osi_messages(tmp_path / "a.osi", "SensorData", library)
    lidars = data.feature_data.lidar_sensor
    assert [lidar.header.sensor_id.value for lidar in lidars] == [0, 1]
    for index, lidar in enumerate(lidars):
        distances_m = [d.position.distance for d in lidar.detection]
        expected_m = np.linalg.norm(cloud.xyz_m[cloud.sensor_index == index].astype(float), axis=1)
        np.testing.assert_allclose(distances_m, expected_m, rtol=1e-12)


def test_an_empty_osi_frame(tmp_path: Path, library: Any) -> None:
    small_cloud(0).save(tmp_path / "a.osi")
    (data,) = osi_messages(tmp_path / "a.osi", "SensorData", library)
    assert len(data.feature_data.lidar_sensor[0].detection) == 0


def test_every_lidar_has_its_own_count_and_time(tmp_path: Path, library: Any) -> None:
    """1.001 s are 1,000,999,999.9999999 ns in floating point: the nearest whole number is right."""
    cloud = small_cloud(N, metadata={"frame_start_s": "1.001"})
    cloud.save(tmp_path / "a.osi")
    (data,) = osi_messages(tmp_path / "a.osi", "SensorData", library)
    assert (data.timestamp.seconds, data.timestamp.nanos) == (1, 1_000_000)
    lidars = data.feature_data.lidar_sensor
    for index, lidar in enumerate(lidars):
        time = lidar.header.measurement_time
        assert (time.seconds, time.nanos) == (1, 1_000_000)
        assert lidar.header.number_of_valid_detections == np.count_nonzero(cloud.sensor_index == index)


@pytest.mark.parametrize("seconds", [0.0, 1.001, 0.1 + 0.2, 1.1 - 0.2, 4.35, 1_700_000_000.57])
def test_times_are_to_the_nearest_nanosecond(seconds: float) -> None:
    """Reference: the number itself, as a fraction; a wire of fields 1 and 2, seven bits a byte."""
    content, numbers = timestamp(1, seconds), []
    offset = 2
    while offset < len(content):
        value, shift, offset = 0, 0, offset + 1
        while content[offset] & 0x80:
            value, shift, offset = value | (content[offset] & 0x7F) << shift, shift + 7, offset + 1
        numbers.append(value | content[offset] << shift)
        offset += 1
    seconds_part, nanoseconds = numbers
    assert nanoseconds < 10**9
    # A product of two doubles is rounded once: of 1.7e9 s to 256 ns.
    error_s = abs(Fraction(seconds_part) + Fraction(nanoseconds, 10**9) - Fraction(seconds))
    assert error_s <= Fraction(1, 2 * 10**9) + Fraction(seconds) * Fraction(2) ** -53


def rotation_of(orientation: Any) -> np.ndarray:
    """OSI's Orientation3d as ISO 8855: Rz(yaw) Ry(pitch) Rx(roll)."""
    angles = (orientation.yaw, orientation.pitch, orientation.roll)
    return np.asarray(Rotation.from_euler("ZYX", angles).as_matrix())


def placed(frame: Any, points_m: np.ndarray) -> np.ndarray:
    """Points of a frame with a position and an orientation, in its parent."""
    position = np.array([getattr(frame.position, axis) for axis in "xyz"])
    return np.asarray(points_m @ rotation_of(frame.orientation).T + position)


def in_the_world(data: Any, lidar: Any) -> np.ndarray:
    """Detections placed as OSI says: by the physical sensor on the vehicle, whose frame lies bbcenter_to_rear from the
    centre of the host's box.
    """
    get = lambda *path: np.array([value_at(detection, path) for detection in lidar.detection])  # noqa: E731
    on_vehicle = placed(lidar.header.mounting_position, cartesian(get))
    (view,) = data.sensor_view
    host = next(o for o in view.global_ground_truth.moving_object if o.id.value == view.host_vehicle_id.value)
    to_rear = host.vehicle_attributes.bbcenter_to_rear
    return placed(host.base, on_vehicle + np.array([to_rear.x, to_rear.y, to_rear.z]))


RIG = rig_text(
    ("front", "vlp-16", "position_m = [2.0, 0.6, 1.1]", "yaw_deg = 40", "pitch_deg = -3"),
    ("2_rear", "vlp-16", "position_m = [-1.5, -0.6, 1.7]", "yaw_deg = -160", "roll_deg = 5"),
)
SCENE = """
name = "yard"
[ego]
position_m = [3, 4, 0]
yaw_deg = 50
speed_m_s = {speed}
yaw_rate_deg_s = {speed}
[[bodies]]
name = "ground"
primitive = "plane"
size_m = [100, 100]
material = "asphalt"
[[bodies]]
name = "own"
class = "car"
primitive = "box"
size_m = [4, 1.8, 0.8]
position_m = [0.4, 0, 0.5]
material = "car_paint_white"
[bodies.motion]
with_ego = true
[[bodies]]
name = "crate"
class = "car"
primitive = "box"
size_m = [3, 2, 2]
position_m = [9, 13, 1]
yaw_deg = 20
material = "concrete"
"""


@pytest.mark.parametrize(("speed", "name"), chosen(1, [(0, "a.osi"), (12, "a.deskewed.osi")]))
def test_two_sensors_meet_on_a_box(mi, run, tmp_path, monkeypatch, library, speed, name):
    """Reference: betterosi, the box of the scene file, and OSI's rules of frames. Each sensor's echoes of the crate lie
    on its faces within 5 cm: the VLP-16 scatters by 1.6 cm, so 99 of 100 (three sigma). Deskewed clouds of a car that
    drives and turns do too, and the truth has the crate where it is.
    """
    library("betterosi")
    monkeypatch.chdir(tmp_path)
    Path("rig.toml").write_text(RIG)
    Path("yard.toml").write_text(SCENE.format(speed=speed))
    options = ("--rig", "rig.toml", "--merge", "--frames", "2", "--labels", "osi", "--deskew")
    ran = run("render", "yard.toml", "-o", "a.osi", *options)
    assert ran.code == 0, ran.err
    assert sorted(path.name for path in tmp_path.glob("*.osi")) == ["a.deskewed.osi", "a.osi"]
    frames = osi_messages(tmp_path / name, "SensorData", library)
    assert len(frames) == 2
    for data in frames:
        objects = {o.id.value: o for o in data.sensor_view[0].global_ground_truth.moving_object}
        assert (sorted(objects), data.sensor_view[0].host_vehicle_id.value) == ([2, 3], 2)
        crate = objects[3].base
        assert [crate.position.x, crate.position.y, crate.position.z] == pytest.approx([9.0, 13.0, 1.0], abs=1e-9)
        assert crate.orientation.yaw == pytest.approx(np.radians(20.0))
        for lidar in data.feature_data.lidar_sensor:
            hits = [
                index
                for index, detection in enumerate(lidar.detection)
                if detection.object_id.value == 3 and detection.classification.value == 1
            ]
            world_m = in_the_world(data, lidar)[hits]
            centre = np.array([9.0, 13.0, 1.0])
            local_m = (world_m - centre) @ rotation_of(crate.orientation)
            apart_m = np.abs(np.abs(local_m) - [1.5, 1.0, 1.0]).min(axis=1)
            assert len(hits) > 30
            assert np.mean(apart_m < 0.05) > 0.97
            assert (np.abs(local_m) < np.array([1.5, 1.0, 1.0]) + 0.12).all()


def test_place_of_the_host_vehicle(tmp_path: Path, library: Any) -> None:
    """Computed by hand: a sensor 2 m ahead of the vehicle's origin and 1 m up, turned to the left, of a vehicle at (10,
    20, 0).

    Without bodies that ride with it the host is an object of its own, whose id follows those of three bodies. Its place
    in the sensor's frame, as OSI has host_vehicle_location, is 2 m to the left, where the rear is, and 1 m down.
    """
    metadata = {
        "frame_start_s": "0.5",
        "frame": "sensor",
        "sensor_to_vehicle": "0 -1 0 2  1 0 0 0  0 0 1 1",
        "sensor_to_world": "0 -1 0 12  1 0 0 20  0 0 1 1",
    }
    small_cloud(3, metadata=metadata, sensor_index=np.zeros(3)).save(tmp_path / "a.osi")
    (data,) = osi_messages(tmp_path / "a.osi", "SensorData", library)
    assert data.mounting_position.position.x == 2.0
    assert data.mounting_position.orientation.yaw == pytest.approx(np.pi / 2)
    location = data.host_vehicle_location
    assert [location.position.x, location.position.y, location.position.z] == pytest.approx([0.0, 2.0, -1.0])
    assert location.orientation.yaw == pytest.approx(-np.pi / 2)
    (view,) = data.sensor_view
    (host,) = view.global_ground_truth.moving_object
    assert host.id.value == view.host_vehicle_id.value == view.global_ground_truth.host_vehicle_id.value == 4
    assert [host.base.position.x, host.base.position.y, host.base.position.z] == pytest.approx([10.0, 20.0, 0.0])
    localization = view.host_vehicle_data.vehicle_localization.position
    assert (localization.x, localization.y) == (10.0, 20.0)
    assert (data.last_measurement_time.nanos, view.timestamp.nanos) == (500_000_000, 500_000_000)


def test_names_of_traces() -> None:
    """Reference: ASAM OSI, trace file naming: time_type_osi_protobuf_frames_name.osi; no other dot is in the name."""
    name = trace_name("sd", 1523, "high_way v1.2", 1_629_299_142 * 10**9)  # date -u -d 2021-08-18T15:05:42Z +%s
    assert name == "20210818T150542Z_sd_370_300_1523_high-way-v1-2.osi"


def test_one_trace_for_a_drive(mi, run, tmp_path, monkeypatch, library):
    """Each sensor of a rig has a trace, named as ASAM says, in the folder; another reader finds its parts."""
    library("betterosi")
    monkeypatch.chdir(tmp_path)
    Path("rig.toml").write_text(RIG)
    Path("yard.toml").write_text(SCENE.format(speed=0))
    options = ("--rig", "rig.toml", "--frames", "3", "--format", "osi", "--epoch", "2025-03-04T05:06:07Z", "--deskew")
    ran = run("render", "yard.toml", "-o", "out", *options)
    assert ran.code == 0, ran.err
    stem = "20250304T050607Z_sd_370_300_3_"
    names = sorted(path.name for path in Path("out").iterdir())
    assert names == [f"{stem}{name}.osi" for name in ("2-rear-deskewed", "2-rear", "front-deskewed", "front")]
    for name, yaw_deg in zip(names, (-160.0, -160.0, 40.0, 40.0), strict=True):
        frames = list(library("betterosi").read(f"out/{name}", version="3.7.0"))  # the name says what it holds
        assert [data.timestamp.nanos for data in frames] == sorted({data.timestamp.nanos for data in frames})
        assert len(frames) == 3
        for data in frames:
            (lidar,) = data.feature_data.lidar_sensor
            assert np.degrees(lidar.header.mounting_position.orientation.yaw) == pytest.approx(yaw_deg)
            assert data.mounting_position == lidar.header.mounting_position


def test_a_multi_channel_trace(tmp_path: Path, library: Any) -> None:
    """Reference: asam-osi-utilities, which decodes by the definitions in the file; and MCAP's own reader for the
    metadata that OSI requires. Messages and times are those of the binary trace.
    """
    mcap, readers = library("mcap.reader"), library("osi_utilities.tracefile.readers.multi")
    need("osi-mcap")
    clouds = [small_cloud(n, metadata={"frame_start_s": f"{n}.25"}) for n in (3, 7)]
    for suffix, storage in (("osi", "binary"), ("mcap", "mcap")):
        with osi_frames(tmp_path / f"a.{suffix}", storage=storage, epoch_ns=1_741_064_400 * 10**9) as append:
            for cloud in clouds:
                append(cloud)
    expected = osi_messages(tmp_path / "a.osi", "SensorData", library)
    received = list(library("betterosi").read(str(tmp_path / "a.mcap"), version="3.7.0"))
    assert [data.to_binary() for data in received] == [data.to_binary() for data in expected]
    reader = readers.MultiTraceReader(decoder_mode="mcap-contained")
    assert reader.open(tmp_path / "a.mcap")
    results = list(reader)
    reader.close()
    assert [(result.status.name, result.message_type.name) for result in results] == [("OK", "SENSOR_DATA")] * 2
    for result, cloud in zip(results, clouds, strict=True):
        assert (result.message.timestamp.seconds, result.message.timestamp.nanos) == (len(cloud), 250_000_000)
        lidars = result.message.feature_data.lidar_sensor
        assert sum(len(lidar.detection) for lidar in lidars) == len(cloud)
    with open(tmp_path / "a.mcap", "rb") as file:
        trace = mcap.make_reader(file)
        (metadata,) = trace.iter_metadata()
        ((schema, channel, message), *_) = trace.iter_messages()
    keys = {"version", "min_osi_version", "max_osi_version", "min_protobuf_version", "max_protobuf_version"}
    assert (metadata.name, set(metadata.metadata)) == ("net.asam.osi.trace", keys | {"zero_time"})
    assert metadata.metadata["zero_time"] == "2025-03-04T05:00:00Z"  # date -u -d @1741064400
    assert (schema.name, schema.encoding, channel.message_encoding) == ("osi3.SensorData", "protobuf", "protobuf")
    assert channel.metadata["net.asam.osi.trace.channel.osi_version"] == "3.7.0"
    assert message.log_time == message.publish_time == 3_250_000_000


def test_asams_own_reader_of_names(library: Any) -> None:
    """Reference: asam-osi-utilities."""
    parsed = library("osi_utilities.filename").parse_osi_trace_filename(trace_name("sd", 10, "2_rear", 0))
    assert (parsed["message_type"].name, parsed["number_of_frames"]) == ("SENSOR_DATA", 10)
    assert (parsed["osi_version"], parsed["custom_trace_name"]) == ("370", "2-rear")
