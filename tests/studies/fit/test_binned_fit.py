"""The solver of laws of bins, on laws whose minima are known."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from lidarscene.maths.arrays import Numbers
from lidarscene.studies.fit.binned_fit import Prior, Statistics, solve
from lidarscene.studies.fit.estimates import Solution

SEEDS = range(20)
BINS = 30
WIDE = np.array([[-9.0] * 2, [9.0] * 2])


def recorded_as(values: Numbers, sigma: float = 0.1) -> Statistics:
    """Bins with these means, each of two pixels in blocks of their own; ``sigma`` over root 2 of the mean."""
    return Statistics.of(list(values[:, None] + [-sigma, sigma]), [np.arange(2)] * len(values), np.arange(2))


def line(places: Numbers) -> Numbers:
    """(m, k) values of lines with (m, 2) offsets and slopes."""
    return places[:, :1] + places[:, 1:] * np.linspace(0.0, 1.0, BINS)


def two_valleys(far: float) -> Callable[[Numbers], Numbers]:
    """Law of one number whose half is the same at 1 and at -1; the other half differs by 2 ``far``."""
    return lambda logs: np.repeat(np.stack([logs[:, 0] ** 2 - 1.0, far * logs[:, 0]], axis=1), BINS // 2, axis=1)


def solved_valleys(far: float, starts: list[float], missed: float = 0.0, sigma: float = 0.5) -> Solution:
    """Solution of `two_valleys` with the truth at 1, of bins that are off by ``missed`` in turn."""
    law, off = two_valleys(far), missed * np.where(np.arange(BINS) % 2, 1.0, -1.0)
    recorded, bounds = recorded_as(law(np.ones((1, 1)))[0] + off, sigma), np.array([[-3.0], [3.0]])
    return solve(recorded, law, np.array(starts)[:, None], bounds, step=0.1)


def test_shares_weigh_by_their_law() -> None:
    """Thirty bins that lose two pulses each of 500; of means of 20 draws one in 700 is beyond 3.2 sigma over root 20.

    Rationale: by the recorded share a bin that lost fewer by chance weighed more, and the chatter came out 3 % low.
    """
    rng, lost = np.random.default_rng(), 0.004
    far = []
    for _ in SEEDS:
        kept = 1.0 - rng.binomial(500, lost, BINS) / 500
        recorded = replace(recorded_as(kept, 0.0), sigma=np.zeros(BINS), trials=np.full(BINS, 500.0))
        law, bounds = lambda logs: np.repeat(1.0 - np.exp(logs), BINS, axis=1), np.log([[1e-5], [0.5]])
        solved = solve(recorded, law, np.log([0.01]), bounds, step=0.1)
        far.append((solved.value[0] - np.log(lost)) * np.sqrt(solved.slope[0, 0]))
    assert abs(np.mean(far)) < 3.2 / np.sqrt(len(far))


def test_a_law_is_asked_once_at_each_place() -> None:
    """Rationale: half of the time of a fit went to places that the solver had been at."""
    places: list[tuple[float, ...]] = []

    def told(asked: Numbers) -> Numbers:
        places.extend(map(tuple, asked.tolist()))
        return line(asked)

    solved = solve(recorded_as(line(np.array([[0.2, 0.7]]))[0]), told, np.zeros(2), WIDE, step=0.1)
    np.testing.assert_allclose(solved.value, [0.2, 0.7], atol=1e-6)
    assert len(set(places)) == len(places) == solved.evaluations


def test_the_interval_of_a_line_is_that_of_least_squares() -> None:
    """Bins of one sigma: (A^T A)^-1 sigma^2; and what is expected of a number counts as one bin more."""
    recorded = recorded_as(line(np.array([[0.2, 0.7]]))[0])
    terms = np.stack([np.ones(BINS), np.linspace(0.0, 1.0, BINS)], axis=1)
    information = terms.T @ terms / recorded.sigma[0] ** 2
    solved = solve(recorded, line, np.zeros(2), WIDE, step=0.1)
    np.testing.assert_allclose(solved.slope, information, rtol=1e-6)
    prior = Prior(np.array([0.0, 3.0]), np.array([np.inf, 0.2]))
    expected = solve(recorded, line, np.zeros(2), WIDE, step=0.1, prior=prior)
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
        values = line(np.array([[0.2, 0.7]]))[0] + np.random.default_rng().normal(0.0, 0.3, BINS)
        alone = solve(recorded_as(values), line, np.zeros(2), WIDE, step=0.1)
        ratios.append(alone.slope[0, 0] / (BINS / (0.3**2 + 0.1**2 / 2.0)))
    assert 0.7 < np.median(ratios) < 2.0


def test_the_roughness_of_a_law_is_no_information() -> None:
    """A weak slope that a law of few draws hides in waves: the interval is that of the smooth law, to 30 %.

    Rationale: slopes between places 0.1 apart were the noise of simulated boards, and a beam of 10.05 +- 0.65 mrad was
    told for one of 6, though light and beam together left it open.
    """
    phases = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, BINS)
    shares = np.array([1.0, 0.1])

    def rough(places: Numbers) -> Numbers:
        return line(places * shares) + 0.01 * np.cos(5.0 * np.pi * places[:, 1:] + phases)

    truth = np.array([0.2, 0.7])
    recorded = recorded_as(rough(truth[None])[0])
    found = solve(recorded, rough, truth, WIDE, step=0.1)
    smooth = solve(
        recorded_as(line(truth[None] * shares)[0]), lambda places: line(places * shares), truth, WIDE, step=0.1
    )
    sigmas = [np.sqrt(solution.covariance[1, 1]) for solution in (found, smooth)]
    assert sigmas[0] == pytest.approx(sigmas[1], rel=0.3)


def test_a_step_beside_the_solution_is_no_information() -> None:
    """A bin that jumps by ten sigmas at once below the truth: the interval is that of the law above, to 30 %.

    Rationale: a light at a step of the scatter, where the strong returns' channel begins, was 8 sigma off.
    """
    truth = np.array([0.2, 0.7])
    recorded = recorded_as(line(truth[None])[0])

    def stepped(places: Numbers) -> Numbers:
        below = places[:, 1:] < truth[1] - 0.01
        return line(places) + 10.0 * recorded.sigma * below * (np.arange(BINS) == 3)

    found = solve(recorded, stepped, truth, WIDE, step=0.1)
    np.testing.assert_allclose(found.value, truth, atol=0.02)
    np.testing.assert_allclose(found.covariance, solve(recorded, line, truth, WIDE, step=0.1).covariance, rtol=0.3)


def test_of_several_starts_the_best_counts() -> None:
    """The deeper of two minima is found; rationale: units of 3 times the light were told as 0.7 +/- 0.1."""
    assert solved_valleys(0.2, [-1.2]).value[0] < 0.0
    solved = solved_valleys(0.2, [-1.2, 1.2])
    assert solved.value[0] == pytest.approx(1.0, abs=1e-3)
    assert not solved.at_limit
    assert solved.held_covariance == pytest.approx(0.0)


@pytest.mark.parametrize(("starts", "variance"), [([1.2, -1.2, -0.8], 2.0), ([1.2, 1.4, 1.3], 0.0)])
def test_another_minimum_as_good_widens_the_interval_once(starts: list[float], variance: float) -> None:
    """One at -1, as likely as that at 1, of a law that misses its bins: half of the square of the distance.

    Starts that end in one minimum add nothing. Rationale: each start added its own distance.
    """
    solved = solved_valleys(1e-4, starts, missed=0.05)
    assert solved.held_covariance == pytest.approx(variance, rel=0.02, abs=1e-6)


def test_ways_that_lead_far_off_are_not_followed() -> None:
    """One place more is asked, 700 sigmas from the bins; rationale: of 30 CPU s of a fit 20 went to such starts."""
    alone = solved_valleys(0.2, [1.2], sigma=0.01)
    assert solved_valleys(0.2, [1.2, 3.2], sigma=0.01).evaluations == alone.evaluations + 1
    assert solved_valleys(0.2, [1.2, -1.2]).evaluations > solved_valleys(0.2, [1.2]).evaluations + 1
