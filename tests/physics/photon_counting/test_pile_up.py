"""Pile-up within an echo, against firings drawn one by one and sums over the shadow."""

import math

import numpy as np
import pytest
from scipy.stats import norm

from lidarscene.physics.photon_counting import matched_filter, pile_up


def test_pile_up_moves_strong_echoes_to_the_front():
    """Against firings drawn one by one: the first of Poisson arrivals, 40,000 SPADs."""
    rng = np.random.default_rng(3)
    for light in (0.2, 2.0, 20.0):
        share = 1 - np.exp(-light)
        # The time of a first arrival: G(t) = -ln(1 - u share) / Lambda.
        times = norm.ppf(-np.log1p(-rng.random(40_000) * share) / light)
        place = times.mean()
        for _ in range(30):
            near = np.exp(-0.5 * ((times - place) / matched_filter.TEMPLATE) ** 2)
            place = np.sum(near * times) / np.sum(near)
        assert float(pile_up.shift(detections=light)) == pytest.approx(place, abs=0.02)


def test_the_shadow_of_an_echo():
    """What the shadow takes off the filter's value, of a background of 20 MHz that it lacks behind the pulse: lambda
    times the template's integral over what lies behind each firing, to first order: 3 % for the exponential.
    """
    rate, sigma, w = 2e7, 1e-9, matched_filter.TEMPLATE
    t = np.linspace(-10.0, 10.0, 4001)
    step = t[1] - t[0]
    fired_share = norm.cdf(t)
    template = matched_filter.SCALE * np.exp(-0.5 * (t / w) ** 2)
    lost_share = rate * sigma * np.sum(fired_share * template) * step
    assert 1.0 - pile_up.shade(rate_hz=rate, sigma_s=sigma) == pytest.approx(lost_share, rel=0.03)
    # The lost background pulls the filter's peak: slope of the loss over the curvature of the echo behind the filter.
    shift = rate * sigma * np.sum(norm.pdf(t) * template) * step * (1.0 + w**2)
    assert pile_up.shadow_s(rate_hz=rate, sigma_s=sigma) == pytest.approx(shift * sigma, rel=1e-3)
    box = pile_up.shade_of_box(rate_hz=rate, sigma_s=sigma, half_width=2.4)
    assert box == pytest.approx(math.exp(-rate * sigma * 2.4))
