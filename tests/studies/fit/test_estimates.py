"""Uncertainties on problems whose answers are known."""

from dataclasses import replace

import numpy as np
import pytest

from lidarscene.studies.fit.estimates import Estimate, Solution, misfit_factor


def solved_line(noise: np.ndarray, blocks: int) -> Solution:
    """A straight line through points with this noise and a sigma of one, block after block."""
    x = np.linspace(-1.0, 1.0, len(noise))
    law = np.column_stack([np.ones_like(x), x])
    value = np.linalg.lstsq(law, 2.0 + 3.0 * x + noise, rcond=None)[0]
    scores_of_points = (2.0 + 3.0 * x + noise - law @ value)[:, None] * law
    scores = scores_of_points.reshape(blocks, -1, 2).sum(axis=1)
    return Solution(value=value, slope=law.T @ law, scores=scores)


def test_both_uncertainties_are_those_of_a_line() -> None:
    """Independent noise: Fisher exactly, the bootstrap within 4 sigma of its own scatter (200 blocks: 5 %)."""
    solved = solved_line(np.random.default_rng(0).standard_normal(4000), 200)
    x = np.linspace(-1.0, 1.0, 4000)
    expected = np.array([4000.0**-0.5, np.sum(x * x) ** -0.5])
    np.testing.assert_allclose(np.sqrt(np.diag(solved.covariance)), expected, rtol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.diag(solved.bootstrap)), expected, rtol=0.25)
    estimate = solved.estimate("offset", "m", lambda p: 2.0 * p[0])
    assert estimate.fisher == pytest.approx(2.0 * expected[0], rel=1e-6)
    assert estimate.sigma == estimate.fisher
    assert replace(estimate, bootstrap=1.5 * estimate.fisher).sigma == 1.5 * estimate.fisher


def test_the_bootstrap_sees_that_a_block_shares_its_noise() -> None:
    """Rationale: 20 points with one noise are one point. Fisher's sigma is then too small by the root of 20."""
    shared = np.repeat(np.random.default_rng(1).standard_normal(200), 20)
    solved = solved_line(shared, 200)
    ratio = np.sqrt(np.diag(solved.bootstrap) / np.diag(solved.covariance))
    np.testing.assert_allclose(ratio, np.sqrt(20.0), rtol=0.25)


def test_an_undetermined_number_is_not_known() -> None:
    slope = np.array([[1.0, 1.0], [1.0, 1.0]])
    solved = Solution(value=np.ones(2), slope=slope, scores=np.ones((3, 2)))
    assert not solved.estimate("a", "", lambda p: float(p[0])).is_known
    one_block = Solution(value=np.ones(2), slope=np.eye(2), scores=np.zeros((1, 2)))
    assert not one_block.estimate("a", "", lambda p: float(p[0])).is_known


def test_what_comes_with_what_is_held_is_added_to_both_uncertainties() -> None:
    """Two blocks of scores s and -s: the unbiased variance of their sum is 4 s^2, which 400 draws have to 5 %."""
    slope = np.array([[2.0, 1.0], [1.0, 2.0]])
    scores = np.array([[0.3, -0.1], [-0.3, 0.1]])
    held_covariance = np.array([[0.5, 0.2], [0.2, 0.4]])
    unwidened = Solution(value=np.ones(2), slope=slope, scores=scores)
    widened = replace(unwidened, held_covariance=held_covariance)
    inverse = np.array([[2.0, -1.0], [-1.0, 2.0]]) / 3.0
    np.testing.assert_allclose(unwidened.covariance, inverse)
    np.testing.assert_allclose(widened.covariance, inverse + held_covariance)
    moved = inverse @ scores[0]
    np.testing.assert_allclose(unwidened.bootstrap, 4.0 * np.outer(moved, moved), rtol=0.25)
    np.testing.assert_allclose(widened.bootstrap - unwidened.bootstrap, held_covariance)
    np.testing.assert_allclose(unwidened.correlation, [[1.0, -0.5], [-0.5, 1.0]])
    first = widened.estimate("first", "", lambda p: p[0])
    assert first.fisher == pytest.approx(np.sqrt(2.0 / 3.0 + 0.5))
    assert first.bootstrap == pytest.approx(np.sqrt(widened.bootstrap[0, 0]))


def test_scores_of_another_variance_make_a_sandwich() -> None:
    """Scores of the variance J at a slope H: the solution's is 1/H J 1/H."""
    solved = Solution(value=np.ones(1), slope=np.array([[4.0]]), scores=np.ones((3, 1)), meat=np.array([[9.0]]))
    assert solved.covariance == pytest.approx(9.0 / 16.0)


@pytest.mark.parametrize(("value", "sigma", "is_known"), [(-2.0, 1.9, True), (-2.0, 2.1, False), (2.0, 2.1, False)])
def test_a_number_is_known_if_its_sigma_is_below_its_size(value: float, sigma: float, is_known: bool) -> None:
    assert Estimate(key="a", value=value, unit="", fisher=sigma, bootstrap=sigma).is_known is is_known


@pytest.mark.parametrize(("ratio", "sigma"), [(1.2, 1.0), (1.4, 1.4), (0.7, 1.0)])
def test_a_bootstrap_that_scatters_a_little_more_is_not_taken(ratio: float, sigma: float) -> None:
    assert Estimate(key="a", value=9.0, unit="", fisher=1.0, bootstrap=ratio).sigma == sigma


@pytest.mark.parametrize(
    ("deviations", "parameters", "factor"),
    [([2.0] * 10, 2, 5.0**0.5), ([-2.0] * 10, 6, 10.0**0.5), ([0.5] * 10, 2, 1.0), ([9.0, 9.0], 2, 1.0), ([], 1, 1.0)],
)
def test_sigmas_grow_by_what_a_law_misses_its_bins(deviations: list[float], parameters: int, factor: float) -> None:
    assert misfit_factor(np.array(deviations), parameters) == pytest.approx(factor)
    solved = Solution(value=np.ones(1), slope=np.eye(1), scores=np.zeros((9, 1)), misfit=factor)
    estimate = solved.estimate("a", "", lambda p: float(p[0]))
    assert (estimate.scatter, estimate.sigma) == (pytest.approx(1.0), pytest.approx(factor))
