"""The statistic by which the scatter of a law is held to what was not fitted."""

import numpy as np
import pytest

from lidarscene.studies.fit.on_scene.checks import OF_ONE, Judged, capped_scatter


def test_the_scatter_of_a_law_that_holds_is_one() -> None:
    """400 sets of 200 normal numbers: mean and deviation to 4 standard errors."""
    random = np.random.default_rng(0)
    found = np.array([capped_scatter(one) for one in random.standard_normal((400, 200))])
    assert np.mean(found) == pytest.approx(1.0, abs=0.012)
    assert np.std(np.log(found)) * np.sqrt(200) == pytest.approx(OF_ONE, rel=0.15)


def test_a_tail_of_other_surfaces_counts_little() -> None:
    """Rationale: one pulse in twenty a hundred sigmas off is left out; four sigmas off, it counts as three."""
    numbers = np.random.default_rng(1).standard_normal(10_000)
    far, off = numbers.copy(), numbers.copy()
    far[::20], off[::20] = 100.0, 4.0
    assert capped_scatter(far) == pytest.approx(1.0, abs=0.02)
    assert 1.1 < capped_scatter(off) < 1.3


def test_a_ratio_is_beyond_its_limit_by_two_of_its_sigmas() -> None:
    def of(ratio: float, sigma: float) -> Judged:
        return Judged(
            signal=np.zeros((0, 3)),
            kept=np.zeros((0, 3)),
            scatter=np.array([[50.0, 1e-2 * ratio, 1e-2, sigma]]),
        )

    assert not of(1.26, 0.05).beyond(1.25)
    assert of(1.45, 0.05).beyond(1.25)
    assert of(0.6, 0.05).beyond(1.25)
    assert not of(0.6, 0.2).beyond(1.25)
