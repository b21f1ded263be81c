"""Pandar64: packets of the maker's format, with what follows them in newer firmware, and with mistakes."""

from pathlib import Path

import numpy as np
import pytest
from helpers.packets import packets_of, random_frame
from helpers.recordings import pcap

from lidarscene.errors import InputError
from lidarscene.formats.packets.makers import maker_of
from lidarscene.recordings.opening import open_recording
from lidarscene.sensor.catalogue import load_sensor

SENSOR = load_sensor("pandar64")


def payloads() -> list[bytes]:
    """A turn and a little more."""
    clouds = [random_frame(SENSOR, number=number) for number in range(2)]
    return [one.payload for one in packets_of(maker_of(SENSOR), SENSOR, clouds)][:310]


def test_turns_are_frames_and_sequence_numbers_are_passed_over(tmp_path: Path) -> None:
    path = pcap(tmp_path / "a.pcap", [one + bytes(4) for one in payloads()])
    with open_recording(path) as recording:
        assert len(recording) == 2
        first, second = recording
    assert (first.shape, second.shape) == ((64, 1800), (64, 60))
    assert first.knows_lost
    # Seven pulses in ten came back: 115,200 of them, with a standard deviation of 0.14 %.
    assert first.kept.mean() == pytest.approx(0.7, abs=0.006)
    np.testing.assert_allclose(np.linalg.norm(first.direction, axis=-1), 1.0, atol=1e-6)


def test_a_units_own_angles_are_used(tmp_path: Path) -> None:
    table = tmp_path / "angles.csv"
    rows = [f"{channel + 1},{10 - 0.25 * channel},0" for channel in range(64)]
    table.write_text("\n".join(["Laser id,Elevation,Azimuth", *rows]) + "\n")
    with open_recording(pcap(tmp_path / "a.pcap", payloads()), table) as recording:
        up = recording[0].direction[..., 2]
    np.testing.assert_allclose(
        np.degrees(np.arcsin(up)),
        np.broadcast_to((10.0 - 0.25 * np.arange(64))[:, None], up.shape),
        atol=1e-4,
    )


def test_a_table_of_another_sensor_is_told(tmp_path: Path) -> None:
    table = tmp_path / "angles.csv"
    table.write_text("Channel,Elevation,Azimuth\n1,3,0\n2,2,0\n")
    with pytest.raises(InputError, match=r"angles\.csv: must have 64 channels of a Pandar64, got 2"):
        open_recording(pcap(tmp_path / "a.pcap", payloads()), table)
