"""Packets of Pandar64: by the arithmetic of the maker's driver every point is where and when it was."""

import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.packets import cut_short, packets_of, random_frame

from lidarscene.formats.packets.layouts import PANDAR64_PACKET
from lidarscene.formats.packets.pcap import HEADER, record_of
from lidarscene.formats.packets.select_encoder import select_encoder
from lidarscene.recordings.opening import open_recording
from lidarscene.sensor.sensor_file import load_sensor

DUAL = ('tdc.keep="strongest_and_last"',)

FIRED = """
    50 60 44 59 38 56 8 54 48 62 42 58 6 55 52 63 46 61 40 57 5 53 4 47 3 49 2 51 1 45 0 43
    23 32 26 41 20 35 14 29 21 36 15 30 9 24 18 33 12 27 19 34 13 28 7 22 16 31 10 25 17 37 11 39
"""
"""Lasers that fire together, two by two, the last ones first: HesaiLidar_General_SDK at d7f39ee, ParseL64Data."""

BEFORE_US = {
    int(laser): 3.62 + 1.304 * min(number // 2, 15) + 1.968 * max(number // 2 - 15, 0)
    for number, laser in enumerate(FIRED.split())
}
"""When a laser fires, before the end of its block."""


def points_of(payload: bytes) -> Iterator[tuple[int, float, float, float, int]]:
    """Laser, azimuth without its own [degrees, clockwise], time within the minute [s], range [m] and reflectivity of
    each point, as CalcL64PointXYZIT of the maker's driver has them.
    """
    start, lasers, blocks, _, step_mm = struct.unpack_from(">HBBBB", payload)
    assert (start, lasers, blocks, len(payload)) == (0xEEFF, 64, 6, 8 + 6 * 194 + 22)
    tail = 8 + 6 * 194 + 8
    turns, stamp_us, echo = struct.unpack_from("<HIB", payload, tail)
    second = payload[tail + 13]
    for block in range(blocks):
        offset = 8 + 194 * block
        azimuth = struct.unpack_from("<H", payload, offset)[0]
        ahead = (5 - block) // 2 if echo == 0x39 else 5 - block
        for laser in range(64):
            distance, reflectivity = struct.unpack_from("<HB", payload, offset + 2 + 3 * laser)
            if distance:
                turned = 0.01 * azimuth - turns * 6e-6 * BEFORE_US[laser]
                time_s = second + 1e-6 * (stamp_us - 55.56 * ahead - 42.58 - BEFORE_US[laser])
                yield laser, turned, time_s, 1e-3 * distance * step_mm, reflectivity


def test_every_point_comes_back_by_the_makers_arithmetic() -> None:
    """Rationale: 2 mm is half a step of the range, 0.01 degrees a step of the azimuth, and 1 us one of the stamp."""
    sensor = load_sensor("pandar64")
    cloud = random_frame(sensor, number=3)
    decoded_points = np.array(
        [point for packet in packets_of(select_encoder(sensor), sensor, [cloud]) for point in points_of(packet.payload)]
    )
    assert len(decoded_points) == len(cloud)
    laser, turned_deg, time_s, range_m, reflectivity = decoded_points.T
    # A frame is a turn: `packets_of` numbers this one 0, which changes no azimuth.
    now_s = cloud.time_s + cloud.frame_start_s
    ours, theirs = np.lexsort((now_s, cloud.channel)), np.lexsort((time_s, laser))
    assert (cloud.channel[ours] == laser[theirs]).all()
    assert np.abs(now_s[ours] - time_s[theirs]).max() < 1.1e-6
    assert np.abs(cloud.range_m[ours] - range_m[theirs]).max() < 0.0021
    assert (cloud.intensity[ours] == reflectivity[theirs]).all()
    own_deg = np.zeros(64)
    own_deg[sensor.scanner.lasers_by_place.values.astype(int)] = np.degrees(sensor.scanner.azimuth_rad.values)
    head_deg = -np.degrees(cloud.azimuth_rad) + own_deg[cloud.channel]
    error_deg = (head_deg[ours] - turned_deg[theirs] + 180.0) % 360.0 - 180.0
    assert np.abs(error_deg).max() < 0.01


@pytest.mark.parametrize("sets", [(), DUAL], ids=["single", "dual"])
def test_our_reader_gives_the_frame_back(tmp_path: Path, sets: tuple[str, ...]) -> None:
    sensor = load_sensor("pandar64", overrides=sets)
    cloud = random_frame(sensor, second=bool(sets))
    packets = packets_of(select_encoder(sensor), sensor, [cloud])
    assert len(packets) == (600 if sets else 300)
    path = tmp_path / "a.pcap"
    path.write_bytes(HEADER + b"".join(record_of(packet, 2368) for packet in packets))
    with open_recording(path) as recording:
        assert (len(recording), recording.metadata["sensor"]) == (1, "Pandar64")
        sweep = recording[0]
    assert sweep.shape == (64, 1800)
    seconds = 0 if sweep.second is None else np.isfinite(sweep.second.range_m).sum()
    assert sweep.has_return.sum() + seconds == len(cloud)
    column = ((cloud.time_s + 1e-9) // sensor.scanner.cycle_s).astype(int)
    place = cloud.channel, column
    apart_m = np.abs(sweep.range_m[place] - cloud.range_m)
    second_m = np.full(len(cloud), np.inf) if sweep.second is None else sweep.second.range_m[place]
    apart_m = np.fmin(apart_m, np.abs(second_m - cloud.range_m))
    assert apart_m.max() < 0.0021
    xyz_m = sweep.direction[place] * cloud.range_m[:, None]
    across_m = np.linalg.norm(xyz_m - cloud.xyz_m, axis=1)
    assert (across_m < 1e-4 + np.radians(0.006) * cloud.range_m).all()  # half a step, and single precision
    assert np.abs(sweep.time_s[place] + sweep.start_s - cloud.time_s).max() < 1e-6


@pytest.mark.parametrize(
    ("sets", "mode", "dual"), [(('tdc.keep="strongest"',), 0x37, 0), ((), 0x38, 0), (DUAL, 0x39, 1)]
)
def test_what_a_packet_says_of_itself(sets: tuple[str, ...], mode: int, dual: int) -> None:
    """The manual's bytes, one by one: the head EE FF, 64 lasers, 6 blocks, which return comes first, steps of 4 mm; in
    the tail 600 turns a minute, the mode of returns, 0x42 of the factory, and year, month, day, hour, minute, second.
    """
    sensor = load_sensor("pandar64", overrides=sets)
    # datetime(2001, 9, 9, 1, 46, 40, tzinfo=UTC).timestamp() is 1e9.
    cloud = random_frame(sensor)
    cloud = replace(cloud, metadata=dict(cloud.metadata) | {"frame_start_s": repr(1e9 - 16 * 86_400.0 + 7.0)})
    packet = packets_of(select_encoder(sensor), sensor, [cloud])[0]
    payload = packet.payload
    assert payload[:6] == bytes([0xEE, 0xFF, 64, 6, dual, 4])
    tail = payload[8 + 6 * 194 + 8 :]
    assert len(tail) == 14
    assert tail[:2] == (600).to_bytes(2, "little")
    stamp_us = int.from_bytes(tail[2:6], "little")
    assert tail[6:] == bytes([mode, 0x42, 1, 8, 24, 1, 46, 47])
    assert packet.time_s == pytest.approx(1e9 - 16 * 86_400.0 + 7.0 + 1e-6 * stamp_us, abs=1e-6)
    firings = 3 if dual else 6
    assert stamp_us == pytest.approx(1e6 * (firings - 1) * 0.1 / 1800 + 51.048 + 3.62 + 42.58, abs=0.6)


def test_the_last_packet_goes_on_without_points() -> None:
    """A frame that ends after eight firings: azimuths and times of the next four are those that they would have had."""
    (ours_s, ours), (theirs_s, theirs) = cut_short(load_sensor("pandar64"), 8, PANDAR64_PACKET, number=1)
    assert ours_s == theirs_s
    for name in ("stamp", "utc"):
        np.testing.assert_array_equal(ours[name], theirs[name])
    blocks = ours["blocks"]
    np.testing.assert_array_equal(blocks["azimuth"], theirs["blocks"]["azimuth"])
    assert blocks["points"]["distance"][1, 1].any()
    assert not blocks["points"]["distance"][1, 2:].any()


def test_the_stamp_goes_on_from_second_to_second() -> None:
    """30 packets of 333 us lie before second 1 and 270 behind it; the date is that of 1970."""
    sensor = load_sensor("pandar64")
    cloud = random_frame(sensor)
    cloud = replace(cloud, metadata=dict(cloud.metadata) | {"frame_start_s": "0.99"})
    packets_of_frame = packets_of(select_encoder(sensor), sensor, [cloud])
    packets = np.frombuffer(b"".join(packet.payload for packet in packets_of_frame), PANDAR64_PACKET)
    whole_s = packets["utc"][:, 5] + 1e-6 * packets["stamp"]
    np.testing.assert_allclose(np.diff(whole_s), 6 * 0.1 / 1800, atol=1.1e-6)
    assert (packets["utc"][:, :5] == [70, 1, 1, 0, 0]).all()
    assert (packets["utc"][:, 5] == 0).sum() == 29
