"""How often band-limited noise rises through a level, counted in sampled noise."""

import numpy as np
import pytest
from numpy.typing import NDArray

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
