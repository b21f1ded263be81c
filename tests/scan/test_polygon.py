"""Polygons against vector optics by brute force."""

import math

import numpy as np
import pytest
from helpers import brute, scanners
from helpers.scanners import DEG, PULSES, directions, shares


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("rotation_hz", [30.0, -30.0])
def test_polygon(side, rotation_hz):
    scanner = scanners.polygon(side=side, rotation_hz=rotation_hz)
    assert scanner.columns == 750  # 150 kHz, 30 turns of four facets, 60 % of the time
    beams, share = directions(scanner, PULSES), shares(scanner, PULSES)
    for n, pulse in enumerate(PULSES.astype(int)):
        number, column = divmod(int(pulse), 750)
        tilt = (-4, -1, 2, 5)[number] * DEG
        turn = 2 * math.pi * rotation_hz * (column - 374.5) / 150e3
        np.testing.assert_allclose(beams[n], brute.facet(40 * DEG, side, turn, tilt), atol=1e-6)
        expected = brute.facet_share(40 * DEG, side, turn, 4, 0.03, 0.012)
        assert share[n] == pytest.approx(expected, abs=0.003)


def test_polygon_moves_the_beam_by_twice_its_turn():
    """Reference: facets without tilt keep the beam level, so the azimuth is exactly twice the turn."""
    azimuth, elevation = scanners.polygon(tilt_rad=[0.0] * 6, duty=0.5).angles(np.arange(10, dtype=np.uint32))
    np.testing.assert_allclose(np.diff(azimuth), 2 * 2 * math.pi * 30 / 150e3, rtol=2e-4)
    np.testing.assert_allclose(elevation, 0.0, atol=1e-7)
