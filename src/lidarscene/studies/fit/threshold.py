"""Detection threshold over SIGNAL and NEAR_IR, fitted to pulses with and without a return.

The chance of a return is the logistic function of (SIGNAL - floor - slope sqrt(NEAR_IR)) / width. Its parameters
maximise the likelihood, which has one maximum. Only pulses with a surface on both sides in their
row count: real sensors compare neighbours, and an isolated return is noise or treated as such.

The sensor does not compare SIGNAL, which counts photons in a box, but the output of its filter, which weighs them. So
part of the width is the filter's noise at a given SIGNAL, and the rest is the threshold's own spread.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...detection.photon_counting.bins import BOX, BOX_SHARE
from ...maths.arrays import Numbers
from ...physics.photon_counting.matched_filter import SCALE, TEMPLATE
from ...sensor.sensor_model import Sensor
from .estimates import Estimate, Solution
from .recorded_pulses import RecordedPulses

LARGEST_SIGNAL_RATIO = 3.0
"""SIGNAL over the median threshold above which pulses are lost for other reasons (blanking, a window): left out."""

NEIGHBOUR_COLUMNS = 10
"""Columns to either side that are searched for a pulse's neighbours."""

LEAST_NEIGHBOURS = 8
"""Least number of neighbours with a return that make a surface."""

RANGE_TOLERANCE = 0.1
"""Largest relative difference of a neighbour's range from the neighbours' median. The pulse's own range does not count,
since a lost pulse has none."""

LEAST_PULSES = 200
"""Least number of pulses near the threshold, with a return and without."""

LARGEST_CONDITION = 1e12
"""Condition number of the Fisher matrix above which the background hardly varies."""

CHANCE_BINS = 20
"""Bins of the chance for the check."""

NORMAL = 1.702
"""Standard deviation of the normal distribution that is nearest to a logistic one of width 1."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Threshold:
    """Fitted chance of a return, 1 / (1 + exp(-(a SIGNAL + b + c sqrt(NEAR_IR)))).

    solved   solution: a, b, c
    near_ir  median NEAR_IR of the pulses near the threshold
    shares   (k, 3) chance by the law, share that was kept, and number of the held-out pulses, by the chance
    """

    solved: Solution
    near_ir: float
    shares: Numbers

    def level(self, near_ir: Numbers) -> Numbers:
        """SIGNAL at which the chance of a return is one half."""
        a, b, c = self.solved.value
        return np.asarray(-(b + c * np.sqrt(near_ir)) / a)

    def chance(self, signal: Numbers, near_ir: Numbers) -> Numbers:
        """Chance of a return at these signals and backgrounds."""
        return _chance(self.solved.value, _design(signal, near_ir))

    @property
    def error(self) -> float:
        """Mean absolute difference of expected and recorded share, weighted by the number of pulses."""
        return float(np.average(np.abs(self.shares[:, 0] - self.shares[:, 1]), weights=self.shares[:, 2]))

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """Estimates of floor, slope and width [photons]."""
        return (
            self.solved.estimate("threshold_floor", "photons", lambda p: -p[1] / p[0]),
            self.solved.estimate("threshold_slope", "photons", lambda p: -p[2] / p[0]),
            self.solved.estimate("threshold_width", "photons", lambda p: 1.0 / p[0]),
        )

    def spread(self, sensor: Sensor) -> Estimate | None:
        """Standard deviation of this sensor's threshold; None if the filter's noise explains all of the width."""
        filter_photons2 = filter_variance(
            sensor, photons=float(self.level(np.array(self.near_ir))), near_ir=self.near_ir
        )
        if (NORMAL / self.solved.value[0]) ** 2 <= filter_photons2:
            return None
        return self.solved.estimate(
            "threshold_spread", "photons", lambda p: math.sqrt(max((NORMAL / p[0]) ** 2 - filter_photons2, 0.0))
        )


def filter_variance(sensor: Sensor, *, photons: float, near_ir: float) -> float:
    """Variance of the filter's output F given SIGNAL S: var F - cov(F, S)^2 / var S [photons^2].

    Photons are independent, so each of the three is the integral of a product of two weights over the counts.
    """
    sigma_s = float(sensor.pixel(0.0).sigma_s)
    offset_sigmas = np.linspace(-8.0, 8.0, 1601)
    background = near_ir * sigma_s / float(sensor.tdc.ambient_s)
    expected_counts = background + photons * np.exp(-0.5 * offset_sigmas**2) / math.sqrt(2.0 * math.pi)
    weight = SCALE * np.exp(-0.5 * (offset_sigmas / TEMPLATE) ** 2)
    box = (np.abs(offset_sigmas) < BOX) / BOX_SHARE
    output_variance, box_variance, covariance = (
        float(np.sum(a * b * expected_counts)) * 0.01  # the step of offset_sigmas
        for a, b in ((weight, weight), (box, box), (weight, box))
    )
    return output_variance - covariance * covariance / box_variance


def fit_threshold(pulses: RecordedPulses) -> Threshold | None:
    """Fit the threshold to a recording; None without SIGNAL and NEAR_IR of lost pulses, or with too few near it."""
    if pulses.signal is None or pulses.near_ir is None:
        return None
    usable = pulses.recorded & np.isfinite(pulses.signal) & np.isfinite(pulses.near_ir) & _on_surface(pulses)
    if pulses.reflectivity is not None:
        # A reflectivity without a range marks an echo that was detected but withheld, not missed.
        usable &= pulses.has_return | ~(pulses.reflectivity > 0.0)
    fitted = np.broadcast_to(pulses.fitted, usable.shape)
    lost = usable & fitted & ~pulses.has_return
    # Largest signal: first a guess from lost pulses, which lie below the threshold or not far above, then by the fit.
    max_signal = 4.0 * float(np.median(pulses.signal[lost])) if lost.any() else 0.0
    for _ in range(2):
        mask = usable & (pulses.signal <= max_signal)
        fit_mask = mask & fitted
        returned = pulses.has_return[fit_mask]
        if min(returned.sum(), (~returned).sum()) < LEAST_PULSES:
            return None
        design = _design(pulses.signal[fit_mask], pulses.near_ir[fit_mask])
        solution = _maximise(design, returned)
        if solution is None:
            return None
        value = solution
        median_level = -(value[1] + value[2] * float(np.median(design[:, 2]))) / value[0]
        max_signal = LARGEST_SIGNAL_RATIO * median_level
    chance = _chance(value, design)
    block = pulses.blocks(fit_mask)
    pulse_scores = (returned - chance)[:, None] * design
    scores = np.column_stack([np.bincount(block, column) for column in pulse_scores.T])
    held_out = mask & ~fitted
    expected = _chance(value, _design(pulses.signal[held_out], pulses.near_ir[held_out]))
    return Threshold(
        solved=Solution(value=value, slope=_information(value, design), scores=scores),
        near_ir=float(np.median(design[:, 2])) ** 2,
        shares=shares_by_chance(expected, pulses.has_return[held_out], CHANCE_BINS),
    )


def shares_by_chance(chance: Numbers, returned: Numbers, bins: int, least: int = 1) -> Numbers:
    """(k, 3) mean chance of a return, share that returned and number of pulses, by the chance.

    bins   number of bins from 0 to 1
    least  least number of pulses in a bin
    """
    bin_index = np.minimum((chance * bins).astype(int), bins - 1)
    masks = [bin_index == number for number in range(bins)]
    rows = [(chance[mask].mean(), returned[mask].mean(), mask.sum()) for mask in masks if mask.sum() >= least]
    return np.array(rows, float).reshape(-1, 3)


def _on_surface(pulses: RecordedPulses) -> Numbers:
    """Mask of the pulses whose neighbours in the row are returns of one surface."""
    range_m = pulses.range_m
    neighbours_m = np.stack(
        [np.roll(range_m, shift, axis=1) for shift in range(-NEIGHBOUR_COLUMNS, NEIGHBOUR_COLUMNS + 1) if shift]
    )
    covered = np.isfinite(neighbours_m).sum(axis=0) >= LEAST_NEIGHBOURS
    mask = np.zeros(range_m.shape, bool)
    median_m = np.nanmedian(neighbours_m[:, covered], axis=0)
    mask[covered] = np.nanmax(np.abs(neighbours_m[:, covered] - median_m), axis=0) < RANGE_TOLERANCE * median_m
    return mask


def _design(signal: Numbers, near_ir: Numbers) -> Numbers:
    return np.column_stack([signal, np.ones_like(signal), np.sqrt(near_ir)])


def _chance(value: Numbers, design: Numbers) -> Numbers:
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(design @ value, -60.0, 60.0))))


def _maximise(design: Numbers, returned: Numbers) -> Numbers | None:
    """Maximise the likelihood; None without a maximum: separable data, constant light, or a chance that falls."""
    from scipy.optimize import root

    def score(value: Numbers) -> Numbers:
        return np.asarray(design.T @ (returned - _chance(value, design)))

    solution = root(score, np.zeros(3), jac=lambda value: -_information(value, design))
    information = _information(solution.x, design)
    # Of separable data no chance is between 0 and 1; the middle element is the sum of chance times (1 - chance).
    is_maximum = solution.success and information[1, 1] > 1.0 and np.linalg.cond(information) < LARGEST_CONDITION
    return np.asarray(solution.x) if is_maximum and solution.x[0] > 0.0 else None


def _information(value: Numbers, design: Numbers) -> Numbers:
    """(3, 3) Fisher matrix."""
    chance = _chance(value, design)
    return np.asarray((design * (chance * (1.0 - chance))[:, None]).T @ design)
