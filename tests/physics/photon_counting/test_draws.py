"""Counts from uniform numbers against the binomial distribution itself."""

import numpy as np
import pytest
from scipy import stats

from lidarscene.physics.photon_counting import draws

UNIFORM = (np.arange(400_000) + 0.5) / 400_000


@pytest.mark.parametrize(
    ("trials", "share"), [(54, 0.01), (864, 0.004), (864, 0.006), (864, 0.1), (54, 0.3), (16, 0.5), (1e5, 0.001)]
)
def test_counts_have_the_binomial_distribution(trials, share):
    """Tolerance: Cornish and Fisher from a mean of 4 on, 2e-3 of probability; term by term below, 2e-5."""
    counts = draws.binomial_count(trials=trials, probability=share, uniform=UNIFORM)
    values = np.arange(int(trials) + 1)
    cumulative = np.cumsum(np.bincount(counts.astype(int), minlength=len(values))) / len(UNIFORM)
    apart = np.abs(cumulative - stats.binom.cdf(values, int(trials), share)).max()
    assert apart < (2e-5 if trials * share < 4 else 2e-3)
    assert counts.mean() == pytest.approx(trials * share, rel=1e-3)
    assert counts.var() == pytest.approx(trials * share * (1 - share), rel=5e-3)


def test_no_trials_no_counts():
    assert not draws.binomial_count(trials=0.0, probability=0.3, uniform=UNIFORM).any()
    assert not draws.binomial_count(trials=50.0, probability=0.0, uniform=UNIFORM).any()


def test_less_than_one_trial_counts_as_often_as_it_should():
    """The mean number of the trials that are left need not be whole: below one, none counts with (1 - p)^N."""
    counts = draws.binomial_count(trials=0.5, probability=0.75, uniform=UNIFORM)
    assert (counts == 0.0).mean() == pytest.approx(0.5, abs=1e-5)


@pytest.mark.parametrize("trials", [1.0, 1.5, 2.0, 2.5, 27.0, 6911.0, 1e6])
def test_counts_known_without_their_terms_are_those_of_the_terms(monkeypatch, trials):
    """Means from 0.01 to 3: where the bounds on the distribution say 0 or 1, so does its inversion, term by term."""
    share = np.geomspace(0.01, 3.0, 40)[:, None] / trials
    share = np.minimum(share, 0.9)
    inverted = draws._small_count(trials, share, UNIFORM[::50])
    monkeypatch.setattr(draws, "_small_count", lambda trials, p, uniform: np.full_like(p * uniform, np.nan))
    counts = draws.binomial_count(trials=trials, probability=share, uniform=UNIFORM[::50])
    known = ~np.isnan(counts)
    np.testing.assert_array_equal(counts[known], inverted[known])
    assert (counts[0] == 1.0).any() == (trials >= 2.0)
