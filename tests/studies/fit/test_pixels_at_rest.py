"""Strengths that are few whole steps, on surfaces whose strengths are known."""

import numpy as np
import pytest

from lidarscene.studies.fit.pixels_at_rest import step_of, unrounded

COS = np.linspace(0.05, 0.5, 2000)


def test_roundings_of_many_steps_compensate_each_other() -> None:
    """Lines through 4 to 7 steps: the error at both ends and in the middle is what is told, by (T185a).

    The rms of 200 draws scatters by 5 %. It is 0.7 of what is told, since ends are worse than the middle, and the
    exponent is more certain than the slope of a line.
    """
    rng, off = np.random.default_rng(), []
    for _ in range(200):
        truth = rng.uniform(10.0, 15.0) * COS
        factor, error = unrounded(np.rint(truth), COS)
        off.append(((factor * np.rint(truth) / truth - 1.0) / error)[[0, len(COS) // 2, -1]])
    assert 0.5 < np.sqrt(np.mean(np.square(off))) < 1.0


def test_readings_that_are_all_the_same_keep_their_error() -> None:
    """What reads 1 all over may have half the light, or half as much again: 1 / sqrt(12)."""
    factor, error = unrounded(np.ones(500), COS[:500])
    np.testing.assert_allclose(factor, 1.0)
    np.testing.assert_allclose(error, 12.0**-0.5)


def test_another_material_keeps_what_was_read() -> None:
    """Every tenth pixel reads three more than the law, and strong ones are none of its business."""
    truth = 12.0 * COS
    other, strong = np.arange(len(COS)) % 10 == 0, COS > 0.4
    read = np.rint(truth) + 3.0 * other + 100.0 * strong
    factor, error = unrounded(read, COS)
    np.testing.assert_array_equal(factor[other | strong], 1.0)
    np.testing.assert_allclose((error * read)[other | strong], 12.0**-0.5)
    rest = ~other & ~strong
    assert np.sqrt(np.mean(np.square((factor * read / truth - 1.0)[rest]))) < 0.15


@pytest.mark.parametrize(("read", "step"), [([1.0, 2.0, 5.0], 1.0), ([0.25, 0.75, np.nan], 0.5), ([3.0, 3.0], 3.0)])
def test_the_step_is_the_least_difference(read: list[float], step: float) -> None:
    """Some formats have fractions of one; of one reading alone the step is that."""
    assert step_of(np.array(read)) == step
