"""Designs: points of the search as values of keys, and the sensors that they make."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ... import catalog
from ...errors import InputError, did_you_mean
from ...files.overrides import assignments, get_at, get_entry, key_path, number_list_entries, toml_text
from ...files.toml import read_toml
from ...maths.arrays import Numbers
from ...sensor.parts import changed_tables, located_parts, split_parts, with_parts
from ...sensor.sensor_file import files_of_sensor, sensor_from_tables
from ...sensor.sensor_model import Sensor
from ..ranging.sweep_axes import numeric_keys
from .study_file import FreeFile, StudyFile

NO_SENSOR = "none"
"""Base of a sensor that is left out."""

_BASE = "sensor"
"""Name of the free choice of a base."""

TURNS = ("mounting.yaw_deg", "mounting.pitch_deg", "mounting.roll_deg")
"""Numbers of every sensor file, 0 if it leaves them out."""

_NOTES = ("sources", "uncertainty")
"""Tables of a sensor file that say what its numbers rest on, by their keys."""

Values = Mapping[str, Any]
"""Value of each free key."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Design:
    """A design that was evaluated.

    Attributes:
        quantities: objectives and constraints by name; {} if the sensor cannot be
        reason: why it cannot be; "" if it can
    """

    values: Values
    quantities: Mapping[str, float]
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Free:
    """Free key and its values; the search sees a share from 0 to 1 of the way from the first to the last.

    Attributes:
        key: key of the sensor file, after "LABEL:" or "BASE:" if it is not that of all sensors
        values: all values of a key that has a finite number; () if it is continuous, from low to high
    """

    key: str
    low: float = 0.0
    high: float = 1.0
    log: bool = False
    values: tuple[Any, ...] = ()

    @property
    def is_continuous(self) -> bool:
        """Whether the key takes any value in between."""
        return not self.values

    @property
    def is_ordered(self) -> bool:
        """Whether all values are numbers, which rise."""
        return all(isinstance(value, int | float) and not isinstance(value, bool) for value in self.values)

    def value(self, share: float) -> Any:
        """Value at a share."""
        if self.values:
            return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
        value = self.low * (self.high / self.low) ** share if self.log else self.low + share * (self.high - self.low)
        return min(max(value, self.low), self.high)

    def share(self, value: Any) -> float:
        """Share of a value."""
        if self.values:
            return (self.values.index(value) + 0.5) / len(self.values)
        if self.log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return float((value - self.low) / (self.high - self.low))


@dataclass(frozen=True, slots=True, kw_only=True)
class Base:
    """Sensor file that a design starts from.

    Attributes:
        settings: values that the study sets, by key
        tables: its tables with these values; None for a sensor that is left out
    """

    name: str
    path: Path | None = None
    settings: Mapping[str, Any]
    tables: dict[str, Any] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Chosen:
    """One sensor of a design: its base, and the keys that the design changes; files are named from ``folder``."""

    base: Base
    changes: Mapping[str, Any]
    folder: Path = Path()

    def sensor(self) -> Sensor:
        """Build the sensor.

        Raises:
            InputError: where a value is out of bounds
        """
        base = self.base
        folder = Path() if base.path is None else base.path.parent
        return sensor_from_tables(base.tables or {}, where=base.name, overrides=self.assignments, folder=folder)

    @property
    def assignments(self) -> list[str]:
        """Changes as ``key=value``, tables first: they stand in place of the file's, and keys may be set in them."""
        tables_first = sorted(self.changes.items(), key=lambda change: not isinstance(change[1], dict))
        return located_parts((f"{key}={toml_text(value)}" for key, value in tables_first), self.folder)

    def replaced_tables(self, source: str) -> tuple[dict[str, Any], dict[tuple[str, str], Any]]:
        """Tables of the base's file that parts of other sensors replace, and entries of sources and uncertainties.

        Args:
            source: of the values that the design changes

        Returns:
            tables by name, and sources and uncertainties by table and key; None for one that goes

        Raises:
            InputError: if a file cannot be read
        """
        assert self.base.path is not None
        settings = located_parts(assignments(self.base.settings), self.folder)
        own, changes = read_toml(self.base.path), [*settings, *self.assignments]
        with_all = changed_tables(own, changes, source=source)
        noted = {
            (name, key): after.get(key)
            for name in _NOTES
            for before, after in [(own.get(name, {}), with_all.get(name, {}))]
            for key in {**before, **after}
            if after.get(key) != before.get(key)
        }
        of_parts = with_parts(own, split_parts(changes)[0])
        names = {**own, **of_parts}.keys() - set(_NOTES)
        replaced = {name: of_parts.get(name) for name in sorted(names) if of_parts.get(name) != own.get(name)}
        return replaced, noted

    @property
    def tables(self) -> dict[str, Any]:
        """Tables of its sensor file.

        Raises:
            InputError: for a part that cannot be read
        """
        return changed_tables(self.base.tables or {}, self.assignments)


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignSpace:
    """All designs of a study: bases by label, and free keys."""

    bases: Mapping[str, Sequence[Base]]
    free: tuple[Free, ...]
    folder: Path = Path()

    @classmethod
    def from_study(cls, study: StudyFile, folder: Path, where: str) -> DesignSpace:
        """Read the sensor files and check the free keys.

        Args:
            folder: of the study file
            where: study file, for messages

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        bases = {
            label: [
                _read_base(name, placed.set, folder, f"{where}: sensors.{label}.base" if label else f"{where}: sensor")
                for name in placed.bases
            ]
            for label, placed in study.placed.items()
        }
        if all(base.tables is None for base in itertools.chain(*bases.values())):
            raise InputError(f'{where}: sensor: must be a sensor, got only "{NO_SENSOR}"')
        choices = [
            Free(key=_joined(label, _BASE), values=tuple(base.name for base in alternatives))
            for label, alternatives in bases.items()
            if len(alternatives) > 1
        ]
        keys = [_free_key(key, entry, bases, f"{where}: free.{key}") for key, entry in study.free.items()]
        return cls(bases=bases, free=(*choices, *keys), folder=folder)

    @property
    def continuous(self) -> Numbers:
        """Numbers of the free keys that take any value in between."""
        return np.flatnonzero([free.is_continuous for free in self.free])

    @property
    def is_smooth(self) -> bool:
        """Whether all free keys are continuous."""
        return len(self.continuous) == len(self.free)

    def every_design(self, most: int) -> Numbers | None:
        """(n, keys) shares of all designs, n no more than ``most``; None where there are more."""
        if len(self.continuous):
            return None
        places = [[(number + 0.5) / len(free.values) for number in range(len(free.values))] for free in self.free]
        bases = self.sensor_choices()
        designs: list[tuple[float, ...]] = []
        for chosen in itertools.product(
            *(p if f.key in bases else p[:1] for f, p in zip(self.free, places, strict=True))
        ):
            present = self.values(np.array(chosen))
            # A key of a base that is not chosen has no effect.
            varied = [
                every if free.key in present and free.key not in bases else [share]
                for free, every, share in zip(self.free, places, chosen, strict=True)
            ]
            if len(designs) + math.prod(map(len, varied)) > most:
                return None
            designs += itertools.product(*varied)
        return np.array(designs)

    def neighbours(self, shares: Numbers) -> list[Numbers]:
        """Designs that differ in one key of finitely many values: by 1, 2, 4, ... steps, or in any other choice."""
        present = self.values(shares)
        moved = []
        for place, free in enumerate(self.free):
            if free.is_continuous or free.key not in present:
                continue
            number, count = free.values.index(present[free.key]), len(free.values)
            steps = [2**power for power in range(count.bit_length())] if free.is_ordered else range(1, count)
            for other in (number + sign * step for step in steps for sign in (-1, 1)):
                if 0 <= other < count:
                    neighbour = np.array(shares)
                    neighbour[place] = free.share(free.values[other])
                    moved.append(neighbour)
        return moved

    def sensor_choices(self) -> dict[str, tuple[str, ...]]:
        """Bases that each free choice of a sensor has, by its key."""
        return {free.key: free.values for free in self.free if _split(free.key)[1] == _BASE}

    def values(self, shares: Numbers) -> dict[str, Any]:
        """Values of the free keys at these shares; without keys of bases that are not chosen."""
        values = {free.key: free.value(float(share)) for free, share in zip(self.free, shares, strict=True)}
        chosen = {label: values.get(_joined(label, _BASE), bases[0].name) for label, bases in self.bases.items()}
        present = {label for label, name in chosen.items() if name != NO_SENSOR}
        prefixes = {"", *present, *chosen.values()} - {NO_SENSOR}
        return {
            key: value
            for key, value in values.items()
            for prefix, plain in [_split(key)]
            if plain == _BASE or prefix in prefixes
        }

    def chosen(self, values: Values) -> dict[str, Chosen]:
        """Base and changed keys of each sensor of a design, by label; without those that are left out."""
        sensors = {}
        for label, alternatives in self.bases.items():
            name = values.get(_joined(label, _BASE), alternatives[0].name)
            base = next(base for base in alternatives if base.name == name)
            if base.tables is not None:
                changes = [
                    (key, values[free.key])
                    for free in self.free
                    for prefix, key in [_split(free.key)]
                    if key != _BASE and free.key in values and prefix in ("", label, base.name)
                ]
                sensors[label] = Chosen(base=base, changes=_merged(base.tables, changes), folder=self.folder)
        return sensors

    def sensors(self, values: Values) -> dict[str, Sensor]:
        """Sensors of a design by label.

        Raises:
            InputError: where a value is out of bounds
        """
        return {label: chosen.sensor() for label, chosen in self.chosen(values).items()}


def files_of_base(base: Base) -> list[Path]:
    """Files that a base names, such as patterns, without itself."""
    return [] if base.path is None else list(files_of_sensor(base.path))[1:]


def _read_base(name: str, settings: Mapping[str, Any], folder: Path, where: str) -> Base:
    """Read a sensor file with the study's settings in it; ``where`` names the key of the base, beside which is `set`.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    if name == NO_SENSOR:
        return Base(name=name, settings=settings)
    settings = {
        key: value for text, value in settings.items() for prefix, key in [_split(text)] if prefix in ("", name)
    }
    try:
        path = catalog.sensor_path(name, folder)
        tables = read_toml(path)
        where = where.removesuffix("sensor").removesuffix("base") + "set" if settings else where
        tables = changed_tables(tables, located_parts(assignments(settings), folder))
        sensor_from_tables(tables, where=name, folder=path.parent)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    return Base(name=name, path=path, settings=settings, tables=tables)


def _joined(label: str, key: str) -> str:
    return f"{label}:{key}" if label else key


def _split(key: str) -> tuple[str, str]:
    """Label or base, "" if none, and key."""
    prefix, colon, plain = key.rpartition(":")
    return (prefix, plain) if colon else ("", key)


def _free_key(key: str, entry: FreeFile, bases: Mapping[str, Sequence[Base]], where: str) -> Free:
    prefix, plain = _split(key)
    prefixes = {name for name in bases if name} | {base.name for base in itertools.chain(*bases.values())}
    if prefix and prefix not in prefixes:
        raise InputError(f"{where}: must start with one of {', '.join(sorted(prefixes))}, got '{prefix}'")
    whole = False
    for label, alternatives in bases.items():
        for base in alternatives:
            if base.tables is not None and prefix in ("", label, base.name):
                numbers = numeric_keys(base.tables)
                if plain in numbers:
                    whole = numbers[plain].whole
                elif entry.choices is None and not has_number(base.tables, plain):
                    ends = [name for name in numbers if name.endswith(f".{plain}")]
                    hint = f"did you mean {ends[0]}?" if ends else did_you_mean(plain, list(numbers))
                    raise InputError(f"{where}: {base.name} has no number of that name; {hint}".rstrip("; "))
    if entry.choices is not None:
        choices = Free(key=key, values=entry.choices)
        return replace(choices, values=tuple(sorted(choices.values))) if choices.is_ordered else choices
    assert entry.low is not None
    assert entry.high is not None
    if entry.step is None and not whole:
        return Free(key=key, low=entry.low, high=entry.high, log=entry.log)
    step = entry.step or 1.0
    count = math.floor((entry.high - entry.low) / step + 1e-9) + 1
    values = [entry.low + step * number for number in range(count)]
    if whole:
        if any(value != round(value) for value in values):
            raise InputError(f"{where}: must be whole numbers, got low {entry.low:g} and step {step:g}")
        values = [int(value) for value in values]
    return Free(key=key, values=tuple(values))


def entry_number(key: str) -> tuple[str, int | None]:
    """Key and number of an entry of its list: `mounting.position_m[2]`; None for a plain key."""
    plain, bracket, number = key.partition("[")
    return (plain, int(number[:-1])) if bracket and number[:-1].isdecimal() and number.endswith("]") else (key, None)


def list_under(tables: Mapping[str, Any], key: str) -> list[Any] | None:
    """List under a key; the origin for a position that the file leaves out."""
    value = get_at(tables, key_path(key))
    if value is None and key == "mounting.position_m":
        return [0.0, 0.0, 0.0]
    return list(value) if isinstance(value, (list, tuple)) else None


def has_number(tables: Mapping[str, Any], key: str) -> bool:
    """Whether a sensor file has a number under a key, also within lists."""
    if key in TURNS or key in numeric_keys(tables):
        return True
    plain, number = entry_number(key)
    if number is not None:
        entries = list_under(tables, plain)
        return entries is not None and number < len(entries)
    value: Any = tables
    for part in number_list_entries(key_path(key), tables):
        value = get_entry(value, int(part) if isinstance(value, list) and part.isdecimal() else part)
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _merged(tables: Mapping[str, Any], changes: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    """Changed keys and their values; entries of one list become one list."""
    merged: dict[str, Any] = {}
    for key, value in changes:
        plain, number = entry_number(key)
        if number is None:
            merged[key] = value
        else:
            merged.setdefault(plain, list_under(tables, plain) or [])[number] = value
    return merged
