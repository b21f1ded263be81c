"""Extremes: of a frame that came out as NaN, the number of the sensor or the scene that is farthest from usual.

Bounds of single numbers keep most of these out (`maths.units.Quantity`), but products of two numbers can still leave
single precision.
"""

from __future__ import annotations

import dataclasses
import math
import typing
from collections.abc import Iterator, Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np

from ..errors import InputError
from ..kernel.rays.point_columns import NOT_A_NUMBER
from ..maths.arrays import Numbers
from ..maths.units import Quantity
from ..scene.scene import Scene
from ..sensor.catalogue import load_sensor
from ..sensor.model import Sensor

USUAL = ("table1-apd", "table1-sipm", "sony-spad-189x600")
"""Sensors with every kind of detector."""

_SHARE = 1e-3
"""Of its upper bound, for a number that may be 0: bounds are some hundred times wider than any device."""


def check_detections(scene: Scene, sensor: Sensor, detections: Sequence[Any]) -> None:
    """Raises InputError for pulses whose signal is NaN, which would count as missed.

    detections  of `kernel.rays.point_columns.with_nan_outcomes`, computed
    """
    for one in detections:
        if (one.outcome.numpy() == NOT_A_NUMBER).any():
            names = ("snr", "detection_probability")
            raise _found(scene, sensor, {name: getattr(one, name).numpy() for name in names}, "pulses")


def of_points(scene: Scene, sensor: Sensor, columns: Mapping[str, Numbers]) -> InputError:
    """For columns of points among which one has NaN."""
    return _found(scene, sensor, columns, "points")


def _found(scene: Scene, sensor: Sensor, values: Mapping[str, Numbers], what: str) -> InputError:
    name, count = next((name, n) for name, one in values.items() if (n := np.count_nonzero(np.isnan(one))))
    return not_a_number(scene, sensor, f"{name} of {count:,} {what} is not a number")


def not_a_number(scene: Scene, sensor: Sensor, told: str) -> InputError:
    """The one line for a frame with NaN.

    told  what is NaN, and at how many places
    """
    usual: dict[str, float] = {}
    for name in USUAL:
        usual = {key: value for key, value, _ in _numbers(load_sensor(name))} | usual
    usual |= {key: value for key, value, _ in _numbers(Scene())}
    given = [*_numbers(sensor), *_numbers(scene)]
    key, value, _ = max(given, key=lambda one: _how_far(one[1], usual.get(one[0]), one[2]))
    return InputError(
        f"scene '{scene.name}', sensor '{sensor.name}': {told}; the most extreme input is {key} = {value:.6g}"
    )


def _numbers(of: Any, before: str = "") -> Iterator[tuple[str, float, Quantity]]:
    """Every declared number of a sensor or scene: its dotted key in the file, its value there, how it is declared."""
    hints = typing.get_type_hints(type(of), include_extras=True)
    for field in dataclasses.fields(of):
        value = getattr(of, field.name)
        declared = next(
            (one for one in getattr(hints[field.name], "__metadata__", ()) if isinstance(one, Quantity)), None
        )
        if declared is not None and isinstance(value, Real):
            yield before + declared.for_field(field.name), float(declared.in_file(value)), declared
        elif dataclasses.is_dataclass(value):
            yield from _numbers(value, f"{before}{field.name}.")


def _how_far(value: float, usual: float | None, declared: Quantity) -> float:
    """Decades from what is usual; of a number that is 0 or left out there, from the middle of its bounds."""
    if not math.isfinite(value):
        return math.inf
    if not usual:
        bounds = [abs(limit) for limit in declared.bounds.values() if limit] or [1.0]
        usual = math.sqrt(bounds[0] * bounds[-1]) if len(bounds) > 1 else _SHARE * bounds[0]
    return abs(math.log10(abs(value) / abs(usual))) if value else 0.0
