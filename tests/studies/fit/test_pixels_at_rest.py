"""Strengths that are few whole steps, on surfaces whose strengths are known."""

import numpy as np
import pytest

from lidarscene.studies.fit.pixels_at_rest import step_of, unrounded

COS = np.linspace(0.05, 0.5, 2000)


def test_steps_tell_what_few_whole_numbers_are() -> None:
    """Laws through 1 to 7 steps: the error at both ends and in the middle is what is told, or somewhat less.

    The rms of 100 draws scatters by 7 %. The law may be no power of the cosine, which these are, so that they are known
    better than is told. Rationale: without the places of the steps dark ground was 10 to 14 % off, two of its sigmas.
    """
    rng, off = np.random.default_rng(), []
    for _ in range(100):
        truth = rng.uniform(9.0, 15.0) * COS ** rng.uniform(0.7, 1.3)
        read = np.mean(np.rint(truth * (1.0 + 0.03 * rng.normal(size=(4, len(COS))))), axis=0)
        smooth, error = unrounded(read, COS)
        off.append(((smooth / truth - 1.0) / error)[[0, len(COS) // 2, len(COS) - 400]])
    assert 0.3 < np.sqrt(np.mean(np.square(off))) < 1.15


def test_readings_that_are_all_the_same_keep_their_error() -> None:
    """What reads 1 all over, seen at one angle, may have half the light, or half as much again.

    Of 300 seeds of the importance sampling the law is off by 0.37 at most, and the error is 0.91 to 1.58 of a step's.
    """
    smooth, error = unrounded(np.ones(500), np.full(500, 0.2))
    np.testing.assert_allclose(smooth, 1.0, atol=0.5)
    np.testing.assert_allclose(error, 12.0**-0.5, rtol=0.8)


def test_another_material_keeps_what_was_read() -> None:
    """Every tenth pixel reads three more than the law, and strong ones are none of its business."""
    truth = 12.0 * COS
    other, strong = np.arange(len(COS)) % 10 == 0, COS > 0.4
    read = np.rint(truth) + 3.0 * other + 100.0 * strong
    smooth, error = unrounded(read, COS)
    np.testing.assert_array_equal(smooth[other | strong], read[other | strong])
    np.testing.assert_allclose((error * read)[other | strong], 12.0**-0.5)
    rest = ~other & ~strong
    assert np.sqrt(np.mean(np.square((smooth / truth - 1.0)[rest]))) < 0.05


@pytest.mark.parametrize(("read", "step"), [([1.0, 2.0, 5.0], 1.0), ([0.25, 0.75, np.nan], 0.5), ([3.0, 3.0], 3.0)])
def test_the_step_is_the_least_difference(read: list[float], step: float) -> None:
    """Some formats have fractions of one; of one reading alone the step is that."""
    assert step_of(np.array(read)) == step
