"""Frames: how far their numbers go."""

import pytest

from lidarscene.errors import InputError
from lidarscene.rendering.frame import frame_edges
from lidarscene.sensor.sensor_file import load_sensor


def test_all_pulses_of_the_last_frame_have_numbers() -> None:
    """Below 2^31: the last whole frame is one, a part of one is none."""
    scanner = load_sensor("vlp-16").scanner
    last = 2**31 // scanner.pulses - 1
    assert (last + 1) * scanner.pulses < 2**31 < (last + 2) * scanner.pulses
    begin_s, end_s = frame_edges(scanner, last)
    assert begin_s == pytest.approx(last * scanner.frame_s, rel=1e-6)
    assert 0.0 < end_s - begin_s < scanner.frame_s
    for number in (last + 1, -1):
        with pytest.raises(InputError, match=f"frame number: must be from 0 to {last}, .* got {number}"):
            frame_edges(scanner, number)
