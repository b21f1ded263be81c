"""Gains of rows, under a light that is smooth from row to row."""

from dataclasses import replace

import numpy as np
import pytest

from lidarscene.recordings.sweep import Sweep
from lidarscene.studies.fit.pulses import pulses_of
from lidarscene.studies.fit.rows import fit_rows

ROWS, COLUMNS = 32, 512
GAINS = 0.1 * (-1.0) ** np.arange(ROWS)


def drawn() -> Sweep:
    """A light that rises over the rows and changes over the columns; staggered rows see it at other columns."""
    random = np.random.default_rng(0)
    columns = np.arange(COLUMNS)
    stagger = 4 * (np.arange(ROWS) % 4)
    light = 400.0 * np.exp(np.cumsum(0.1 * random.standard_normal(COLUMNS)))
    seen = np.stack([np.roll(light, -turn) for turn in stagger]) * np.linspace(0.7, 1.4, ROWS)[:, None]
    azimuth = -2.0 * np.pi * (columns + stagger[:, None]) / COLUMNS
    return Sweep(
        range_m=np.full((ROWS, COLUMNS), np.nan), recorded=np.ones((ROWS, COLUMNS), bool),
        direction=np.stack([np.cos(azimuth), np.sin(azimuth), 0.0 * azimuth], axis=-1),
        near_ir=random.poisson(seen * np.exp(GAINS)[:, None]),
    )  # fmt: skip


def test_the_gains_are_found() -> None:
    """A row's sigma is 0.3 % (median of 512 steps, Poisson noise of 5 %); five, and what is smoothed off."""
    found = fit_rows(pulses_of([drawn()]))
    assert found is not None
    inner = slice(4, -4)
    np.testing.assert_allclose(np.log(found.gain)[inner], GAINS[inner], atol=0.025)
    assert 0.001 < found.sigma[0] < 0.01


@pytest.mark.parametrize("follows", [0.0, 1.0])
def test_signal_tells_what_the_gains_are_of(follows: float) -> None:
    """Rationale: a receiver that detects more has more of both, one with a wider field more background alone.

    The exponent's sigma is 0.01: a median of 512 steps of 10 %, over gains of 10 %.
    """
    sweep = drawn()
    random = np.random.default_rng(1)
    light = 400.0 * np.exp(follows * GAINS)[:, None] * np.ones((1, COLUMNS))
    sweep = replace(sweep, range_m=np.full((ROWS, COLUMNS), 10.0), signal=random.poisson(light))
    found = fit_rows(pulses_of([sweep]))
    assert found is not None
    assert found.follows is not None
    assert found.follows[0] == pytest.approx(follows, abs=0.1)
    assert found.key == ("responsivity" if follows else "background_gain")
    assert replace(found, follows=(0.5, 0.1)).key is None


def test_few_columns_tell_nothing() -> None:
    assert fit_rows(pulses_of([drawn()]).part(np.arange(40))) is None
