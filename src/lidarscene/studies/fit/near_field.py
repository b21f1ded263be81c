"""Near field: share of a target's light that falls on the detector, over the range, from a recording alone.

An Ouster reports SIGNAL, the photons of a return, and REFLECTIVITY, which its maker corrected for range and near
field. So SIGNAL R^2 100 / REFLECTIVITY is K share(R), K being the photons of a white wall times the square of its
range, far away. The share is that of T18 with the lens focused at infinity: the blur has the radius r_A / R, the
detector r_PD / f, and below R0 = r_A f / r_PD the blur is the larger one. The laser's spot makes the knee at R0 round.
A sensor whose file has two lenses, or a focus, has a special curve, which is stretched over the range. If that
is not enough, the transmitter's place, crossing, focus and scattered share (`LENSES`) are free, too.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...maths.arrays import Lanes, Numbers
from ...maths.special import SIGMA_PER_MAD, expm1
from ...physics.optics import receiver
from ...sensor.overlap import Alignment
from ...sensor.sensor_model import Sensor
from .estimates import MOST_EVALUATIONS, Estimate, Solution, huber_weight
from .products import near_field_m, white_over_range_m2
from .recorded_pulses import RecordedPulses
from .tuning import (
    CURVE_HUBER,
    FAR_RATIO,
    LEAST_GAIN,
    LEAST_MISFIT,
    LEAST_REFLECTIVITY,
    LEAST_SHARE,
    LEAST_SIGNAL,
    LENS_BOUNDS,
    LENS_RATIOS,
    LENS_SIGMAS,
    LENS_STEP,
    LOG_RANGE_STEP,
    LONGEST_STRETCH,
    MOST_REFLECTIVITY,
    OUTLIER,
    SAME_LAW,
    SPOT_BOUNDS,
)

LEAST_PULSES = 30
"""Least number of pulses in a bin."""

LEAST_BINS = 6

LENSES = ("offset_over_aperture", "near_field_over_crossing", "near_field_over_focus", "scattered_share")
"""Numbers of a receiver beside its transmitter that may be free: its offset over r_A, R0 over the range at which the
axes meet and over that in focus (0: infinity), and the share of the light that reaches the detector by scatter."""

Curve = Callable[..., Numbers]
"""Function from range over R0, and perhaps the `LENSES`, to the share of the light on the detector, relative to that at
`FAR_RATIO`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NearField:
    """Fitted near field.

    Attributes:
        range_m: (n,) mean range of each bin
        white_m2: (n,) K share(R) of each bin
        sigma: (n,) standard deviation of ln white_m2
        misfit: standard deviation of ln white_m2 that the law leaves unexplained
        sensor_curve: curve of the sensor's own optics; None: law of one lens
        solved: solution: ln K, ln R0; for one lens also ln of the spot's radius over the field's, for free lenses the
            `LENSES`
        check_range_m: ``range_m`` for the held-out blocks
        check_white_m2: ``white_m2`` for the held-out blocks
    """

    range_m: Numbers
    white_m2: Numbers
    sigma: Numbers
    misfit: float
    sensor_curve: Curve | None
    solved: Solution
    check_range_m: Numbers
    check_white_m2: Numbers

    def law(self, range_m: Numbers) -> Numbers:
        """Evaluate the fitted white_m2 at these ranges."""
        return np.asarray(np.exp(_law(self.sensor_curve, self.solved.value, np.log(range_m))))

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the fitted parameters."""
        others = ("ln spot",) if self.sensor_curve is None else LENSES
        return ("ln white_m2", "ln R0", *others)[: len(self.solved.value)]

    @property
    def error(self) -> float:
        """Mean absolute error of the law on the held-out blocks, relative to the recorded values."""
        return float(np.mean(np.abs(self.law(self.check_range_m) / self.check_white_m2 - 1.0)))

    def error_of(self, sensor: Sensor) -> float:
        """The same of a sensor's photons."""
        photons_m2 = white_over_range_m2(sensor, self.check_range_m)
        return float(np.mean(np.abs(photons_m2 / self.check_white_m2 - 1.0)))

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """Estimates of K and R0, for one lens also of spot over field of view."""
        range_estimates = (
            self.solved.estimate("white_m2", "photons m2", lambda p: math.exp(p[0])),
            self.solved.estimate("near_field_m", "m", lambda p: math.exp(p[1])),
        )
        if self.sensor_curve is not None:
            lenses = LENSES[: len(self.solved.value) - 2]
            return (
                *range_estimates,
                *(self.solved.estimate(key, "", operator.itemgetter(k)) for k, key in enumerate(lenses, start=2)),
            )
        return (*range_estimates, self.solved.estimate("spot_over_field", "", lambda p: math.exp(p[2])))


def share(range_over_r0: Lanes, spot_over_field: Lanes) -> Lanes:
    """Share of the light on the detector relative to that far away (T18), lens focused at infinity."""
    far_share = -expm1(-2.0 / (spot_over_field * spot_over_field))
    near_share = receiver.gaussian_share_on_axis(spot_rad=spot_over_field, field_rad=1.0, blur_rad=1.0 / range_over_r0)
    return near_share / far_share


def spot_over_field(sensor: Sensor) -> float | None:
    """Radius of the spot over that of the field of view; None unless within `SPOT_BOUNDS` and behind one lens."""
    ratio = _spot(sensor)
    return ratio if SPOT_BOUNDS[0] < ratio < SPOT_BOUNDS[1] and sensor.optics.overlap and _one_lens(sensor) else None


def own_curve(sensor: Sensor) -> Curve | None:
    """Near field of a sensor's own optics; None if they are one lens on the laser's axis, focused at infinity."""
    overlap, r0_m = sensor.optics.overlap, near_field_m(sensor)
    if overlap is None or _one_lens(sensor):
        return None
    far_share = float(overlap.share(FAR_RATIO * r0_m))
    return lambda ratio: np.maximum(np.asarray(overlap.share(r0_m * ratio)) / far_share, LEAST_SHARE)


class LensCurve:
    """Near field of a sensor whose `LENSES` are free: a `Curve` of range over R0 and of them.

    Attributes:
        own: (4,) the file's own values of the `LENSES`
    """

    def __init__(self, sensor: Sensor) -> None:
        """Take all but the alignment from a sensor that has an overlap."""
        assert sensor.optics.overlap is not None
        self._geometry = sensor.optics.overlap.geometry
        self._aperture_m, self._r0_m = float(self._geometry.aperture_radius_m), near_field_m(sensor)
        alignment = self._geometry.alignment
        inverses = (self._r0_m / alignment.crossing_m, self._r0_m / alignment.focus_m)
        self.own = np.array([alignment.offset_m / self._aperture_m, *inverses, alignment.scattered], float)
        self._tables: dict[tuple[float, ...], Numbers] = {}

    def __call__(self, ratio: Numbers, *lenses: float) -> Numbers:
        """Share of the light at these ranges over R0, relative to that at `FAR_RATIO`."""
        self.prepare(np.array([lenses]))
        return np.asarray(np.exp(np.interp(np.log(ratio), np.log(LENS_RATIOS), self._tables[lenses])))

    def prepare(self, lenses: Numbers) -> None:
        """Integrate the overlap for all (n, 4) lenses in one call, which takes nearly the same time as for one."""
        new = np.array([row for row in lenses.tolist() if tuple(row) not in self._tables]).reshape(-1, len(LENSES))
        if not len(new):
            return
        places = np.append(LENS_RATIOS, FAR_RATIO)
        offset, crossing, focus, scattered = np.repeat(new, len(places), axis=0).T
        with np.errstate(divide="ignore"):
            alignment = Alignment(
                offset_m=offset * self._aperture_m,
                crossing_m=self._r0_m / crossing,
                focus_m=self._r0_m / focus,
                scattered=scattered,
            )
        shares = replace(self._geometry, alignment=alignment).share(self._r0_m * np.tile(places, len(new)))
        shares = shares.reshape(len(new), len(places))
        tables = np.log(np.maximum(shares[:, :-1] / shares[:, -1:], LEAST_SHARE))
        self._tables |= dict(zip(map(tuple, new.tolist()), tables, strict=True))


def _spot(sensor: Sensor) -> float:
    return 0.5 * sensor.laser.mean_divergence_rad * float(sensor.optics.focal_length_m / sensor.detector.radius_m)


def _one_lens(sensor: Sensor) -> bool:
    overlap, places = sensor.optics.overlap, np.geomspace(0.1, 10.0, 40)
    assert overlap is not None
    sensor_share = np.asarray(overlap.share(places * near_field_m(sensor)))
    lens_share = np.asarray(share(places, float(np.clip(_spot(sensor), *SPOT_BOUNDS))))
    return bool(np.abs(sensor_share / sensor_share[-1] * lens_share[-1] - lens_share).max() < SAME_LAW)


def _law(sensor_curve: Curve | None, p: Numbers, x: Numbers) -> Numbers:
    ratio = np.exp(x - p[1])
    shares = share(ratio, np.exp(p[2])) if sensor_curve is None else sensor_curve(ratio, *p[2:])
    return np.asarray(p[0] + np.log(shares))


def fit_near_field(pulses: RecordedPulses, sensor: Sensor | None = None) -> NearField | None:
    """Fit the near field to a recording; None if SIGNAL or REFLECTIVITY is missing, or too few ranges.

    Args:
        sensor: sensor whose own curve is stretched, unless it has one lens; None: law of one lens
    """
    if pulses.signal is None or pulses.reflectivity is None:
        return None
    binned = _bins(pulses.select_columns(pulses.fitted))
    check = _bins(pulses.select_columns(~pulses.fitted))
    if binned is None or check is None:
        return None
    x, y = binned[:2]
    # Start: the plateau from the highest third of the bins, the knee where the share has fallen to one half.
    plateau = float(np.median(np.sort(y)[-max(len(y) // 3, 3) :]))
    sensor_curve = None if sensor is None else own_curve(sensor)
    if sensor is None or sensor_curve is None:
        knee, knee_bounds = float(x[np.argmin(np.abs(y - plateau + math.log(2.0)))]), (x.min() - 1.5, x.max() + 1.5)
    else:
        knee = math.log(near_field_m(sensor))
        knee_bounds = knee - LONGEST_STRETCH, knee + LONGEST_STRETCH
    parameters = 3 if sensor_curve is None else 2
    start = np.array([plateau, knee, math.log(0.35)])[:parameters]
    bounds = np.array([(y.min() - 2.0, y.max() + 2.0), knee_bounds, np.log(SPOT_BOUNDS)])[:parameters].T
    near_field = _solve(binned, check, sensor_curve, start, bounds)
    if sensor is None or sensor_curve is None or near_field.misfit < LEAST_MISFIT:
        return near_field
    curve, lens_bounds = LensCurve(sensor), np.array(LENS_BOUNDS).T
    start = np.append(near_field.solved.value, np.clip(curve.own, *lens_bounds))
    free = _solve(binned, check, curve, start, np.hstack([bounds, lens_bounds]))
    return free if free.error < (1.0 - LEAST_GAIN) * near_field.error else near_field


Bins = tuple[Numbers, Numbers, Numbers, Numbers, Numbers]
"""What `_bins` returns."""


def _solve(binned: Bins, check: Bins, sensor_curve: Curve | None, start: Numbers, bounds: Numbers) -> NearField:
    """Fit a curve to the bins, from these parameters on and within (2, p) bounds.

    Free lenses are expected within `LENS_SIGMAS` of the file's.
    """
    from scipy.optimize import least_squares

    x, y, sigma, sums, counts = binned
    parameters = len(start)
    misfit, evaluations = 0.05, 0
    weight = np.ones_like(y)
    value, slope = start, np.zeros((len(y), len(start)))
    for _ in range(4):  # the misfit and the weights follow from the residuals, which follow from the weights
        root = np.sqrt(weight) / np.sqrt(sigma**2 + misfit**2)

        def residuals(p: Numbers, root: Numbers = root) -> Numbers:
            return np.append((y - _law(sensor_curve, p, x)) * root, _prior_residuals(sensor_curve, p))

        solution = least_squares(
            residuals,
            value,
            jac=_lens_slopes(sensor_curve, residuals) if isinstance(sensor_curve, LensCurve) else "2-point",
            bounds=bounds,
            x_scale="jac",
            max_nfev=MOST_EVALUATIONS // (1 + parameters),
        )
        value, slope = solution.x, solution.jac
        evaluations = max(evaluations, solution.nfev + parameters * solution.njev)
        residual = y - _law(sensor_curve, value, x)
        # What of the scatter is beyond the bins' own noise is the misfit of the law.
        excess = np.median(np.abs(residual)) * SIGMA_PER_MAD
        misfit = math.sqrt(max(excess**2 - float(np.median(sigma)) ** 2, 1e-6**2))
        weight = huber_weight(residual, np.hypot(sigma, misfit), CURVE_HUBER)
    root = np.sqrt(weight) / np.sqrt(sigma**2 + misfit**2)
    # Score of a block: its part of each bin's mean residual, times the slope of the law there.
    block_residuals = np.divide(sums - counts * _law(sensor_curve, value, x), counts.sum(axis=0))
    scores = (block_residuals * root) @ -slope[: len(x)]
    solved = Solution(value=value, slope=slope.T @ slope, scores=scores, evaluations=evaluations)
    return NearField(
        range_m=np.exp(x),
        white_m2=np.exp(y),
        sigma=sigma,
        misfit=misfit,
        sensor_curve=sensor_curve,
        solved=solved,
        check_range_m=np.exp(check[0]),
        check_white_m2=np.exp(check[1]),
    )


def _prior_residuals(sensor_curve: Curve | None, value: Numbers) -> Numbers:
    if not isinstance(sensor_curve, LensCurve):
        return np.zeros(0)
    return np.asarray((sensor_curve.own - value[2:]) / LENS_SIGMAS)


def _lens_slopes(curve: LensCurve, residuals: Callable[[Numbers], Numbers]) -> Callable[[Numbers], Numbers]:
    """Slopes of the residuals by forward differences, all overlaps of one place integrated together."""

    def slopes(value: Numbers) -> Numbers:
        steps = LENS_STEP * np.maximum(1.0, np.abs(value))
        moved = value + np.diag(steps)
        curve.prepare(np.vstack([value[2:], moved[:, 2:]]))
        centre = residuals(value)
        return np.stack([(residuals(row) - centre) / step for row, step in zip(moved, steps, strict=True)], axis=1)

    return slopes


def _bins(pulses: RecordedPulses) -> Bins | None:
    """Bin pulses by ln R: (bins,) mean ln R, mean ln white_m2, its sigma; (blocks, bins) sums of it, and counts."""
    from scipy import ndimage

    assert pulses.signal is not None
    assert pulses.reflectivity is not None
    mask = pulses.has_return & (pulses.signal >= LEAST_SIGNAL)
    mask &= (pulses.reflectivity >= LEAST_REFLECTIVITY) & (pulses.reflectivity < MOST_REFLECTIVITY)
    if mask.sum() < LEAST_PULSES:
        return None
    x = np.log(pulses.range_m[mask])
    y = np.log(pulses.signal[mask] * 100.0 / pulses.reflectivity[mask]) + 2.0 * x
    block = pulses.blocks(mask)
    bin_index = np.unique(np.floor(x / LOG_RANGE_STEP), return_inverse=True)[1]
    median = np.asarray(ndimage.median(y, bin_index, np.arange(bin_index.max() + 1)))
    near_median = np.abs(y - median[bin_index]) < OUTLIER
    in_full_bin = near_median & (np.bincount(bin_index[near_median], minlength=len(median))[bin_index] >= LEAST_PULSES)
    x, y, block = x[in_full_bin], y[in_full_bin], block[in_full_bin]
    bins, bin_index = np.unique(bin_index[in_full_bin], return_inverse=True)
    if len(bins) < LEAST_BINS:
        return None
    # Move each pulse to the middle of its bin along the bin's regression line, so that its place adds no scatter.
    n = np.bincount(bin_index)
    middle_x, middle_y = (np.bincount(bin_index, values) / n for values in (x, y))
    offset = x - middle_x[bin_index]
    rise = np.bincount(bin_index, offset * y) / np.maximum(np.bincount(bin_index, offset * offset), 1e-12)
    y = y - rise[bin_index] * offset
    spread = np.sqrt(np.bincount(bin_index, (y - middle_y[bin_index]) ** 2) / n)
    shape = (int(block.max()) + 1, len(bins))
    flat = block * shape[1] + bin_index
    counts, sums = (np.bincount(flat, weights, minlength=shape[0] * shape[1]).reshape(shape) for weights in (None, y))
    return middle_x, middle_y, np.maximum(spread / np.sqrt(n), 1e-6), sums, counts
