"""Cells that fire and recover, followed one by one: how often their number rises to a level."""

import numpy as np
import pytest

from lidarscene.physics.electronics import counting

FOUR = 4.0  # standard errors: a false alarm rate of 6e-5 per comparison
DEAD_NS = 20.0


def rises(*, cells: int, busy_share: float, least: int, time_ns: float) -> int:
    """Events: each cell waits for an exponential time, fires, and is dead for 20 ns. Counted after 200 ns."""
    wait_ns = DEAD_NS * (1.0 - busy_share) / busy_share
    turns = int(1.5 * time_ns / (wait_ns + DEAD_NS) + 20.0)
    waits = np.random.default_rng(15).exponential(wait_ns, (cells, turns))
    waits[:, 1:] += DEAD_NS
    fired = np.cumsum(waits, axis=1).ravel()
    when = np.concatenate((fired, fired + DEAD_NS))
    step = np.repeat([1, -1], fired.size)
    order = np.argsort(when)
    when, step = when[order], step[order]
    counted = (step == 1) & (np.cumsum(step) == least) & (when > 200.0) & (when < time_ns)
    return int(np.count_nonzero(counted))


@pytest.mark.parametrize(
    ("cells", "busy_share", "least"), [(400, 0.01, 9), (400, 0.001, 3), (50, 0.3, 21), (50, 0.3, 10)]
)
def test_rises_of_the_number_of_busy_cells(cells: int, busy_share: float, least: int) -> None:
    time_ns = 6e4
    rate_hz = counting.upcrossings_hz(
        least=float(least), cells=float(cells), busy_share=busy_share, dead_time_s=1e-9 * DEAD_NS
    )
    expected = float(rate_hz) * 1e-9 * (time_ns - 200.0)
    assert expected > 30.0
    count = rises(cells=cells, busy_share=busy_share, least=least, time_ns=time_ns)
    assert abs(count - expected) < FOUR * np.sqrt(expected)


def test_more_cells_than_there_are_are_never_busy() -> None:
    rate = counting.upcrossings_hz(least=51.0, cells=50.0, busy_share=0.3, dead_time_s=1e-8)
    assert float(rate) == 0.0


def test_a_count_without_noise_is_its_mean():
    """Where all cells are dead all the time their firings are a clock: whatever the deviate."""
    deviate = np.linspace(-4.0, 4.0, 9)
    count = counting.poisson_count(mean=np.full(9, 1234.0), uniform=np.full(9, 0.5), deviate=deviate, narrowing=0.0)
    np.testing.assert_array_equal(count, 1234.0)
