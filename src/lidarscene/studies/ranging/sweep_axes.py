"""Axes of a sweep: the quantity varied, its unit, ends and steps, from a name given by the user.

Conditions (distance, illuminance_klux, ...) and every numeric key of a sensor file can be swept; both become an `Axis`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import BaseModel

from ...errors import OptionError, did_you_mean, question
from ...files.toml import model_of
from ...maths.arrays import Numbers
from ...maths.units import keys_like, split_unit
from ...sensor.sensor_file import SensorFile
from .aperture_laws import LARGEST_DEG
from .conditions import CONDITIONS


@dataclass(frozen=True, slots=True, kw_only=True)
class Axis:
    """Quantity that is swept.

    Attributes:
        key: name as the user gave it
        column: name with unit, for files
        label: name with unit, for charts
        whole: True if values are whole numbers
    """

    key: str
    column: str
    label: str
    unit: str
    values: Numbers
    log: bool
    whole: bool = False

    @property
    def is_parameter(self) -> bool:
        """True if a number of the sensor is varied, False for a condition."""
        return self.key not in CONDITIONS

    def between(self, low: float, high: float, count: int) -> Numbers:
        """(count,) values from low to high, spaced as the axis is."""
        return np.geomspace(low, high, count) if self.log else np.linspace(low, high, count)


def condition_axis(key: str, *, start: float | None, stop: float | None, count: int, log: bool | None) -> Axis:
    """Make an axis over one of `CONDITIONS`.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    bounds = CONDITIONS[key]
    first, last = bounds.start if start is None else start, bounds.stop if stop is None else stop
    for option, end in (("start", first), ("stop", last)):
        bounds.check(option, end)
        bounds.warn_of_unit(option, end)
    log = bounds.log if log is None else log
    return Axis(
        key=key,
        column=key if key.endswith(bounds.unit) else f"{key}_{bounds.unit}",
        unit=bounds.unit.replace("deg", "°"),
        label=bounds.meaning + (f" [{bounds.unit.replace('deg', '°')}]" if bounds.unit else ""),
        values=_steps(first, last, count, log=log),
        log=log,
    )


def parameter_axis(
    key: str,
    files: Sequence[tuple[str, Mapping[str, Any]]],
    *,
    start: float | None,
    stop: float | None,
    count: int,
    log: bool | None,
) -> Axis:
    """Make an axis over a key of sensor files, by default from a fifth to five times its value.

    Args:
        files: name and tables of each

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    whole, lows, highs = False, [], []
    for where, tables in files:
        info = numeric_keys(tables).get(key)
        if info is None:
            raise OptionError("{over} {0}: {1}", key, _unknown_key_text(key, where, tables))
        whole = whole or info.whole
        if start is None or stop is None:
            if not info.value:
                state = "is 0" if info.value == 0.0 else "is not given"
                raise OptionError("{over} {0}: {1} in {2}, so {start} and {stop} must be given", key, state, where)
            ends = sorted((info.value / 5.0, info.value * 5.0))
            lows.append(min(max(ends[0], info.low), info.value))
            highs.append(max(min(ends[1], info.high), info.value))
    first = min(lows) if start is None else start
    last = max(highs) if stop is None else stop
    log = (first > 0.0) if log is None else log
    values = _steps(first, last, count, log=log)
    name, unit = split_unit(key)
    return Axis(
        key=key,
        column=key,
        label=f"{name} [{unit}]" if unit else name,
        unit=unit,
        values=np.unique(np.rint(values)) if whole else values,
        log=log,
        whole=whole,
    )


def _steps(start: float, stop: float, count: int, *, log: bool) -> Numbers:
    """(count,) values from start to stop.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    if not (math.isfinite(start) and math.isfinite(stop)):
        raise OptionError("{start} {0:g} {stop} {1:g}: must be finite numbers", start, stop)
    if start >= stop:
        raise OptionError("{start} {0:g} {stop} {1:g}: {start} must be below {stop}", start, stop)
    if log and start <= 0.0:
        raise OptionError("{start} {0:g}: must be more than 0 on a logarithmic axis; even steps may begin at 0", start)
    steps = np.geomspace(start, stop, count) if log else np.linspace(start, stop, count)
    steps[0], steps[-1] = start, stop  # geomspace may miss them by a rounding
    return steps


@dataclass(frozen=True, slots=True, kw_only=True)
class NumericKey:
    """Numeric key of a sensor file: its value (None if not given) and its bounds."""

    value: float | None
    low: float
    high: float
    whole: bool


def numeric_keys(tables: Mapping[str, Any]) -> dict[str, NumericKey]:
    """All numeric keys that this sensor file has or may have, dotted name -> key."""
    return dict(_numeric(SensorFile, tables, ""))


def _numeric(model: type[BaseModel], tables: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, NumericKey]]:
    """Yield name and key of each number in a model and its tables; of a union of models, that of the given "type"."""
    for name, info in model.model_fields.items():
        key, value = prefix + (info.alias or name), tables.get(info.alias or name)
        types = list(_types(info.annotation))
        if isinstance(value, Mapping) and (table_model := model_of(info.annotation, value)) is not None:
            yield from _numeric(table_model, value, key + ".")
        elif (float in types or int in types) and not isinstance(value, (list, tuple, str, bool, Mapping)):
            value = info.default if value is None else value
            limits = {
                slot: float(getattr(rule, slot))
                for rule in info.metadata
                for slot in ("gt", "ge", "lt", "le")
                if getattr(rule, slot, None) is not None
            }
            yield (
                key,
                NumericKey(
                    value=float(value) if isinstance(value, (int, float)) else None,
                    low=limits.get("ge", limits.get("gt", -math.inf)),
                    high=limits.get("le", limits.get("lt", math.inf)),
                    whole=float not in types,
                ),
            )


def _types(annotation: Any) -> Iterator[Any]:
    """Yield the types in a union, without those inside lists and tables."""
    origin = getattr(annotation, "__origin__", None)
    if origin in (tuple, list, dict):
        return
    arguments = getattr(annotation, "__args__", ())
    if not arguments:
        yield annotation
    for argument in arguments:
        yield from _types(argument)


def _unknown_key_text(key: str, where: str, tables: Mapping[str, Any]) -> str:
    keys = numeric_keys(tables)
    hint = question(keys_like(key, keys)) or did_you_mean(key, [*keys, *CONDITIONS])
    hint = hint or f"must be one of {', '.join(CONDITIONS)} or a key such as detector.radius_mm"
    return f"{where} has no numeric key of that name; {hint}"


def require_within_law(axis: Axis) -> None:
    """Raise InputError for angles at which a fixed window or a mirror has no aperture."""
    if np.max(np.abs(axis.values)) > LARGEST_DEG:
        raise OptionError(
            "{over} {0}: this aperture law holds to {1:g} degrees, got {2:g} to {3:g}",
            axis.key,
            LARGEST_DEG,
            axis.values[0],
            axis.values[-1],
        )
