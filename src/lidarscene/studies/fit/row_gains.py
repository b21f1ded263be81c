"""Gains of the rows: how much more background a row counts than its neighbours.

Neighbouring rows see nearly the same light. The median over the columns of ln(NEAR_IR of a row / NEAR_IR of the row
above) is the step from row to row. The gains are the sum of the steps, minus its smooth course over the rows, which is
the scene's. The steps of SIGNAL between neighbours at one range show the cause: a more sensitive receiver counts more
of both, a wider field of view only more background.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...maths.arrays import Numbers
from .recorded_pulses import RecordedPulses
from .tuning import GAIN_SIGNAL, SAME_RANGE

LEAST_COLUMNS = 64
"""Least number of columns for a median."""

SMOOTHING_ROWS = 8
"""Rows to either side in the parabola that follows the scene's own course."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RowGains:
    """Gain and its sigma, (rows,), from the top row down; their geometric mean is 1.

    Attributes:
        follows: exponent x of SIGNAL ~ gain^x from row to row, and its sigma; None if too few signals are strong
    """

    gain: Numbers
    sigma: Numbers
    follows: tuple[float, float] | None = None

    @property
    def key(self) -> str | None:
        """Key of `[scanner]` for these gains: responsivity (x near 1), background_gain (near 0); None if open."""
        if self.follows is None:
            return None
        exponent, sigma = self.follows
        if abs(exponent - 0.5) < 2.0 * sigma:
            return None
        return "responsivity" if exponent > 0.5 else "background_gain"

    @property
    def spread(self) -> float:
        """Standard deviation of the gains' logarithm."""
        return float(np.std(np.log(self.gain)))


def fit_rows(pulses: RecordedPulses) -> RowGains | None:
    """Fit the gains of the rows to a recording; None without NEAR_IR, with few rows or few columns."""
    if pulses.near_ir is None or min(pulses.near_ir.shape[0] - 2 * 2, pulses.near_ir.shape[1] - LEAST_COLUMNS) < 0:
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        log_near_ir = np.log(_destagger(pulses, np.where(pulses.recorded, pulses.near_ir, np.nan)))
    halves = [log_near_ir[:, (pulses.block % 2) == k] for k in (0, 1)]
    log_gains = [_gains(values) for values in (log_near_ir, *halves) if values.shape[1] >= LEAST_COLUMNS // 2]
    if len(log_gains) < 3 or not all(np.isfinite(gains).all() for gains in log_gains):
        return None
    # The halves differ by twice the sigma of the whole.
    half_difference = 0.5 * (log_gains[1] - log_gains[2])
    sigma = np.full(len(half_difference), float(np.sqrt(np.mean(half_difference**2))))
    return RowGains(gain=np.exp(log_gains[0]), sigma=sigma, follows=_signal_exponent(pulses, log_gains[0]))


def _signal_exponent(pulses: RecordedPulses, gains: Numbers) -> tuple[float, float] | None:
    """Slope of the logarithmic gains of SIGNAL over those of NEAR_IR, and its sigma."""
    if pulses.signal is None:
        return None
    strong_signals = pulses.has_return & (pulses.signal >= GAIN_SIGNAL)
    log_signal = _destagger(pulses, np.log(np.where(strong_signals, pulses.signal, 1.0)))
    range_m, strong_mask = _destagger(pulses, np.nan_to_num(pulses.range_m)), _destagger(pulses, 1.0 * strong_signals)
    with np.errstate(divide="ignore", invalid="ignore"):
        pair_mask = (strong_mask[1:] * strong_mask[:-1] > 0.0) & (np.abs(range_m[1:] / range_m[:-1] - 1.0) < SAME_RANGE)
    signal_gains = _gains_of_steps(np.where(pair_mask, log_signal[1:] - log_signal[:-1], np.nan))
    if not np.isfinite(signal_gains).all():
        return None
    # Regression through the origin, since both sets of gains have mean 0.
    square = float(gains @ gains)
    exponent = float(signal_gains @ gains) / square
    return exponent, float(np.std(signal_gains - exponent * gains)) / square**0.5


def _gains(log_values: Numbers) -> Numbers:
    return _gains_of_steps(log_values[1:] - log_values[:-1])


def _gains_of_steps(steps: Numbers) -> Numbers:
    finite = np.isfinite(steps)
    if (finite.sum(axis=1) < LEAST_COLUMNS // 4).any():
        return np.full(len(steps) + 1, np.nan)
    course = np.concatenate([[0.0], np.cumsum(np.nanmedian(np.where(finite, steps, np.nan), axis=1))])
    row = np.arange(len(course), dtype=float)
    smooth = np.zeros_like(course)
    for k in range(len(course)):  # least-squares parabola through the rows around
        nearby = np.abs(row - k) <= SMOOTHING_ROWS
        smooth[k] = np.polyval(np.polyfit(row[nearby] - k, course[nearby], 2), 0.0)
    gains = course - smooth
    return np.asarray(gains - gains.mean())


def _destagger(pulses: RecordedPulses, values: Numbers) -> Numbers:
    """Shift each row's columns so that one index is one azimuth; unchanged for several frames or unknown azimuths."""
    columns = values.shape[1]
    if pulses.frames > 1 or columns < 4 or not np.isfinite(pulses.azimuth_rad).all():
        return values
    step = np.angle(np.exp(1j * np.diff(pulses.azimuth_rad[0]))).mean()
    offset_rad = np.angle(np.exp(1j * (pulses.azimuth_rad[:, 0] - pulses.azimuth_rad[0, 0])))
    shifts = np.rint(offset_rad / step).astype(int)
    return np.stack([np.roll(row, shift) for row, shift in zip(values, shifts, strict=True)])
