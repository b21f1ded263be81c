"""How often band-limited noise rises through a level, counted in sampled noise."""

import numpy as np
import pytest
from helpers.run_seed import chosen
from numpy.typing import NDArray
from scipy.stats import norm

from lidarscene.physics.electronics import tdc

FOUR = 4.0  # standard errors: a false alarm rate of 6e-5 per comparison


def upcrossings(noise: NDArray[np.float64], level: float) -> int:
    return int(np.count_nonzero((noise[1:] >= level) & (noise[:-1] < level)))


@pytest.mark.parametrize("tnr", [1.5, 2.0, 2.5, 3.0])
def test_rice_counts_the_crossings_of_white_noise_behind_an_ideal_low_pass(tnr: float) -> None:
    """Sampled 32 times as often as the bandwidth: then one excursion in 200 is too short to be seen, 1 % is allowed.

    Crossings of so high a level come in no clumps, so that their number is at most a Poisson number's.
    """
    samples, oversampling = 2**20, 32
    spectrum = np.fft.rfft(np.random.default_rng(15).standard_normal(samples))
    spectrum[np.fft.rfftfreq(samples, 1.0 / oversampling) > 1.0] = 0.0
    noise = np.fft.irfft(spectrum, samples)
    noise /= noise.std()
    rate = float(tdc.rice_rate_hz(threshold=tnr, noise=1.0, bandwidth_hz=1.0))
    expected = rate * samples / oversampling
    assert abs(upcrossings(noise, tnr) - expected) < FOUR * np.sqrt(expected) + 0.01 * expected


def test_no_noise_never_crosses() -> None:
    assert float(tdc.rice_rate_hz(threshold=1.0, noise=0.0, bandwidth_hz=1e8)) == 0.0


def test_times_are_rounded_to_the_nearest_step() -> None:
    """Rounding goes to either side, so that the error has no mean; no step leaves them as they are."""
    time_s = np.array([0.0, 1.4, 1.6, 2.49, 2.51]) * 1e-10
    rounded = tdc.quantise(time_s=time_s, least_significant_bit_s=1e-10)
    np.testing.assert_allclose(rounded, np.array([0.0, 1.0, 2.0, 2.0, 3.0]) * 1e-10)
    np.testing.assert_array_equal(tdc.quantise(time_s=time_s, least_significant_bit_s=0.0), time_s)


@pytest.mark.parametrize(("kappa_1", "kappa_2"), [(0.5, 0.0), (0.7, -2e-3), (0.0, -4e-3)])
def test_the_crossing_level_solves_its_equation(kappa_1: float, kappa_2: float) -> None:
    """s + z sigma(s) = U, for cells too, whose noise falls as they fill."""
    deviate = np.linspace(-4.0, 4.0, 33)
    level = tdc.crossing_level(threshold=30.0, noise=4.0, kappa_1=kappa_1, kappa_2=kappa_2, deviate=deviate)
    sigma = np.sqrt(16.0 + kappa_1 * level + kappa_2 * level**2)
    np.testing.assert_allclose(level + deviate * sigma, 30.0, rtol=1e-12)


@pytest.mark.parametrize("kappa_2", [0.01, 0.04, 0.36, 1.2])
def test_noise_that_grows_with_the_signal_detects_as_often_as_its_probability(kappa_2: float) -> None:
    """Rationale: of a laser whose power scatters, kappa_2 = r^2. From r |z| = 1 on noise outgrows the signal, and no
    echo, however strong, trips the comparator. On even quantiles of z, to one of them.
    """
    quantiles = 4001
    deviate = norm.ppf((np.arange(quantiles) + 0.5) / quantiles)
    level = tdc.crossing_level(threshold=30.0, noise=4.0, kappa_1=0.5, kappa_2=kappa_2, deviate=deviate)
    assert (np.diff(level) <= 0.0).all()
    for signal in (10.0, 30.0, 100.0, 1e4):
        sigma = tdc.noise_at_level(level=signal, noise=4.0, kappa_1=0.5, kappa_2=kappa_2)
        probability = tdc.detection_probability(signal=signal, threshold=30.0, noise_at_peak=sigma)
        assert np.mean(signal >= level) == pytest.approx(float(probability), abs=1.0 / quantiles)


@pytest.mark.parametrize(("lag", "close"), [(1.0 / 32.0, 0.01), (4.0 / 32.0, 0.02), (1.5, 0.1)])
def test_noise_changes_as_sampled_noise_does(lag: float, close: float) -> None:
    """White noise behind an ideal low-pass: the deviation of its change over that of independent noise, within the
    tail of its correlation, sinc, that a Gaussian lacks.
    """
    samples = 2**20
    spectrum = np.fft.rfft(np.random.default_rng(16).standard_normal(samples))
    spectrum[np.fft.rfftfreq(samples, 1.0 / 32) > 1.0] = 0.0
    noise = np.fft.irfft(spectrum, samples)
    change = (noise - np.roll(noise, round(lag * 32))).std() / (np.sqrt(2.0) * noise.std())
    assert tdc.noise_change(lag_s=lag, crossing_bandwidth_hz=1.0) == pytest.approx(change, rel=close)


@pytest.mark.parametrize("steepness", chosen(1, [0.5, 1.0, 2.0]))
def test_further_crossings_of_an_edge_by_sampled_noise(steepness: float) -> None:
    """Straight edges in white noise behind an ideal low-pass of 1 Hz: upward crossings beyond the first, counted.

    Of 4,000 edges, whose further crossings come in ones mostly: four standard errors, and 2 % for excursions too short
    to be seen in 32 samples of a period.
    """
    edges, samples, step_s = 4000, 2048, 1.0 / 32.0
    spectrum = np.fft.rfft(np.random.default_rng(5).standard_normal((edges, samples)))
    spectrum[:, np.fft.rfftfreq(samples, step_s) > 1.0] = 0.0
    noise = np.fft.irfft(spectrum, samples)
    noise /= noise.std()
    slope = steepness * 2.0 * np.pi * tdc.MEAN_FREQUENCY_LOW_PASS
    signal = slope * (np.arange(samples) - samples / 2) * step_s + noise
    counted = ((signal[:, 1:] >= 0.0) & (signal[:, :-1] < 0.0)).sum(axis=1) - 1.0
    expected = float(tdc.further_crossings(steepness=np.array(steepness)))
    assert counted.mean() == pytest.approx(expected, rel=0.02, abs=FOUR * counted.std() / np.sqrt(edges))
