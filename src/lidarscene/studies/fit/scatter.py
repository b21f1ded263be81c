"""Scatter of the range over the photons of the return: sigma^2 = c^2 / SIGNAL + floor^2.

A patch is five pulses along a ring, every second column; the residuals about a parabola through them have two degrees
of freedom. Neighbouring columns of an Ouster share shots, and below 100 photons it seems to filter over more of them
(docs/sensors.md), so neither is used. Surfaces must be smooth: a patch counts if the patches in the rows above and
below are among the smoothest, since their noise is independent of its own. Patches far above the law are left out, and
the truncated chi^2 distribution corrects for that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...maths.arrays import Numbers
from .estimates import Estimate, Solution, misfit_factor
from .recorded_pulses import RecordedPulses

PATCH, COLUMN_STEP = 5, 2
"""Pulses in a patch, and columns from one to the next."""

LEAST_SIGNAL = 100.0
"""Least harmonic mean of SIGNAL over a patch [photons]."""

SMOOTH_SHARE = 0.5
"""Share of the patches, by the scatter of their neighbours, that count as smooth."""

LARGEST_SIGNAL_RATIO = 2.0
"""Largest ratio of the signals within a patch."""

LARGEST_SQUARE = 6.0
"""Sum of squares over sigma^2 above which a patch is left out: exp(-3) = 5 % of clean ones."""

LEAST_PATCHES = 60
"""Least number of patches."""

LEAST_OF_OCTAVE = 20
"""Least number of patches in an octave of SIGNAL."""

_SHARE_BELOW = 1.0 - math.exp(-0.5 * LARGEST_SQUARE)
_MEAN_BELOW = (2.0 - (2.0 + LARGEST_SQUARE) * math.exp(-0.5 * LARGEST_SQUARE)) / _SHARE_BELOW
"""Mean of chi^2 with two degrees of freedom, given that it is below `LARGEST_SQUARE`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scatter:
    """Fitted scatter of the range.

    solved            solution: c^2 [m2 photons] and floor^2 [m2]
    fitted, held_out  (k, 3) middle of each octave of SIGNAL, scatter [m] and number of patches, of fitted and held-out
                      blocks
    """

    solved: Solution
    fitted: Numbers
    held_out: Numbers

    def law(self, signal: Numbers) -> Numbers:
        """Evaluate the fitted sigma at these signals [m]."""
        c2, floor2 = self.solved.value
        return np.asarray(np.sqrt(c2 / signal + floor2))

    @property
    def octaves(self) -> Numbers:
        """(k, 4) signal, scatter of the held-out blocks [m], that of the law [m], relative sigma of their ratio.

        The relative sigma of a standard deviation from n sums of two squares is 1 / (2 sqrt(n)).
        """
        signal, sigma_m, patches = self.held_out.T
        return np.column_stack([signal, sigma_m, self.law(signal), 0.5 / np.sqrt(patches)])

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """Estimates of c and floor [mm]."""
        return (
            self.solved.estimate("scatter_c", "mm", lambda p: 1e3 * math.sqrt(max(p[0], 0.0))),
            self.solved.estimate("scatter_floor", "mm", lambda p: 1e3 * math.sqrt(max(p[1], 0.0))),
        )


def fit_scatter(pulses: RecordedPulses) -> Scatter | None:
    """Fit the scatter of the range to a recording; None without SIGNAL, or with too few patches."""
    from scipy.optimize import nnls

    if pulses.signal is None:
        return None
    squares, inverse, block = _patches(pulses.select_columns(pulses.fitted))
    if len(squares) < LEAST_PATCHES:
        return None
    value = _start(squares, inverse)
    law = np.column_stack([inverse, np.ones_like(inverse)])
    inlier = np.ones(len(squares), bool)
    for _ in range(200):
        variance = law @ value
        inlier = squares < LARGEST_SQUARE * variance
        if inlier.sum() < LEAST_PATCHES // 4:
            return None
        # The squares are exponentially distributed with mean ``law @ value`` times the truncated mean: iteratively
        # reweighted least squares with weights 1 / variance^2 solve their likelihood; neither part is negative.
        scale = 1.0 / variance[inlier]
        solution = nnls(law[inlier] * scale[:, None], squares[inlier] / _MEAN_BELOW * scale)[0]
        converged = np.abs(solution - value).max() <= 1e-7 * np.abs(value).max()
        value = solution
        if converged:
            break
    variance = law @ value
    inlier = squares < LARGEST_SQUARE * variance
    patch_scores = np.where(inlier, squares / _MEAN_BELOW - variance, 0.0)[:, None] * law / variance[:, None] ** 2
    scores = np.column_stack([np.bincount(block, column) for column in patch_scores.T])
    # Slope of the sum of the scores: the cut at LARGEST_SQUARE moves with the law, which takes off the share ``edge``.
    edge = 0.5 * math.exp(-0.5 * LARGEST_SQUARE) * LARGEST_SQUARE * (LARGEST_SQUARE / _MEAN_BELOW - 1.0) / _SHARE_BELOW
    relative = law[inlier] / variance[inlier, None]
    fisher = relative.T @ relative
    spread = float(np.var(squares[inlier] / variance[inlier] / _MEAN_BELOW))
    excess = squares[inlier] / variance[inlier] / _MEAN_BELOW - 1.0
    deviations = _deviations(excess / math.sqrt(spread), inverse[inlier])
    solved = Solution(
        value=value,
        slope=(1.0 - edge) * fisher,
        scores=scores,
        meat=spread * fisher,
        misfit=misfit_factor(deviations, int(np.count_nonzero(value))),
    )
    return Scatter(
        solved=solved,
        fitted=_octaves(squares, inverse, value),
        held_out=_octaves(*_patches(pulses.select_columns(~pulses.fitted))[:2], value),
    )


def _patches(pulses: RecordedPulses) -> tuple[Numbers, Numbers, Numbers]:
    """Sum of squared residuals [m2], mean of 1 / SIGNAL and block index of each patch on a smooth surface."""
    assert pulses.signal is not None
    reach = PATCH * COLUMN_STEP
    starts = np.arange(0, pulses.range_m.shape[1] - reach + 1, reach)[:, None]
    columns = np.concatenate([starts + first + COLUMN_STEP * np.arange(PATCH) for first in range(COLUMN_STEP)])
    block = pulses.block[columns]
    in_one_block = (block.max(axis=1) == block.min(axis=1)) & (np.ptp(columns, axis=1) == reach - COLUMN_STEP)
    range_m, signal = pulses.range_m[:, columns], pulses.signal[:, columns]
    with np.errstate(invalid="ignore"):
        valid = np.isfinite(range_m).all(axis=2) & (signal.min(axis=2) > 0.0) & in_one_block
        valid &= signal.max(axis=2) < LARGEST_SIGNAL_RATIO * signal.min(axis=2)
    basis = np.linalg.qr(np.vander(np.arange(PATCH), 3))[0]  # orthonormal basis of the parabolas over a patch
    filled_range_m = np.where(valid[..., None], range_m, 0.0)
    squares = np.sum((filled_range_m - (filled_range_m @ basis) @ basis.T) ** 2, axis=2)
    inverse = np.mean(1.0 / np.where(valid[..., None], signal, 1.0), axis=2)
    relative = np.where(valid, squares / inverse, np.inf)
    neighbour_scatter = np.full_like(relative, np.inf)
    neighbour_scatter[1:-1] = np.maximum(relative[:-2], relative[2:])
    usable = valid & np.isfinite(neighbour_scatter) & (inverse < 1.0 / LEAST_SIGNAL)
    if not usable.any():
        return np.zeros(0), np.zeros(0), np.zeros(0, int)
    usable &= neighbour_scatter <= np.quantile(neighbour_scatter[usable], SMOOTH_SHARE)
    block_index = np.unique(np.broadcast_to(block[:, 0], valid.shape)[usable], return_inverse=True)[1]
    return squares[usable], inverse[usable], block_index


def _start(squares: Numbers, inverse: Numbers) -> Numbers:
    """Starting values from the median sum of squares, which is 2 ln 2 sigma^2 on clean surfaces."""
    return np.array([max(float(np.median(squares / inverse)) / (2.0 * math.log(2.0)), 1e-9), 1e-12])


def _deviations(excess: Numbers, inverse: Numbers) -> Numbers:
    """(k,) mean excess of the squares over the law in each octave, in sigmas of that mean.

    excess  (n,) of each patch, in sigmas of one patch
    """
    octave = np.unique(np.floor(np.log2(1.0 / inverse)), return_inverse=True)[1]
    sums, patches = np.bincount(octave, excess), np.bincount(octave)
    return np.asarray((sums / np.sqrt(patches))[patches >= LEAST_OF_OCTAVE])


def _octaves(squares: Numbers, inverse: Numbers, value: Numbers) -> Numbers:
    """(k, 3) signal, sigma and number of patches by octave, without patches far above the law."""
    inlier = squares < LARGEST_SQUARE * (value[0] * inverse + value[1])
    octave = np.floor(np.log2(1.0 / inverse[inlier])).astype(int)
    rows = []
    for number in np.unique(octave):
        of_octave = squares[inlier][octave == number]
        if len(of_octave) >= LEAST_OF_OCTAVE:
            rows.append((2.0 ** (number + 0.5), math.sqrt(float(of_octave.mean()) / _MEAN_BELOW), len(of_octave)))
    return np.array(rows).reshape(-1, 3)
