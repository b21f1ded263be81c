"""Gains of the rows: how much more background a row counts than its neighbours do.

Neighbouring rows see nearly the same light. The median over the columns of ln(NEAR_IR of a row over the next one's) is
the step from row to row; summed up, and less what is smooth over the rows, which is the scene's, these are the gains.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...maths.arrays import Numbers
from .pulses import Pulses

LEAST_COLUMNS = 64

SMOOTH = 8
"""Rows to either side that the scene's own course is taken from."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RowGains:
    """Gain and its sigma, (rows,), from the top row down; their geometric mean is 1."""

    gain: Numbers
    sigma: Numbers

    @property
    def spread(self) -> float:
        """Standard deviation of the gains' logarithm."""
        return float(np.std(np.log(self.gain)))


def fit_rows(pulses: Pulses) -> RowGains | None:
    """From the pulses of a recording; None without NEAR_IR, with few rows or few columns."""
    if (
        pulses.near_ir is None
        or min(pulses.near_ir.shape[0] - 2 * 2, pulses.near_ir.shape[1] - LEAST_COLUMNS) < 0
    ):
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        light = np.log(_unstaggered(pulses))
    halves = [light[:, (pulses.block % 2) == k] for k in (0, 1)]
    found = [_gains(one) for one in (light, *halves) if one.shape[1] >= LEAST_COLUMNS // 2]
    if len(found) < 3 or not all(np.isfinite(one).all() for one in found):
        return None
    # The halves differ by twice the sigma of the whole.
    apart = 0.5 * (found[1] - found[2])
    sigma = np.full(len(apart), float(np.sqrt(np.mean(apart**2))))
    return RowGains(gain=np.exp(found[0]), sigma=sigma)


def _gains(light: Numbers) -> Numbers:
    steps = light[1:] - light[:-1]
    good = np.isfinite(steps)
    if (good.sum(axis=1) < LEAST_COLUMNS // 4).any():
        return np.full(len(light), np.nan)
    course = np.concatenate([[0.0], np.cumsum(np.nanmedian(np.where(good, steps, np.nan), axis=1))])
    place = np.arange(len(course), dtype=float)
    smooth = np.zeros_like(course)
    for k in range(len(course)):  # a parabola through the rows around
        near = np.abs(place - k) <= SMOOTH
        smooth[k] = np.polyval(np.polyfit(place[near] - k, course[near], 2), 0.0)
    gains = course - smooth
    return np.asarray(gains - gains.mean())


def _unstaggered(pulses: Pulses) -> Numbers:
    """NEAR_IR with each row's columns turned so that those of one index look in one direction, if that is known."""
    assert pulses.near_ir is not None
    light = np.where(pulses.recorded, pulses.near_ir, np.nan)
    columns = light.shape[1]
    if pulses.frames > 1 or columns < 4 or not np.isfinite(pulses.azimuth_rad).all():
        return light
    step = np.angle(np.exp(1j * np.diff(pulses.azimuth_rad[0]))).mean()
    aside = np.angle(np.exp(1j * (pulses.azimuth_rad[:, 0] - pulses.azimuth_rad[0, 0])))
    turns = np.rint(aside / step).astype(int)
    return np.stack([np.roll(one, turn) for one, turn in zip(light, turns, strict=True)])
