"""Timing formulas at their limits: broad tops, and fractions of a peak that shares the noise of its edge."""

import math

import numpy as np
import pytest

from lidarscene.physics.electronics import sampling
from lidarscene.physics.reference import electronics as reference_electronics


def test_a_broad_top_moves_no_farther_than_the_light_falls_by_the_noise():
    """P (1 - kappa u^2 / 2) has fallen by the noise at u = sqrt(2 noise / kappa); a narrow one moves by less."""
    for curvature, expected in ((1e-4, math.sqrt(2.0 * 0.05 / 1e-4)), (1.0, 0.05 * 0.4)):
        deviation = sampling.peak_deviation(noise_share=np.array([0.05]), slope_noise=0.4, curvature=curvature)
        assert deviation[0] == pytest.approx(expected)


def test_a_peak_lower_than_its_noise_moves_no_farther_than_its_pulse():
    """Rationale: a shoulder on a falling edge has next to no height of its own; its time was off by 2e10 m."""
    heights = np.array([1.0, 0.5, 1e-3, 1e-30])
    for slope_noise in (0.3, 1.0):
        deviation = sampling.peak_deviation(noise_share=0.5 / heights, slope_noise=slope_noise, curvature=1.0)
        assert (deviation <= math.sqrt(2.0)).all()
        assert deviation[0] == pytest.approx(min(0.5 * slope_noise, 1.0))


def test_fraction_of_a_peak_by_draws():
    """(T76) of a straight edge: noise at the fraction less the fraction of that of the peak, over the slope; kept whole
    (r = 1) a half of it stays. 2e5 draws, 1e-6 on either side.
    """
    random = np.random.default_rng(7)
    edge = random.normal(size=200_000)
    for correlation in (0.0, 0.6, 1.0):
        peak = correlation * edge + math.sqrt(1.0 - correlation**2) * random.normal(size=edge.size)
        error = (0.02 * edge - 0.5 * 0.03 * peak) / (0.5 * math.sqrt(2.0 * math.log(2.0)))
        deviation = reference_electronics.fraction_deviation(
            fraction=np.array([0.5]), noise_share_at_fraction=0.02, noise_share_at_peak=0.03, correlation=correlation
        )
        assert deviation[0] == pytest.approx(error.std(), rel=4.9 / math.sqrt(2.0 * edge.size))
