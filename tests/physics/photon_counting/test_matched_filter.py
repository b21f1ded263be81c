"""The filter over a histogram, against histograms of Poisson counts."""

import numpy as np
import pytest

from lidarscene.physics.photon_counting import matched_filter

SIGMA = 2.1  # bins of 1 ns
W = matched_filter.TEMPLATE
OFFSETS = np.arange(-10, 11)


def filtered_noise(rng, mean, bins, sigma=SIGMA):
    """F above its mean in a long histogram of even background."""
    counts = rng.poisson(mean, bins).astype(float)
    template = np.exp(-0.5 * (OFFSETS / (W * sigma)) ** 2) * matched_filter.SCALE
    return np.convolve(counts, template, "same") - mean * template.sum()


@pytest.mark.parametrize("mean", [0.3, 2.0])
def test_noise_of_the_background(mean):
    """Variance to 1 %, tail within 4 standard errors, both of 2e6 bins of which one in 13 is independent."""
    noise = filtered_noise(np.random.default_rng(1), mean, 2_000_000)
    variance = matched_filter.background_variance(rate_hz=mean, sigma_s=SIGMA)
    assert noise.var() == pytest.approx(variance, rel=0.01)
    unit = matched_filter.background_skewness(variance=variance, rate_hz=mean, sigma_s=SIGMA)
    for sigmas in (2.0, 3.0):
        excess = sigmas * np.sqrt(variance)
        expected = float(matched_filter.tail(excess=excess, variance=variance, unit=unit))
        assert (noise > excess).mean() == pytest.approx(expected, abs=4 * np.sqrt(expected * 13 / 2e6))


@pytest.mark.parametrize(("mean", "sigma"), [(0.3, SIGMA), (2.0, SIGMA), (20.0, SIGMA), (2.0, 0.8), (20.0, 0.8)])
@pytest.mark.parametrize("sigmas", [3.0, 3.8])
def test_false_peaks_within_four_standard_errors(mean, sigma, sigmas):
    """Passages of the threshold upwards, counted; a Gaussian tail would give a third of them at 0.3 counts a bin. With
    bins of 1.25 sigmas most excursions end within one.
    """
    noise = filtered_noise(np.random.default_rng(7), mean, 1_000_000, sigma)
    variance = matched_filter.background_variance(rate_hz=mean, sigma_s=sigma)
    level = sigmas * np.sqrt(variance)
    counted = int(((noise[1:] > level) & (noise[:-1] <= level)).sum())
    share = matched_filter.false_peak_share(threshold=level, rate_hz=mean, variance=variance, sigma_s=sigma, bin_s=1.0)
    expected = 1e6 * float(share)
    assert abs(counted - expected) < 4 * np.sqrt(expected)


@pytest.mark.parametrize(("signal", "rate"), [(2000.0, 0.0), (200.0, 1.0), (60.0, 5.0)])
def test_bound_of_the_precision(signal, rate):
    """In the dark sigma / sqrt(S); else by the integral over the pulse. Tolerance: bins of a tenth of the width."""
    bound = float(matched_filter.bound_s(signal=signal, rate_hz=rate, sigma_s=1.0, bin_s=0.1))
    if rate == 0.0:
        assert bound == pytest.approx(1 / np.sqrt(signal), rel=2e-3)
    t = np.linspace(-6, 6, 4001)
    light = signal * np.exp(-0.5 * t * t) / np.sqrt(2 * np.pi)
    information = np.sum((light * t) ** 2 / np.maximum(light + rate, 1e-30)) * (t[1] - t[0])
    assert bound == pytest.approx(1 / np.sqrt(information), rel=3e-3)
