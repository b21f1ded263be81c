"""The solver of laws of bins, on laws whose minima are known."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from lidarscene.maths.arrays import Numbers
from lidarscene.studies.fit.binned_fit import Prior, Statistics, _Solver, solve
from lidarscene.studies.fit.estimates import Solution

SEEDS = range(20)
BINS = 30
WIDE = np.array([[-9.0] * 2, [9.0] * 2])


def recorded_as(values: Numbers, sigma: float = 0.1) -> Statistics:
    """Bins with these means, each of two pixels in blocks of their own; ``sigma`` over root 2 of the mean."""
    return Statistics.of(list(values[:, None] + [-sigma, sigma]), [np.arange(2)] * len(values), np.arange(2))


def line(place: Numbers) -> Numbers:
    """(k,) values of a line with this offset and slope."""
    return place[0] + place[1] * np.linspace(0.0, 1.0, BINS)


def two_valleys(far: float) -> Callable[[Numbers], Numbers]:
    """Law of one number whose half is the same at 1 and at -1; the other half differs by 2 ``far``."""
    return lambda place: np.repeat([place[0] ** 2 - 1.0, far * place[0]], BINS // 2)


def solved_valleys(far: float, sigma: float, start: float = -1.2, along: int | None = 0) -> Solution:
    """Solution of `two_valleys` and of an offset that half of further bins have, with the truth at 1 and 0."""
    law = two_valleys(far)

    def both(place: Numbers) -> Numbers:
        return np.append(law(place), place[1] + np.zeros(BINS))

    bounds = np.array([[-3.0, -9.0], [3.0, 9.0]])
    return solve(recorded_as(both(np.array([1.0, 0.0])), sigma), both, np.array([start, 0.5]), bounds, along=along)


def test_shares_weigh_by_their_law() -> None:
    """Thirty bins that lose two pulses each of 500; of means of 20 draws one in 700 is beyond 3.2 sigma over root 20.

    Rationale: by the recorded share a bin that lost fewer by chance weighed more, and the chatter came out 3 % low.
    """
    rng, lost = np.random.default_rng(), 0.004
    far = []
    for _ in SEEDS:
        kept = 1.0 - rng.binomial(500, lost, BINS) / 500
        recorded = replace(recorded_as(kept, 0.0), sigma=np.zeros(BINS), trials=np.full(BINS, 500.0))
        law, bounds = lambda logs: np.repeat(1.0 - np.exp(logs), BINS), np.log([[1e-5], [0.5]])
        solved = solve(recorded, law, np.log([0.01]), bounds)
        far.append((solved.value[0] - np.log(lost)) * np.sqrt(solved.slope[0, 0]))
    assert abs(np.mean(far)) < 3.2 / np.sqrt(len(far))


def test_a_law_is_asked_once_at_each_place() -> None:
    """Rationale: half of the time of a fit went to places that the solver had been at."""
    places: list[tuple[float, ...]] = []

    def told(asked: Numbers) -> Numbers:
        places.append(tuple(asked.tolist()))
        return line(asked)

    solved = solve(recorded_as(line(np.array([0.2, 0.7]))), told, np.zeros(2), WIDE)
    np.testing.assert_allclose(solved.value, [0.2, 0.7], atol=1e-6)
    assert len(set(places)) == len(places) == solved.evaluations


def test_the_interval_of_a_line_is_that_of_least_squares() -> None:
    """Bins of one sigma: (A^T A)^-1 sigma^2; and what is expected of a number counts as one bin more."""
    recorded = recorded_as(line(np.array([0.2, 0.7])))
    terms = np.stack([np.ones(BINS), np.linspace(0.0, 1.0, BINS)], axis=1)
    information = terms.T @ terms / recorded.sigma[0] ** 2
    solved = solve(recorded, line, np.zeros(2), WIDE)
    np.testing.assert_allclose(solved.slope, information, rtol=1e-6)
    prior = Prior(np.array([0.0, 3.0]), np.array([np.inf, 0.2]))
    expected = solve(recorded, line, np.zeros(2), WIDE, prior=prior)
    information[1, 1] += 0.2**-2
    np.testing.assert_allclose(expected.slope, information, rtol=1e-6)
    pull = np.linalg.solve(information, [0.0, (3.0 - 0.7) / 0.2**2])
    np.testing.assert_allclose(expected.value, np.array([0.2, 0.7]) + pull, rtol=1e-3)


def test_a_misfit_of_the_law_is_found_in_the_bins() -> None:
    """Bins scatter by 0.3 about the line beyond their own 0.07, which makes the interval of its offset so wide.

    The variance by medians of 30 bins scatters by 40 %, so the median of 20 draws by 11 %, and lies some 15 % low.

    Rationale: a misfit that was assumed, of 0.1, made the intervals of both jitters twice as wide as their scatter.
    """
    ratios = []
    for _ in SEEDS:
        values = line(np.array([0.2, 0.7])) + np.random.default_rng().normal(0.0, 0.3, BINS)
        alone = solve(recorded_as(values), line, np.zeros(2), WIDE)
        ratios.append(alone.slope[0, 0] / (BINS / (0.3**2 + 0.1**2 / 2.0)))
    assert 0.7 < np.median(ratios) < 2.0


def test_no_minimum_is_missed_along_a_number() -> None:
    """The deeper of two is found from the valley of the other, and only that counts.

    Rationale: of nine starts three ended 16 sigma off, and units of 3 times the light were told as 0.7 +/- 0.1.
    """
    assert solved_valleys(0.2, 0.5, along=None).value[0] < 0.0
    solved = solved_valleys(0.2, 0.5)
    np.testing.assert_allclose(solved.value, [1.0, 0.0], atol=0.01)
    alone = solved_valleys(0.2, 0.5, start=1.2, along=None)
    np.testing.assert_allclose(solved.covariance, alone.covariance, rtol=0.2, atol=1e-6)
    assert not solved.at_limit


def test_the_interval_is_that_of_the_likelihood() -> None:
    """Two minima at -1 and 1 that are as likely: the mean square is 1, and each counts once, to a sum of few values."""
    solved = solved_valleys(1e-6, 0.5)
    assert solved.value[0] == pytest.approx(0.0, abs=0.4)
    assert solved.covariance[0, 0] + solved.value[0] ** 2 == pytest.approx(1.0, rel=0.15)


@pytest.mark.parametrize("start", [-2.0, 0.3, 2.5])
def test_the_interval_between_two_steps_is_that_of_an_even_distribution(start: float) -> None:
    """Half of the bins jump by many sigmas at -0.3 and at 0.5 of a number that nothing else tells.

    Rationale: a light beside a step of the scatter, where strong returns get a channel of their own, was told as
    1.38 +/- 0.08 for 2.02.
    """

    def stepped(place: Numbers) -> Numbers:
        steps = np.tanh((place[0] + 0.3) / 0.01) + np.tanh((place[0] - 0.5) / 0.01)
        return np.append(line(place[1:]), steps + np.zeros(BINS))

    recorded, bounds = recorded_as(stepped(np.array([0.1, 0.2, 0.7]))), np.array([[-3.0, -9.0, -9.0], [3.0, 9.0, 9.0]])
    solved = solve(recorded, stepped, np.array([start, 0.0, 0.0]), bounds, along=0)
    assert solved.value[0] == pytest.approx(0.1, abs=0.05)
    assert np.sqrt(solved.covariance[0, 0]) == pytest.approx(0.8 / np.sqrt(12.0), rel=0.15)
    np.testing.assert_allclose(solved.value[1:], [0.2, 0.7], atol=1e-3)


def test_a_number_that_lost_its_slope_comes_back() -> None:
    """A loss exp(-1 / x^2) has no slope at a small x, to which bins lead that do not depend on it alone.

    Rationale: fits that had begun with too little light ended at no chatter, with the beam at half.
    """

    def law(place: Numbers) -> Numbers:
        loss = np.exp(-np.exp(-2.0 * place[1]) + 1.0)
        return np.append(place[0] + np.zeros(BINS), np.exp(place[0]) * loss + np.zeros(BINS))

    truth, bounds = np.array([1.0, 0.0]), np.array([[-6.0, -4.0], [6.0, 4.0]])
    solver = _Solver(recorded_as(law(truth)), law, np.array([1.0, 0.2]), bounds, Prior(truth, np.full(2, np.inf)))
    end = solver.descend(np.array([1.0, -2.0]), np.full(2 * BINS, 10.0), np.ones(2, bool))
    np.testing.assert_allclose(end.place, truth, atol=1e-2)
