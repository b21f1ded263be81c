"""Gains of rows, under a light that is smooth from row to row."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.premises import premise

from lidarscene.maths.arrays import Numbers
from lidarscene.recordings.sweep import Sweep
from lidarscene.studies.fit.recorded_pulses import RecordedPulses, gather_pulses
from lidarscene.studies.fit.row_gains import RowGains, fit_rows

ROWS, COLUMNS = 32, 512
GAINS = 0.1 * (-1.0) ** np.arange(ROWS)


def draw_sweep() -> Sweep:
    """A light that rises over the rows and changes over the columns; staggered rows see it at other columns."""
    random = np.random.default_rng(0)
    columns = np.arange(COLUMNS)
    stagger = 4 * (np.arange(ROWS) % 4)
    light = 400.0 * np.exp(np.cumsum(0.1 * premise(1).standard_normal(COLUMNS)))
    mean_counts = np.stack([np.roll(light, -turn) for turn in stagger]) * np.linspace(0.7, 1.4, ROWS)[:, None]
    azimuth = -2.0 * np.pi * (columns + stagger[:, None]) / COLUMNS
    return Sweep(
        range_m=np.full((ROWS, COLUMNS), np.nan),
        recorded=np.ones((ROWS, COLUMNS), bool),
        direction=np.stack([np.cos(azimuth), np.sin(azimuth), 0.0 * azimuth], axis=-1),
        near_ir=random.poisson(mean_counts * np.exp(GAINS)[:, None]),
    )


def test_the_gains_are_found() -> None:
    """The step to the next row is good to 0.6 % (median of 512, Poisson noise of 8 %); steps add up over the four rows
    that are smoothed to each side, to 1.1 %. Five of that.
    """
    row_gains = fit_rows(gather_pulses([draw_sweep()]))
    assert row_gains is not None
    inner = slice(4, -4)
    np.testing.assert_allclose(np.log(row_gains.gain)[inner], GAINS[inner], atol=0.055)
    assert 0.001 < row_gains.sigma[0] < 0.01
    assert np.mean(np.log(row_gains.gain)) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("follows", [0.0, 1.0])
def test_signal_tells_what_the_gains_are_of(follows: float) -> None:
    """Rationale: a receiver that detects more has more of both, one with a wider field more background alone.

    The exponent's sigma is 0.01: a median of 512 steps of 10 %, over gains of 10 %.
    """
    sweep = draw_sweep()
    random = np.random.default_rng(1)
    light = 400.0 * np.exp(follows * GAINS)[:, None] * np.ones((1, COLUMNS))
    sweep = replace(sweep, range_m=np.full((ROWS, COLUMNS), 10.0), signal=random.poisson(light))
    row_gains = fit_rows(gather_pulses([sweep]))
    assert row_gains is not None
    assert row_gains.follows is not None
    assert row_gains.follows[0] == pytest.approx(follows, abs=0.1)
    assert row_gains.key == ("responsivity" if follows else "background_gain")
    assert replace(row_gains, follows=(0.5, 0.1)).key is None


def test_few_columns_tell_nothing() -> None:
    assert fit_rows(gather_pulses([draw_sweep()]).select_columns(np.arange(40))) is None


def pulses_at_rest(near_ir: Numbers, **changed: Any) -> RecordedPulses:
    """Rows at one place, of which nothing else is known; two blocks of columns."""
    columns = np.arange(near_ir.shape[1])
    fields: dict[str, Any] = {
        "range_m": np.full(near_ir.shape, 10.0),
        "recorded": np.ones(near_ir.shape, bool),
        "signal": None,
        "near_ir": near_ir,
        "reflectivity": None,
        "azimuth_rad": np.full(near_ir.shape, np.nan),
        "frame": 0 * columns,
        "block": columns // (len(columns) // 2),
    }
    return RecordedPulses(**fields | changed)


def test_a_light_that_is_a_parabola_over_the_rows_has_no_gains() -> None:
    """Also at the first and the last row, where there are rows to one side only."""
    rows = np.arange(ROWS)
    light = np.exp(0.002 * rows**2 - 0.03 * rows)
    gains = fit_rows(pulses_at_rest(400.0 * light[:, None] * np.ones((1, 128))))
    assert gains is not None
    np.testing.assert_allclose(gains.gain, 1.0, rtol=1e-9)


def test_the_sigma_is_half_of_what_two_halves_differ_by() -> None:
    """Gains of +-10 %, 2 % more in one half and 2 % less in the other: 2 %, of which smoothing takes a few per cent."""
    sides = (-1.0) ** np.arange(ROWS)[:, None]
    change = np.repeat([0.02, -0.02], 64)[None, :]
    gains = fit_rows(pulses_at_rest(400.0 * np.exp(sides * (0.1 + change))))
    assert gains is not None
    assert gains.sigma[0] == pytest.approx(0.02, rel=0.15)


@pytest.mark.parametrize("size", [0.1, 0.2])
def test_the_exponents_sigma_is_the_scatter_over_the_gains(size: float) -> None:
    """Signals with half of the gains and a rest that goes with none of them, a fifth as large: 0.2 / sqrt(rows).

    Twice the gains with twice the rest tell the exponent as well. Smoothing takes some of both.
    """
    gains = size * (-1.0) ** np.arange(ROWS)
    unrelated = 0.2 * size * np.where(np.arange(ROWS) // 2 % 2 == 0, 1.0, -1.0)
    flat = np.ones((1, 128))
    pulses = pulses_at_rest(
        400.0 * np.exp(gains)[:, None] * flat, signal=400.0 * np.exp(0.5 * gains + unrelated)[:, None] * flat
    )
    follows = fit_rows(pulses)
    assert follows is not None
    assert follows.follows is not None
    assert follows.follows[0] == pytest.approx(0.5, abs=0.05)
    assert follows.follows[1] == pytest.approx(0.2 / np.sqrt(ROWS), rel=0.2)
    # Weak rows, and steps between surfaces, tell nothing.
    weak = replace(pulses, signal=0.05 * np.asarray(pulses.signal))
    steps = replace(pulses, range_m=pulses.range_m * np.where(np.arange(ROWS) % 2 == 0, 1.0, 1.05)[:, None])
    for undecided in (weak, steps):
        row_gains = fit_rows(undecided)
        assert row_gains is not None
        assert row_gains.follows is None
        assert row_gains.key is None


@pytest.mark.parametrize(("exponent", "key"), [(0.69, None), (0.71, "responsivity"), (0.29, "background_gain")])
def test_the_key_is_told_two_sigmas_from_the_middle(exponent: float, key: str | None) -> None:
    assert RowGains(gain=np.ones(2), sigma=np.ones(2), follows=(exponent, 0.1)).key == key
