"""Scatter of the range over the photons of the return: sigma^2 = c^2 / SIGNAL + floor^2.

A patch is five pulses along a ring, every second column; the residuals about a parabola through them have two degrees
of freedom. Columns of an Ouster share noise: on a static pair of frames with .59, .38, .26, .13, .07 and .03 at 1 to 6
columns, so that such a patch reads 26 % low. Differences over 18 columns show by how much, and the squares are raised
by that. Weak pulses, whose noise columns share more (T176b), are not used; how far they reach is fitted by itself.
Surfaces must be smooth: a patch counts if the patches in the rows above and below are among the smoothest, since their
noise is independent of its own. Patches far above the law are left out, and the truncated chi^2 distribution corrects
for that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ...maths.arrays import Numbers
from ...sensor.histogram import Histogram
from .binned_fit import Statistics, solve
from .estimates import Estimate, Solution, block_sums, misfit_factor
from .recorded_pulses import RecordedPulses
from .tuning import (
    COLUMN_PHOTONS,
    LEAST_SHARED,
    PATCH_SIGNAL,
    PATCH_SIGNAL_RATIO,
    PATCH_SQUARE,
    SHARED_SMOOTH,
    SMOOTH_SHARE,
)

PATCH, COLUMN_STEP = 5, 2
"""Pulses in a patch, and columns from one to the next."""

LEAST_PATCHES = 60
"""Least number of patches."""

LEAST_OF_OCTAVE = 20
"""Least number of patches in an octave of SIGNAL. The scatter of n has a relative sigma of 1 / (2 sqrt(n)): 11 %."""

LEAST_BENT = 4
"""Least number of half octaves that tell where the scatter bends: two on each side."""

WIDE_STEP = 6
"""Columns from one pulse to the next in a difference whose pulses share no noise."""

WIDE = np.array([-1.0, 3.0, -3.0, 1.0]) / math.sqrt(20.0)
"""Third difference of four pulses, 0 on parabolas, with the deviation of one pulse."""

_MEDIAN_ONE, MEDIAN_TWO = 0.45494, 2.0 * math.log(2.0)
"""Medians of chi^2 with one and two degrees of freedom."""

_MEDIAN_VARIANCE_ONE, _MEDIAN_VARIANCE_TWO = 8.0, 2.1
"""Source: statistics of chi^2; variance of the logarithm of a median, times the number of values: 1 / (2 m f(m))^2,
which is 5.4 and 2.1. Neighbouring third differences of a block are correlated by up to 0.6, which makes 5.4 some 8."""

_SHARE_BELOW = 1.0 - math.exp(-0.5 * PATCH_SQUARE)
MEAN_BELOW = (2.0 - (2.0 + PATCH_SQUARE) * math.exp(-0.5 * PATCH_SQUARE)) / _SHARE_BELOW
"""Mean of chi^2 with two degrees of freedom, given that it is below `PATCH_SQUARE`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scatter:
    """Fitted scatter of the range.

    Attributes:
        solved: solution: c^2 [m2 photons] and floor^2 [m2]
        fitted: (k, 3) middle of each octave of SIGNAL, scatter [m] and number of patches, of fitted blocks
        held_out: (k, 3) the same of held-out blocks
        correlation: factor on the squares of the patches, for noise that neighbouring columns share; 1: none is seen
    """

    solved: Solution
    fitted: Numbers
    held_out: Numbers
    correlation: float = 1.0

    def law(self, signal: Numbers) -> Numbers:
        """Evaluate the fitted sigma at these signals [m]."""
        c2, floor2 = self.solved.value
        return np.asarray(np.sqrt(c2 / signal + floor2))

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """Estimates of c and floor [mm]."""
        return (
            self.solved.estimate("scatter_c", "mm", lambda p: 1e3 * math.sqrt(max(p[0], 0.0))),
            self.solved.estimate("scatter_floor", "mm", lambda p: 1e3 * math.sqrt(max(p[1], 0.0))),
        )


def is_strong(signal: Numbers, histogram: Histogram | None) -> Numbers:
    """Mask of the signals whose scatter is that of the photons: neither weak nor shared by more columns (T176b)."""
    left = 1.0 if histogram is None else histogram.noise_left(signal)
    return np.asarray((signal > PATCH_SIGNAL) & (left == 1.0))


def fit_scatter(pulses: RecordedPulses, histogram: Histogram | None = None) -> Scatter | None:
    """Fit the scatter of the range to a recording; None without SIGNAL, or with too few patches.

    Args:
        histogram: of the sensor file that the fit starts from; None: no columns share more of weak returns
    """
    if pulses.signal is None:
        return None
    squares, inverse, block = _patches(pulses.select_columns(pulses.fitted), histogram)
    if len(squares) < LEAST_PATCHES:
        return None
    correlation, relative_variance = _correlation(pulses, squares / inverse, histogram)
    squares = squares * correlation
    solved = solve_squares(squares, inverse, block)
    if solved is None:
        return None
    held_out_squares, held_out_inverse, _ = _patches(pulses.select_columns(~pulses.fitted), histogram)
    return Scatter(
        solved=solved.wider(relative_variance * np.outer(solved.value, solved.value)),
        fitted=_octaves(squares, inverse, solved.value),
        held_out=_octaves(held_out_squares * correlation, held_out_inverse, solved.value),
        correlation=correlation,
    )


def solve_squares(squares: Numbers, inverse: Numbers, block: Numbers, known: Numbers | float = 0.0) -> Solution | None:
    """Fit the variance a / photons + b + ``known`` to sums of squares of patches, (n,); None with too few.

    Args:
        inverse: (n,) mean of 1 / photons
        block: (n,) block of each patch
        known: (n,) part of the variance that is not fitted
    """
    from scipy.optimize import nnls

    value = _start(squares, inverse)
    law = np.column_stack([inverse, np.ones_like(inverse)])
    inlier = np.ones(len(squares), bool)
    for _ in range(200):
        variance = law @ value + known
        inlier = squares < PATCH_SQUARE * variance
        if inlier.sum() < LEAST_PATCHES // 4:
            return None
        # The squares are exponentially distributed with mean ``law @ value`` times the truncated mean: iteratively
        # reweighted least squares with weights 1 / variance^2 solve their likelihood; neither part is negative.
        scale = 1.0 / variance[inlier]
        solution = nnls(law[inlier] * scale[:, None], (squares / MEAN_BELOW - known)[inlier] * scale)[0]
        converged = np.abs(solution - value).max() <= 1e-7 * np.abs(value).max()
        value = solution
        if converged:
            break
    variance = law @ value + known
    inlier = squares < PATCH_SQUARE * variance
    patch_scores = np.where(inlier, squares / MEAN_BELOW - variance, 0.0)[:, None] * law / variance[:, None] ** 2
    # Slope of the sum of the scores: the cut at PATCH_SQUARE moves with the law, which takes off the share ``edge``.
    edge = 0.5 * math.exp(-0.5 * PATCH_SQUARE) * PATCH_SQUARE * (PATCH_SQUARE / MEAN_BELOW - 1.0) / _SHARE_BELOW
    relative = law[inlier] / variance[inlier, None]
    fisher = relative.T @ relative
    spread = float(np.var(squares[inlier] / variance[inlier] / MEAN_BELOW))
    if not spread > 0.0:
        return None
    excess = squares[inlier] / variance[inlier] / MEAN_BELOW - 1.0
    deviations = _deviations(excess / math.sqrt(spread), inverse[inlier])
    return Solution(
        value=value,
        slope=(1.0 - edge) * fisher,
        scores=block_sums(patch_scores, block),
        meat=spread * fisher,
        misfit=misfit_factor(deviations, int(np.count_nonzero(value))),
    )


def fit_column_photons(pulses: RecordedPulses, histogram: Histogram, step_m: float) -> Estimate | None:
    """Fit the photons below which columns share more, (T176b), to the scatter of weak returns over that of strong ones.

    Patches count in half octaves of SIGNAL from `LEAST_SHARED` photons on, the smoothest of each. How much columns
    share in strong returns takes the same part off all of them, so that it need not be known.

    Args:
        histogram: of the sensor, whose law it is
        step_m: of the ranges

    Returns:
        the estimate [photons]; None without SIGNAL, or with too few half octaves to tell a bend
    """
    if pulses.signal is None:
        return None
    chosen_pulses = pulses.select_columns(pulses.fitted)
    columns = patch_columns(chosen_pulses.block, COLUMN_STEP)
    range_m, inverse, valid, _ = _windows(chosen_pulses, columns, None)
    squares, usable = squared_rest(range_m, valid), valid & (inverse < 1.0 / LEAST_SHARED)
    relative = np.where(valid, squares, np.inf) / inverse
    place, block = np.floor(-2.0 * np.log2(inverse)), blocks_of_patches(chosen_pulses, columns, np.ones_like(usable))
    noise = ((squares - 2.0 * step_m**2 / 12.0) / MEAN_BELOW / inverse).ravel()  # without the rounding of both degrees
    members = []
    for number in np.unique(place[usable]):
        chosen = np.flatnonzero(smoothest(relative, usable & (place == number), SHARED_SMOOTH)[1])
        if len(chosen) < LEAST_PATCHES:
            continue
        near = chosen[relative.flat[chosen] < PATCH_SQUARE * np.median(relative.flat[chosen]) / MEDIAN_TWO]
        if len(near) >= LEAST_PATCHES and noise[near].mean() > 0.0:
            members.append(near)
    if len(members) < LEAST_BENT:
        return None
    recorded = Statistics.of([noise[near] for near in members], members, block).logarithm()
    signal = np.array([1.0 / inverse.flat[near].mean() for near in members])

    def law(parameters: Numbers) -> Numbers:
        unit = replace(histogram, column_photons=math.exp(parameters[1]))
        return np.asarray(parameters[0] + 2.0 * np.log(unit.noise_left(signal)))

    highest, bounds = float(recorded.value.max()), np.log(COLUMN_PHOTONS)
    start = np.array([highest, bounds.mean()])
    solved = solve(recorded, law, start, np.array([[highest - 3.0, highest + 3.0], bounds]).T, along=1)
    return solved.estimate("column_photons", "photons", lambda parameters: math.exp(parameters[1]))


def _patches(pulses: RecordedPulses, histogram: Histogram | None = None) -> tuple[Numbers, Numbers, Numbers]:
    """Sum of squared residuals [m2], mean of 1 / SIGNAL and block index of each patch on a smooth surface."""
    columns = patch_columns(pulses.block, COLUMN_STEP)
    range_m, inverse, valid, strong = _windows(pulses, columns, histogram)
    squares = squared_rest(range_m, valid)
    _, smooth = smoothest(np.where(valid, squares, np.inf) / inverse, strong)
    return squares[smooth], inverse[smooth], blocks_of_patches(pulses, columns, smooth)


def patch_columns(block: Numbers, step: int) -> Numbers:
    """(k, `PATCH`) columns of patches in one block each, so many columns from one pulse to the next."""
    starts = np.arange(0, len(block) - PATCH * step + 1, PATCH * step)[:, None]
    columns = np.concatenate([starts + first + step * np.arange(PATCH) for first in range(step)])
    return np.asarray(columns[np.ptp(block[columns], axis=1) == 0])


def squared_rest(values: Numbers, valid: Numbers) -> Numbers:
    """(rows, k) sums of squares that parabolas leave of patches, (rows, k, `PATCH`); 0 of invalid ones."""
    basis = np.linalg.qr(np.vander(np.arange(PATCH), 3))[0]  # orthonormal basis of the parabolas over a patch
    filled = np.where(valid[..., None], values, 0.0)
    return np.asarray(np.sum((filled - (filled @ basis) @ basis.T) ** 2, axis=2))


def blocks_of_patches(pulses: RecordedPulses, columns: Numbers, chosen: Numbers) -> Numbers:
    """Block index of each of the chosen patches, counted from 0 without gaps."""
    return np.asarray(
        np.unique(np.broadcast_to(pulses.block[columns[:, 0]], chosen.shape)[chosen], return_inverse=True)[1]
    )


def _windows(
    pulses: RecordedPulses, columns: Numbers, histogram: Histogram | None
) -> tuple[Numbers, Numbers, Numbers, Numbers]:
    """Ranges in each row at (k, w) columns, (rows, k, w), and (rows, k) their mean of 1 / SIGNAL and two masks.

    The masks are those of like returns, and of those among them that are strong.
    """
    assert pulses.signal is not None
    range_m, signal = pulses.range_m[:, columns], pulses.signal[:, columns]
    with np.errstate(invalid="ignore", divide="ignore"):
        least, inverse = signal.min(axis=2), np.mean(1.0 / signal, axis=2)
        valid = np.isfinite(range_m).all(axis=2) & (least > 0.0) & (signal.max(axis=2) < PATCH_SIGNAL_RATIO * least)
        return range_m, np.where(valid, inverse, 1.0), valid, valid & is_strong(1.0 / inverse, histogram)


def smoothest(relative: Numbers, usable: Numbers, share: float | None = None) -> tuple[Numbers, Numbers]:
    """Mask of windows with one above and below that has a scatter, and of those whose neighbours scatter least.

    Args:
        share: of the windows; None: `SMOOTH_SHARE`
    """
    neighbours = np.full_like(relative, np.inf)
    neighbours[1:-1] = np.maximum(relative[:-2], relative[2:])
    usable = usable & np.isfinite(neighbours)
    if not usable.any():
        return usable, usable
    return usable, usable & (neighbours <= np.quantile(neighbours[usable], share or SMOOTH_SHARE))


def _correlation(pulses: RecordedPulses, relative: Numbers, histogram: Histogram | None) -> tuple[float, float]:
    """Factor by which the squares of the patches are too small, and its relative variance; 1 and 0 within two sigmas.

    The factor is that of the scatter of third differences over `WIDE_STEP` to that of the patches, both by medians.

    Args:
        relative: (n,) squares of the patches times their signals
    """
    reach = WIDE_STEP * (len(WIDE) - 1)
    columns = np.arange(max(pulses.range_m.shape[1] - reach, 0))[:, None] + WIDE_STEP * np.arange(len(WIDE))
    columns = columns[np.ptp(pulses.block[columns], axis=1) == 0]  # a block has no gap but of lost columns
    range_m, inverse, _, strong = _windows(pulses, columns, histogram)
    wide = np.where(strong, (range_m @ WIDE) ** 2 / inverse, np.inf)
    usable, smooth = smoothest(wide, strong)
    if usable.sum() < LEAST_PATCHES:
        return 1.0, 0.0
    factor = float(np.median(wide[smooth]) / _MEDIAN_ONE * MEDIAN_TWO / np.median(relative))
    variance = _MEDIAN_VARIANCE_ONE / int(smooth.sum()) + _MEDIAN_VARIANCE_TWO / len(relative)
    return (factor, variance) if factor > 0.0 and math.log(factor) > 2.0 * math.sqrt(variance) else (1.0, 0.0)


def _start(squares: Numbers, inverse: Numbers) -> Numbers:
    """Starting values from the median sum of squares, which is 2 ln 2 sigma^2 on clean surfaces."""
    return np.array([max(float(np.median(squares / inverse)) / (2.0 * math.log(2.0)), 1e-9), 1e-12])


def _deviations(excess: Numbers, inverse: Numbers) -> Numbers:
    """(k,) mean excess of the squares over the law in each octave, in sigmas of that mean.

    Args:
        excess: (n,) of each patch, in sigmas of one patch
    """
    octave = np.unique(np.floor(np.log2(1.0 / inverse)), return_inverse=True)[1]
    sums, patches = np.bincount(octave, excess), np.bincount(octave)
    return np.asarray((sums / np.sqrt(patches))[patches >= LEAST_OF_OCTAVE])


def _octaves(squares: Numbers, inverse: Numbers, value: Numbers) -> Numbers:
    """(k, 3) signal, sigma and number of patches by octave, without patches far above the law."""
    inlier = squares < PATCH_SQUARE * (value[0] * inverse + value[1])
    octave = np.floor(np.log2(1.0 / inverse[inlier])).astype(int)
    rows = []
    for number in np.unique(octave):
        of_octave = squares[inlier][octave == number]
        if len(of_octave) >= LEAST_OF_OCTAVE:
            rows.append((2.0 ** (number + 0.5), math.sqrt(float(of_octave.mean()) / MEAN_BELOW), len(of_octave)))
    return np.array(rows).reshape(-1, 3)
