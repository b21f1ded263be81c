"""Detection rates of several sensors against the scene's illuminance, and where their curves cross.

Every step traces the whole scene under another sun, with the same seed and place.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from ...sensor.sensor_model import Sensor
from ..ranging.conditions import PROBABILITY
from ..ranging.plane import Target, equal_range_illuminance_klux
from .bench import Bench, NamedSensor
from .comparison_statistics import DetectionRate, overall_rate, range_errors
from .observations import Observation

# A factor of 100 between two steps leaves a bracket of 100^(2^-14), 0.03 %.
_HALVINGS = 14

_NARROWINGS = 8
"""Narrowings of the place of the least lead: each to 0.62 of its width, all to a fiftieth."""

_GOLDEN = 0.5 * (3.0 - math.sqrt(5.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class IlluminanceStep:
    """Results of one sensor under one illuminance; ``sigma_m`` is the range's deviation, None without echoes."""

    illuminance_klux: float
    rate: DetectionRate
    false_alarms: int
    sigma_m: float | None

    @classmethod
    def from_observation(cls, observation: Observation, illuminance_klux: float) -> IlluminanceStep:
        """Compute the results of an observation."""
        errors = range_errors(observation)
        return cls(
            illuminance_klux=illuminance_klux,
            rate=overall_rate(observation.rated_surfaces),
            false_alarms=observation.false_alarms,
            sigma_m=errors[0].sigma_m if errors else None,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class RateCrossing:
    """Illuminance at which two sensors are expected to find equally many surfaces; ``ahead_below`` finds more below."""

    illuminance_klux: float
    expected: float
    ahead_below: str
    ahead_above: str


@dataclass(frozen=True, slots=True, kw_only=True)
class IlluminanceSweep:
    """Results of all sensors over the illuminance, and where others cross the first.

    Attributes:
        illuminances_klux: rising
        courses: sensor -> its results in order of illuminance
        crossings: other sensor -> its crossings with the first
        on_plane_klux: other sensor -> illuminance at which both have the same range at P_d 0.9 on Table 1's plane;
            None if outside the sweep
    """

    illuminances_klux: tuple[float, ...]
    courses: dict[str, list[IlluminanceStep]]
    crossings: dict[str, list[RateCrossing]]
    on_plane_klux: dict[str, float | None]


def sweep_illuminance(
    bench: Bench,
    sensors: Sequence[NamedSensor],
    illuminances_klux: Sequence[float],
    *,
    progress: Callable[[int], object] = lambda rendered: None,
) -> IlluminanceSweep:
    """Observe every sensor under every illuminance, and find where the others cross the first.

    Args:
        illuminances_klux: rising, above 0
        progress: called with the number of frames rendered so far; not during the search for crossings

    Raises:
        BackendError: if Mitsuba has no back end that works on this machine
    """
    courses: dict[str, list[IlluminanceStep]] = {name: [] for name, _ in sensors}
    for rendered, ((name, sensor), lux) in enumerate(itertools.product(sensors, illuminances_klux), start=1):
        courses[name].append(IlluminanceStep.from_observation(bench.observe(name, sensor, illuminance_klux=lux), lux))
        progress(rendered)
    first, rivals = sensors[0], sensors[1:]
    crossings = {name: _crossings(bench, first, (name, sensor), courses) for name, sensor in rivals}
    plane = {name: _equal_range_klux(first[1], sensor, illuminances_klux) for name, sensor in rivals}
    return IlluminanceSweep(
        illuminances_klux=tuple(illuminances_klux), courses=courses, crossings=crossings, on_plane_klux=plane
    )


def _crossings(
    bench: Bench, a: NamedSensor, b: NamedSensor, courses: Mapping[str, Sequence[IlluminanceStep]]
) -> list[RateCrossing]:
    """Illuminances at which the expected rates of two sensors are equal.

    Expected rates are mean P_d, so chance detections do not move the crossing.
    """

    def expected_at(named_sensor: NamedSensor, lux: float) -> float:
        return _expected(IlluminanceStep.from_observation(bench.observe(*named_sensor, illuminance_klux=lux), lux))

    def lead_at(lux: float) -> float:
        return expected_at(a, lux) - expected_at(b, lux)

    steps = zip(courses[a[0]], courses[b[0]], strict=True)
    leads = {step_a.illuminance_klux: _expected(step_a) - _expected(step_b) for step_a, step_b in steps}
    crossings = []
    for lux, ahead_below in lead_changes(lead_at, leads):
        names = (a[0], b[0]) if ahead_below else (b[0], a[0])
        crossings.append(
            RateCrossing(illuminance_klux=lux, expected=expected_at(a, lux), ahead_below=names[0], ahead_above=names[1])
        )
    return crossings


def lead_changes(lead_at: Callable[[float], float], leads: Mapping[float, float]) -> list[tuple[float, bool]]:
    """Illuminances at which a lead changes its sign, and whether it is above 0 before; by bisection of the logarithm.

    A lead that has one sign at two neighbouring illuminances may change it twice in between: where it is smaller in
    their middle, its least size is searched until the sign is another.

    Args:
        lead_at: function of the illuminance, dear to call
        leads: the lead at some illuminances, rising
    """
    places = list(leads.items())
    for (low, lead_at_low), (high, lead_at_high) in itertools.pairwise(leads.items()):
        if lead_at_low * lead_at_high > 0.0:
            between = _other_sign(lead_at, (low, lead_at_low), (high, lead_at_high))
            places += [] if between is None else [between]
    changes = []
    for (low, lead_at_low), (high, lead_at_high) in itertools.pairwise(sorted(places)):
        if lead_at_low * lead_at_high >= 0.0:
            continue
        for _ in range(_HALVINGS):
            middle = math.sqrt(low * high)
            if lead_at(middle) * lead_at_low > 0.0:
                low = middle
            else:
                high = middle
        changes.append((math.sqrt(low * high), lead_at_low > 0.0))
    return changes


def _other_sign(
    lead_at: Callable[[float], float], low: tuple[float, float], high: tuple[float, float]
) -> tuple[float, float] | None:
    """Illuminance between two others of one sign of the lead at which it has the other sign, and the lead; or None."""
    sign = math.copysign(1.0, low[1])
    left, right = math.log(low[0]), math.log(high[0])
    middle = 0.5 * (left + right)
    size = sign * lead_at(math.exp(middle))
    for _ in range(_NARROWINGS):
        if size < 0.0:
            return math.exp(middle), sign * size
        if size >= min(sign * low[1], sign * high[1]):
            return None
        # The smallest of three is in the middle: a golden section of the wider part keeps it so.
        wider_left = middle - left > right - middle
        place = middle + _GOLDEN * ((left if wider_left else right) - middle)
        size_there = sign * lead_at(math.exp(place))
        if size_there < size:
            left, right = (left, middle) if wider_left else (middle, right)
            middle, size = place, size_there
        else:
            left, right = (place, right) if wider_left else (left, place)
    return None


def _expected(step: IlluminanceStep) -> float:
    return step.rate.expected or 0.0


def _equal_range_klux(first: Sensor, second: Sensor, illuminances_klux: Sequence[float]) -> float | None:
    try:
        return equal_range_illuminance_klux(
            first,
            second,
            Target(),
            probability=PROBABILITY,
            low_klux=min(illuminances_klux),
            high_klux=max(illuminances_klux),
        )
    except ValueError:
        return None
