"""The filter over a histogram, against histograms of Poisson counts."""

import numpy as np
import pytest
from helpers.run_seed import chosen

from lidarscene.physics.photon_counting import matched_filter
from lidarscene.physics.reference import photon_counting as reference_photon_counting

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
    unit = matched_filter.background_skewness(variance_share=1.0)
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
    share = matched_filter.false_peak_share(threshold=level, rate_hz=mean, sigma_s=sigma, bin_s=1.0)
    expected = 1e6 * float(share)
    assert abs(counted - expected) < 4 * np.sqrt(expected)


def passages(rng, counts, bin_to_sigma, bins):
    """Sorted values of the filter above its mean before and after each bin in which it rises beyond its mean."""
    side = int(np.ceil(3.0 / bin_to_sigma))
    weights = matched_filter.SCALE * np.exp(-0.5 * (np.arange(-side, side + 1) * bin_to_sigma / W) ** 2)
    mean = counts * bin_to_sigma
    value = np.convolve(rng.poisson(mean, bins).astype(np.float32), weights.astype(np.float32)) - mean * weights.sum()
    before, after = value[:-1], value[1:]
    rises = after > np.maximum(before, 0.0)
    return np.sort(before[rises]), np.sort(after[rises])


@pytest.mark.parametrize("counts", [0.02, 0.1, 0.5])
@pytest.mark.parametrize("bin_to_sigma", chosen(1, [0.3, 0.57, 1.0, 1.45]))
def test_false_peaks_of_few_counts(bin_to_sigma, counts):
    """Rationale: few counts under the template make a lattice of values, which the smooth form exceeds up to 5 times
    and falls short of up to 4 times. Whole histograms, at thresholds of all shares down to 1e-5.

    Tolerance: 5 standard errors, which 12 x 90 thresholds pass by chance 6e-4 of the time; the table's grid moves a
    step of the lattice by 0.08 photons; and 6 %, of the smooth form with 0.5 counts and of rows between which it is
    straight.
    """
    bins = 4_000_000
    before, after = passages(np.random.default_rng(8), counts, bin_to_sigma, bins)
    levels = np.arange(0.2, 9.2, 0.1)
    keys = {"rate_hz": counts, "sigma_s": 1.0, "bin_s": bin_to_sigma}
    expected = bins * np.asarray(matched_filter.false_peak_share(threshold=levels, bin_to_sigma=bin_to_sigma, **keys))
    near = levels + np.array([[-0.08], [-0.04], [0.0], [0.04], [0.08]])
    counted = np.searchsorted(before, near, "right") - np.searchsorted(after, near, "right")
    often = expected > 40.0
    assert often.sum() > 20
    slack = 0.06 * expected + 5.0 * np.sqrt(expected)
    assert (counted.max(axis=0) > expected - slack)[often].all()
    assert (counted.min(axis=0) < expected + slack)[often].all()
    smooth = bins * np.asarray(matched_filter.false_peak_share(threshold=levels, **keys))
    if counts == 0.02:
        off = np.maximum(counted.min(axis=0) / smooth, smooth / np.maximum(counted.max(axis=0), 1))
        assert off[often].max() > 1.7


@pytest.mark.parametrize("counts", [1e-7, 1e-5, 2e-4, 1e-3])
def test_a_single_count_exceeds_any_threshold_below_its_own_height(counts):
    """Computed by hand: each count in the dark is a peak of 1.30 photons. Tolerance: two counts within the template."""
    levels = np.array([1e-3, 0.1, 1.2, 1.4])
    keys = {"rate_hz": counts, "sigma_s": 1.0, "bin_s": 0.8, "bin_to_sigma": 0.8}
    share = np.asarray(matched_filter.false_peak_share(threshold=levels, **keys))
    assert share[:3] == pytest.approx(0.8 * counts, rel=0.01 + 10.0 * counts)
    assert share[3] < 0.8 * counts * max(10.0 * counts, 1e-3)


@pytest.mark.parametrize("counts", [0.02, 3.0, 300.0])
def test_no_share_is_negative_however_far_in_the_tail(counts):
    """Rates of an Ouster were -1.7e-38 Hz beyond 15 deviations."""
    deviations = np.geomspace(1.0, 100.0, 200)
    levels = deviations * np.sqrt(matched_filter.background_variance(rate_hz=counts, sigma_s=1.0))
    share = np.asarray(
        matched_filter.false_peak_share(
            threshold=levels, rate_hz=np.full(200, counts), sigma_s=1.0, bin_s=0.5, variance_share=1.0
        )
    )
    assert share[0] > 0.0
    assert share.min() >= 0.0


@pytest.mark.parametrize(("signal", "rate"), [(2000.0, 0.0), (200.0, 1.0), (60.0, 5.0)])
def test_bound_of_the_precision(signal, rate):
    """The bound is sigma / sqrt(S) in the dark; else by the integral over the pulse. Tolerance: bins of a tenth of the
    width.
    """
    bound = float(reference_photon_counting.bound_s(signal=signal, rate_hz=rate, sigma_s=1.0, bin_s=0.1))
    if rate == 0.0:
        assert bound == pytest.approx(1 / np.sqrt(signal), rel=2e-3)
    t = np.linspace(-6, 6, 4001)
    light = signal * np.exp(-0.5 * t * t) / np.sqrt(2 * np.pi)
    information = np.sum((light * t) ** 2 / np.maximum(light + rate, 1e-30)) * (t[1] - t[0])
    assert bound == pytest.approx(1 / np.sqrt(information), rel=3e-3)


@pytest.mark.parametrize(
    ("bright", "later"), [(0.02, 0.5), (0.1, 1.0), (0.3, 1.5), (0.3, 2.0), (1.0, 1.5), (1.0, 2.0), (1.0, 3.0)]
)
def test_exclusion_has_the_spectrum_of_a_renewal_process(bright, later):
    """Firings of a SPAD have the spectrum Re (1 + phi) / (1 - phi), with phi that of the times between them (D. R. Cox,
    Renewal Theory, 1962). The template's weights over frequency, in units of 1 / reach, are a Gaussian, those of its
    slope have the frequency squared too.

    (T104) leaves out the third of three firings in the template, which is at least two dead times after the first:
    that is ``3 bright^2 exp(-2 later^2)`` at most.
    """
    frequency = (np.arange(20_000) + 0.5) * 6e-4
    between = np.exp(-1j * frequency * later) * bright / (bright + 1j * frequency)
    spectrum, gaussian = ((1.0 + between) / (1.0 - between)).real, np.exp(-0.5 * frequency**2)
    reach_s = 1e-9 * matched_filter.BACKGROUND_REACH
    spad = {"rate_hz": np.array(bright / reach_s), "dead_time_s": np.array(later * reach_s)}
    excluded = matched_filter.excluded(**spad, free=1.0 / (1.0 + bright * later), reach_s=reach_s)
    slope = matched_filter.slope_excluded(**spad, sigma_s=np.array(1e-9))
    third = 3.0 * bright**2 * np.exp(-2.0 * later**2) + 1e-5
    assert excluded == pytest.approx(0.5 * (np.average(spectrum, weights=gaussian) - 1.0), abs=third)
    assert slope == pytest.approx(np.average(spectrum, weights=frequency**2 * gaussian), abs=third)
