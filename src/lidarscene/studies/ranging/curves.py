"""Curves of a quantity over an axis for several sensors, and the places where they cross.

A crossing answers "which sensor sees farther, and from where on?". It is not interpolated from the sampled curve: the
samples only bracket it, and the bracket is evaluated again, finer and finer, to a relative width of 1e-10.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...maths.arrays import Numbers
from ...physics.optics import air
from ...sensor.sensor_model import Sensor
from . import plane
from .aperture_laws import LAWS, of_scanner
from .conditions import PROBABILITY
from .plane import RangeStatus, Target
from .subjects import Subject
from .sweep_axes import Axis

_FINE = 33  # evaluations in a bracket at a time

_CLOSE = 1e-10
"""Accuracy bought: relative width of a crossing's final bracket."""

_JUMP = 1e-4
"""Accuracy bought: difference in the final bracket above which a curve jumps there, and does not cross."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """Quantity to compute along an axis, and the conditions.

    Attributes:
        distance_m: distance of the target, for "snr" and "pd" over an axis other than distance
        probability: P_d at the range, and where "snr" and "pd" are marked
        law: for an elevation or azimuth axis: "scanner" (the sensor's own) or one of `aperture_laws.LAWS`
        visibility_m: adds extinction by Kim at the sensor's wavelength; None for clear air
    """

    quantity: str
    axis: Axis
    target: Target = field(default_factory=Target)
    distance_m: float = 100.0
    probability: float = PROBABILITY
    law: str = "scanner"
    visibility_m: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepCurve:
    """One sensor's values along the axis.

    Attributes:
        excess: P_d less that at the range, for "snr" and "pd"; None for "range"
        status: `RangeStatus`, for "range"
    """

    name: str
    values: Numbers
    excess: Numbers | None = None
    status: Numbers | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveCrossing:
    """Place where two curves are equal or, with an empty ``second``, where one has the P_d of its range.

    Attributes:
        place: value on the axis
        value: value of the curves
        falls: True if the first falls below the second, or below that P_d, towards larger x
    """

    first: str
    second: str
    place: float
    value: float
    falls: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Curves:
    """All curves of a question and their crossings, in order along the axis.

    Attributes:
        detection_limits: places where P_d is that at the range
    """

    question: Question
    curves: tuple[SweepCurve, ...]
    crossings: tuple[CurveCrossing, ...]
    detection_limits: tuple[CurveCrossing, ...]


def conditions_for(subject: Subject, question: Question, x: Numbers) -> list[tuple[Sensor, Target]]:
    """Sensor and target along the axis.

    One pair with arrays if the sensor's numbers can be stacked, else one pair for each x.
    """
    axis, target = question.axis, question.target
    if not axis.is_parameter:
        sensor = subject.sensor()
        return [(sensor, with_haze(sensor, _target_along(sensor, target, question, x), question.visibility_m))]
    sensors = [subject.sensor_with(axis.key, float(value), whole=axis.whole) for value in x]
    stack = plane.stack_sensors(sensors)
    if stack is None:
        return [(sensor, with_haze(sensor, target, question.visibility_m)) for sensor in sensors]
    hazy = [with_haze(sensor, target, question.visibility_m).extinction_per_m for sensor in sensors]
    # An array even where nothing differs, so that all conditions have the axis's shape.
    return [(stack, replace(target, extinction_per_m=np.array(hazy, dtype=np.float64)))]


def _target_along(sensor: Sensor, target: Target, question: Question, x: Numbers) -> Target:
    """Target with the values x of the swept condition; distance is no property of a target."""
    match question.axis.key:
        case "illuminance_klux":
            return replace(target, illuminance_klux=x)
        case "reflectivity":
            return replace(target, reflectivity=x)
        case "incidence":
            return replace(target, cos_incidence=np.maximum(np.cos(np.radians(x)), 0.0))
        case "elevation" | "azimuth":
            law = question.law
            shares = of_scanner(sensor.scanner, question.axis.key, x) if law == "scanner" else (LAWS[law](x),) * 2
            echo, background = (np.maximum(share, 0.0) for share in shares)
            return replace(target, aperture_share=echo, background_share=background)
    return target


def with_haze(sensor: Sensor, target: Target, visibility_m: float | None) -> Target:
    """Add the extinction of this visibility at the sensor's wavelength to the target's; nothing if None."""
    if visibility_m is None:
        return target
    alpha = air.extinction_from_visibility_per_m(visibility_m=visibility_m, wavelength_m=sensor.laser.wavelength_m)
    return replace(target, extinction_per_m=target.extinction_per_m + alpha)


def curve(subject: Subject, question: Question, x: Numbers) -> SweepCurve:
    """Curve of a sensor at these x."""
    pairs = conditions_for(subject, question, x)
    if question.quantity == "range":
        limits = [plane.detection_range_m(sensor, target, question.probability) for sensor, target in pairs]
        values = np.concatenate([np.atleast_1d(limit) for limit, _ in limits])
        status = np.concatenate([np.atleast_1d(status) for _, status in limits])
        return SweepCurve(
            name=subject.name, values=np.broadcast_to(values, x.shape), status=np.broadcast_to(status, x.shape)
        )
    distance: Any = x if question.axis.key == "distance" else question.distance_m
    values = detected = np.concatenate([plane.detection_probability(*pair, distance) for pair in pairs])
    if question.quantity == "snr":
        values = np.concatenate([plane.snr(*pair, distance) for pair in pairs])
    excess = np.broadcast_to(detected - question.probability, x.shape)
    return SweepCurve(name=subject.name, values=np.broadcast_to(values, x.shape), excess=excess)


def curves(subjects: Sequence[Subject], question: Question) -> Curves:
    """Compute every sensor's curve, the crossings of any two, and the places where P_d is that at the range."""
    x = question.axis.values
    sensor_curves = [curve(subject, question, x) for subject in subjects]
    crossings: list[CurveCrossing] = []
    for (first_subject, first_curve), (second_subject, second_curve) in itertools.combinations(
        zip(subjects, sensor_curves, strict=True), 2
    ):
        crossings += _crossings(
            question, (first_subject, second_subject), _difference(question, first_curve, second_curve)
        )
    limits: list[CurveCrossing] = []
    for subject, sensor_curve in zip(subjects, sensor_curves, strict=True):
        if sensor_curve.excess is not None:
            limits += _crossings(question, (subject,), sensor_curve.excess)
    return Curves(
        question=question,
        curves=tuple(sensor_curves),
        crossings=tuple(sorted(crossings, key=lambda crossing: crossing.place)),
        detection_limits=tuple(limits),
    )


def _difference(question: Question, first: SweepCurve, second: SweepCurve, *, tolerance: float = 1e-9) -> Numbers:
    """(n,) relative difference of two curves; 0 where it is at most ``tolerance`` or both are negligible."""
    a, b = first.values, second.values
    both_finite = np.isfinite(a) & np.isfinite(b)
    size = np.where(both_finite, np.maximum(np.abs(a), np.abs(b)), 1.0)
    least = 1e-6 if question.quantity == "pd" else 0.0
    with np.errstate(invalid="ignore"):
        part = np.where(both_finite & (size > least), (a - b) / np.where(size > 0.0, size, 1.0), 0.0)
    unlimited = np.isinf(a).astype(float) - np.isinf(b).astype(float)
    part = np.where(both_finite, part, unlimited)
    return np.where(np.abs(part) > tolerance, part, 0.0)


def _crossings(question: Question, pair: tuple[Subject, ...], height: Numbers) -> list[CurveCrossing]:
    """Find the places where a height, sampled along the axis, changes its sign."""

    def height_at(x: Numbers) -> tuple[Numbers, Numbers]:
        pair_curves = [curve(subject, question, x) for subject in pair]
        if len(pair_curves) == 2:
            return _difference(question, *pair_curves, tolerance=0.0), pair_curves[0].values
        assert pair_curves[0].excess is not None
        return pair_curves[0].excess, pair_curves[0].values

    x = question.axis.values
    places = np.flatnonzero(height != 0.0)
    crossings = []
    for low, high in itertools.pairwise(places):
        if height[low] * height[high] < 0.0:
            place_and_value = _refine(
                question.axis, height_at, float(x[low]), float(x[high]), falls=bool(height[low] > 0.0)
            )
            if place_and_value is not None:
                place, value = place_and_value
                second = pair[1].name if len(pair) == 2 else ""
                crossings.append(
                    CurveCrossing(
                        first=pair[0].name, second=second, place=place, value=value, falls=bool(height[low] > 0.0)
                    )
                )
    return crossings


def _refine(
    axis: Axis, height_at: Callable[[Numbers], tuple[Numbers, Numbers]], low: float, high: float, *, falls: bool
) -> tuple[float, float] | None:
    """Place and value of a change of sign in this bracket; None if it is a jump.

    On an axis of whole numbers it is the first number after the change.
    """
    while True:
        steps = axis.between(low, high, _FINE)
        steps = np.unique(np.rint(steps)) if axis.whole else steps
        height, values = height_at(steps)
        # The last step before the change becomes the lower end of the next bracket.
        before_change = height > 0.0 if falls else height < 0.0
        before_change[0], before_change[-1] = True, False
        last = int(np.flatnonzero(before_change)[-1]) if not axis.whole else int(np.argmin(before_change)) - 1
        low, high = float(steps[last]), float(steps[last + 1])
        if axis.whole and high - low <= 1.0:
            return high, float(values[last + 1])
        if not axis.whole and high - low <= _CLOSE * max(abs(low), abs(high), 1e-6):
            if min(abs(height[last]), abs(height[last + 1])) > _JUMP or not math.isfinite(values[last]):
                return None
            return 0.5 * (low + high), 0.5 * float(values[last] + values[last + 1])


def is_flat(sensor_curve: SweepCurve) -> bool:
    """True if the values are the same along the whole axis."""
    return bool(np.all(sensor_curve.values == sensor_curve.values[0]))


def limit_word(status: int) -> str:
    """Word in a table for a status without a range."""
    return {RangeStatus.NEVER_DETECTED: "never", RangeStatus.NO_LIMIT: "no limit", RangeStatus.SATURATED: "saturated"}[
        RangeStatus(status)
    ]
