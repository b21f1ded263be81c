"""Ambient counts: SciPy's Poisson distribution, counters with dead time shot by shot, and the rates by hand."""

import numpy as np
import pytest
from helpers import chain
from helpers.table_1 import DCR, DEAD, HNU, IDB, P_RS, PDE, QE, N
from scipy.constants import e
from scipy.stats import f, norm, poisson

from lidarscene.detection import ambient
from lidarscene.physics.electronics import counting

DRAWS = 400_000
WINDOW_S = 4e-6


@pytest.mark.parametrize("mean", [0.01, 0.7, 3.0, 9.99, 10.01, 20.0, 100.0, 5e4])
def test_poisson(mean):
    """Tolerance: Kolmogorov's at one in 1000, and 1e-3 for the Cornish-Fisher steps (1.4e-3 right above 10)."""
    rng = np.random.default_rng(9)
    drawn = counting.poisson_count(
        mean=np.full(DRAWS, mean), uniform=1.0 - rng.random(DRAWS), deviate=rng.normal(size=DRAWS), narrowing=1.0
    )
    assert (drawn >= 0.0).all()
    assert (drawn == np.rint(drawn)).all()
    values, numbers = np.unique(drawn, return_counts=True)
    steps = np.abs(np.cumsum(numbers) / DRAWS - poisson.cdf(values, mean))
    assert steps.max() < 1.95 / np.sqrt(DRAWS) + 1.5e-3
    assert drawn.mean() == pytest.approx(mean, abs=4.5 * np.sqrt(mean / DRAWS), rel=2e-4)


def count_ambient(name, power_w, seed=3, *overrides):
    sensor = chain.sensor(name, *overrides)
    pulse = np.arange(20_000, dtype=np.uint32)
    return ambient.counts(np.full(pulse.shape, power_w), sensor, seed=seed, pulse=pulse)


def test_apd_counts_electrons():
    """Reference: eta P T / (h nu) and i_db T / e, at Table 1. Four standard errors."""
    expected = WINDOW_S * (QE * P_RS / HNU + IDB / e)
    drawn = count_ambient("table1-apd", P_RS)
    assert abs(drawn.mean() - expected) < 4.0 * np.sqrt(expected / len(drawn))
    assert drawn.var() == pytest.approx(expected, rel=0.05)  # 1 % is a standard error of it


def test_sipm_counts_firings():
    """Reference: cells that are dead for tau after each firing, exponential waits, drawn one by one in numpy."""
    rate = P_RS * PDE / HNU / N + DCR
    rng = np.random.default_rng(8)
    times = np.cumsum(rng.exponential(1.0 / rate, size=(4000, 600)) + DEAD, axis=1)
    assert (times[:, -1] > 2.0 * WINDOW_S).all()
    per_cell = np.sum((times > WINDOW_S) & (times <= 2.0 * WINDOW_S), axis=1)  # after it has settled
    drawn = count_ambient("table1-sipm", P_RS)
    assert drawn.mean() == pytest.approx(N * per_cell.mean(), rel=4e-3)  # 0.05 % of it is statistics
    assert drawn.var() == pytest.approx(N * per_cell.var(), rel=0.12)  # 4000 cells: 2.2 % each side


def test_cells_that_fire_others_are_counted_in_clusters():
    """Reference: cells in small steps, each avalanche trying one other cell at once, which fires if it is ready. An F
    test at 1e-6 of 1000 windows of sixty dead times, of which steps and ends leave 4 %.
    """
    steps, shots, window = 50, 1000, 60
    rng, cells, crosstalk = np.random.default_rng(6), round(N), 0.45
    rate = -np.expm1(-(P_RS * PDE / HNU / N + DCR) * DEAD / steps)
    fired, busy, total = np.zeros((steps, shots), int), np.zeros(shots, int), np.zeros(shots, int)
    for k in range((window + 6) * steps):
        busy = busy - fired[k % steps]
        new = rng.binomial(cells - busy, rate)
        cluster = np.zeros(shots, int)
        while new.any():
            cluster, busy = cluster + new, busy + new
            new = np.minimum(rng.binomial(new, crosstalk * (cells - busy) / cells), cells - busy)
        fired[k % steps] = cluster
        total += cluster if k >= 6 * steps else 0
    more = f"detector.crosstalk={crosstalk}", f"tdc.window_us={1e6 * window * DEAD!r}"
    drawn = count_ambient("table1-sipm", P_RS, 3, "detector.statistics='steady_state'", *more)
    assert drawn.mean() == pytest.approx(total.mean(), rel=0.02)  # a step of a fiftieth of the dead time
    ratio = drawn.var() / total.var()
    assert 1.0 / f.isf(1e-6, shots - 1, len(drawn) - 1) < ratio * 1.04
    assert ratio / 1.04 < f.isf(1e-6, len(drawn) - 1, shots - 1)


def test_window():
    """Half of the time, half of the counts; the listening window by default."""
    whole = count_ambient("table1-apd", P_RS).mean()
    assert count_ambient("table1-apd", P_RS, 3, "tdc.window_us=2").mean() == pytest.approx(whole / 2, rel=1e-3)


def test_counts_belong_to_the_pulse():
    """Another seed, other numbers; independent of each other (correlation below 4.5 / sqrt n)."""
    first, repeated, other_seed = (count_ambient("table1-apd", P_RS, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, repeated)
    assert abs(np.corrcoef(first, other_seed)[0, 1]) < norm.isf(3e-6) / np.sqrt(len(first))
