"""False alarms of a sensor among the points of a frame.

The formulas are those of `physics.electronics.tdc` and of the detector's working point, which `render` uses too. No
tracing, no LLVM.

Symbols: P_d detection probability.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from ...maths.arrays import Lanes, Numbers
from ...physics.constants import SPEED_OF_LIGHT_M_S
from ...sensor.detectors import WorkingPoint
from ...sensor.sensor_model import Sensor
from . import plane
from .plane import Target

_DEVIATES = [NormalDist().inv_cdf((k + 0.5) / 200.0) for k in range(200)]
"""Quantiles of the standard normal distribution at 200 equally likely places."""


@dataclass(frozen=True, slots=True)
class FalsePoints:
    """Expected false alarms among the points of one frame.

    Attributes:
        per_pulse: mean number reported for one pulse
        per_frame: per_pulse times the pulses of a frame, all of them on the same target or sky
    """

    per_pulse: float
    per_frame: float


def false_points(sensor: Sensor, target: Target, range_m: float | None = None) -> FalsePoints:
    """Expected false points of a frame whose pulses all meet this target, or for a range of None the sky.

    Exact for the Poisson alarms of (10) and a converter that keeps its first stops, of any number: alarms before the
    echo may take its stop, and alarms after it need a stop that is still free. Of one that keeps the last or the
    strongest only without an echo in the window.
    """
    point = sensor.working_point(background_w(sensor, target, sky=range_m is None))
    rate = float(np.ravel(_alarms_hz(sensor, point, sensor.threshold(point)))[0])
    blanking_s, window_s = float(sensor.tdc.blanking_s), float(sensor.tdc.window_s)
    stops = sensor.tdc.stops
    per_pulse = _mean_of_first(rate * (window_s - blanking_s), stops)
    arrival_s = math.inf if range_m is None else 2.0 * range_m / SPEED_OF_LIGHT_M_S
    if range_m is not None and blanking_s <= arrival_s < window_s:
        p_detect = float(plane.detection_probability(sensor, target, range_m)[0])
        before, after = rate * (arrival_s - blanking_s), rate * (window_s - arrival_s)
        # With n alarms before it, the echo takes a stop if n < stops; stops - 1 - n are then free for alarms after it.
        with_echo = _mean_of_first(before, stops) + sum(
            _poisson(before, n) * _mean_of_first(after, stops - 1 - n) for n in range(stops)
        )
        per_pulse = p_detect * with_echo + (1.0 - p_detect) * per_pulse
    return FalsePoints(per_pulse, per_pulse * sensor.scanner.pulses)


def background_w(sensor: Sensor, target: Target, *, sky: bool) -> Numbers:
    """(1,) light on the detector in W from the target or the sky."""
    return np.asarray(plane.echoes_of_plane(sensor, target, -1.0 if sky else 1.0).background_power_w)


def _alarms_hz(sensor: Sensor, point: WorkingPoint, threshold: Lanes) -> Lanes:
    """Rate of false alarms."""
    return mean_over_points(sensor, threshold, lambda level: sensor.false_alarm_rate_hz(point, level))


def mean_over_points(sensor: Sensor, threshold: Lanes, formula: Callable[[Lanes], Lanes]) -> Lanes:
    """Mean of a formula over the thresholds that the noise of the points meets, where these scatter (T111)."""
    histogram = sensor.histogram
    if histogram is None:
        return formula(threshold)
    if histogram.threshold_spread is None or histogram.neighbours:
        return formula(histogram.threshold_of_noise(threshold, 0.0))
    values = [np.asarray(formula(histogram.threshold_of_noise(threshold, place))) for place in _DEVIATES]
    return np.asarray(np.mean(values, axis=0))


def _poisson(mean: float, count: int) -> float:
    return math.exp(-mean) * mean**count / math.factorial(count)


def _mean_of_first(mean: float, stops: int) -> float:
    """Mean of min(N, stops) for Poisson N: the sum of P(N >= n) for n from 1 to stops."""
    at_least, total = -math.expm1(-mean), 0.0
    for n in range(1, stops + 1):
        total += at_least
        at_least = max(at_least - _poisson(mean, n), 0.0)
    return total
