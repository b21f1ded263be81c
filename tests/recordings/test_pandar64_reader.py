"""Pandar64: packets of the maker's format, with what follows them in newer firmware, and with mistakes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.mistakes import told
from helpers.packets import packets_of, random_frame
from helpers.recordings import pcap

from lidarscene.formats.packets.pcap import HEADER, record_of
from lidarscene.formats.packets.select_encoder import select_encoder
from lidarscene.recordings.opening import open_recording
from lidarscene.sensor.sensor_file import load_sensor

SENSOR = load_sensor("pandar64")


def payloads() -> list[bytes]:
    """A turn and a little more."""
    clouds = [random_frame(SENSOR, number=number) for number in range(2)]
    return [packet.payload for packet in packets_of(select_encoder(SENSOR), SENSOR, clouds)][:310]


def test_turns_are_frames_and_sequence_numbers_are_passed_over(tmp_path: Path) -> None:
    path = pcap(tmp_path / "a.pcap", [payload + bytes(4) for payload in payloads()])
    with open_recording(path) as recording:
        assert len(recording) == 2
        first, second = recording
    assert (first.shape, second.shape) == ((64, 1800), (64, 60))
    assert first.includes_lost
    # Seven pulses in ten came back: 115,200 of them, with a standard deviation of 0.14 %.
    assert first.has_return.mean() == pytest.approx(0.7, abs=0.006)
    np.testing.assert_allclose(np.linalg.norm(first.direction, axis=-1), 1.0, atol=1e-6)


def test_a_units_own_angles_are_used(tmp_path: Path) -> None:
    table = tmp_path / "angles.csv"
    rows = [f"{channel + 1},{10 - 0.25 * channel},0" for channel in range(64)]
    table.write_text("\n".join(["Laser id,Elevation,Azimuth", *rows]) + "\n")
    with open_recording(pcap(tmp_path / "a.pcap", payloads()), table) as recording:
        up = recording[0].direction[..., 2]
    np.testing.assert_allclose(
        np.degrees(np.arcsin(up)), np.broadcast_to((10.0 - 0.25 * np.arange(64))[:, None], up.shape), atol=1e-4
    )


def test_a_table_of_another_sensor_is_told(tmp_path: Path) -> None:
    table = tmp_path / "angles.csv"
    table.write_text("Channel,Elevation,Azimuth\n1,3,0\n2,2,0\n")
    with told("angles.csv | 64 channels | Pandar64 | 2"):
        open_recording(pcap(tmp_path / "a.pcap", payloads()), table)


@pytest.mark.parametrize("late_s", [-0.4, 0.4])
def test_the_second_is_the_recorders_and_its_part_the_sensors(tmp_path: Path, late_s: float) -> None:
    """A recorder's clock may be half a second off: the nearest second to which the sensor's part fits is right."""
    cloud = random_frame(SENSOR)
    cloud = replace(cloud, metadata=dict(cloud.metadata) | {"frame_start_s": "1000.5"})
    packets = packets_of(select_encoder(SENSOR), SENSOR, [cloud])
    content = HEADER + b"".join(record_of(packet._replace(time_s=packet.time_s + late_s), 2368) for packet in packets)
    (tmp_path / "a.pcap").write_bytes(content)
    with open_recording(tmp_path / "a.pcap") as recording:
        assert recording[0].start_s == pytest.approx(1000.5, abs=1e-6)


def test_a_units_azimuths_are_clockwise(tmp_path: Path) -> None:
    """Azimuths are so in Hesai's tables: three degrees more are three degrees to the right."""
    azimuths_deg = []
    for azimuth_deg in (0.0, 3.0):
        table = tmp_path / "angles.csv"
        rows = [f"{channel + 1},{10 - 0.25 * channel},{azimuth_deg}" for channel in range(64)]
        table.write_text("\n".join(["Laser id,Elevation,Azimuth", *rows]) + "\n")
        with open_recording(pcap(tmp_path / "a.pcap", payloads()), table) as recording:
            direction = recording[0].direction[:, 100]
        azimuths_deg.append(np.degrees(np.arctan2(direction[:, 1], direction[:, 0])))
    np.testing.assert_allclose((azimuths_deg[1] - azimuths_deg[0] + 180.0) % 360.0 - 180.0, -3.0, atol=1e-4)


def test_steps_and_intensities_of_two_returns(tmp_path: Path) -> None:
    """Each return has its own; a packet says how long its steps are [mm]."""
    sensor = load_sensor("pandar64", overrides=('tdc.keep="strongest_and_last"',))
    cloud = random_frame(sensor, second=True)
    payloads_of_frame = [bytearray(packet.payload) for packet in packets_of(select_encoder(sensor), sensor, [cloud])]
    for payload in payloads_of_frame:
        assert payload[5] == 4
        payload[5] = 2
    with open_recording(pcap(tmp_path / "a.pcap", [bytes(payload) for payload in payloads_of_frame])) as recording:
        sweep = recording[0]
    assert sweep.second is not None
    assert sweep.intensity is not None
    assert sweep.second.intensity is not None
    has_second = np.isfinite(sweep.second.range_m)
    assert has_second.sum() == (cloud.return_number == 2).sum()
    column = ((cloud.time_s + 1e-9) // sensor.scanner.cycle_s).astype(int)
    expected = {
        (r, c, round(m / 0.004)): i
        for r, c, m, i in zip(
            cloud.channel.tolist(), column.tolist(), cloud.range_m.tolist(), cloud.intensity.tolist(), strict=True
        )
    }
    for range_m, intensity in ((sweep.range_m, sweep.intensity), (sweep.second.range_m, sweep.second.intensity)):
        places = np.argwhere(np.isfinite(range_m))[::997]
        for row, place in places.tolist():
            steps = round(range_m[row, place] / 0.002)
            assert expected[row, place, steps] == intensity[row, place]
