"""Detection threshold over SIGNAL and NEAR_IR, fitted to pulses with and without a return.

The chance of a return is the logistic function of ln(SIGNAL / U) / width, with the threshold U =
slope sqrt(NEAR_IR + pedestal). Its parameters maximise the likelihood, which has one maximum for each pedestal. Only
pulses with a surface on both sides in their row count: real sensors compare neighbours, and an isolated return is noise
or treated as such.

The sensor does not compare SIGNAL, which counts photons in a box, but the output of its filter, which weighs them. So
part of the width is the filter's noise at a given SIGNAL, and the rest is the threshold's own spread.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...maths.arrays import Numbers
from ...physics.photon_counting.matched_filter import SCALE, TEMPLATE
from ...physics.photon_counting.pile_up import BOX, BOX_SHARE
from ...sensor.sensor_model import Sensor
from .estimates import Estimate, Solution, block_sums, misfit_factor
from .recorded_pulses import RecordedPulses
from .tuning import LARGEST_CONDITION, LARGEST_PEDESTAL, LARGEST_SIGNAL_RATIO, LEAST_VARIANCE, RANGE_TOLERANCE

NEIGHBOUR_COLUMNS = 10
"""Columns to either side that are searched for a pulse's neighbours."""

LEAST_NEIGHBOURS = 8
"""Least number of neighbours with a return that make a surface."""

LEAST_PULSES = 200
"""Least number of pulses near the threshold, with a return and without."""

CHANCE_BINS = 20
"""Bins of the chance for the check."""

LOGISTIC = math.pi / math.sqrt(3.0)
"""Standard deviation of a logistic distribution of width 1."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Threshold:
    """Fitted chance of a return, 1 / (1 + exp(-ln(SIGNAL / U) / width)), U = slope sqrt(NEAR_IR + pedestal).

    Attributes:
        solved: solution: ln slope, pedestal, ln width
        near_ir: median NEAR_IR of the pulses near the threshold
        held_out: (n, 3) SIGNAL, NEAR_IR and whether it was kept of each held-out pulse
    """

    solved: Solution
    near_ir: float
    held_out: Numbers

    def level(self, near_ir: Numbers) -> Numbers:
        """SIGNAL at which the chance of a return is one half."""
        return _level(self.solved.value, near_ir)

    def shares(self, sensor: Sensor) -> Numbers:
        """(k, 3) chance by a sensor, share that was kept, and number of the held-out pulses, by the chance.

        The sensor's threshold and its spread, and the noise of its filter, are a logistic law, as in `spread`.
        """
        assert sensor.histogram is not None
        signal, near_ir, returned = self.held_out.T
        level = np.asarray(sensor.histogram.threshold(near_ir), np.float64)
        middle = float(np.ravel(sensor.histogram.threshold(np.array([self.near_ir])))[0])
        filter_share = filter_variance(sensor, photons=middle, near_ir=self.near_ir) / (middle * middle)
        width = math.sqrt(float(sensor.histogram.threshold_spread or 0.0) ** 2 + filter_share) / LOGISTIC
        argument = np.log(photons(signal) / level) / width
        return shares_by_chance(logistic(argument), returned, CHANCE_BINS)

    def error_of(self, sensor: Sensor) -> float:
        """Mean absolute difference of a sensor's and the recorded share, weighted by the number of pulses."""
        chance, kept, pulses = self.shares(sensor).T
        return float(np.average(np.abs(chance - kept), weights=pulses))

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """Estimates of slope [photons], pedestal [counts], of all shots, and width of the logarithm."""
        return (
            self.solved.estimate("threshold_slope", "photons", lambda p: math.exp(p[0])),
            self.solved.estimate("threshold_pedestal", "counts", lambda p: p[1]),
            self.solved.estimate("threshold_width", "", lambda p: math.exp(p[2])),
        )

    def spread(self, sensor: Sensor) -> Estimate | None:
        """Standard deviation of the logarithm of this sensor's threshold, from what the filter leaves of the variance.

        None if the filter's noise explains the width.
        """
        level = float(self.level(np.array(self.near_ir)))
        filter_share = filter_variance(sensor, photons=level, near_ir=self.near_ir) / (level * level)
        if (LOGISTIC * math.exp(self.solved.value[2])) ** 2 <= filter_share:
            return None
        return self.solved.estimate(
            "threshold_spread", "", lambda p: math.sqrt(max((LOGISTIC * math.exp(p[2])) ** 2 - filter_share, 0.0))
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
    usable = threshold_pulses(pulses) & on_surface(pulses)
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
        signal, near_ir = pulses.signal[fit_mask], pulses.near_ir[fit_mask]
        solution = _maximise(signal, near_ir, returned)
        if solution is None:
            return None
        value = solution
        max_signal = LARGEST_SIGNAL_RATIO * float(_level(value, np.median(near_ir)))
    chance, slopes = _chance(value, signal, near_ir), _slopes(value, signal, near_ir)
    held_out = mask & ~fitted
    return Threshold(
        solved=Solution(
            value=value,
            slope=information(slopes, chance),
            scores=block_sums((returned - chance)[:, None] * slopes, pulses.blocks(fit_mask)),
            misfit=misfit_factor(deviations_of_shares(chance, returned), len(value)),
        ),
        near_ir=float(np.median(near_ir)),
        held_out=np.column_stack([pulses.signal[held_out], pulses.near_ir[held_out], pulses.has_return[held_out]]),
    )


def threshold_pulses(pulses: RecordedPulses) -> Numbers:
    """Mask of the pulses with SIGNAL and NEAR_IR that met a threshold, so were not withheld."""
    assert pulses.signal is not None
    assert pulses.near_ir is not None
    usable = pulses.recorded & np.isfinite(pulses.signal) & np.isfinite(pulses.near_ir)
    if pulses.reflectivity is not None:
        # A reflectivity without a range marks an echo that was detected but withheld, not missed.
        usable &= pulses.has_return | ~(pulses.reflectivity > 0.0)
    return np.asarray(usable)


def shares_by_chance(chance: Numbers, returned: Numbers, bins: int, least: int = 1) -> Numbers:
    """(k, 3) mean chance of a return, share that returned and number of pulses, by the chance.

    Args:
        bins: number of bins from 0 to 1
        least: least number of pulses in a bin
    """
    bin_index = np.minimum((chance * bins).astype(int), bins - 1)
    masks = [bin_index == number for number in range(bins)]
    rows = [(chance[mask].mean(), returned[mask].mean(), mask.sum()) for mask in masks if mask.sum() >= least]
    return np.array(rows, float).reshape(-1, 3)


def deviations_of_shares(chance: Numbers, returned: Numbers) -> Numbers:
    """(k,) differences of recorded shares from the law, by its chance, in sigmas of a binomial number."""
    expected, share, pulses = shares_by_chance(chance, returned, CHANCE_BINS).T
    variance = pulses * expected * (1.0 - expected)
    return np.asarray((pulses * (share - expected) / np.sqrt(variance))[variance >= LEAST_VARIANCE])


def on_surface(pulses: RecordedPulses) -> Numbers:
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


def photons(signal: Numbers) -> Numbers:
    """SIGNAL as recorded in whole photons, of none half of one."""
    return np.maximum(signal, 0.5)


def _level(value: Numbers, near_ir: Numbers) -> Numbers:
    return np.asarray(math.exp(value[0]) * np.sqrt(near_ir + value[1]))


def _argument(value: Numbers, signal: Numbers, near_ir: Numbers) -> Numbers:
    """ln(SIGNAL / U) / width."""
    return np.asarray(np.log(photons(signal) / _level(value, near_ir)) * math.exp(-value[2]))


def _chance(value: Numbers, signal: Numbers, near_ir: Numbers) -> Numbers:
    return logistic(_argument(value, signal, near_ir))


def _slopes(value: Numbers, signal: Numbers, near_ir: Numbers) -> Numbers:
    """(n, 3) slopes of the argument by the parameters."""
    steep = math.exp(-value[2])
    argument = _argument(value, signal, near_ir)
    return np.column_stack([np.full_like(argument, -steep), -0.5 * steep / (near_ir + value[1]), -argument])


def _maximise(signal: Numbers, near_ir: Numbers, returned: Numbers) -> Numbers | None:
    """Maximise the likelihood; None without a maximum: separable data, constant light, or a chance that falls."""
    from scipy.optimize import minimize_scalar

    median = float(np.median(near_ir))

    def at_pedestal(pedestal: float) -> tuple[float, Numbers | None]:
        """-ln L and parameters. A pedestal given, the argument is linear in 1 / width and ln slope / width."""
        design = np.column_stack([np.log(photons(signal) / np.sqrt(near_ir + pedestal)), np.ones_like(signal)])
        linear = logistic_coefficients(design, returned)
        if linear is None or linear[0] <= 0.0:
            return math.inf, None
        value = np.array([-linear[1] / linear[0], pedestal, -math.log(linear[0])])
        argument = _argument(value, signal, near_ir)
        return float(np.sum(np.logaddexp(0.0, np.where(returned, -argument, argument)))), value

    def share_of_pedestal(share: float) -> float:
        return median * share / (1.0 - share)

    without = at_pedestal(0.0)
    if without[1] is None:
        return None
    largest = LARGEST_PEDESTAL / (1.0 + LARGEST_PEDESTAL)
    best = minimize_scalar(
        lambda share: at_pedestal(share_of_pedestal(share))[0],
        bounds=(0.0, largest),
        method="bounded",
        options={"xatol": 1e-4},
    )
    value = min(without, at_pedestal(share_of_pedestal(best.x)), key=lambda pair: pair[0])[1]
    assert value is not None
    # The same threshold in other units, so that the condition is that of the light alone.
    scale = np.array([1.0, median, 1.0])
    matrix = information(_slopes(value, signal, near_ir), _chance(value, signal, near_ir))
    regular = np.linalg.cond(matrix * np.outer(scale, scale)) < LARGEST_CONDITION
    return value if regular else None


def logistic_coefficients(design: Numbers, returned: Numbers) -> Numbers | None:
    """Coefficients of the likeliest logistic law; None without a maximum."""
    from scipy.optimize import root

    def matrix(value: Numbers) -> Numbers:
        return information(design, logistic(design @ value))

    solution = root(
        lambda value: design.T @ (returned - logistic(design @ value)), np.zeros(2), jac=lambda value: -matrix(value)
    )
    # Of separable data no chance is between 0 and 1; the last element is the sum of chance times (1 - chance).
    return np.asarray(solution.x) if solution.success and matrix(solution.x)[1, 1] > 1.0 else None


def logistic(argument: Numbers) -> Numbers:
    """Evaluate the logistic function."""
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(argument, -60.0, 60.0))))


def information(slopes: Numbers, chance: Numbers) -> Numbers:
    """(p, p) Fisher matrix of (n,) logistic chances whose arguments have (n, p) slopes."""
    return np.asarray((slopes * (chance * (1.0 - chance))[:, None]).T @ slopes)
