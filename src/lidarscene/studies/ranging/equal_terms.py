"""Equal terms: sensors under the same statistics, false alarms and eye safety, each at its best gain.

Two sensor files may differ by what nobody can build: a peak power that the eye forbids, a gain that costs range, a
threshold with more false alarms, statistics that leave out the pulse's course. A comparison of detectors takes these
away first. What the file says is compared beside it.

A range is as sure as the numbers behind it: those for which the file has an `uncertainty` are moved to both of its
ends, one after the other, and what this adds to the range, and takes from it, is summed in squares (T222).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...errors import InputError
from ...maths.arrays import Numbers
from ...sensor.detectors import Apd, Sipm
from ...sensor.sensor_file import SensorTables
from ...sensor.sensor_model import Sensor
from ..eye_safety.eye_safety_report import eye_safety_report
from . import plane, sensitivities, statistics
from .conditions import PROBABILITY
from .curves import with_haze
from .plane import Target

ILLUMINANCES_KLUX = (1.0, 10.0, 50.0, 100.0, 130.0)
"""Choice: light under which a verdict has the ranges, up to the brightest sun."""

FALSE_POINTS_A_FRAME = 10.0
"""Choice: false points of a frame on equal terms, the same for every sensor, so that their order changes no figure."""

_GAINS = (1.0, 1000.0)
"""Choice: least and largest gain among which the best one is sought."""

_RATIOS = (0.5, 50.0)
"""Choice: thresholds over noise that are tried."""

_ALIKE = 1e-6
"""Accuracy bought: logarithm of false points over wanted ones within which they are as wanted."""

_NO_GAIN_WORTH = 0.01
"""Choice: share of the range below which a better gain is not named."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Terms:
    """Sensor as its file has it and on equal terms, with the range of each.

    Attributes:
        probability: P_d at all ranges
        file: the sensor as its file has it
        interval_m: ends of the range that the file's uncertainties give; None if it has none
        false_points: of a frame, on equal terms
        course_m: range under each of `ILLUMINANCES_KLUX`
        changes: what its file has otherwise, in words: eye safety, gain, statistics, then the threshold
    """

    name: str
    probability: float
    sensor: Sensor
    file: Sensor
    file_range_m: float
    range_m: float
    interval_m: tuple[float, float] | None
    false_points: float
    course_m: tuple[float, ...]
    changes: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class BreakEven:
    """Illuminance at which two sensors on equal terms see equally far."""

    illuminance_klux: float
    range_m: float
    ahead_below: str
    ahead_above: str


def equal_terms(
    sensors: Sequence[tuple[str, Sensor]],
    target: Target,
    *,
    visibility_m: float | None = None,
    probability: float = PROBABILITY,
) -> list[Terms]:
    """Put sensors on equal terms: each has `FALSE_POINTS_A_FRAME`, all its pulses in the light of the target.

    Time-domain statistics, class 1 with the beam scanning, the gain of the longest range. A threshold that is no ratio
    to the noise stays, and so does a power that is not known; `Terms.changes` says so.

    Args:
        visibility_m: of the air, whose extinction depends on the wavelength; None: that of the target
        probability: P_d at the ranges
    """
    return [_terms(name, sensor, with_haze(sensor, target, visibility_m), probability) for name, sensor in sensors]


def crossings(terms: Sequence[Terms], target: Target, *, visibility_m: float | None = None) -> list[BreakEven]:
    """Illuminances between those of `ILLUMINANCES_KLUX` at which two of the sensors change places, to 1e-4."""
    from scipy.optimize import brentq

    places = []

    def range_under(entry: Terms, klux: float) -> float:
        hazy = with_haze(entry.sensor, target, visibility_m)
        return range_under_m(entry.sensor, hazy, klux, probability=entry.probability)

    for first, second in itertools.combinations(terms, 2):

        def lead(log_klux: float, pair: tuple[Terms, Terms] = (first, second)) -> float:
            first_m, second_m = (range_under(entry, math.exp(log_klux)) for entry in pair)
            return first_m - second_m

        leads = [a - b for a, b in zip(first.course_m, second.course_m, strict=True)]
        steps = zip(itertools.pairwise(ILLUMINANCES_KLUX), itertools.pairwise(leads), strict=True)
        for (low, high), (before, after) in steps:
            if before * after < 0.0:
                klux = math.exp(float(brentq(lead, math.log(low), math.log(high), xtol=1e-4)))
                below, above = (first, second) if before > 0.0 else (second, first)
                # The mean of both, so that the order of the sensors changes no digit.
                reached_m = 0.5 * (range_under(first, klux) + range_under(second, klux))
                places.append(
                    BreakEven(illuminance_klux=klux, range_m=reached_m, ahead_below=below.name, ahead_above=above.name)
                )
    return sorted(places, key=lambda crossing: crossing.illuminance_klux)


def verdict(terms: Sequence[Terms], target: Target, *, visibility_m: float | None = None) -> tuple[str, ...]:
    """Sentences on the ranges on equal terms, with other light, and on what the files have otherwise."""
    order = sorted(terms, key=lambda entry: -entry.range_m)
    reached = ", ".join(f"{entry.name} {_range_text(entry.range_m)}{_interval_text(entry)}" for entry in order)
    plane_text = f"{100 * target.reflectivity:.3g} % under {target.illuminance_klux:g} klux"
    lead = (
        f"On equal terms (time domain, class 1 scanning, best gain, {FALSE_POINTS_A_FRAME:g} false points a frame), "
        f"range at P_d {order[0].probability:g} on {plane_text}: {reached}."
    )
    otherwise = "; ".join(
        f"{entry.name} {_range_text(entry.file_range_m)}{' with ' if entry.changes else ''}{', '.join(entry.changes)}"
        for entry in terms
    )
    places = crossings(terms, target, visibility_m=visibility_m)
    differences = _difference_text(order, target, visibility_m)
    return (
        f"{lead} {_certainty(order)}",
        *([differences] if differences else []),
        _course_text(order, places),
        f"As their files have them: {otherwise}.",
    )


def waterfall(first: Terms, second: Terms, target: Target, *, visibility_m: float | None = None) -> dict[str, float]:
    """What each part of the second sensor's file is worth in the first, in metres of its range on equal terms.

    The parts are exchanged one after the other, and each sensor in between is put on equal terms. The last step, with
    all that belongs to the detector, leaves the second sensor, so that the sum is the difference of both ranges. What
    does not fit, or is of a sensor that no file describes, is in the last step, then called "rest".
    """
    steps: dict[str, float] = {}
    sensor, before_m = first.file, first.range_m
    for part in ("optics", "laser"):
        try:
            exchanged = _with_part_of(sensor, part, second.file)
            hazy = with_haze(exchanged, target, visibility_m)
            equal, _ = _equalized(exchanged, hazy, first.probability)
            reached_m = plane.range_at_probability_m(equal, hazy, first.probability)
        except (InputError, ValueError):
            continue
        steps[part] = reached_m - before_m
        sensor, before_m = exchanged, reached_m
    return {**steps, "detector" if len(steps) == 2 else "rest": second.range_m - before_m}


def _with_part_of(sensor: Sensor, part: str, other: Sensor) -> Sensor:
    """Sensor with a part of another's file.

    Raises:
        InputError: for parts that do not fit together, and for a sensor that no file describes
    """
    if not isinstance(sensor.origin, SensorTables) or not isinstance(other.origin, SensorTables):
        raise InputError(f"'{sensor.name}': must be of a file for its {part} to be exchanged")
    return sensor.origin.with_part_of(part, other.origin)


def _difference_text(order: Sequence[Terms], target: Target, visibility_m: float | None) -> str:
    """Sentences on what separates the farthest sensor from each other one, besides the detector; "" for one sensor."""
    ahead, texts = order[0], []
    for entry in order[1:]:
        worth = waterfall(entry, ahead, target, visibility_m=visibility_m)
        words = []
        for part, metres in worth.items():
            differs = _differs(part, ahead, entry)
            if differs or part in ("detector", "rest") or abs(metres) >= 0.05:
                words.append(f"{_PART_WORDS[part]} {metres:+.1f} m{f' ({differs})' if differs else ''}")
        texts.append(f"{ahead.name} against {entry.name}, {ahead.range_m - entry.range_m:+.1f} m: {', '.join(words)}.")
    return " ".join(texts)


_PART_WORDS = {
    "optics": "lens",
    "laser": "laser",
    "detector": "detector with its electronics and scanner",
    "rest": "all that cannot be exchanged by itself",
}

_NAMED = {
    "optics": (("aperture_radius_m", 1e3, "mm aperture radius"), ("focal_length_m", 1e3, "mm focal length")),
    "laser": (
        ("pulse_fwhm_s", 1e9, "ns pulse"),
        ("wavelength_m", 1e9, "nm"),
        ("divergence_rad", 1e3, "mrad divergence"),
        ("repetition_rate_hz", 1e-3, "kHz"),
    ),
}
"""Choice: numbers that are named where two sensors differ in them, by part: field, factor and unit."""


def _differs(part: str, ahead: Terms, other: Terms) -> str:
    """Numbers of a part in which two sensors differ, in words."""
    texts = []
    for field, factor, words in _NAMED.get(part, ()):
        first, second = (factor * float(getattr(getattr(entry.file, part), field)) for entry in (ahead, other))
        if first != second:
            texts.append(f"{first:.4g} for {second:.4g} {words}")
    return ", ".join(texts)


def _interval_text(entry: Terms) -> str:
    return "" if entry.interval_m is None else f" ({entry.interval_m[0]:.0f} to {entry.interval_m[1]:.0f})"


def _certainty(order: Sequence[Terms]) -> str:
    """Sentence on what the intervals are, and whether they separate the two farthest sensors."""
    unknown = [entry.name for entry in order if entry.interval_m is None]
    if len(unknown) == len(order):
        return "Their files state no uncertainty."
    texts = ["Brackets: range over the stated uncertainties"]
    if unknown:
        texts.append(f"none stated: {', '.join(unknown)}")
    elif len(order) > 1:
        (low, _), (_, high) = (entry.interval_m or (0.0, 0.0) for entry in order[:2])
        first, second = (entry.name for entry in order[:2])
        texts.append(f"{first} {'is' if low > high else 'is not'} ahead of {second} beyond them")
    return "; ".join(texts) + "."


def _course_text(order: Sequence[Terms], places: Sequence[BreakEven]) -> str:
    """Sentence on the ranges over the illuminance, and on where the sensors change places."""
    steps = ", ".join(f"{klux:g}" for klux in ILLUMINANCES_KLUX)
    courses = "; ".join(
        f"{entry.name} {', '.join('nothing' if reached <= 0.0 else f'{reached:.0f}' for reached in entry.course_m)} m"
        for entry in order
    )
    if len(order) < 2:
        return f"The same under {steps} klux: {courses}."
    changes = [
        f"{crossing.ahead_above} overtakes {crossing.ahead_below} at {crossing.illuminance_klux:.3g} klux, "
        f"{crossing.range_m:.0f} m"
        for crossing in places
    ]
    return f"The same under {steps} klux: {courses}. {'; '.join(changes) or 'Their order does not change'}."


def range_under_m(sensor: Sensor, target: Target, klux: float, *, probability: float = PROBABILITY) -> float:
    """Range under another illuminance with a threshold of as many false points."""
    lit = replace(target, illuminance_klux=klux)
    if sensor.tdc.threshold_to_noise is not None:
        sensor = _with_false_points(sensor, lit)
    return plane.range_at_probability_m(sensor, lit, probability)


def _terms(name: str, sensor: Sensor, target: Target, probability: float) -> Terms:
    equal, changes = _equalized(sensor, target, probability)
    range_m = plane.range_at_probability_m(equal, target, probability)
    limited = float(equal.laser.peak_power_w) != float(sensor.laser.peak_power_w)
    return Terms(
        name=name,
        probability=probability,
        sensor=equal,
        file=sensor,
        file_range_m=plane.range_at_probability_m(sensor, target, probability),
        range_m=range_m,
        interval_m=range_interval_m(
            equal,
            target,
            range_m,
            without={"detector.gain", *(["laser.peak_power_w"] if limited else [])},
            probability=probability,
        ),
        false_points=false_points(equal, target),
        course_m=tuple(range_under_m(equal, target, klux, probability=probability) for klux in ILLUMINANCES_KLUX),
        changes=changes,
    )


def _equalized(sensor: Sensor, target: Target, probability: float) -> tuple[Sensor, tuple[str, ...]]:
    """Sensor on equal terms, and what it had otherwise: eye safety, gain, statistics, then the threshold."""
    equal, statistics_change = _physical(sensor)
    equal, power_change = _safe(equal)
    threshold_change: tuple[str, ...] = ()
    if equal.tdc.threshold_to_noise is None:
        threshold_change = ("a threshold that is not a ratio to noise",)
    else:
        before = float(equal.tdc.threshold_to_noise)
        equal = _with_false_points(equal, target)
        after = float(equal.tdc.threshold_to_noise or 0.0)
        if abs(after - before) > 0.005 * before:
            threshold_change = (f"threshold {before:.3g} of the noise for {after:.3g}",)
    gain_change: tuple[str, ...] = ()
    if isinstance(equal.detector, Apd):
        equal, gain_change = _at_best_gain(equal, equal.detector, target, probability)
    return equal, (*power_change, *gain_change, *statistics_change, *threshold_change)


def range_interval_m(
    sensor: Sensor, target: Target, range_m: float, *, without: Collection[str] = (), probability: float = PROBABILITY
) -> tuple[float, float] | None:
    """Ends of the range that the sensor's uncertainties give, root of summed squares (T222).

    None if the sensor states no uncertainty of a number that its range depends on.

    Args:
        range_m: range at P_d ``probability`` without them
        without: numbers that are set and not read from the file, such as a power at the limit of class 1
    """
    halves = {name: half for name, half in sensor.uncertainty.items() if name not in without}
    moves = range_moves_m(sensor, target, range_m, halves, probability=probability)
    if not len(moves):
        return None
    below, above = np.minimum(moves.min(axis=1), 0.0), np.maximum(moves.max(axis=1), 0.0)
    return range_m - math.hypot(*below), range_m + math.hypot(*above)


def range_moves_m(
    sensor: Sensor, target: Target, range_m: float, halves: Mapping[str, float], *, probability: float = PROBABILITY
) -> Numbers:
    """(n, 2) change of the range as each number alone goes down and up by its half, for those that the range has.

    Args:
        halves: by dotted name in SI units, as in `sensitivities.parameters`
    """
    values = sensitivities.parameters(sensor, target)
    moves = []
    for name in sorted(halves.keys() & values.keys()):  # in an order that stays
        ends = []
        for value in (max(values[name] - halves[name], 0.0), values[name] + halves[name]):
            changed, at = sensitivities.with_parameters(sensor, target, {name: value})
            ends.append(plane.range_at_probability_m(changed, at, probability) - range_m)
        moves.append(ends)
    return np.array(moves).reshape(-1, 2)


def false_points(sensor: Sensor, target: Target) -> float:
    """False points of a frame in the light of the target, without its echo.

    In the dark of the sky a SiPM's floor of a cell sets its alarms, and no ratio to the noise would.
    """
    return statistics.false_points(sensor, target, math.inf).per_frame


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
    words = f"{power_w:.3g} W, not class 1 but {power_w / limit_w:.3g} times its limit"
    return replace(sensor, laser=replace(sensor.laser, peak_power_w=limit_w)), (words,)


def _with_false_points(sensor: Sensor, target: Target) -> Sensor:
    """Sensor whose threshold gives `FALSE_POINTS_A_FRAME`; the nearest one within `_RATIOS`."""

    def with_ratio(log_ratio: float) -> Sensor:
        return replace(sensor, tdc=replace(sensor.tdc, threshold_to_noise=math.exp(log_ratio)))

    def excess(log_ratio: float) -> float:
        return math.log(max(false_points(with_ratio(log_ratio), target), 1e-300) / FALSE_POINTS_A_FRAME)

    # Where a SiPM's floor of a cell is the threshold, all ratios have the same false points: the file's own stays.
    if abs(excess(math.log(float(sensor.tdc.threshold_to_noise or 1.0)))) < _ALIKE:
        return sensor
    return with_ratio(_root(excess, math.log(_RATIOS[0]), math.log(_RATIOS[1])))


def _root(falling: Callable[[float], float], low: float, high: float) -> float:
    """Root of a falling function; the end where it has none."""
    from scipy.optimize import brentq

    if falling(low) <= 0.0:
        return low
    if falling(high) >= 0.0:
        return high
    return float(brentq(falling, low, high, xtol=1e-6))


def _at_best_gain(sensor: Sensor, diode: Apd, target: Target, probability: float) -> tuple[Sensor, tuple[str, ...]]:
    """Sensor at the gain of the longest range, its false points held, and the gain that it had."""
    from scipy.optimize import minimize_scalar

    def with_gain(log_gain: float) -> Sensor:
        tuned = replace(sensor, detector=replace(diode, gain=math.exp(log_gain)))
        return tuned if tuned.tdc.threshold_to_noise is None else _with_false_points(tuned, target)

    def shortfall(log_gain: float) -> float:
        return -plane.range_at_probability_m(with_gain(log_gain), target, probability)

    bounds = tuple(np.log(_GAINS))
    best = minimize_scalar(shortfall, bounds=bounds, method="bounded", options={"xatol": 1e-3})
    present = -shortfall(math.log(float(diode.gain)))
    if not -best.fun > present * (1.0 + _NO_GAIN_WORTH):
        return with_gain(math.log(float(diode.gain))), ()
    optimum = math.exp(best.x)
    off = 100.0 * (float(diode.gain) / optimum - 1.0)
    words = f"gain {diode.gain:.3g}, {abs(off):.0f} % {'above' if off > 0.0 else 'below'} its best {optimum:.3g}"
    return with_gain(float(best.x)), (words,)


def _range_text(range_m: float) -> str:
    return f"{range_m:.1f} m" if range_m > 0.0 else "nothing"
