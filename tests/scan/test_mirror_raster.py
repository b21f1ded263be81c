"""Rasters of mirrors: their grids in angles and in time."""

import math

import numpy as np
from helpers import brute, scanners
from helpers.scanners import DEG, directions

from lidarscene import scan


def test_mirror_raster_turns_its_mirrors_by_its_grid():
    scanner = scanners.mirror()
    row, column = 3, 117
    turned = (1 - 2 * column / 119) * 15 * DEG, (1 - 2 * row / 40) * 6 * DEG
    expected, _ = brute.gimbal(0.6, "below", "elevation", *turned)
    direction = directions(scanner, np.array([row * 120 + column], dtype=np.uint32))[0]
    np.testing.assert_allclose(direction, expected, atol=3e-7)


def test_sine_lines_come_back_and_are_even_in_time():
    """Rationale: a resonant mirror's angle is A sin, whichever way the line goes; lines follow at half a period."""
    scanner = scanners.mirror(waveform="sine", line_duty=0.8, mirrors=scan.MirrorPair(last="elevation"))
    pulse = np.arange(240, dtype=np.uint32)
    (fast, _), time_s = scanner._mechanism(pulse), scanner.time_s(pulse)
    line_s = 120 / (100e3 * 0.8)
    middle = time_s - 59.5 / 100e3  # the first line's middle is where the sine goes through zero
    np.testing.assert_allclose(fast, -15 * DEG * np.sin(math.pi * middle / line_s), atol=1e-6)


def test_ramp_goes_on_within_a_line():
    scanner = scanners.mirror(slow="ramp")
    _, slow = scanner._mechanism(scanners.frame(scanner))
    whole = scanner.time_s(scanners.frame(scanner)) / (41 * scanner.line_s)
    np.testing.assert_allclose(slow, (1 - 2 * whole) * 6 * DEG, atol=2e-7)


def test_lines_are_vertical_where_the_fast_turn_is_that_of_elevation():
    """Lines go from the left, each from the top."""
    scanner = scanners.mirror(fast="elevation")
    pulse = np.arange(scanner.pulses, dtype=np.uint32)
    azimuth, elevation = (np.asarray(angle).reshape(41, 120) for angle in scanner._mechanism(pulse))
    assert np.ptp(azimuth, axis=1).max() == 0.0
    assert (np.diff(azimuth[:, 0]) < 0.0).all()
    assert (np.diff(elevation, axis=1) < 0.0).all()
