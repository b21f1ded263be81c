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
from functools import partial

import numpy as np

from ...maths.arrays import Lanes, Numbers
from ...maths.special import expm1
from ...physics.optics import receiver
from ...sensor.overlap import Alignment
from ...sensor.sensor_model import Sensor
from .binned_fit import Prior, Statistics, misfit_beyond, solve
from .estimates import Estimate, Solution, exponential
from .noise_photons import SIGNAL_ERROR, noise_bins
from .products import at_pulses, near_field_m, white_over_range_m2
from .recorded_pulses import RecordedPulses
from .tuning import (
    FAR_RATIO,
    FIRST_MISFIT,
    LEAST_GAIN,
    LEAST_MISFIT,
    LEAST_REFLECTIVITY,
    LEAST_SHARE,
    LEAST_SIGNAL,
    LENS_BOUNDS,
    LENS_SIGMAS,
    LOG_RANGE_STEP,
    LONGEST_STRETCH,
    MOST_CHECK_SIGMA,
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
        sensor_curve: curve of the sensor's own optics; None: law of one lens
        solved: solution: ln K, ln R0; for one lens also ln of the spot's radius over the field's, for free lenses the
            `LENSES`
        check_range_m: ``range_m`` for the held-out blocks
        check_white_m2: ``white_m2`` for the held-out blocks
    """

    range_m: Numbers
    white_m2: Numbers
    sigma: Numbers
    sensor_curve: Curve | None
    solved: Solution
    check_range_m: Numbers
    check_white_m2: Numbers

    def law(self, range_m: Numbers) -> Numbers:
        """Evaluate the fitted white_m2 at these ranges."""
        return np.asarray(np.exp(_laws(self.sensor_curve, self.solved.value[None], np.log(range_m))[0]))

    @property
    def misfit(self) -> float:
        """Standard deviation of ln white_m2 that the law leaves unexplained."""
        return misfit_beyond(np.log(self.white_m2 / self.law(self.range_m)), self.sigma)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the fitted parameters."""
        others = ("ln spot",) if self.sensor_curve is None else LENSES
        return ("ln white_m2", "ln R0", *others)[: len(self.solved.value)]

    @property
    def error(self) -> float:
        """Mean absolute error of the law on the held-out blocks, relative to the recorded values."""
        return float(np.mean(np.abs(self.law(self.check_range_m) / self.check_white_m2 - 1.0)))

    def error_of(self, sensor: Sensor) -> float | None:
        """The same of a sensor's photons; None: no held-out bin is certain enough to judge."""
        if not len(self.check_range_m):
            return None
        photons_m2 = white_over_range_m2(sensor, self.check_range_m)
        return float(np.mean(np.abs(photons_m2 / self.check_white_m2 - 1.0)))

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """Estimates of K and R0, for one lens also of spot over field of view."""
        units = {"white_m2": "photons m2", "near_field_m": "m"}
        if self.sensor_curve is None:
            units["spot_over_field"] = ""
        lenses = LENSES[: len(self.solved.value) - len(units)]
        return (
            *(self.solved.estimate(*item, exponential(k)) for k, item in enumerate(units.items())),
            *(self.solved.estimate(key, "", operator.itemgetter(k)) for k, key in enumerate(lenses, start=2)),
        )


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

    def __call__(self, ratio: Numbers, *lenses: Numbers | float) -> Numbers:
        """Share of the light relative to that at `FAR_RATIO`, (m, k); in one call, which takes the time of one lens.

        Args:
            ratio: (m, k) ranges over R0
            lenses: (m, 1) of each of the `LENSES`
        """
        places = np.reshape(ratio, (np.size(lenses[0]), -1))
        places = np.append(places, np.full_like(places[:, :1], FAR_RATIO), axis=1)
        offset, crossing, focus, scattered = (np.repeat(lens, places.shape[1]) for lens in lenses)
        with np.errstate(divide="ignore"):
            alignment = Alignment(
                offset_m=offset * self._aperture_m,
                crossing_m=self._r0_m / crossing,
                focus_m=self._r0_m / focus,
                scattered=scattered,
            )
        shares = replace(self._geometry, alignment=alignment).share(self._r0_m * places.ravel())
        shares = shares.reshape(places.shape)
        return np.reshape(np.maximum(shares[:, :-1] / shares[:, -1:], LEAST_SHARE), np.shape(ratio))


def _spot(sensor: Sensor) -> float:
    return 0.5 * sensor.laser.mean_divergence_rad * float(sensor.optics.focal_length_m / sensor.detector.radius_m)


def _one_lens(sensor: Sensor) -> bool:
    overlap, places = sensor.optics.overlap, np.geomspace(0.1, 10.0, 40)
    assert overlap is not None
    sensor_share = np.asarray(overlap.share(places * near_field_m(sensor)))
    lens_share = np.asarray(share(places, float(np.clip(_spot(sensor), *SPOT_BOUNDS))))
    return bool(np.abs(sensor_share / sensor_share[-1] * lens_share[-1] - lens_share).max() < SAME_LAW)


def _laws(sensor_curve: Curve | None, places: Numbers, x: Numbers) -> Numbers:
    """(m, k) ln white_m2 of (m, p) parameters at (k,) ln R."""
    ratio = np.exp(x - places[:, 1:2])
    others = places.T[2:, :, None]
    shares = share(ratio, np.exp(others[0])) if sensor_curve is None else sensor_curve(ratio, *others)
    return np.asarray(places[:, :1] + np.log(shares))


def fit_near_field(pulses: RecordedPulses, sensor: Sensor | None = None) -> NearField | None:
    """Fit the near field to a recording; None if SIGNAL or REFLECTIVITY is missing, or too few ranges.

    Args:
        sensor: sensor whose own curve is stretched, unless it has one lens; None: law of one lens. Without SIGNAL the
            noise of REFLECTIVITY tells the photons of one that counts them (`noise_photons`)
    """
    if pulses.reflectivity is None or (pulses.signal is None and (sensor is None or sensor.histogram is None)):
        return None
    fitted, check = (_bins(pulses.select_columns(mask), sensor) for mask in (pulses.fitted, ~pulses.fitted))
    if fitted is None or check is None:
        return None
    (x, binned), y = fitted, fitted[1].value
    judging = check[1].sigma < MOST_CHECK_SIGMA
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

    def near_field(curve: Curve | None, start: Numbers, bounds: Numbers, prior: Prior) -> NearField:
        solved = solve(binned, lambda place: _laws(curve, place[None], x)[0], start, bounds, prior)
        return NearField(
            range_m=np.exp(x),
            white_m2=np.exp(y),
            sigma=binned.sigma,
            sensor_curve=curve,
            solved=solved,
            check_range_m=np.exp(check[0][judging]),
            check_white_m2=np.exp(check[1].value[judging]),
        )

    stretched = near_field(sensor_curve, start, bounds, Prior(start, np.full_like(start, np.inf), FIRST_MISFIT))
    if pulses.signal is None:
        error = np.zeros_like(stretched.solved.slope)
        error[0, 0] = SIGNAL_ERROR**2
        return replace(stretched, solved=stretched.solved.wider(error))
    if sensor is None or sensor_curve is None or stretched.misfit < LEAST_MISFIT:
        return stretched
    lens_curve, lens_bounds = LensCurve(sensor), np.array(LENS_BOUNDS).T
    start = np.append(stretched.solved.value, np.clip(lens_curve.own, *lens_bounds))
    prior = Prior(np.append(start[:2], lens_curve.own), np.array([np.inf, np.inf, *LENS_SIGMAS]), FIRST_MISFIT)
    free = near_field(lens_curve, start, np.hstack([bounds, lens_bounds]), prior)
    return free if free.error < (1.0 - LEAST_GAIN) * stretched.error else stretched


def _bins(pulses: RecordedPulses, sensor: Sensor | None) -> tuple[Numbers, Statistics] | None:
    """Bin pulses by ln R: (bins,) its mean, and the means of ln white_m2; None of too few.

    Args:
        sensor: whose curve weighs the noise of REFLECTIVITY, if SIGNAL is not recorded
    """
    from scipy import ndimage

    assert pulses.reflectivity is not None
    if pulses.signal is None:
        assert sensor is not None
        binned = noise_bins(pulses, at_pulses(partial(white_over_range_m2, sensor), pulses.range_m))
        return binned if binned is not None and len(binned[0]) >= LEAST_BINS else None
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
    middle_x = np.bincount(bin_index, x) / n
    offset = x - middle_x[bin_index]
    rise = np.bincount(bin_index, offset * y) / np.maximum(np.bincount(bin_index, offset * offset), 1e-12)
    y = y - rise[bin_index] * offset
    members = [np.flatnonzero(bin_index == number) for number in range(len(bins))]
    return middle_x, Statistics.of([y[chosen] for chosen in members], members, block)
