"""Slopes of a design's quantities over its free keys.

A free key of the sensor file moves numbers of the sensor, and through these the quantity (T220):
dq/dk = sum over n of dq/dn dn/dk. The derivatives dq/dn of range, P_d and SNR come from the stages that render
(`ranging.sensitivities`): of an APD, or SPADs with the paper's statistics, by Dr.Jit's reverse mode. The time domain
and a histogram are sums over many instants, whose reversed kernel takes LLVM minutes: for them, and without a
back end, sixth-order differences over the numbers take its place. dn/dk is the difference of two sensors that are built
from the file, exact where a key is in proportion to its number.

Central differences of the whole evaluation stay for what cannot go this way: quantities that Python computes with
branches and tables (eye safety, false alarms), by simulated shots or by tracing, and keys that move more than numbers
(a table of a filter, a whole number, the scan).

Symbols: q quantity, k key, n number of the sensor.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import InputError
from ...maths.arrays import Numbers
from ...sensor.detectors import Apd, Sipm
from ...sensor.sensor_model import Sensor
from ..ranging import plane, sensitivities
from .designs import Chosen, Design, DesignSpace, Free, Values
from .quantities import Evaluator, target_of
from .study_file import OF_ALL_SENSORS, TRACED, QuantityFile

Evaluate = Callable[[Values], Mapping[str, float]]
"""Function of a design; returns its quantities by name. Raises InputError for one that cannot be."""

STEP = 1e-4
"""Accuracy bought: step of differences, as a share of a key's range: of a longer one the curve bends, a shorter one is
rounded."""

AUTOMATIC, CHAIN, DIFFERENCES = "automatic differentiation", "differences of the chain", "differences"


@dataclass(frozen=True, slots=True, kw_only=True)
class Slopes:
    """Slopes of quantities over the shares of the continuous keys of a design.

    Attributes:
        slopes: quantity by name -> (continuous keys of the space,); 0 for keys that the design does not have
        methods: quantity by name -> `AUTOMATIC`, `CHAIN` or `DIFFERENCES`
    """

    slopes: Mapping[str, Numbers]
    methods: Mapping[str, str]


SlopesOf = Callable[[Design], Slopes]
"""Function of a design; returns the slopes of its quantities. Raises InputError if no step gives a sensor."""


def differences(evaluate: Evaluate, space: DesignSpace) -> SlopesOf:
    """Central differences of any function of designs; one-sided at the ends of a key's range."""

    def slopes_of(design: Design) -> Slopes:
        sides = [_sides(entry, design.values, evaluate) for entry in _continuous(space)]
        names = dict.fromkeys(name for side in sides if side is not None for name in side.high)
        slopes = {name: np.array([0.0 if side is None else side.slope(name) for side in sides]) for name in names}
        return Slopes(slopes=slopes, methods=dict.fromkeys(names, DIFFERENCES))

    return slopes_of


def derivatives(evaluator: Evaluator) -> SlopesOf:
    """Slopes of a study's quantities, through the numbers that the keys move where there is a way."""
    space = evaluator.space
    traced = {entry for entry, quantity in evaluator.entries.items() if quantity.quantity_name in TRACED}
    whole = differences(evaluator, space)

    def slopes_of(design: Design) -> Slopes:
        values = design.values
        chosen = space.chosen(values)
        sensors = {label: placed.sensor() for label, placed in chosen.items()}
        sides = [_sides(entry, values, lambda moved: _Placed.of(space, moved)) for entry in _continuous(space)]
        slopes, methods = {}, {}
        for quantity_name, entry in evaluator.entries.items():
            label = evaluator.label_of(entry)
            methods[quantity_name] = DIFFERENCES
            if quantity_name in traced:
                continue
            if label not in sensors and entry.quantity_name not in OF_ALL_SENSORS:
                slopes[quantity_name] = np.zeros(len(sides))
                continue
            numbers: dict[str, float] | None = None
            moved: list[dict[str, float] | None] = [None] * len(sides)
            if entry.quantity_name in _CHAIN:
                moved = [None if side is None else _moved(side, label, entry) for side in sides]
            if any(numbers_moved is not None for numbers_moved in moved):
                method, derive = sensitivities.choose_derivation(_method(sensors[label]))
                is_automatic = method == "drjit"
                value = design.quantities[quantity_name]
                numbers = _gradient(sensors[label], entry, value, moved, derive, of_all=is_automatic)
            if numbers is not None:
                methods[quantity_name] = AUTOMATIC if is_automatic else CHAIN
            slopes[quantity_name] = np.array(
                [
                    0.0
                    if side is None
                    else sum(numbers[number] * slope for number, slope in numbers_moved.items())
                    if numbers is not None and numbers_moved is not None
                    else _difference(evaluator, entry, side)
                    for side, numbers_moved in zip(sides, moved, strict=True)
                ]
            )
        if traced:
            differenced = whole(design).slopes
            slopes |= {quantity_name: differenced[quantity_name] for quantity_name in traced}
        return Slopes(slopes=slopes, methods=methods)

    return slopes_of


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sides:
    """Whatever a function gives for the designs on both sides of one, along one key, and their distance in shares."""

    low: Any
    high: Any
    width: float

    def slope(self, name: str) -> float:
        """Difference quotient of the quantity of this name; 0 where it is infinite."""
        difference = float(self.high[name] - self.low[name])
        return difference / self.width if np.isfinite(difference) else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Placed:
    """Sensors of a design by label, with the files that they come from."""

    chosen: Mapping[str, Chosen]
    sensors: Mapping[str, Sensor]

    @classmethod
    def of(cls, space: DesignSpace, values: Values) -> _Placed:
        """Build the sensors.

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        chosen = space.chosen(values)
        return cls(chosen=chosen, sensors={label: placed.sensor() for label, placed in chosen.items()})


def _continuous(space: DesignSpace) -> list[Free]:
    return [space.free[number] for number in space.continuous]


def _sides(entry: Free, values: Values, function: Callable[[Values], Any]) -> _Sides | None:
    """Function of the designs a step below and above one along a key; None for a key that the design does not have.

    On one side only where the other is beyond the key's range, or cannot be.

    Raises:
        InputError: where neither can
    """
    if entry.key not in values:
        return None
    share = entry.share(values[entry.key])
    results, errors = {}, []
    for place in (max(share - STEP, 0.0), min(share + STEP, 1.0)):
        try:
            results[place] = function({**values, entry.key: entry.value(place)})
        except InputError as error:
            errors.append(error)
    if len(results) < 2 and share not in results:
        if not results:
            raise errors[0]
        results[share] = function(values)
    low, high = sorted(results)
    return _Sides(low=results[low], high=results[high], width=high - low)


_CHAIN = ("range", "detection_probability", "snr")
"""Quantities that the stages compute."""


def _method(sensor: Sensor) -> str:
    """Method of `sensitivities.choose_derivation` for a sensor."""
    detector = sensor.detector
    is_short = isinstance(detector, Apd) or (isinstance(detector, Sipm) and detector.statistics == "published")
    return "auto" if is_short else "differences"


def _gradient(
    sensor: Sensor,
    entry: QuantityFile,
    value: float,
    moved: Sequence[Mapping[str, float] | None],
    derive: sensitivities.Derivation,
    *,
    of_all: bool,
) -> dict[str, float] | None:
    """Derivatives of a quantity with respect to the numbers that keys move; None if it has no exact ones.

    Args:
        value: of the quantity
        of_all: with respect to all numbers of the sensor, so that designs that differ in any share a kernel
    """
    quantity = entry.quantity_name
    target = target_of(sensor, entry)
    values = sensitivities.parameters(sensor, target)
    used = {name for numbers in moved if numbers is not None for name in numbers}
    if not of_all:
        values = {name: values[name] for name in used}
    try:
        if quantity == "range":
            slopes = sensitivities.range_slopes(sensor, target, value, derive, values)
        elif quantity == "snr":
            slopes = sensitivities.snr_slopes(sensor, target, entry.distance, derive, values)
        else:
            slopes = sensitivities.detection_slopes(sensor, target, entry.distance, derive, values)[1]
    except InputError:
        return None
    return slopes if all(np.isfinite(slopes[name]) for name in used) else None


def _moved(side: _Sides, label: str, entry: QuantityFile) -> dict[str, float] | None:
    """Slopes of the numbers of a sensor over a key's share; None if the key moves more than numbers."""
    ends = [placed.sensors[label] for placed in (side.low, side.high)]
    low, high = (sensitivities.parameters(sensor, target_of(sensor, entry)) for sensor in ends)
    if low.keys() != high.keys() or not _same(*(_other_parts(sensor, set(low)) for sensor in ends)):
        return None
    return {name: (high[name] - low[name]) / side.width for name in low if high[name] != low[name]}


def _other_parts(sensor: Sensor, numbers: set[str]) -> dict[str, Any]:
    """What decides a sensor's range and is none of these numbers; the overlap follows from them."""
    return {
        f"{part}.{field.name}": getattr(component, field.name)
        for part in plane.PARTS
        for component in [getattr(sensor, part)]
        if component is not None
        for field in dataclasses.fields(component)
        if f"{part}.{field.name}" not in numbers and f"{part}.{field.name}" != "optics.overlap"
    }


def _same(first: Any, second: Any) -> bool:
    """Whether two descriptions hold the same numbers, arrays among them."""
    if first is second:
        return True
    if type(first) is not type(second):
        return False
    if isinstance(first, np.ndarray):
        return np.array_equal(first, second)
    if isinstance(first, Mapping):
        return first.keys() == second.keys() and all(_same(first[key], second[key]) for key in first)
    if isinstance(first, (list, tuple)):
        return len(first) == len(second) and all(map(_same, first, second))
    if dataclasses.is_dataclass(first):
        names = [field.name for field in dataclasses.fields(first)]
        return all(_same(getattr(first, name), getattr(second, name)) for name in names)
    return bool(first == second)


def _difference(evaluator: Evaluator, entry: QuantityFile, side: _Sides) -> float:
    low, high = (evaluator.closed_form(entry, placed.chosen, placed.sensors) for placed in (side.low, side.high))
    return (high - low) / side.width if np.isfinite(high - low) else 0.0
