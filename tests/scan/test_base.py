"""Frames: field of view, times, closing, points per second, channels."""

import math
from fractions import Fraction

import numpy as np
import pytest
from helpers import scanners
from helpers.scanners import ALL, DEG, frame

from lidarscene.scan.turns import Turns

CLOSING = [name for name in ALL if name not in ("vlp16", "mid40", "six_beams", "three_wedges", "mirror_behind_prisms")]
"""Those whose next frame starts where this one did."""

FIELD_OF_VIEW_DEG = {
    # azimuth and elevation, lowest and highest; by hand from the numbers in scanners.py
    "raster": (-0.5 / DEG, 0.5 / DEG, -0.2 / DEG, 0.2 / DEG),
    "vlp16": (-180.0, 180.0, -15.0, 15.0),
    "encoder_clocked": (-180.0, 180.0, -0.1 / DEG, 0.1 / DEG),
    "mirror_triangle_pair": (None, None, -12.0, 12.0),  # on the middle line; first turn 30 on the last cone
    "lissajous_pair": (-24.0, 24.0, -16.0, 16.0),
    "flash": (-math.atan(0.6) / DEG, math.atan(0.6) / DEG, -math.atan(0.4) / DEG, math.atan(0.4) / DEG),
}


@pytest.mark.parametrize("name", FIELD_OF_VIEW_DEG)
def test_field_of_view(name):
    scanner = ALL[name]()
    azimuth, elevation = (np.degrees(a) for a in scanner.angles(frame(scanner)))
    edges = azimuth.min(), azimuth.max(), elevation.min(), elevation.max()
    for edge, expected in zip(edges, FIELD_OF_VIEW_DEG[name], strict=True):
        if expected is not None:
            assert edge == pytest.approx(expected, abs=0.21)  # VLP-16 columns; sines may miss their peaks
            assert abs(edge) < abs(expected) + 1e-4


@pytest.mark.parametrize("name", ALL)
def test_directions_are_unit_vectors_and_angles_agree(name):
    scanner = ALL[name]()
    pulse = frame(scanner)
    x, y, z = np.broadcast_arrays(*scanner.direction(pulse))
    azimuth, elevation = scanner.angles(pulse)
    np.testing.assert_allclose(x * x + y * y + z * z, 1.0, atol=1e-6)
    np.testing.assert_allclose(np.cos(elevation) * np.cos(azimuth), x, atol=5e-7)
    np.testing.assert_allclose(np.cos(elevation) * np.sin(azimuth), y, atol=5e-7)
    np.testing.assert_allclose(np.sin(elevation), z, atol=5e-7)


@pytest.mark.parametrize("name", ALL)
def test_times_rise_through_frames(name):
    scanner = ALL[name]()
    time_s = scanner.time_s(np.arange(2 * scanner.pulses + 1))
    assert time_s.dtype == np.float64
    assert time_s[0] == 0.0
    steps = np.diff(time_s)
    simultaneous = name.startswith("flash") or name == "encoder_clocked"
    assert steps.min() >= 0.0 if simultaneous else steps.min() > 0.0
    for number in (1, 2):
        assert time_s[number * scanner.pulses] == pytest.approx(number * scanner.frame_s, rel=1e-12)


@pytest.mark.parametrize("name", CLOSING)
def test_frames_close(name):
    """Rationale: after one period the mechanism stands as at the start. Tolerance: single precision."""
    scanner = ALL[name]()
    pulse = frame(scanner)
    following = pulse + np.uint32(scanner.pulses)
    for component, next_component in zip(scanner.direction(pulse), scanner.direction(following), strict=True):
        np.testing.assert_allclose(component, next_component, atol=1e-6)
    np.testing.assert_array_equal(scanner.channel(pulse), scanner.channel(following))


CHANNELS = {
    # pulses that follow each other on one channel, and channels before it starts anew; by hand from scanners.py
    "raster": (101, 21),
    "mirror_step": (120, 41),
    "lissajous": (1, 1),
    "polygon": (750, 4),
    "polygon_backwards": (750, 4),
    "mid40": (1, 1),
    "six_beams": (1, 6),
    "flash": (61, 41),
    "pattern": (1, 3),
}


@pytest.mark.parametrize("name", CHANNELS)
def test_channels_follow_each_other(name):
    """Reference: a count of the pulses of a frame and a half."""
    scanner, (pulses_each, channels) = ALL[name](), CHANNELS[name]
    pulse = np.arange(scanner.pulses * 3 // 2, dtype=np.uint32)
    within = np.arange(len(pulse)) % scanner.pulses if name in CLOSING else np.arange(len(pulse))
    np.testing.assert_array_equal(scanner.channel(pulse), within // pulses_each % channels)


def test_a_facet_is_a_channel():
    """The elevation of a line is about 2 b cos i of the facet's own tilt b: the channel tells which."""
    scanner = ALL["polygon"]()
    _, elevation = scanner.angles(frame(scanner))
    channel = scanner.channel(frame(scanner))
    for number, tilt_deg in enumerate((-4.0, -1.0, 2.0, 5.0)):
        middle = np.median(np.degrees(elevation[channel == number]))
        assert middle == pytest.approx(2.0 * tilt_deg * math.cos(40.0 * DEG), abs=0.1)


def test_a_frame_that_does_not_close_goes_on():
    """1808 cycles of the VLP-16 are 0.09 degrees short of a turn; the next frame starts there."""
    scanner = scanners.vlp16()
    azimuth, _ = scanner.angles(np.array([scanner.pulses], dtype=np.uint32))
    assert scanner.cycles == 1808
    assert azimuth[0] == pytest.approx(2 * math.pi * (1 - 10 * 1808 * 55.296e-6), abs=1e-6)


POINTS_PER_SECOND = {
    "raster": 50e3,
    "vlp16": 289_352,  # 16 in 55.296 us, by the user manual
    "encoder_clocked": 4 * 1024 * 20,
    "mirror_step": 100e3 * 0.8 * 0.9,
    "lissajous": 200e3,
    "polygon": 150e3 * 0.6,
    "mid40": 100e3,
    "flash": 61 * 41 * 25,
    "pattern": 100e3,
}


@pytest.mark.parametrize("name", POINTS_PER_SECOND)
def test_points_per_second(name):
    scanner = ALL[name]()
    assert scanner.pulses / scanner.frame_s == pytest.approx(POINTS_PER_SECOND[name], rel=2e-6)


def test_lasers_fire_in_the_order_of_their_times():
    """Those that fire at once keep the order of the list; the channel is the place in the list."""
    scanner = scanners.encoder_clocked()
    pulse = np.arange(8, dtype=np.uint32)
    np.testing.assert_array_equal(scanner.channel(pulse), [1, 3, 0, 2, 1, 3, 0, 2])
    np.testing.assert_allclose(scanner.time_s(pulse)[:4], [0.0, 0.0, 3e-6, 3e-6])
    azimuth, elevation = scanner.angles(pulse)
    np.testing.assert_allclose(elevation[:4], [0.05, -0.1, 0.1, -0.05], rtol=1e-6)
    lead = 2 * math.pi * 20 * 3e-6
    expected = np.array([-0.02, -0.05, 0.05 + lead, 0.02 + lead]) + math.pi
    np.testing.assert_allclose((azimuth[:4] - expected + 1) % (2 * math.pi), 1.0, atol=1e-6)


@pytest.mark.parametrize(
    ("frequency_hz", "rate_hz"), [(-121.5657, 100e3), (77.7430, 100e3), (1310.0, 2.3e6), (59_999.7, 1e5)]
)
def test_turns_are_exact(frequency_hz, rate_hz):
    """Ten million pulses and more against float64, which is itself good to 1e-9 here; `Turns` says 1e-6."""
    pulse = np.concatenate([np.arange(10_000_000, dtype=np.uint32)[::97], [2**31 - 1]]).astype(np.uint32)
    angle_rad = Turns.per_pulse(frequency_hz=frequency_hz, rate_hz=rate_hz, start_rad=0.7).angle_rad(pulse)
    expected = 2 * math.pi * np.remainder(pulse * np.float64(frequency_hz / rate_hz), 1.0) + 0.7
    error = np.remainder(angle_rad - expected + math.pi, 2 * math.pi) - math.pi
    assert np.abs(error).max() < 1e-6
    assert np.abs(angle_rad).max() <= np.float32(math.pi)
    # After days, against fractions: numbers of 64 bits, and 32 bits of turns that go on from there.
    turns = Turns.per_pulse(frequency_hz=frequency_hz, rate_hz=rate_hz, start_rad=0.7)
    for first in (2**32 - 2, 2**38 + 12_345, 2**49):
        number = np.arange(5)
        step = Fraction(frequency_hz) / Fraction(rate_hz)
        expected = [2 * math.pi * float((first + n) * step % 1) + 0.7 for n in number.tolist()]
        going_on = turns.from_start(turns.steps(first))
        for angle_rad in (turns.angle_rad(first + number), going_on.angle_rad(number.astype(np.uint32))):
            error = np.remainder(angle_rad - expected + math.pi, 2 * math.pi) - math.pi
            assert np.abs(error).max() < 1e-6


@pytest.mark.parametrize("name", [n for n in ALL if not n.startswith("flash")])
def test_encoders_round_what_is_reported_and_not_where_the_beam_goes(name):
    import dataclasses

    exact = ALL[name]()
    step = 0.7e-3
    coarse = dataclasses.replace(exact, encoder_rad=step)
    pulse = frame(exact)
    for exact_component, coarse_component in zip(exact.direction(pulse), coarse.direction(pulse), strict=True):
        np.testing.assert_array_equal(exact_component, coarse_component)
    turned = np.stack(coarse._read(pulse)) / step
    np.testing.assert_allclose(turned, np.rint(turned), atol=2e-3)
    true, read = (np.stack(s.angles(pulse)) for s in (exact, coarse))
    off = np.abs(np.remainder(true - read + math.pi, 2 * math.pi) - math.pi)
    # A mirror doubles its angle; prisms move the beam by less than they turn. Azimuth counts less off the horizon.
    assert 2e-5 < off.max() < (2.2e-3 if name.startswith(("mirror", "lissajous", "polygon")) else 0.36e-3)
