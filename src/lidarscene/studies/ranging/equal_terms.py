"""Equal terms: sensors under the same statistics, false alarms and eye safety, each at its best gain.

Two sensor files may differ by what nobody can build: a peak power that the eye forbids, a gain that costs range, a
threshold with more false alarms, statistics that leave out the pulse's course. A comparison of detectors takes these
away first. What the file says is compared beside it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...errors import InputError
from ...sensor.detectors import Apd, Sipm
from ...sensor.sensor_model import Sensor
from ..eye_safety.eye_safety_report import eye_safety_report
from . import plane, statistics
from .curves import with_haze
from .plane import Target

PROBABILITY = 0.9
"""P_d at the range of a verdict."""

_GAINS = (1.0, 1000.0)
_RATIOS = (0.5, 50.0)  # thresholds over noise that are tried
_NO_GAIN_WORTH = 0.01
"""Share of the range below which a better gain is not named."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Terms:
    """Sensor as its file has it and on equal terms, with the range of each at a P_d of `PROBABILITY`.

    false_points  per pulse, on equal terms
    changes       what its file has otherwise, in words
    """

    name: str
    sensor: Sensor
    file_range_m: float
    range_m: float
    false_points: float
    changes: tuple[str, ...]


def equal_terms(
    sensors: Sequence[tuple[str, Sensor]], target: Target, *, visibility_m: float | None = None
) -> list[Terms]:
    """Put sensors on equal terms; each has as many false points a pulse as the first.

    visibility_m  of the air, whose extinction depends on the wavelength; None: that of the target

    Time-domain statistics, class 1 with the beam scanning, the gain of the longest range. A threshold that is no ratio
    to the noise stays, and so does a power that is not known; `Terms.changes` says so.
    """
    per_pulse = statistics.false_points(_physical(sensors[0][1])[0], target).per_pulse
    return [_terms(name, sensor, with_haze(sensor, target, visibility_m), per_pulse) for name, sensor in sensors]


def verdict(terms: Sequence[Terms], target: Target) -> tuple[str, str]:
    """Sentences on the ranges on equal terms, and on what the files have otherwise."""
    order = sorted(terms, key=lambda entry: -entry.range_m)
    reached = ", ".join(f"{entry.name} {_range_text(entry.range_m)}" for entry in order)
    plane_text = f"{100 * target.reflectivity:.3g} % under {target.illuminance_klux:g} klux"
    lead = (
        f"On equal terms (time domain, class 1 scanning, best gain, {terms[0].false_points:.2g} false points a pulse), "
        f"range at P_d {PROBABILITY:g} on {plane_text}: {reached}."
    )
    otherwise = "; ".join(
        f"{entry.name} {_range_text(entry.file_range_m)}{' with ' if entry.changes else ''}{', '.join(entry.changes)}"
        for entry in terms
    )
    return lead, f"As their files have them: {otherwise}."


def _terms(name: str, sensor: Sensor, target: Target, per_pulse: float) -> Terms:
    equal, changes = _physical(sensor)
    equal, power_change = _safe(equal)
    changes += power_change
    if equal.tdc.threshold_to_noise is None:
        changes += ("a threshold that is not a ratio to noise",)
    else:
        before = float(equal.tdc.threshold_to_noise)
        equal = _with_false_points(equal, target, per_pulse)
        after = float(equal.tdc.threshold_to_noise or 0.0)
        if abs(after - before) > 0.005 * before:
            changes += (f"threshold {before:.3g} of the noise for {after:.3g}",)
    if isinstance(equal.detector, Apd):
        equal, gain_change = _at_best_gain(equal, equal.detector, target, per_pulse)
        changes += gain_change
    return Terms(
        name=name,
        sensor=equal,
        file_range_m=plane.range_at_probability_m(sensor, target, PROBABILITY),
        range_m=plane.range_at_probability_m(equal, target, PROBABILITY),
        false_points=statistics.false_points(equal, target).per_pulse,
        changes=changes,
    )


def _physical(sensor: Sensor) -> tuple[Sensor, tuple[str, ...]]:
    """Sensor with the statistics of the time domain, and what it had otherwise."""
    detector = sensor.detector
    if not isinstance(detector, Sipm) or detector.statistics == "time_domain":
        return sensor, ()
    words = (f"{detector.statistics.replace('_', ' ')} statistics",)
    return replace(sensor, detector=replace(detector, statistics="time_domain")), words


def _safe(sensor: Sensor) -> tuple[Sensor, tuple[str, ...]]:
    """Sensor with at most the power of class 1, the beam scanning."""
    power_w = float(sensor.laser.peak_power_w)
    try:
        report = eye_safety_report(sensor, scanned=True)
    except InputError:
        return sensor, ("a laser outside the tables of eye safety",)
    if report.not_known:
        return sensor, ("a laser whose pulse is not known, so that class 1 is not judged",)
    if report.margin >= 1.0:
        return sensor, ()
    limit_w = report.class_1_peak_power_w
    words = f"{power_w:.3g} W, {power_w / limit_w:.3g} times class 1"
    return replace(sensor, laser=replace(sensor.laser, peak_power_w=limit_w)), (words,)


def _with_false_points(sensor: Sensor, target: Target, per_pulse: float) -> Sensor:
    """Sensor whose threshold gives as many false points on the sky; the nearest one within `_RATIOS`."""

    def with_ratio(log_ratio: float) -> Sensor:
        return replace(sensor, tdc=replace(sensor.tdc, threshold_to_noise=math.exp(log_ratio)))

    def excess(log_ratio: float) -> float:
        points = statistics.false_points(with_ratio(log_ratio), target).per_pulse
        return math.log(max(points, 1e-300)) - math.log(max(per_pulse, 1e-300))

    return with_ratio(_root(excess, math.log(_RATIOS[0]), math.log(_RATIOS[1])))


def _root(falling: Callable[[float], float], low: float, high: float) -> float:
    """Root of a falling function; the end where it has none."""
    from scipy.optimize import brentq

    if falling(low) <= 0.0:
        return low
    if falling(high) >= 0.0:
        return high
    return float(brentq(falling, low, high, xtol=1e-6))


def _at_best_gain(sensor: Sensor, diode: Apd, target: Target, per_pulse: float) -> tuple[Sensor, tuple[str, ...]]:
    """Sensor at the gain of the longest range, its false points held, and the gain that it had."""
    from scipy.optimize import minimize_scalar

    def with_gain(log_gain: float) -> Sensor:
        tuned = replace(sensor, detector=replace(diode, gain=math.exp(log_gain)))
        return tuned if tuned.tdc.threshold_to_noise is None else _with_false_points(tuned, target, per_pulse)

    def shortfall(log_gain: float) -> float:
        return -plane.range_at_probability_m(with_gain(log_gain), target, PROBABILITY)

    bounds = tuple(np.log(_GAINS))
    best = minimize_scalar(shortfall, bounds=bounds, method="bounded", options={"xatol": 1e-3})
    present = -shortfall(math.log(float(diode.gain)))
    if not -best.fun > present * (1.0 + _NO_GAIN_WORTH):
        return with_gain(math.log(float(diode.gain))), ()
    return with_gain(float(best.x)), (f"gain {diode.gain:.3g}, best {math.exp(best.x):.3g}",)


def _range_text(range_m: float) -> str:
    return f"{range_m:.1f} m" if range_m > 0.0 else "nothing"
