"""Extremes: for a frame with NaN or infinities, the input of sensor or scene that is farthest from usual values.

Bounds of single numbers keep most of these out (`maths.units.Quantity`), but products of two numbers can still leave
single precision.
"""

from __future__ import annotations

import dataclasses
import math
import typing
from collections.abc import Callable, Iterator, Mapping
from numbers import Real
from typing import Any

import numpy as np

from ..errors import InputError
from ..kernel.rays.point_columns import NOT_A_NUMBER
from ..maths.arrays import Numbers
from ..maths.units import Quantity
from ..scene.scene import Scene
from ..sensor.sensor_file import load_sensor
from ..sensor.sensor_model import Sensor

USUAL = ("table1-apd", "table1-sipm", "sony-spad-189x600")
"""Sensors with every kind of detector."""

_SHARE = 1e-3
"""Choice: usual value over upper bound, for a number that may be 0: bounds are some hundred times wider than any
device."""


def check_detections(scene: Scene, sensor: Sensor, values: Callable[[str], Numbers]) -> None:
    """Raise InputError for pulses whose signal is NaN or infinite, which would count as missed.

    Args:
        values: gives a field of `kernel.rays.point_columns.with_nan_outcomes`, (n,) by its name
    """
    if values("outcome").max(initial=0) == NOT_A_NUMBER:
        names = ("snr", "detection_probability")
        raise _nan_error(scene, sensor, {name: values(name) for name in names}, "pulses")


def points_error(scene: Scene, sensor: Sensor, columns: Mapping[str, Numbers]) -> InputError:
    """Error for columns of points of which at least one contains NaN or an infinity."""
    return _nan_error(scene, sensor, columns, "points")


def _nan_error(scene: Scene, sensor: Sensor, values: Mapping[str, Numbers], kind: str) -> InputError:
    # A true range is infinite where there is no surface.
    broken = {
        name: np.isnan(column) if name == "true_range_m" else ~np.isfinite(column) for name, column in values.items()
    }
    name, count = next((name, n) for name, mask in broken.items() if (n := np.count_nonzero(mask)))
    return not_a_number(scene, sensor, f"{name} of {count:,} {kind} is not a finite number")


def not_a_number(scene: Scene, sensor: Sensor, description: str) -> InputError:
    """Error that names the most extreme input, for a frame with NaN or infinities.

    Args:
        description: what is not finite, and how often
    """
    usual: dict[str, float] = {}
    for name in USUAL:
        usual = {key: value for key, value, _ in _numbers(load_sensor(name))} | usual
    usual |= {key: value for key, value, _ in _numbers(Scene())}
    inputs = [*_numbers(sensor), *_numbers(scene)]
    key, value, _ = max(inputs, key=lambda entry: _how_far(entry[1], usual.get(entry[0]), entry[2]))
    return InputError(
        f"scene '{scene.name}', sensor '{sensor.name}': {description}; the most extreme input is {key} = {value:.6g}"
    )


def _numbers(instance: Any, before: str = "") -> Iterator[tuple[str, float, Quantity]]:
    """Iterate over declared numbers of a sensor or scene: dotted key in the file, value in its unit, declaration."""
    hints = typing.get_type_hints(type(instance), include_extras=True)
    for field in dataclasses.fields(instance):
        value = getattr(instance, field.name)
        declared = next(
            (
                annotation
                for annotation in getattr(hints[field.name], "__metadata__", ())
                if isinstance(annotation, Quantity)
            ),
            None,
        )
        if declared is not None and isinstance(value, Real):
            yield before + declared.for_field(field.name), float(declared.in_file(value)), declared
        elif dataclasses.is_dataclass(value):
            yield from _numbers(value, f"{before}{field.name}.")


def _how_far(value: float, usual: float | None, declared: Quantity) -> float:
    """Distance of a value from its usual one [decades].

    Where the usual value is 0 or None, the geometric mean of the bounds replaces it.
    """
    if not math.isfinite(value):
        return math.inf
    if not usual:
        bounds = [abs(limit) for limit in declared.bounds.values() if limit] or [1.0]
        usual = math.sqrt(bounds[0] * bounds[-1]) if len(bounds) > 1 else _SHARE * bounds[0]
    return abs(math.log10(abs(value) / abs(usual))) if value else 0.0
