"""Lissajous scanners against their formula."""

import math

import numpy as np
from helpers import brute, scanners
from helpers.scanners import DEG, PULSES, directions


def test_lissajous():
    """Reference: the two sines at the pulse's own time in float64, then the mirror by brute force."""
    scanner = scanners.lissajous()
    beams = directions(scanner, PULSES)
    for pulse, direction in zip(PULSES, beams, strict=True):
        t = int(pulse) / 200e3
        a = 12 * DEG * math.sin(2 * math.pi * 1310 * t + 0.3)
        e = 8 * DEG * math.sin(2 * math.pi * 1190 * t + 1.2)
        np.testing.assert_allclose(direction, brute.gimbal(0.3, "left", "elevation", a, e)[0], atol=1e-6)
