"""Scatter of the range over the photons of the return: sigma^2 = c^2 / SIGNAL + floor^2.

From five pulses along a ring, every second column, less the parabola through them, of which two degrees of freedom are
left. Neighbouring columns of an Ouster share shots, and below 100 photons it seems to filter over more of them
(docs/sensors.md), so neither is used. Surfaces must be smooth: a patch counts if those of the rows above and below are
among the smoothest, whose noise is its own. What is still far above the law is left out, and what that takes off is
given back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...maths.arrays import Numbers
from .estimates import Estimate, Solution
from .recorded_pulses import RecordedPulses

PATCH, APART = 5, 2
"""Pulses of a patch, and columns from one to the next."""

LEAST_SIGNAL = 100.0

SMOOTHEST = 0.5
"""Share of the patches."""

ALIKE = 2.0
"""Most ratio of the signals of a patch."""

FURTHEST = 6.0
"""Sum of squares over sigma^2 above which a patch is left out: of clean ones exp(-3) = 5 %."""

LEAST = 60
"""Patches."""

LEAST_OF_OCTAVE = 20

_SHARE_BELOW = 1.0 - math.exp(-0.5 * FURTHEST)
_MEAN_BELOW = (2.0 - (2.0 + FURTHEST) * math.exp(-0.5 * FURTHEST)) / _SHARE_BELOW
"""Of chi^2 with two degrees of freedom below `FURTHEST`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scatter:
    """The fit.

    solved    c^2 [m2 photons] and floor^2 [m2]
    signal, sigma_m, check_sigma_m, patches, check_patches   by octave of SIGNAL: of the blocks that were fitted, of
              the others (NaN with too few), and the number of patches of each
    """

    solved: Solution
    signal: Numbers
    sigma_m: Numbers
    check_sigma_m: Numbers
    patches: Numbers
    check_patches: Numbers

    def law(self, signal: Numbers) -> Numbers:
        """Sigma at these signals [m]."""
        c2, floor2 = self.solved.value
        return np.asarray(np.sqrt(c2 / signal + floor2))

    @property
    def ratios(self) -> Numbers:
        """Of the blocks that were not fitted over the law, by octave."""
        ratio = self.check_sigma_m / self.law(self.signal)
        return np.asarray(ratio[np.isfinite(ratio)])

    def beyond(self, most: float) -> bool:
        """Whether one of the ratios is above ``most``, or below its inverse, by more than two of its sigmas.

        n sums of two squares give a standard deviation to 1 / (2 sqrt(n)) of itself.
        """
        sigma = 0.5 / np.sqrt(self.check_patches[np.isfinite(self.check_sigma_m)])
        return bool(np.any(np.abs(np.log(self.ratios)) > math.log(most) + 2.0 * sigma))

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """C and floor."""
        return (
            self.solved.estimate("scatter_c", "mm", lambda p: 1e3 * math.sqrt(max(p[0], 0.0))),
            self.solved.estimate("scatter_floor", "mm", lambda p: 1e3 * math.sqrt(max(p[1], 0.0))),
        )


def fit_scatter(pulses: RecordedPulses) -> Scatter | None:
    """From the pulses of a recording; None without signals, or with too few patches."""
    if pulses.signal is None:
        return None
    squares, inverse, block = _patches(pulses.select_columns(pulses.fitted))
    if len(squares) < LEAST:
        return None
    value = _start(squares, inverse)
    law = np.column_stack([inverse, np.ones_like(inverse)])
    near = np.ones(len(squares), bool)
    for _ in range(200):
        variance = law @ value
        near = squares < FURTHEST * variance
        if near.sum() < LEAST // 4:
            return None
        weighted = law[near] / variance[near, None] ** 2
        solution = np.linalg.lstsq(weighted.T @ law[near], weighted.T @ (squares[near] / _MEAN_BELOW), rcond=None)[0]
        if solution[0] <= 0.0 or solution[1] < 0.0:  # a floor below nothing, or no photons' part: one of them alone
            only = 1 if solution[0] <= 0.0 else 0
            alone = float(weighted[:, only] @ (squares[near] / _MEAN_BELOW) / (weighted[:, only] @ law[near, only]))
            solution = np.array([alone, 0.0]) if only == 0 else np.array([0.0, alone])
        converged = np.abs(solution - value).max() <= 1e-7 * np.abs(value).max()
        value = solution
        if converged:
            break
    variance = law @ value
    near = squares < FURTHEST * variance
    patch_scores = np.where(near, squares / _MEAN_BELOW - variance, 0.0)[:, None] * law / variance[:, None] ** 2
    scores = np.column_stack([np.bincount(block, column) for column in patch_scores.T])
    # The slope of the sum of the scores: those left out move with the law, which takes off some of it.
    edge = 0.5 * math.exp(-0.5 * FURTHEST) * FURTHEST * (FURTHEST / _MEAN_BELOW - 1.0) / _SHARE_BELOW
    relative = law[near] / variance[near, None]
    fisher = relative.T @ relative
    spread = float(np.var(squares[near] / variance[near] / _MEAN_BELOW))
    solved = Solution(value=value, slope=(1.0 - edge) * fisher, scores=scores, meat=spread * fisher)
    signal, sigma, patches = _octaves(squares, inverse, value)
    check_patches_of = _patches(pulses.select_columns(~pulses.fitted))
    held_out = (
        _octaves(check_patches_of[0], check_patches_of[1], value) if len(check_patches_of[0]) else (np.zeros(0),) * 3
    )
    check = {octave: values for octave, *values in zip(*held_out, strict=True)}
    check_sigma_m, check_patches = np.array([check.get(octave, (math.nan, 0)) for octave in signal]).T
    return Scatter(
        solved=solved,
        signal=signal,
        sigma_m=sigma,
        patches=patches,
        check_sigma_m=check_sigma_m,
        check_patches=check_patches,
    )


def _patches(pulses: RecordedPulses) -> tuple[Numbers, Numbers, Numbers]:
    """Sums of squares [m2], mean of 1 / SIGNAL and block, of each patch on a smooth surface."""
    assert pulses.signal is not None
    reach = PATCH * APART
    starts = np.arange(0, pulses.range_m.shape[1] - reach + 1, reach)[:, None]
    place = np.concatenate([starts + first + APART * np.arange(PATCH) for first in range(APART)])
    block = pulses.block[place]
    together = (block.max(axis=1) == block.min(axis=1)) & (np.ptp(place, axis=1) == reach - APART)
    range_m, signal = pulses.range_m[:, place], pulses.signal[:, place]
    with np.errstate(invalid="ignore"):
        good = np.isfinite(range_m).all(axis=2) & (signal.min(axis=2) > 0.0) & together
        good &= signal.max(axis=2) < ALIKE * signal.min(axis=2)
    basis = np.linalg.qr(np.vander(np.arange(PATCH), 3))[0]  # all parabolas over the patch
    filled = np.where(good[..., None], range_m, 0.0)
    squares = np.sum((filled - (filled @ basis) @ basis.T) ** 2, axis=2)
    inverse = np.mean(1.0 / np.where(good[..., None], signal, 1.0), axis=2)
    relative = np.where(good, squares / inverse, np.inf)
    around = np.full_like(relative, np.inf)
    around[1:-1] = np.maximum(relative[:-2], relative[2:])
    usable = good & np.isfinite(around) & (inverse < 1.0 / LEAST_SIGNAL)
    if not usable.any():
        return np.zeros(0), np.zeros(0), np.zeros(0, int)
    usable &= around <= np.quantile(around[usable], SMOOTHEST)
    block_index = np.unique(np.broadcast_to(block[:, 0], good.shape)[usable], return_inverse=True)[1]
    return squares[usable], inverse[usable], block_index


def _start(squares: Numbers, inverse: Numbers) -> Numbers:
    """The median, 2 ln 2 sigma^2 on clean surfaces."""
    return np.array([max(float(np.median(squares / inverse)) / (2.0 * math.log(2.0)), 1e-9), 1e-12])


def _octaves(squares: Numbers, inverse: Numbers, value: Numbers) -> tuple[Numbers, Numbers, Numbers]:
    """Signal, sigma and number by octave, of the patches not far above the law."""
    variance = value[0] * inverse + value[1]
    near = squares < FURTHEST * variance
    octave = np.floor(np.log2(1.0 / inverse)).astype(int)
    rows = []
    for number in np.unique(octave[near]):
        inside = near & (octave == number)
        if inside.sum() >= LEAST_OF_OCTAVE:
            sigma = math.sqrt(float(squares[inside].mean()) / _MEAN_BELOW)
            rows.append((2.0 ** (number + 0.5), sigma, int(inside.sum())))
    return tuple(np.array(column) for column in zip(*rows, strict=True)) if rows else (np.zeros(0),) * 3  # type: ignore[return-value]
