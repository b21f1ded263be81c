"""Noise of inertial sensors: the Allan variances of IEEE Std 952, and what data sheets print twice."""

import math

import numpy as np
import pytest
from helpers.run_seed import chosen

from lidarscene.physics import inertial
from lidarscene.physics.reference import surroundings as reference_surroundings


def test_a_body_at_rest_is_pushed_up() -> None:
    """Specific force is what a spring scale shows: g upwards at rest, nothing in free fall."""
    upright = np.eye(3)[None]
    force = inertial.specific_force_m_s2(rotation=upright, acceleration_m_s2=np.zeros((1, 3)))
    np.testing.assert_array_equal(force, [[0.0, 0.0, 9.80665]])
    falling = np.array([[0.0, 0.0, -9.80665]])
    np.testing.assert_array_equal(
        inertial.specific_force_m_s2(rotation=upright, acceleration_m_s2=falling), np.zeros((1, 3))
    )


def test_random_walk_of_a_data_sheet() -> None:
    """Reference: ADIS16470, which prints 0.008 deg/s/sqrt(Hz) and 0.34 deg/sqrt(h): the same noise, twice.

    An angle after one hour is the mean rate over it times the hour. The tolerance is half of their last digit.
    """
    hour_s = 3600.0
    mean_rate_deg_s = float(
        reference_surroundings.allan_deviation(density=0.008, instability=0.0, tau_s=np.array(hour_s))
    )
    assert mean_rate_deg_s * hour_s == pytest.approx(0.34, abs=0.005)


def test_white_noise_of_a_sample() -> None:
    """A sample is the mean over its period: both formulas give its standard deviation."""
    sigma = inertial.white_sigma(density=0.014, rate_hz=200.0)
    assert sigma == pytest.approx(0.014 * math.sqrt(100.0))
    mean = reference_surroundings.allan_deviation(density=0.014, instability=0.0, tau_s=np.array(1.0 / 200.0))
    assert mean == pytest.approx(sigma, rel=1e-12)


def test_flicker_noise_is_flat() -> None:
    """Reference: IEEE Std 952, C.1.3: the flat part of the Allan deviation is sqrt(2 ln 2 / pi) B.

    Ten processes a factor of 4 apart ripple by 2e-4; beyond the longest and below the shortest they fall off.
    """
    tau_s = np.geomspace(20.0, 2e4, 50)
    flat = reference_surroundings.allan_deviation(density=0.0, instability=3.0, tau_s=tau_s)
    np.testing.assert_allclose(flat, 3.0 * math.sqrt(2.0 * math.log(2.0) / math.pi), rtol=0.02)
    assert reference_surroundings.allan_deviation(density=0.0, instability=3.0, tau_s=np.array(0.05)) < 0.7


@pytest.mark.parametrize("tau_s", chosen(1, [0.3, 5.0, 400.0]))
def test_allan_variance_of_the_processes(tau_s: float) -> None:
    """Second road: half the mean square of the difference of two neighbouring means, from the autocovariance.

    Means of n instants: the sum over all pairs is off by 1/n^2 of it at most, here 1e-5.
    """
    count = 1000
    times_s = tau_s * (np.arange(2 * count) + 0.5) / count
    weights = np.repeat([-1.0, 1.0], count) / count
    apart_s = np.abs(times_s[:, None] - times_s)
    variance = 0.0
    for correlation_s in inertial.CORRELATION_TIMES_S:
        covariance = inertial.markov_sigma(instability=2.0) ** 2 * np.exp(-apart_s / correlation_s)
        variance += 0.5 * float(weights @ covariance @ weights)
    expected = reference_surroundings.allan_deviation(density=0.0, instability=2.0, tau_s=np.array(tau_s))
    assert math.sqrt(variance) == pytest.approx(float(expected), rel=1e-4)
