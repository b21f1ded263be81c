"""Frames: how far their numbers go."""

from types import SimpleNamespace
from typing import Any

import pytest
from helpers.mistakes import told

from lidarscene.rendering.frame import frame_edges
from lidarscene.sensor.sensor_file import load_sensor


def test_frames_go_on_where_numbers_on_the_device_begin_again() -> None:
    """The last whole frame below 2^31 pulses, the one after it, and the highest number of all."""
    scanner = load_sensor("vlp-16").scanner
    last = 2**31 // scanner.pulses - 1
    assert (last + 1) * scanner.pulses < 2**31 < (last + 2) * scanner.pulses
    for number in (last, last + 1, 2**31 - 1):
        begin_s, end_s = frame_edges(scanner, number)
        assert begin_s == pytest.approx(number * scanner.frame_s, rel=1e-12)
        assert 0.0 < end_s - begin_s < scanner.frame_s
    for number in (2**31, -1):
        with told(f"frame number | 0 | {2**31 - 1} | {number}"):
            frame_edges(scanner, number)


def test_the_largest_frames_have_fewer_numbers() -> None:
    """Frames of 2^31 - 1 pulses: each begins a new rollover, of which there are 2^24."""
    pulses = 2**31 - 1
    scanner: Any = SimpleNamespace(pulses=pulses, time_s=lambda pulse: pulse / pulses)
    assert frame_edges(scanner, 2**24 - 1)[0] == pytest.approx(2**24 - 1, rel=1e-15)
    with told(f"frame number | 0 | {2**24 - 1} | {2**24}"):
        frame_edges(scanner, 2**24)
