"""Laser power, amplifier noise and background of a sensor, fitted to all ranges that its maker publishes, together.

Ranges know ratios only. Without the sun, R^2 goes with power over noise; in it, the noise of the wall's sunlight adds,
so that from one reflectivity to another, and from day to night, R tells sunlight over noise. Power, noise and sunlight
with one factor each (p, p and p^2) leave all ranges as they are. What is assumed of noise and sunlight, and within
which factor, is in the file (`published.unknowns`). The logarithms of the unknowns, theta, minimise

    sum_i (ln R_i(theta) - ln R_i)^2 / s^2 + sum_k (theta_k - a_k)^2 / ln(f_k)^2

with published ranges R_i, assumptions a_k and their factors f_k: the most probable values, whose covariance is the
inverse of the second derivatives (Laplace). The power has no second term.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...maths.arrays import Numbers
from ...sensor.readout import PublishedFile
from ...sensor.sensor_file import load_sensor, published_performance
from ...sensor.sensor_model import Sensor
from ..ranging.plane import FARTHEST_M, NEAREST_M, Target, maximum_range_m
from .tuning import RANGE_SIGMA, UNDETERMINED

POWER = "laser.peak_power_w"
"""Key of the unknown of which nothing is assumed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedRanges:
    """(n,) ranges that a maker publishes, with the reflectivity and the illuminance of each."""

    reflectivity: Numbers
    illuminance_klux: Numbers
    range_m: Numbers

    @classmethod
    def of(cls, published: PublishedFile) -> PublishedRanges | None:
        """Take all ranges of a file; None without one."""
        if published.range_m is None:
            return None
        day = ((published.reflectivity, published.range_m), *published.also)
        rows = [(share, published.illuminance_klux, range_m) for share, range_m in day]
        rows += [(share, 0.0, range_m) for share, range_m in published.dark]
        share, klux, range_m = np.array(rows, dtype=np.float64).T
        return cls(reflectivity=share, illuminance_klux=klux, range_m=range_m)

    def simulated_m(self, sensor: Sensor) -> Numbers:
        """(n,) ranges of a sensor under the same conditions."""
        return reached_m(sensor, Target(reflectivity=self.reflectivity, illuminance_klux=self.illuminance_klux))


def reached_m(sensor: Sensor, target: Target) -> Numbers:
    """`maximum_range_m`; where there is none, the nearest or farthest that is sought, which have a logarithm."""
    return np.asarray(np.clip(maximum_range_m(sensor, target)[0], NEAREST_M, FARTHEST_M))


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedNumber:
    """Number of a sensor file by the published ranges, in the unit of its key.

    Attributes:
        sigma: standard deviation of its logarithm
        sigma_alone: the same with all other unknowns as they are
        prior: standard deviation of its logarithm by what is assumed; inf: nothing is
    """

    key: str
    value: float
    sigma: float
    sigma_alone: float
    prior: float

    @property
    def interval(self) -> tuple[float, float]:
        """Ends of one standard deviation either way."""
        return self.value * math.exp(-self.sigma), self.value * math.exp(self.sigma)

    @property
    def is_determined(self) -> bool:
        """True if the ranges leave less than half of what is assumed open, and a factor below 2 where nothing is."""
        return self.sigma < UNDETERMINED * min(self.prior, 2.0 * math.log(2.0))

    def __str__(self) -> str:
        """Interval, and how sure the number is alone."""
        low, high = self.interval
        text = f"{low:.3g} to {high:.3g}, {100.0 * math.expm1(self.sigma_alone):.0f} % with the others as they are"
        return text if self.is_determined else f"{text}; not determined by the published ranges alone"


def fit_published(name: str) -> tuple[FittedNumber, ...]:
    """Fit the unknowns of `[published]` to all its ranges; none without unknowns.

    Args:
        name: sensor of the catalogue, or its file

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    from scipy.optimize import least_squares

    published = published_performance(name)
    ranges = None if published is None else PublishedRanges.of(published)
    if published is None or ranges is None or not published.unknowns:
        return ()
    keys = (POWER, *published.unknowns)
    assumed = np.array([value for value, _ in published.unknowns.values()])
    priors = np.log([factor for _, factor in published.unknowns.values()])
    power_w = float(load_sensor(name).laser.peak_power_w)
    start = np.log([power_w, *assumed])

    def misfit(logs: Numbers) -> Numbers:
        values = zip(keys, np.exp(logs).tolist(), strict=True)
        sensor = load_sensor(name, overrides=(*published.settings, *(f"{key}={value!r}" for key, value in values)))
        deviations = np.log(ranges.simulated_m(sensor) / ranges.range_m) / RANGE_SIGMA
        return np.concatenate([deviations, (logs[1:] - start[1:]) / priors])

    found = least_squares(misfit, start, diff_step=1e-4, x_scale="jac")
    information = found.jac.T @ found.jac
    sigma = np.sqrt(np.diag(np.linalg.inv(information)))
    rows = zip(keys, np.exp(found.x), sigma, 1.0 / np.sqrt(np.diag(information)), (math.inf, *priors), strict=True)
    return tuple(
        FittedNumber(key=key, value=float(value), sigma=float(all_open), sigma_alone=float(alone), prior=float(prior))
        for key, value, all_open, alone, prior in rows
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class RangeLaw:
    """How a published range changes with reflectivity, or from day to night, beside the sensor's own.

    Attributes:
        published: exponent of the range over the reflectivity, or night's range over day's
        sigma: standard deviation of the published one, of its logarithm for a ratio
    """

    condition: str
    published: float
    simulated: float
    sigma: float


def exponents(ranges: PublishedRanges, sensor: Sensor) -> Iterator[RangeLaw]:
    """Exponent x of R ~ reflectivity^x between the darkest and the brightest target, in each light."""
    simulated_m = ranges.simulated_m(sensor)
    for klux in np.unique(ranges.illuminance_klux)[::-1]:
        lit = np.flatnonzero(ranges.illuminance_klux == klux)
        dark, bright = (lit[pick(ranges.reflectivity[lit])] for pick in (np.argmin, np.argmax))
        apart = math.log(ranges.reflectivity[bright] / ranges.reflectivity[dark])
        if apart > 0.0:
            yield RangeLaw(
                condition=f"{ranges.reflectivity[dark]:.0%} to {ranges.reflectivity[bright]:.0%}, {klux:g} klux",
                published=math.log(ranges.range_m[bright] / ranges.range_m[dark]) / apart,
                simulated=math.log(simulated_m[bright] / simulated_m[dark]) / apart,
                sigma=math.sqrt(2.0) * RANGE_SIGMA / apart,
            )


def nights_over_days(ranges: PublishedRanges, sensor: Sensor) -> Iterator[RangeLaw]:
    """Range without light over that in it, for each reflectivity of which both are published."""
    simulated_m = ranges.simulated_m(sensor)
    for night, day in itertools.product(range(len(simulated_m)), repeat=2):
        same = ranges.reflectivity[night] == ranges.reflectivity[day]
        if same and ranges.illuminance_klux[night] == 0.0 < ranges.illuminance_klux[day]:
            yield RangeLaw(
                condition=f"{ranges.reflectivity[day]:.0%}, {ranges.illuminance_klux[day]:g} klux",
                published=float(ranges.range_m[night] / ranges.range_m[day]),
                simulated=float(simulated_m[night] / simulated_m[day]),
                sigma=math.sqrt(2.0) * RANGE_SIGMA,
            )
