"""Packets of Ouster: the maker's own library gives back what was put in, pixel by pixel."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.mistakes import told
from helpers.packets import firings_of, points, random_frame

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.formats.packets.ouster_encoder import PROFILES
from lidarscene.formats.packets.pcap import description_path, pcap_stream
from lidarscene.formats.packets.select_encoder import select_encoder
from lidarscene.recordings.opening import open_recording
from lidarscene.sensor.sensor_file import load_sensor
from lidarscene.sensor.sensor_model import Sensor

NARROW = ("scanner.columns_per_turn=512",)


def write_capture(path: Path, sensor: Sensor, profile: str = "default", **options: Any) -> tuple[Any, Any]:
    """A frame in a pcap: its cloud, and the background of every pulse by column and row."""
    cloud = random_frame(sensor, **options)
    rng = np.random.default_rng(5)
    ambient = rng.integers(0, 4000, sensor.scanner.pulses).astype(np.uint64)
    with pcap_stream(path, select_encoder(sensor, profile)) as take:
        take(firings_of(sensor, cloud, ambient=ambient))
    return cloud, ambient.reshape(-1, sensor.scanner.lasers)


def read_capture(library: Callable[[str], Any], path: Path) -> tuple[Any, Any]:
    """The frame and its metadata, as ouster-sdk has them."""
    sdk = library("ouster.sdk")
    with open_recording(path):  # whether ours takes it, too
        pass
    source = sdk.open_source(str(path), meta=[str(description_path(path, ".json"))], collate=False, sensor_idx=0)
    frames = [frame_set[0] for frame_set in source]
    assert len(frames) == 1
    return frames[0], source.sensor_info[0]


@pytest.mark.parametrize("name", ["os0-128", "os1-128", "os2-128"])
def test_every_pixel_comes_back(library: Callable[[str], Any], tmp_path: Path, name: str) -> None:
    """Rationale: the acceptance: range to 1 mm, counts equal, and points within 2 mm."""
    sensor = load_sensor(name, overrides=NARROW)
    cloud, ambient = write_capture(tmp_path / "a.pcap", sensor)
    frame, info = read_capture(library, tmp_path / "a.pcap")
    column = np.rint(cloud.time_s / sensor.scanner.cycle_s).astype(int)
    place = cloud.ring, column
    is_filled = np.zeros((128, 512), bool)
    is_filled[place] = True
    assert ((frame.field("RANGE") > 0) == is_filled).all()
    from_mm = 1e3 * float(sensor.scanner.start_m[0].values[0])
    assert np.abs(frame.field("RANGE")[place] - from_mm - 1e3 * cloud.range_m).max() < 1.0
    assert (frame.field("SIGNAL")[place] == cloud.signal).all()
    assert (frame.field("REFLECTIVITY")[place] == cloud.intensity).all()
    assert (frame.field("NEAR_IR") == ambient.T).all()
    core = library("ouster.sdk.core")
    xyz_m = np.asarray(core.XYZLut(info, use_extrinsics=False)(frame))
    assert np.abs(xyz_m[place] - cloud.xyz_m).max() < 0.002
    np.testing.assert_allclose(
        np.asarray(frame.timestamp, float), 1e9 * sensor.scanner.cycle_s * np.arange(512), atol=1.0
    )
    assert (info.prod_line, str(info.config.lidar_mode)) == (f"OS-{name[2]}-128", "512x10")


@pytest.mark.parametrize(
    ("profile", "sdk_name"),
    [(name, names_of_profile[1]) for name, names_of_profile in PROFILES.items()],
    ids=list(PROFILES),
)
def test_profiles_have_what_they_name(library, tmp_path, profile, sdk_name):
    """Two returns, the strongest first; the low rate has steps of 8 mm and 16 counts, the old one a single return."""
    sensor = load_sensor("os1-128", overrides=(*NARROW, "histogram.stops=2"))
    assert sensor.tdc.stops == 2
    cloud, ambient = write_capture(tmp_path / "a.pcap", sensor, profile, second=True)
    frame, info = read_capture(library, tmp_path / "a.pcap")
    assert str(info.format.udp_profile_lidar).endswith(sdk_name)
    step_mm, step_counts = (8, 16) if profile == "low-rate" else (1, 1)
    assert np.abs(frame.field("NEAR_IR").astype(float) - ambient.T).max() < step_counts
    column = np.rint(cloud.time_s / sensor.scanner.cycle_s).astype(int)
    strength, range_m = np.zeros((2, 128, 512)), np.zeros((2, 128, 512))
    for number in (1, 2):
        rows = cloud.return_number == number
        place = number - 1, cloud.channel[rows], column[rows]
        strength[place], range_m[place] = cloud.signal[rows], cloud.range_m[rows]
    order = np.argsort(-strength, axis=0, kind="stable")
    sorted_m = np.take_along_axis(range_m, order, axis=0)
    from_mm = 1e3 * float(sensor.scanner.start_m[0].values[0])
    for field, expected_m in zip(("RANGE", "RANGE2"), sorted_m, strict=True):
        if field not in frame.fields:
            assert profile == "legacy"
            continue
        range_mm = frame.field(field).astype(float)
        assert ((range_mm > 0) == (expected_m > 0)).all()
        error_mm = np.abs(range_mm - from_mm - 1e3 * expected_m)[expected_m > 0]
        assert error_mm.max() < step_mm
    assert (expected_m > 0).sum() > 10_000


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ("scanner.columns_per_turn=1000", "columns and turns | 512x10 | 1000x10"),
        ("scanner.rotation_hz=-15", "columns and turns | 512x10 | 2048x15"),
        ("scanner.rotation_hz=10", "scanner.rotation_hz | negative"),
    ],
)
def test_what_no_ouster_does_is_told(library: Callable[[str], Any], change: str, named: str) -> None:
    library("ouster.sdk.core")
    with told(f"sensor 'os1-128' | {named}"):
        select_encoder(load_sensor("os1-128", overrides=[change]))


@pytest.mark.parametrize(
    ("profile", "farthest_m", "brightest"), [("default", 524.287, 65_535), ("low-rate", 262.136, 4080)]
)
def test_what_no_field_can_say(library, tmp_path, profile, farthest_m, brightest):
    """A range beyond the last of its bits is lost and comes not back as a near one; counts end at their largest.

    19 bits of a millimetre, 15 of 8 mm; 16 bits of a count, 8 of 16 counts.
    """
    sensor = load_sensor("os1-128", overrides=NARROW)
    from_m = float(sensor.scanner.start_m[0].values[0])
    ranges_m = farthest_m - from_m + np.array([-0.02, 0.02])
    cloud = PointCloud(**points(sensor, np.array([0, 128]), ranges_m, 0))
    counts = np.full(sensor.scanner.pulses, 1_000_000, np.uint64)
    with pcap_stream(tmp_path / "a.pcap", select_encoder(sensor, profile)) as take:
        take(firings_of(sensor, cloud, ambient=counts))
    sdk_frame, _ = read_capture(library, tmp_path / "a.pcap")
    laser = int(sensor.scanner.channel(np.zeros(1, np.uint32))[0])
    assert sdk_frame.field("RANGE")[laser, 0] == pytest.approx(1e3 * farthest_m - 20.0, abs=8.0)
    assert sdk_frame.field("RANGE")[laser, 1] == 0
    assert (sdk_frame.field("NEAR_IR") == brightest).all()


def test_a_head_that_begins_aside(library: Callable[[str], Any], tmp_path: Path) -> None:
    """The head begins at 90 degrees, where a turn the other way would show, and 36 mm up: points are where the sensor
    has them.
    """
    high = f"scanner.height_mm={[36.18] * 128}"
    sensor = load_sensor("os1-128", overrides=(*NARROW, "scanner.start_azimuth_deg=90", high))
    cloud, _ = write_capture(tmp_path / "a.pcap", sensor)
    frame, info = read_capture(library, tmp_path / "a.pcap")
    xyz_m = np.asarray(library("ouster.sdk.core").XYZLut(info, use_extrinsics=False)(frame))
    column = np.rint(cloud.time_s / sensor.scanner.cycle_s).astype(int)
    assert np.abs(xyz_m[cloud.channel, column] - cloud.xyz_m).max() < 0.002


def test_a_shifted_picture_has_one_direction_in_a_column(library: Callable[[str], Any]) -> None:
    """Reference: ouster-sdk's destagger of the azimuths of all pixels. Half a column is what whole shifts leave."""
    core = library("ouster.sdk.core")
    sensor = load_sensor("os1-128", overrides=NARROW)
    info = core.SensorInfo(select_encoder(sensor).description[0])
    pulse = np.arange(sensor.scanner.pulses, dtype=np.uint32)
    azimuth, _ = sensor.scanner.angles(pulse)
    picture = np.zeros((128, 512))
    picture[sensor.scanner.channel(pulse), pulse // 128] = azimuth
    straight = core.destagger(info, picture)
    spread_rad = np.angle(np.exp(1j * (straight - straight[:1])))
    step = 2.0 * np.pi / 512
    assert np.abs(picture - picture[:1]).max() > step
    assert np.abs(spread_rad).max() <= 1.01 * step


def test_packets_of_frame_after_frame(library: Callable[[str], Any], tmp_path: Path) -> None:
    """Frames are counted, so that a reader tells them apart; a packet leaves when its last column has been measured."""
    sensor = load_sensor("os1-128", overrides=NARROW)
    packets_made = []
    maker = select_encoder(sensor)
    with pcap_stream(tmp_path / "a.pcap", maker) as take:
        for number in (0, 1):
            firings = firings_of(sensor, number=number, ambient=np.ones(2, np.uint64))
            packets_made += maker.packets(firings)
            take(firings)
    expected_s = (16 * np.arange(1, 65) - 1) * sensor.scanner.cycle_s
    np.testing.assert_allclose([packet.time_s for packet in packets_made], expected_s, atol=1e-9)
    core = library("ouster.sdk.core")
    packet_format = core.PacketFormat.from_info(core.SensorInfo(maker.description[0]))
    ids = [packet_format.frame_id(packet.payload) for packet in packets_made]
    assert ids == [0] * 32 + [1] * 32
    for number, expected in ((65_535, 65_535), (65_536, 0)):  # 16 bits
        later = replace(firings, number=512 * number)
        assert packet_format.frame_id(maker.packets(later)[0].payload) == expected


def test_beams_that_leave_aside_are_refused(library: Callable[[str], Any]) -> None:
    library("ouster.sdk.core")
    sensor = load_sensor("os1-128", overrides={"scanner.left_mm": [5.0] * 128})
    with told("beams | one height and one place"):
        select_encoder(sensor)
