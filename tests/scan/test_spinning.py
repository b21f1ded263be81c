"""Spinning heads, by hand."""

import math

import numpy as np
import pytest
from helpers import scanners
from helpers.scanners import DEG

from lidarscene.scan import AzimuthSweep, Bank, Spinning


def test_vlp16_by_hand():
    """Pulse 3 of cycle 100: laser 3 at +3 degrees, 100 x 55.296 + 3 x 2.304 us after the start, turning clockwise."""
    scanner = scanners.vlp16()
    pulse = np.array([1603], dtype=np.uint32)
    azimuth, elevation = scanner.angles(pulse)
    t = 100 * 55.296e-6 + 3 * 2.304e-6
    assert scanner.time_s(pulse)[0] == pytest.approx(t, rel=1e-12)
    assert azimuth[0] == pytest.approx(-2 * math.pi * 10 * t, abs=3e-7)
    assert elevation[0] == pytest.approx(3 * DEG, abs=1e-8)
    np.testing.assert_allclose(np.ravel(scanner.offset_m(pulse)), [0, 0, -2.2e-3], atol=1e-9)


def test_each_receiver_has_its_responsivity():
    """Rationale: pulse 16 k + n is of laser n, in any firing order; the background has both factors."""
    gains, wider = tuple(0.5 + 0.1 * n for n in range(16)), tuple(2.0 - 0.1 * n for n in range(16))
    scanner = scanners.vlp16(responsivity=gains, background_gain=wider)
    pulse = np.arange(160, 192, dtype=np.uint32)
    laser = scanner.channel(pulse)
    np.testing.assert_allclose(scanner.aperture_share(pulse), np.array(gains)[laser], rtol=1e-6)
    np.testing.assert_allclose(scanner.background_share(pulse), (np.array(gains) * np.array(wider))[laser], rtol=1e-6)
    plain = scanners.vlp16()
    assert plain.aperture_share(pulse) == plain.background_share(pulse) == 1.0


def test_exits_turn_with_the_head():
    scanner = scanners.vlp16(
        start_m=([0.03] * 16, [0.01] * 16, [0.0] * 16), sweep=AzimuthSweep(start_azimuth_rad=math.pi / 2)
    )
    x, y, z = (v[0] for v in scanner.offset_m(np.zeros(1, dtype=np.uint32)))
    np.testing.assert_allclose([x, y, z], [-0.01, 0.03, 0.0], atol=1e-8)


@pytest.mark.parametrize("rotation_hz", [10.0, -10.0])
def test_a_head_clocked_by_its_encoder_turns_as_it_rotates(rotation_hz):
    """A column of 1024 later it is a 1024th of a turn on: to the left, or to the right if the rate is negative."""
    scanner = Spinning.create(rotation_hz=rotation_hz, cycles_per_turn=1024, bank=Bank(elevation_rad=(0.0, 0.1)))
    azimuth, _ = scanner.angles(np.arange(0, 20, 2, dtype=np.uint32))
    expected = math.copysign(2.0 * math.pi / 1024, rotation_hz) * np.arange(10)
    np.testing.assert_allclose(azimuth, expected, atol=3e-7)
