"""Valleys between bins of a filtered histogram, against Poisson counts filtered by other code."""

import math

import numpy as np
import pytest

from lidarscene.physics.photon_counting import matched_filter, valleys

W = matched_filter.TEMPLATE


@pytest.mark.parametrize(
    ("bin_sigmas", "echoes", "even"),
    [
        (0.4, ((150.0, 0.0), (150.0, 3.6)), 0.0),
        (0.8, ((15.0, 0.0), (150.0, 5.1)), 0.0),
        (0.8, ((50.0, 0.0), (150.0, 4.7)), 20.0),
        (0.4, ((30.0, 0.0), (30.0, 3.0)), 20.0),
        (1.2, ((80.0, 0.0), (80.0, 3.9)), 5.0),
    ],
)
def test_valleys_are_as_many_as_in_counts(bin_sigmas, echoes, even):
    """8,000 histograms of Poisson counts, the sum of all bins between the echoes: 4 standard errors, and 0.03 for
    values that are taken for normal.
    """
    rng, count = np.random.default_rng(3), 8000
    places = np.arange(-20.0, 25.0, bin_sigmas)
    density = sum(s * np.exp(-0.5 * (places - c) ** 2) / math.sqrt(2.0 * math.pi) for s, c in echoes)
    counts = rng.poisson((density + even) * bin_sigmas, (count, len(places)))
    template = matched_filter.SCALE * np.exp(-0.5 * (np.arange(-14, 15) * bin_sigmas / W) ** 2)
    values = np.lib.stride_tricks.sliding_window_view(counts, len(template), axis=1) @ template
    middle = places[14:-14]
    between = (middle > 0.0) & (middle < echoes[1][1])
    valley = (values[:, :-2] > values[:, 1:-1]) & (values[:, 1:-1] <= values[:, 2:])
    simulated = valley[:, between[1:-1]].sum() / count

    def mean(place):
        unit = place / matched_filter.OUTPUT_WIDTH
        return sum(s * np.exp(-0.5 * (unit - c / matched_filter.OUTPUT_WIDTH) ** 2) for s, c in echoes)

    def variance(place):
        off = [(place - c) / (matched_filter.OUTPUT_WIDTH * valleys.SIGNAL_WIDTH) for _, c in echoes]
        own = sum(s * np.exp(-0.5 * x * x) for (s, _), x in zip(echoes, off, strict=True))
        return matched_filter.background_variance(rate_hz=even, sigma_s=1.0) + valleys.SIGNAL_HEIGHT * own

    at = middle[between]
    share = valleys.probability(
        means=tuple(mean(at + k * bin_sigmas) for k in (-1, 0, 1)),
        variances=tuple(variance(at + k * bin_sigmas) for k in (-1.0, -0.5, 0.0, 0.5, 1.0)),
        bin_sigmas=bin_sigmas,
    )
    assert 0.02 < simulated < 0.98
    assert share.sum() == pytest.approx(simulated, abs=4.0 * math.sqrt(0.25 / count) + 0.03)


def test_even_light_and_echoes_have_the_variance_of_the_filter():
    """Sums of the squared template over a fine grid, to 1e-6."""
    step = 0.01
    offset = np.arange(-12.0, 12.0, step)
    template = matched_filter.SCALE * np.exp(-0.5 * (offset / W) ** 2)
    assert template.sum() * step == pytest.approx(matched_filter.SCALE * valleys.TEMPLATE_AREA, rel=1e-6)
    assert (template**2).sum() / template.sum() == pytest.approx(valleys.EVEN_HEIGHT, rel=1e-6)
    for place in (0.0, 1.7):
        echo = np.exp(-0.5 * (offset - place) ** 2) / math.sqrt(2.0 * math.pi)
        own = (template**2 * echo).sum() * step
        off = place / (matched_filter.OUTPUT_WIDTH * valleys.SIGNAL_WIDTH)
        assert own == pytest.approx(valleys.SIGNAL_HEIGHT * math.exp(-0.5 * off * off), rel=1e-6)
