"""SPADs under a background: closed forms there and back, and the noise of a filter over simulated firings."""

import math

import numpy as np
import pytest
from helpers import photons

from lidarscene.physics.photon_counting import matched_filter

BACKGROUND_W = np.array([2e-10])


@pytest.mark.parametrize("coincidence", [1, 2])
@pytest.mark.parametrize("coates", ["true", "false"])
def test_power_and_photons_are_inverse(coincidence, coates):
    """To 1e-6, the bisection of the response of coincidences to 1e-4."""
    counter = photons.sensor(f"detector.coincidence={coincidence}", f"histogram.coates={coates}")
    pixel = counter.pixel(BACKGROUND_W)
    power = np.geomspace(1e-10, 5e-9, 9)
    back = pixel.power_w(pixel.counts(pixel.detections(power)))
    np.testing.assert_allclose(back, power, rtol=1e-6 if coincidence == 1 else 1e-4)


def test_background_counts_are_those_of_free_spads():
    """N a (1 - exp(-lambda bin)) with a = 1 / (1 + lambda tau); of first photons N (1 - exp(-lambda window))."""
    counter = photons.sensor()
    pixel = counter.pixel(BACKGROUND_W)
    rate = float(pixel.rate_hz[0])
    share = -math.expm1(-rate * 1e-9) / (1.0 + rate * 12e-9)
    assert pixel.count_rate_hz[0] == pytest.approx(64 * 50 * share / 1e-9, rel=1e-9)
    first = photons.sensor("detector.stamps='first'").pixel(BACKGROUND_W)
    counts, _ = first.background_counts(1e-6)
    assert counts[0] * 1e-6 == pytest.approx(64 * 50 * -math.expm1(-rate * 1e-6), rel=1e-9)


def test_dead_time_narrows_the_noise_of_the_filter():
    """`variance_share`: 2000 SPADs fire photon by photon for 2 us at 20 MHz; four standard errors of the variance, and
    3 % for a share to first order in lambda sigma.
    """
    counter = photons.sensor("histogram.bin_ns=0.5")
    pixel = counter.pixel(BACKGROUND_W * 0.0)
    power = (20e6 - float(pixel.rate_hz[0])) / float(pixel.per_watt) * np.ones(1)
    pixel = counter.pixel(power)
    assert pixel.rate_hz[0] == pytest.approx(20e6, rel=1e-3)
    rng = np.random.default_rng(5)
    arrivals = photons.arrivals(rng, 2000, rate_per_ns=0.02, start=-200.0, end=2000.0)
    fired = photons.fired(arrivals, 12.0)
    w = 1e9 * matched_filter.TEMPLATE * float(pixel.sigma_s)
    template = np.exp(-0.5 * (0.5 * np.arange(-24, 25) / w) ** 2)
    counts = np.stack([photons.histogram(one[None], bins=4000, bin_ns=0.5) for one in fired])
    own = np.stack([np.convolve(one, template, "valid") for one in counts])
    poisson = counts.mean() * np.sum(template**2)
    share = own.var(axis=0).mean() / poisson
    # Some 2000 x 2000 ns / (w sqrt(2 pi)) independent values.
    error = math.sqrt(2.0 / (2000 * 2000 / (3.5 * w)))
    assert share == pytest.approx(float(pixel.variance_share[0]), abs=4.0 * error + 0.03)
    assert share < 0.95
