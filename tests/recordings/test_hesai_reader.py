"""Hesai: packets as the PandarXT-32's manual has them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.recordings import hesai_packet, pcap

from lidarscene.errors import InputError
from lidarscene.recordings.opening import open_recording


@pytest.fixture(autouse=True)
def _decoder(library: Callable[[str], Any]) -> None:
    library("hydra4.decoders")


def test_points_turned_to_x_forward(tmp_path: Path) -> None:
    packets = [hesai_packet(azimuth, 2500) for azimuth in range(0, 36_000 + 2000, 144)]
    table = tmp_path / "angles.csv"
    rows = [f"{channel + 1},{15 - channel},0" for channel in range(32)]
    table.write_text("\n".join(["Channel,Elevation,Azimuth", *rows]) + "\n")
    with open_recording(pcap(tmp_path / "xt.pcap", packets), table) as recording:
        assert (len(recording), recording.metadata["sensor"]) == (2, "PandarXT32")
        sweep = recording[0]
    assert sweep.shape == (250 * 8 * 32,)
    np.testing.assert_allclose(sweep.range_m, 10.0, rtol=1e-9)
    # Hesai counts azimuths clockwise from its y axis, ahead. The first block looks there, a later one to the right.
    first, later = sweep.xyz_m[0], sweep.xyz_m[32 * 8 * 62]
    elevation = np.radians(15.0)
    np.testing.assert_allclose(first, [10.0 * np.cos(elevation), 0.0, 10.0 * np.sin(elevation)], atol=1e-9)
    assert later[1] < -9.0
    assert sweep.time_s is not None
    # A block lasts 50 us, and a turn of 250 packets 0.1 s; the packets of one instant differ by their blocks alone.
    assert 0.0 <= sweep.time_s.min() <= sweep.time_s.max() < 1e-3


@pytest.mark.parametrize(("protocol", "lasers", "blocks"), [((3, 1), 32, 8), ((6, 1), 16, 8), ((6, 1), 32, 6)])
def test_other_models_are_told(tmp_path: Path, protocol: tuple[int, int], lasers: int, blocks: int) -> None:
    """Rationale: PandarXT-16 and XT-32M have the XT-32's protocol and shorter packets, which gave struct's message."""
    payload = bytearray(hesai_packet(0, 2500))[: 12 + blocks * (2 + 4 * lasers) + 28]
    payload[2:4], payload[6:8] = bytes(protocol), bytes([lasers, blocks])
    message = f"got protocol {protocol[0]}.{protocol[1]}, {lasers} lasers, {blocks} blocks"
    with pytest.raises(InputError, match=rf"must be packets of a PandarXT-32 .* or OT128 .*, {message}"):
        open_recording(pcap(tmp_path / "other.pcap", [bytes(payload)]))
