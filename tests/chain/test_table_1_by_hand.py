"""A second road to (19), (27) and their ranges: the equations typed out again with SciPy, nothing shared."""

import math

import numpy as np
import pytest
from scipy.constants import c, e, h, k
from scipy.optimize import brentq

from lidarscene import load_sensor
from lidarscene.studies.ranging import plane
from lidarscene.studies.ranging.plane import Target

PHOTON = h * c / 905e-9
APERTURE = math.pi * 0.025**2


def powers(range_m, klux):
    echo = 0.98**2 * 0.7206 * 0.1 * 45.0 * APERTURE / (math.pi * range_m**2)
    sun = 29.4 * klux / 100.0 * 0.7986 * 0.98 * 0.1 * APERTURE * (1e-4 / 0.03) ** 2 * math.cos(math.radians(60))
    return echo, sun


def snr_apd(range_m, klux):
    echo, sun = powers(range_m, klux)
    responsivity, gain, bandwidth = e * 0.7 / PHOTON, 80.0, 167e6
    excess = gain**0.3
    variance = (
        2 * e * responsivity * sun * gain**2 * excess * bandwidth
        + 2 * e * (1e-10 + 1e-10 * gain**2 * excess) * bandwidth
        + 4 * k * 300.0 * bandwidth / 1e4
    )
    return responsivity * gain * echo / math.sqrt(variance)


def snr_sipm(range_m, klux):
    echo, sun = powers(range_m, klux)
    cells, pde, dead, dark = 400, 0.22, 6e-9, 2007.0
    trigger = math.exp(-pde / cells) - 1
    background, signal = sun * dead / PHOTON, echo * 6e-9 / (2 * PHOTON)
    busy = cells * (1 - math.exp(background * trigger))
    fired = (cells - busy - cells * dark * dead) * (1 - math.exp(signal * trigger))
    return fired / math.sqrt(busy * math.exp(background * trigger) + cells * dark * dead)


SENSORS = ((load_sensor("table1-apd"), snr_apd), (load_sensor("table1-sipm"), snr_sipm))


@pytest.mark.parametrize(("sensor", "by_hand"), SENSORS)
@pytest.mark.parametrize("klux", [0.3, 1.0, 3.0, 10.0, 50.0, 100.0, 130.0])
def test_snr_and_range(sensor, by_hand, klux):
    """Tolerance: float64 rounding; the constants are the same CODATA values."""
    target = Target(illuminance_klux=klux)
    ranges = np.geomspace(1.0, 1000.0, 17)
    expected = [by_hand(r, klux) for r in ranges]
    np.testing.assert_allclose(plane.snr(sensor, target, ranges), expected, rtol=1e-9)
    limit = brentq(lambda r: by_hand(r, klux) - 5.0, 10.0, 5000.0, xtol=1e-9)
    assert plane.maximum_range_m(sensor, target)[0] == pytest.approx(limit, rel=1e-9)
