"""Hesai: packets of every model that is read, made by their layouts, and those of hydra4's decoders."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.mistakes import told
from helpers.recordings import DATA, at128_corrections, hesai_packet, pcap

from lidarscene.recordings.hesai_reader import FORMATS, PacketFormat, format_of, recording_of_scans
from lidarscene.recordings.opening import open_recording
from lidarscene.recordings.pcap_reader import packets_of
from lidarscene.sensor.sensor_file import load_sensor

COUNT = {"AT128": 2000}
"""Turns per minute as packets count them, 600 of a head; the beams of an AT128 turn by 2,400 degrees per second."""

MODELS = {layout.name: layout for layout in reversed(FORMATS)}
"""One layout of each model: the OT128's without options."""


def payloads(
    layout: PacketFormat, steps: Any, *, mode: int = 0x37, returns: int = 1, packets: int = 6, stamp_us: int = 1000
) -> list[bytes]:
    """Packets of a head that turns at 600 in a minute, each laser's distances [steps] by the block in its firing."""
    count = COUNT.get(layout.name, 600)
    rows = np.zeros(packets, layout.dtype)
    firings = layout.blocks // returns
    firing = np.arange(packets)[:, None] * firings + np.arange(firings)
    if layout.has_mirror:  # which turns by half of what the beams do, and is at the left edge after 15 degrees
        azimuth = np.rint(25_600.0 * (15.0 + 0.5 * layout.speed_deg_s * count * firing * layout.cycle_s)).astype(int)
        rows["blocks"]["fine"] = np.repeat(azimuth % 256, returns, axis=1)
        azimuth //= 256
    else:
        azimuth = np.rint(layout.speed_deg_s * count * firing * layout.cycle_s * 100.0) % 36_000
    rows["blocks"]["azimuth"] = np.repeat(azimuth, returns, axis=1)
    rows["blocks"]["points"]["distance"] = np.tile(np.asarray(steps), (packets, firings, 1))
    rows["blocks"]["points"]["reflectivity"] = 7
    rows["turns_per_minute"], rows["mode"] = count, mode
    rows["stamp"] = np.rint(1e6 * layout.cycle_s * firings * np.arange(packets)) + stamp_us
    rows["stamp"] %= 10**6
    if layout.phase is not None:
        rows["phase"] = (np.arange(packets) + 1) % 2 if returns > 1 else 0
    if layout.step_mm is None:
        rows["step_mm"] = 4
    contents = [bytearray(row.tobytes()) for row in rows]
    for content in contents:
        if layout.protocol is not None:
            content[:4] = bytes([0xEE, 0xFF, *layout.protocol])
            content[6:8] = bytes([layout.lasers, layout.blocks])
            content[11] = layout.flags or 0
        elif layout.header:
            content[:4] = bytes([0xEE, 0xFF, layout.lasers, layout.blocks])
        else:
            for block in range(layout.blocks):
                start = block * (layout.mark + 2 + layout.point * layout.lasers)
                content[start : start + 2] = b"\xff\xee"
    return [bytes(content) for content in contents]


def unit_file(folder: Path, layout: PacketFormat) -> Path | None:
    """The file of corrections without which a model is not read, with the catalogue's angles; None for another."""
    if not layout.has_mirror:
        return None
    scanner = load_sensor(layout.sensor).scanner
    laser = np.argsort(scanner.lasers_by_place.values)
    angles = (np.degrees(angle.values[laser]) * 25_600.0 for angle in (scanner.azimuth_rad, scanner.elevation_rad))
    azimuth, elevation = (np.rint(angle).astype(int).tolist() for angle in angles)
    return at128_corrections(folder / "a.dat", azimuth=azimuth, elevation=elevation)


@pytest.mark.parametrize("layout", FORMATS, ids=lambda layout: f"{layout.name}-{layout.flags or 0}")
def test_every_model_is_read_with_the_catalogues_beams(tmp_path: Path, layout: PacketFormat) -> None:
    """Ranges to rounding; elevations and the head's turn between pulses to 1e-4 degrees, azimuths come in 0.01."""
    steps = 500 + np.arange(layout.lasers)
    packets = payloads(layout, steps)
    assert format_of(packets[0]) is layout
    with open_recording(pcap(tmp_path / "a.pcap", packets), unit_file(tmp_path, layout)) as recording:
        sweep = recording[0]
        assert recording.metadata["sensor"] == layout.name
    assert sweep.shape == (layout.lasers, 6 * layout.blocks)
    np.testing.assert_allclose(sweep.range_m, np.broadcast_to(0.004 * steps[:, None], sweep.shape), rtol=1e-12)
    scanner = load_sensor(layout.sensor).scanner
    pulse = np.arange(scanner.line_pulses, dtype=np.uint32)
    channel = np.asarray(scanner.channel(pulse))
    azimuth_deg, elevation_deg = (np.degrees(np.asarray(angle)) for angle in scanner.angles(pulse))
    np.testing.assert_allclose(np.degrees(np.arcsin(sweep.direction[channel, 0, 2])), elevation_deg, atol=1e-4)
    # A cycle of the catalogue's sensor, whose head turns as this one: the same azimuths but for one turn of all, and
    # those of a second firing in the cycle from the second column.
    second = np.asarray(scanner.time_s(pulse)) > layout.cycle_s * (1.0 - 1e-3)
    direction = sweep.direction[channel, second.astype(int)]
    apart_deg = np.degrees(np.arctan2(direction[:, 1], direction[:, 0])) - azimuth_deg
    apart_deg = (apart_deg - apart_deg[0] + 180.0) % 360.0 - 180.0
    assert np.abs(apart_deg).max() < 0.006
    assert sweep.time_s is not None
    fired_s = sweep.time_s[channel, second.astype(int)]
    np.testing.assert_allclose(fired_s - fired_s.min(), scanner.time_s(pulse), atol=2e-10)


@pytest.mark.parametrize("stamp_us", [1000, 501_500, 999_500])
def test_clocks_that_are_not_set_by_each_other(tmp_path: Path, stamp_us: int) -> None:
    """The recorder's clock begins at a whole second and gains 0.7 ms a packet. The sensor's is half a second away, also
    from one turn to the next, or passes a second.
    """
    layout = MODELS["Pandar64"]
    path = pcap(tmp_path / "a.pcap", payloads(layout, np.full(layout.lasers, 500), stamp_us=stamp_us))
    packets = list(packets_of(path))
    for count in (6, 3, 2):
        turns = [packets[first : first + count] for first in range(0, 6, count)]
        sweeps = list(recording_of_scans(path, None, turns, name=""))
        time_s = np.concatenate([sweep.start_s + np.ravel(np.asarray(sweep.time_s)) for sweep in sweeps])
        assert 0.0 < np.nanmax(time_s) - np.nanmin(time_s) < 0.01


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize(("mode", "first", "second"), [(0x39, 700, 500), (0x39, 500, 700), (0x3B, 500, 700)])
def test_two_returns(tmp_path: Path, name: str, mode: int, first: int, second: int) -> None:
    """The strongest, which is never behind the last, in whichever block; of the first and the last the first."""
    layout = MODELS[name]
    steps = np.stack([np.full(layout.lasers, first), np.full(layout.lasers, second)])
    steps[1, 1::2] = steps[0, 1::2] = min(first, second)  # every other laser has one return, told twice
    packets = payloads(layout, steps, mode=mode, returns=2)
    with open_recording(pcap(tmp_path / "a.pcap", packets), unit_file(tmp_path, layout)) as recording:
        sweep = recording[0]
        assert recording.metadata["mode"] == "dual"
    assert sweep.shape == (layout.lasers, 6 * layout.blocks // 2)
    assert np.unique(sweep.range_m).tolist() == [2.0]
    assert sweep.second is not None
    np.testing.assert_allclose(sweep.second.range_m[::2], 2.8, rtol=1e-12)
    assert np.isnan(sweep.second.range_m[1::2]).all()


def test_a_laser_that_does_not_fire_is_not_recorded(tmp_path: Path) -> None:
    """A quarter of a QT128C2X rests in each firing; an OT128 says which rest, and why the others saw nothing."""
    quarter = MODELS["QT128C2X"]
    with open_recording(pcap(tmp_path / "a.pcap", payloads(quarter, np.zeros(128)))) as recording:
        assert recording[0].recorded[:, 0].tolist() == [False] * 32 + [True] * 96
        assert recording[0].recorded[:, 1].tolist() == [True] * 32 + [False] * 32 + [True] * 64
    layout = MODELS["OT128"]
    with open_recording(pcap(tmp_path / "b.pcap", payloads(layout, np.arange(128)))) as recording:
        sweep = recording[0]
    assert sweep.recorded[:, 0].tolist() == [False] + [True] * 127
    assert sweep.has_return[:, 0].tolist() == [False] * 4 + [True] * 124


@pytest.mark.parametrize("name", ["PandarXT32", "OT128"])
def test_points_are_those_of_another_decoder(tmp_path: Path, library: Callable[[str], Any], name: str) -> None:
    """hydra4's, which leave out what the head turns while lasers fire: at 0 turns in a minute there is none.

    0.1 mm at 10 m: its angles are float32.
    """
    decoders, layout = library("hydra4.decoders"), MODELS[name]
    rows = [f"{channel + 1},{15 - 0.2 * channel:.2f},{0.1 * (channel % 5):.1f}" for channel in range(layout.lasers)]
    table = tmp_path / "angles.csv"
    table.write_text("\n".join(["Channel,Elevation,Azimuth", *rows]) + "\n")
    still = [bytearray(content) for content in payloads(layout, 2500 + np.arange(layout.lasers))]
    offset = layout.dtype.fields["turns_per_minute"][1]
    date = {"PandarXT32": 13, "OT128": 15}[name] - layout.turns_per_minute + offset
    for content in still:
        content[offset : offset + 2] = bytes(2)
        content += bytes(100)
        content[date : date + 6] = bytes([126, 1, 2, 3, 4, 5])
    decoder = getattr(decoders, name if name != "OT128" else "PandarOT128")(table, 0.0, 1000.0)
    blocks = [block for content in still for block in decoder(SimpleNamespace(data=bytes(content)))]
    right, forward, up, _, ring, *_ = np.array([point for block in blocks for point in block.points], np.float64).T
    with open_recording(pcap(tmp_path / "a.pcap", [bytes(content) for content in still]), table) as recording:
        xyz_m = recording[0].xyz_m
    column = np.arange(len(ring)) // layout.lasers
    np.testing.assert_allclose(xyz_m[ring.astype(int), column], np.stack([forward, -right, up], axis=-1), atol=1e-4)


def test_turns_are_frames(tmp_path: Path) -> None:
    packets = [hesai_packet(azimuth, 2500) for azimuth in range(0, 36_000 + 2000, 144)]
    with open_recording(pcap(tmp_path / "xt.pcap", packets)) as recording:
        assert (len(recording), recording[0].shape, recording[1].shape) == (2, (32, 2000), (32, 112))


@pytest.mark.parametrize("layout", FORMATS, ids=lambda layout: f"{layout.name}-{layout.flags or 0}")
def test_lost_packets_have_their_place(tmp_path: Path, layout: PacketFormat) -> None:
    """Those between the others are not recorded, and all other pulses are as if they had come."""
    packets = payloads(layout, np.full(layout.lasers, 500), packets=8)
    full, sweep = (
        open_recording(pcap(tmp_path / "a.pcap", some), unit_file(tmp_path, layout))[0]
        for some in (packets, packets[:3] + packets[5:])
    )
    lost = slice(3 * layout.blocks, 5 * layout.blocks)
    assert not sweep.recorded[:, lost].any()
    for field in ("recorded", "range_m", "direction", "time_s"):
        values, right = (np.delete(getattr(one, field), lost, axis=1) for one in (sweep, full))
        np.testing.assert_array_equal(values, right)
    np.testing.assert_allclose(sweep.direction, full.direction, atol=2e-4)  # azimuths are rounded to 0.01 degrees


def test_a_table_of_another_sensor_is_refused(tmp_path: Path) -> None:
    table = tmp_path / "angles.csv"
    table.write_text("Channel,Elevation,Azimuth\n1,3,0\n2,2,0\n")
    with told("angles.csv | 32 channels | PandarXT32 | 2"):
        open_recording(pcap(tmp_path / "a.pcap", [hesai_packet(0, 2500)]), table)


@pytest.mark.parametrize(("protocol", "lasers", "blocks"), [((3, 4), 32, 8), ((6, 1), 24, 8), ((4, 7), 128, 2)])
def test_other_models_are_refused(tmp_path: Path, protocol: tuple[int, int], lasers: int, blocks: int) -> None:
    payload = bytearray(hesai_packet(0, 2500))
    payload[2:4], payload[6:8] = bytes(protocol), bytes([lasers, blocks])
    with told(f"Pandar40P | AT128 | protocol {protocol[0]}.{protocol[1]} | {lasers} lasers | {blocks} blocks"):
        open_recording(pcap(tmp_path / "other.pcap", [bytes(payload)]))


def test_a_packet_that_is_cut_off_is_passed_over(tmp_path: Path) -> None:
    packets = payloads(MODELS["PandarQT"], np.full(64, 500))
    packets[3] = packets[3][:800]
    with open_recording(pcap(tmp_path / "a.pcap", packets)) as recording:
        assert recording[0].recorded.any(axis=0).sum() == 20


def test_layouts_do_not_fit_each_others_packets() -> None:
    for layout in FORMATS:
        (payload,) = payloads(layout, np.zeros(layout.lasers), packets=1)
        assert [other for other in FORMATS if other.fits(payload)] == [layout]
        assert not replace(layout, blocks=layout.blocks + 1).fits(payload)


def test_points_of_an_at128_are_those_of_another_decoder(tmp_path: Path) -> None:
    """The other is nebula, which rounds both corrections to 0.01 degrees: 0.0071 degrees at most, and lets the mirror
    stand.
    """
    recorded, layout = json.loads((DATA / "at128.json").read_text()), MODELS["AT128"]
    keys = ("azimuth", "elevation", "face_start", "azimuth_shift", "elevation_shift", "unit")
    table = at128_corrections(tmp_path / "a.dat", **{key: recorded[key] for key in keys})
    points = np.array(recorded["points"])
    azimuths, place = np.unique(points[:, 0].astype(int), return_inverse=True)
    laser = points[:, 1].astype(int)
    packets = [bytearray(payload) for payload in payloads(layout, np.zeros(128), packets=len(azimuths) // 2)]
    for number, content in enumerate(packets):
        packet = np.frombuffer(content, layout.dtype)[0]
        packet["turns_per_minute"] = 0
        for block in range(2):
            is_here = place == 2 * number + block
            packet["blocks"][block]["azimuth"], packet["blocks"][block]["fine"] = divmod(
                azimuths[2 * number + block], 256
            )
            packet["blocks"][block]["points"]["distance"][laser[is_here]] = points[is_here, 2]
    with open_recording(pcap(tmp_path / "a.pcap", [bytes(content) for content in packets]), table) as recording:
        sweep = recording[0]
    apart_m = np.linalg.norm(sweep.xyz_m[laser, place] - points[:, 3:], axis=-1)  # its x is ahead, its y to the left
    # Coordinates are rounded to 0.1 mm in the extract.
    assert (apart_m < np.radians(0.0072) * sweep.range_m[laser, place] + 2e-4).all()
    assert sweep.has_return.sum() == len(points)


def test_faces_of_a_mirror_are_frames(tmp_path: Path) -> None:
    """Three faces carry the same beams past the same directions; what is between them is no pulse."""
    layout = MODELS["AT128"]
    packets = [bytearray(payload) for _ in range(3) for payload in payloads(layout, np.full(128, 500), packets=4)]
    for number, content in enumerate(packets):
        fields = np.frombuffer(content, layout.dtype)
        fields["blocks"]["azimuth"] += np.uint16(12_000 * (number // 4))
        fields["stamp"] += np.uint32(10_000 * (number // 4))
    path = pcap(tmp_path / "a.pcap", [bytes(content) for content in packets])
    with open_recording(path, unit_file(tmp_path, layout)) as recording:
        directions = [sweep.direction for sweep in recording]
    assert [direction.shape for direction in directions] == [(128, 8, 3)] * 3
    for direction in directions[1:]:
        np.testing.assert_allclose(direction, directions[0], atol=1e-12)


def test_an_at128_needs_the_units_file(tmp_path: Path) -> None:
    path = pcap(tmp_path / "a.pcap", payloads(MODELS["AT128"], np.full(128, 500)))
    with told("metadata | .dat | AT128"):
        open_recording(path)
    table = at128_corrections(tmp_path / "a.dat", azimuth=[0] * 64, elevation=[0] * 64)
    with told("a.dat | 128 channels | AT128 | 64"):
        open_recording(path, table)
    whole = table.read_bytes()
    for content, named in (
        (whole[:-400], "64 lasers | 3 faces | bytes"),
        (whole[:3] + b"\x03" + whole[4:], "version 1.5 | 1.3"),
        (b"Channel,Elevation,Azimuth\n", "first bytes"),
        (b"", "first bytes"),
    ):
        table.write_bytes(content)
        with told(f"a.dat | {named}"):
            open_recording(path, table)
