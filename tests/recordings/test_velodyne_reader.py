"""Velodyne: packets as the VLP-16's manual has them, and what becomes of each pulse."""

import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.mistakes import told
from helpers.packets import packets_of, random_frame
from helpers.recordings import FIRINGS, pcap, turns, vls_packet

from lidarscene.formats.packets.layouts import Packet
from lidarscene.formats.packets.select_encoder import select_encoder
from lidarscene.recordings.as_cloud import cloud_of
from lidarscene.recordings.opening import open_recording
from lidarscene.recordings.velodyne_reader import recording_of_scans, sweep_of_points
from lidarscene.sensor.sensor_file import load_sensor

PACKETS = 75
"""Of a turn: 12 blocks of 0.4 degrees each."""

ELEVATIONS_DEG = np.arange(-15.0, 16.0, 2.0)


@pytest.fixture
def two_turns(tmp_path: Path, library: Callable[[str], Any]) -> Path:
    library("velodyne_decoder")
    return pcap(tmp_path / "vlp.pcap", turns(2 * PACKETS, missing=[(3, 40)]))


def test_frames_are_turns_and_can_be_sought(two_turns: Path) -> None:
    with open_recording(two_turns) as recording:
        assert (len(recording), recording.metadata["sensor"]) == (2, "VLP16")
        last, last_from_end = recording[1], recording[-1]
        np.testing.assert_array_equal(last.range_m, last_from_end.range_m)
        assert [sweep.shape for sweep in recording] == [(16, FIRINGS * PACKETS)] * 2
        with told("vlp.pcap | frame | 0 | 1 | 2"):
            recording[2]


def test_a_frame_begins_when_its_first_pulse_leaves(tmp_path: Path, library: Callable[[str], Any]) -> None:
    """A VLS-128 stamps a packet 6.46 us after its first laser fires, so that times count from before the stamp.

    Reference: the clock of the scene that the packets are of. Tolerance: half a microsecond of the stamp, and the
    0.54 us by which velodyne-decoder takes off more; both again from packet to packet, and 2.2 us: the decoder takes
    53.3 us from firing to firing, as the manual says, where recorded sensors need 55.3 us.
    """
    library("velodyne_decoder")
    sensor = load_sensor("vls-128")
    cloud = random_frame(sensor, number=1)
    packets = packets_of(select_encoder(sensor), sensor, [cloud])[:40]
    with open_recording(pcap(tmp_path / "vls.pcap", [packet.payload for packet in packets])) as recording:
        sweep = recording[0]
    assert cloud.frame_start_s > 0.09
    assert sweep.start_s == pytest.approx(cloud.frame_start_s, abs=1.1e-6)
    assert sweep.time_s is not None
    assert np.nanmin(sweep.time_s) == 0.0
    # Of the first packet it does not know yet how long a firing takes, and of the last none says how far the head
    # turns: on 7 of 32 seeds a point stood in the next column.
    later = np.arange(3, sweep.shape[1] - 3, 3)  # first firings of a packet
    begun_s = np.nanmin(sweep.time_s[:, later], axis=0)
    np.testing.assert_allclose(begun_s, sensor.scanner.cycle_s * later, atol=4.4e-6)


def test_a_packet_that_comes_late_is_in_its_place(two_turns: Path, tmp_path: Path) -> None:
    """Also where a turn ends, which is after 75 packets."""
    payloads = turns(2 * PACKETS, missing=[(3, 40)])
    for late in (40, 74, 75):
        payloads.insert(late, payloads.pop(late + 1))
    with open_recording(two_turns) as expected, open_recording(pcap(tmp_path / "a.pcap", payloads)) as recording:
        for sweep, right in zip(recording, expected, strict=True):
            np.testing.assert_array_equal(sweep.direction, right.direction)


@pytest.mark.parametrize("apart", [1, 2, 5])
def test_a_packet_that_was_captured_twice_counts_once(two_turns: Path, tmp_path: Path, apart: int) -> None:
    """A bridge, and the port behind it, which hands on some packets at a time."""
    payloads = turns(2 * PACKETS, missing=[(3, 40)])
    bursts = [payloads[first : first + apart] for first in range(0, len(payloads), apart)]
    twice = [payload for burst in bursts for payload in (*burst, *burst)]
    with open_recording(two_turns) as expected, open_recording(pcap(tmp_path / "a.pcap", twice)) as recording:
        for sweep, right in zip(recording, expected, strict=True):
            np.testing.assert_array_equal(sweep.range_m, right.range_m)


@pytest.mark.parametrize("missing", [50, 75, 110])
def test_a_turn_ends_where_the_recording_pauses(tmp_path: Path, library: Callable[[str], Any], missing: int) -> None:
    """Two thirds of a turn, a whole one, or one and a half are missing: no frame is longer than a turn of 0.1 s."""
    library("velodyne_decoder")
    payloads = turns(200)
    with open_recording(pcap(tmp_path / "a.pcap", payloads[:30] + payloads[30 + missing :])) as recording:
        lengths_s = [float(np.ptp(np.asarray(sweep.time_s))) for sweep in recording]
    assert len(lengths_s) == 3
    assert max(lengths_s) < 0.1


def test_a_turn_ends_where_the_clock_is_set_back(tmp_path: Path, library: Callable[[str], Any]) -> None:
    """The second turn is cut, whose times would be as long as the 500 s of the step."""
    library("velodyne_decoder")
    payloads = turns(2 * PACKETS)
    for number in range(100):
        (stamp_us,) = struct.unpack_from("<I", payloads[number], 1200)
        payloads[number] = payloads[number][:1200] + struct.pack("<I", stamp_us + 500_000_000) + payloads[number][1204:]
    with open_recording(pcap(tmp_path / "a.pcap", payloads)) as recording:
        assert [sweep.shape[1] // FIRINGS for sweep in recording] == [75, 25, 50]
        assert max(float(np.ptp(np.asarray(sweep.time_s))) for sweep in recording) < 0.1


def test_ranges_directions_and_the_lost_pulse(two_turns: Path) -> None:
    sweep = open_recording(two_turns)[0]
    # Laser 3 fires at +3 degrees: the tenth channel from below.
    assert np.argwhere(sweep.lost).tolist() == [[9, 40]]
    np.testing.assert_allclose(
        sweep.range_m[sweep.has_return], 10.0, atol=0.012
    )  # the decoder adds offsets of the height
    elevation = np.degrees(np.arcsin(sweep.direction[..., 2]))
    # The exits are up to 11 mm above or below the origin, which is 0.064 degrees at 10 m.
    np.testing.assert_allclose(elevation, np.broadcast_to(ELEVATIONS_DEG[:, None], elevation.shape), atol=0.07)
    lost_direction, before, after = (sweep.direction[9, column] for column in (40, 38, 42))
    middle = (before + after) / np.linalg.norm(before + after)
    # Two hundredths of a degree: azimuths are whole hundredths.
    assert np.degrees(np.arccos(min(1.0, lost_direction @ middle))) < 0.02
    assert sweep.includes_lost
    assert sweep.recorded.all()
    assert sweep.intensity is not None
    assert sweep.intensity[sweep.has_return].min() >= 50


def test_a_vls_128_turns_from_its_first_packet_on(tmp_path: Path, library: Callable[[str], Any]) -> None:
    """Rationale: lasers of a firing fire one after the other, and a decoder turns them on at the rate of the packet
    before. Without one, the first three firings of a turn were up to 0.1 degrees behind.
    """
    library("velodyne_decoder")
    packets = [vls_packet(300 * number % 36_000, 100, 160 * number) for number in range(130)]
    with open_recording(pcap(tmp_path / "vls.pcap", packets)) as recording:
        assert (len(recording), recording.metadata["sensor"]) == (2, "VLS128")
        sought = recording[1]
        in_order = list(recording)[1]
    np.testing.assert_array_equal(sought.direction, in_order.direction)
    assert sought.time_s is not None
    np.testing.assert_array_equal(sought.time_s, in_order.time_s)
    azimuth = np.unwrap(np.arctan2(sought.direction[..., 1], sought.direction[..., 0]), axis=1)
    # To the rounding of the packet's hundredths; of a stopped sensor the fourth step is 0.5 degrees off.
    np.testing.assert_allclose(np.degrees(np.diff(azimuth[:, :6], axis=1)), -1.0, atol=0.011)


def test_firings_of_lost_packets_have_their_place(tmp_path: Path, library: Callable[[str], Any]) -> None:
    """A channel that sees the sky before three lost packets and after them: as if they had come, in time and place."""
    library("velodyne_decoder")
    payloads = turns(PACKETS, missing=[(laser, firing) for laser in range(9) for firing in range(600, 900)])
    some = payloads[:30] + payloads[33:]
    sweep, full = (open_recording(pcap(tmp_path / "a.pcap", packets))[0] for packets in (some, payloads))
    came = sweep.recorded[0]
    np.testing.assert_array_equal(np.flatnonzero(~came), np.arange(30 * FIRINGS, 33 * FIRINGS))
    np.testing.assert_allclose(sweep.direction[:, came], full.direction[:, came], atol=1e-6)
    np.testing.assert_allclose(np.asarray(sweep.time_s)[:, came], np.asarray(full.time_s)[:, came], atol=1e-8)


def test_channels_in_the_sky_have_rows_and_directions(tmp_path: Path, library: Callable[[str], Any]) -> None:
    library("velodyne_decoder")
    packets = [bytearray(turn) for turn in turns(PACKETS)]
    for number, packet in enumerate(packets):
        for block in range(12):
            for firing in range(2):
                offset = 100 * block + 4 + 3 * (16 * firing + 15)  # laser 15, +15 degrees: the highest
                if (number, block) != (30, 5):
                    packet[offset : offset + 2] = b"\0\0"
    sweep = open_recording(pcap(tmp_path / "sky.pcap", [bytes(packet) for packet in packets]))[0]
    assert sweep.has_return[15].sum() == 2
    assert sweep.lost[15].sum() == FIRINGS * PACKETS - 2
    highest, below = sweep.direction[15], sweep.direction[14]
    turned = np.arctan2(highest[:, 1], highest[:, 0]) - np.arctan2(below[:, 1], below[:, 0])
    apart_deg = np.degrees(np.abs((turned + np.pi) % (2.0 * np.pi) - np.pi))
    # From one place of the turn to all others: the mean rate is known to half a hundredth in 0.2 degrees at worst.
    assert np.median(apart_deg) < 1.0


def test_a_file_without_packets_is_told(tmp_path: Path) -> None:
    with told("other.pcap | Velodyne | Hesai | Ouster"):
        open_recording(pcap(tmp_path / "other.pcap", [b"nothing"]))


def test_messages_without_packets_have_no_pulses(tmp_path: Path, library: Callable[[str], Any]) -> None:
    """Rationale: velodyne-decoder ends Python over none. A packet of another length is passed over."""
    library("velodyne_decoder")
    turn = [Packet(0.0, payload) for payload in turns(PACKETS)]
    recording = recording_of_scans(tmp_path, None, [[], [Packet(0.0, b"cut"), *turn]], name="")
    assert [sweep.shape for sweep in recording] == [(16, 0), (16, FIRINGS * PACKETS)]


@pytest.mark.parametrize("empty", [0, 1, 2])
def test_a_turn_without_a_point_has_its_place_among_the_others(
    tmp_path: Path, library: Callable[[str], Any], empty: int
) -> None:
    """A covered lens: the turn is empty, and begins when its first packet was sent, 1.327 ms after the one before."""
    library("velodyne_decoder")
    firings = range(FIRINGS * PACKETS * empty, FIRINGS * PACKETS * (empty + 1))
    payloads = turns(3 * PACKETS, missing={(laser, firing) for laser in range(16) for firing in firings})
    with open_recording(pcap(tmp_path / "a.pcap", payloads)) as recording:
        sweeps = list(recording)
    assert [int(sweep.has_return.sum()) for sweep in sweeps] == [
        16 * FIRINGS * PACKETS * (n != empty) for n in range(3)
    ]
    assert [sweep.start_s for sweep in sweeps] == pytest.approx([1.327e-3 * PACKETS * n for n in range(3)], abs=1e-6)
    assert cloud_of(sweeps[empty]).xyz_m.shape == (0, 3)


def filled_firings() -> np.ndarray:
    """(n, 8) points of two channels of a sensor that turns clockwise by 0.2 degrees each 50 us, across the seam behind;
    of channel 1 only firings 20 to 30 have one, of channel 0 all but 5 of 40.
    """
    rows = []
    for channel, firings in ((0, [k for k in range(40) if k not in (0, 1, 19, 20, 21)]), (1, range(20, 31))):
        for k in firings:
            azimuth, up = np.radians(180.0 - 0.2 * (k - 20)), np.radians(-1.0 + 2.0 * channel)
            x, y, z = 10 * np.cos(up) * np.cos(azimuth), 10 * np.cos(up) * np.sin(azimuth), 10 * np.sin(up)
            rows.append([x, y, z, 7.0, 50e-6 * k + 2e-6 * channel, k, channel, 1])
    return np.array(rows)


def test_lost_pulses_have_the_times_and_directions_between_their_neighbours() -> None:
    """Reference: a head that turns evenly. Before a channel's first point and after its last it goes on so."""
    sweep = sweep_of_points(filled_firings(), start_s=3.0, metadata={})
    assert sweep.shape == (16, 40)
    assert sweep.time_s is not None
    k = np.arange(40)
    for channel in (0, 1):
        azimuth, up = np.radians(180.0 - 0.2 * (k - 20)), np.radians(-1.0 + 2.0 * channel)
        expected = [np.cos(up) * np.cos(azimuth), np.cos(up) * np.sin(azimuth), np.full(40, np.sin(up))]
        np.testing.assert_allclose(sweep.direction[channel], np.stack(expected, axis=-1), atol=1e-9)
        np.testing.assert_allclose(sweep.time_s[channel], 50e-6 * k + 2e-6 * channel, atol=1e-12)
    assert sweep.start_s == 3.0
    assert np.isnan(sweep.direction[2:]).all()


@pytest.mark.parametrize(("channels", "rows"), [(16, 16), (17, 32), (32, 32), (33, 64), (128, 128)])
def test_rows_are_those_of_a_model(channels: int, rows: int) -> None:
    points = np.array([[10.0, 0, 0, 7, 1e-6 * n, 0, n, 1] for n in range(channels)])
    assert sweep_of_points(points, start_s=0.0, metadata={}).shape == (rows, 1)


def test_two_returns_of_a_pulse_are_apart() -> None:
    """RETURN: 1 strongest, 2 last, 3 both in one. Where the decoder left out the stronger one the other is first."""
    rows = [(10.0, 7, 0, 1), (20.0, 8, 0, 2), (30.0, 9, 1, 3), (40.0, 5, 2, 2)]
    points = np.array([[x, 0, 0, level, 1e-6 * ring, 0, ring, kind] for x, level, ring, kind in rows])
    sweep = sweep_of_points(points, start_s=0.0, metadata={})
    assert sweep.range_m[:3, 0].tolist() == [10.0, 30.0, 40.0]
    assert sweep.intensity is not None
    assert sweep.intensity[:3, 0].tolist() == [7.0, 9.0, 5.0]
    assert sweep.second is not None
    assert sweep.second.intensity is not None
    assert sweep.second.range_m[0, 0] == 20.0
    assert sweep.second.intensity[0, 0] == 8.0
    assert np.isnan(sweep.second.range_m[1:]).all()


def test_a_units_own_calibration_is_used(tmp_path: Path, library: Callable[[str], Any]) -> None:
    """The maker's table of a VLP-16 with every laser a degree higher: so are all directions.

    Tolerance: the exits, at up to 11 mm from the middle, seen at 10 m under angles that differ by a degree.
    """
    decoder, yaml = library("velodyne_decoder"), library("yaml")
    content = yaml.safe_load(decoder.Calibration.default_calibs[decoder.Model.VLP16].to_string())
    for laser in content["lasers"]:
        laser["vert_correction"] += math.radians(1.0)
    (tmp_path / "unit.yaml").write_text(yaml.safe_dump(content))
    path = pcap(tmp_path / "a.pcap", turns(PACKETS))
    plain, higher = (open_recording(path, unit)[0] for unit in (None, tmp_path / "unit.yaml"))
    up = [np.degrees(np.arcsin(sweep.direction[..., 2])) for sweep in (plain, higher)]
    np.testing.assert_allclose(up[1] - up[0], 1.0, atol=0.01)


def test_a_sought_turn_is_that_of_a_head_that_has_changed_its_pace(
    tmp_path: Path, library: Callable[[str], Any]
) -> None:
    """Its first firings turn on at the rate of the packets just before it, not of those a turn ago."""
    library("velodyne_decoder")
    slow = [vls_packet(150 * number, 50, 160 * number) for number in range(120)]
    fast = [vls_packet((18_000 + 300 * number) % 36_000, 100, 160 * (120 + number)) for number in range(70)]
    with open_recording(pcap(tmp_path / "vls.pcap", [*slow, *fast])) as recording:
        assert len(recording) == 2
        direction = recording[1].direction[:, :6]
    azimuth = np.unwrap(np.arctan2(direction[..., 1], direction[..., 0]), axis=1)
    np.testing.assert_allclose(np.degrees(np.diff(azimuth, axis=1)), -1.0, atol=0.011)
