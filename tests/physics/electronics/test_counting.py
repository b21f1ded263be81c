"""Cells that fire and recover, followed one by one: how often their number rises to a level."""

import numpy as np
import numpy.typing as npt
import pytest

from lidarscene.physics.electronics import counting

DEAD_NS = 20.0
PARTS = 400


def rises(*, cells: int, busy_share: float, least: int, time_ns: float) -> npt.NDArray[np.int64]:
    """Events: each cell waits for an exponential time, fires, and is dead for 20 ns. Counted after 200 ns, in each of
    400 equal parts of the time.
    """
    wait_ns = DEAD_NS * (1.0 - busy_share) / busy_share
    turns = int(1.5 * time_ns / (wait_ns + DEAD_NS) + 20.0)
    waits = np.random.default_rng(15).exponential(wait_ns, (cells, turns))
    waits[:, 1:] += DEAD_NS
    fired = np.cumsum(waits, axis=1).ravel()
    when = np.concatenate((fired, fired + DEAD_NS))
    step = np.repeat([1, -1], fired.size)
    order = np.argsort(when)
    when, step = when[order], step[order]
    rising = when[(step == 1) & (np.cumsum(step) == least)]
    return np.histogram(rising, bins=PARTS, range=(200.0, time_ns))[0]


@pytest.mark.parametrize(
    ("cells", "busy_share", "least"), [(400, 0.01, 9), (400, 0.001, 3), (50, 0.3, 21), (50, 0.3, 10)]
)
def test_rises_of_the_number_of_busy_cells(cells: int, busy_share: float, least: int) -> None:
    """Tolerance: 4.5 standard errors, from the scatter between parts of 600 ns. Rises come in clusters within a dead
    time: their number scatters by up to 2.5 times the variance of a Poisson process.
    """
    time_ns = 2.4e5
    rate_hz = counting.upcrossings_hz(
        least=float(least), cells=float(cells), busy_share=busy_share, dead_time_s=1e-9 * DEAD_NS
    )
    expected = float(rate_hz) * 1e-9 * (time_ns - 200.0)
    assert expected > 30.0
    counts = rises(cells=cells, busy_share=busy_share, least=least, time_ns=time_ns)
    assert abs(counts.sum() - expected) < 4.5 * np.sqrt(PARTS) * np.std(counts, ddof=1)


def test_more_cells_than_there_are_are_never_busy() -> None:
    rate = counting.upcrossings_hz(least=51.0, cells=50.0, busy_share=0.3, dead_time_s=1e-8)
    assert float(rate) == 0.0


def test_a_count_without_noise_is_its_mean():
    """Where all cells are dead all the time their firings are a clock: whatever the deviate."""
    deviate = np.linspace(-4.0, 4.0, 9)
    count = counting.poisson_count(mean=np.full(9, 1234.0), uniform=np.full(9, 0.5), deviate=deviate, narrowing=0.0)
    np.testing.assert_array_equal(count, 1234.0)
