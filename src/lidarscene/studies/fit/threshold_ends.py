r"""Both ends of the threshold: the least one that a point of a surface meets, and that of echoes without neighbours.

Of the pulses whose row has no return in the two columns to either side, the chance of a return is a logistic function
of ln(SIGNAL / U), as on surfaces, but half of them return at `lone_factor` times the median threshold U.

On surfaces a point's threshold is U e^(spread z) and at least `threshold_least` U (T111), and the filter's output F,
which is compared with it, scatters about SIGNAL by s U. So with the normal distribution Phi

.. math:: P(x) = \int_{\mathrm{least}}^\infty \Phi(\ln f / \mathrm{spread})\,\mathrm{N}(f; x, s)\,\mathrm{d}f,
          \quad x = \mathrm{SIGNAL} / U \tag{T183}
"""

from __future__ import annotations

import math

import numpy as np

from ...maths.arrays import Numbers
from ...sensor.sensor_model import Sensor
from .estimates import Estimate, Solution, block_sums, drawn_counts, misfit_factor
from .recorded_pulses import RecordedPulses
from .threshold import (
    Threshold,
    deviations_of_shares,
    filter_variance,
    information,
    logistic,
    logistic_coefficients,
    on_surface,
    photons,
    threshold_pulses,
)
from .tuning import DECISIVE, FILTER_DEVIATES, LARGEST_RATIO, LEAST_RATIO, LEASTS

LONE_COLUMNS = 2
"""Columns to either side without a return that make a pulse a lone one."""

LEAST_LONE = 10
"""Least number of lone pulses with a return, and without."""


def fit_lone_factor(pulses: RecordedPulses, threshold: Threshold) -> Estimate | None:
    """Fit `lone_factor` to the pulses without neighbours; None with too few of them, or without a maximum."""
    usable = threshold_pulses(pulses)
    has_neighbour = np.zeros(usable.shape, bool)
    for shift in range(1, LONE_COLUMNS + 1):
        has_neighbour |= np.roll(pulses.has_return, shift, axis=1) | np.roll(pulses.has_return, -shift, axis=1)
    ratio = _ratio(pulses, threshold)
    mask = usable & ~has_neighbour & (ratio > LEAST_RATIO) & np.broadcast_to(pulses.fitted, usable.shape)
    returned, logarithm = pulses.has_return[mask], np.log(ratio[mask])
    if min(returned.sum(), (~returned).sum()) < LEAST_LONE:
        return None
    design = np.column_stack([logarithm, np.ones_like(logarithm)])
    coefficients = logistic_coefficients(design, returned)
    if coefficients is None or coefficients[0] <= 0.0:
        return None
    chance = logistic(design @ coefficients)
    solved = Solution(
        value=coefficients,
        slope=information(design, chance),
        scores=block_sums((returned - chance)[:, None] * design, pulses.blocks(mask)),
        misfit=misfit_factor(deviations_of_shares(chance, returned), 2),
    )
    return solved.estimate("lone_factor", "", lambda p: math.exp(-p[1] / p[0]))


def fit_least(pulses: RecordedPulses, threshold: Threshold, sensor: Sensor, spread: float) -> Estimate | None:
    """Fit `threshold_least` to the pulses on surfaces (T183); None if an endless threshold is nearly as likely.

    Args:
        sensor: sensor whose filter scatters about SIGNAL
        spread: fitted `threshold_spread`
    """
    ratio = _ratio(pulses, threshold)
    mask = threshold_pulses(pulses) & on_surface(pulses) & (ratio < LARGEST_RATIO)
    mask &= np.broadcast_to(pulses.fitted, mask.shape)
    if not mask.any():
        return None
    returned, block = pulses.has_return[mask], pulses.blocks(mask)
    level = float(threshold.level(np.array(threshold.near_ir)))
    filter_sigma = math.sqrt(filter_variance(sensor, photons=level, near_ir=threshold.near_ir)) / level
    # The chances on a grid of the ratio, one column for each least threshold, and one without an end.
    grid = np.linspace(0.0, LARGEST_RATIO, 301)
    log_chance, log_loss = np.log(_chances(grid, spread, filter_sigma, np.append(LEASTS, 1e-6)))
    place = np.minimum((ratio[mask] / (grid[1] - grid[0])).round().astype(int), len(grid) - 1)
    likelihoods = np.zeros((int(block.max()) + 1, len(LEASTS) + 1))
    np.add.at(likelihoods, block, np.where(returned[:, None], log_chance[place], log_loss[place]))
    total = likelihoods.sum(axis=0)
    best = int(np.argmax(total[:-1]))
    if total[best] - total[-1] < DECISIVE or best in (0, len(LEASTS) - 1):
        return None
    likely = LEASTS[total[:-1] > total[best] - 0.5]
    drawn = LEASTS[np.argmax(drawn_counts(len(likelihoods)) @ likelihoods[:, :-1], axis=1)]
    step = LEASTS[best] - LEASTS[best - 1]
    return Estimate(
        key="threshold_least",
        value=float(LEASTS[best]),
        unit="",
        fisher=float(max(0.5 * np.ptp(likely), step)),
        bootstrap=float(np.std(drawn)) if len(likelihoods) > 1 else math.inf,
    )


def _ratio(pulses: RecordedPulses, threshold: Threshold) -> Numbers:
    """SIGNAL over the median threshold of each pulse; NaN where one was not recorded."""
    assert pulses.signal is not None
    assert pulses.near_ir is not None
    return np.asarray(photons(pulses.signal) / threshold.level(pulses.near_ir))


def _chances(ratio: Numbers, spread: float, filter_sigma: float, least: Numbers) -> Numbers:
    """(2, ratios, leasts) chances of a return and of none (T183), not below 1e-6, which is noise."""
    from scipy.special import ndtr

    output = np.maximum(ratio[:, None] + filter_sigma * FILTER_DEVIATES, 1e-9)
    weight = np.exp(-0.5 * FILTER_DEVIATES**2)
    weight /= weight.sum()
    met = ndtr(np.log(output) / spread) * weight
    # Sum of what lies above each least threshold, from the far end.
    chance = np.stack([np.sum(np.where(output >= limit, met, 0.0), axis=1) for limit in least], axis=1)
    return np.asarray(np.clip(np.stack([chance, 1.0 - chance]), 1e-6, 1.0))
