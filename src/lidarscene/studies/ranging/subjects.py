"""Sensors under study, from names, files and assignments, with any key of their files set to any value.

A sweep varies keys of the file, not fields of `Sensor`, so that derived numbers follow and bounds are checked.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ... import catalog
from ...errors import InputError
from ...files.overrides import split_sensor
from ...files.toml import read_toml
from ...sensor.parts import changed_tables
from ...sensor.sensor_file import SensorTables, sensor_from_tables
from ...sensor.sensor_model import Sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Subject:
    """Sensor with the tables of its file.

    Attributes:
        name: name from the file, made unique
        argument: name or path as the user gave it
        where: file, for messages
        tables: tables of the file, without assignments
        overrides: assignments, KEY=VALUE
        built: sensor that a program made or changed, so that there are no tables; else None
    """

    name: str
    argument: str
    where: str
    tables: dict[str, Any]
    folder: Path | None
    overrides: tuple[str, ...] = ()
    built: Sensor | None = None

    @property
    def changed(self) -> dict[str, Any]:
        """Tables with the assignments applied.

        Raises:
            InputError: without tables
        """
        if self.built is not None:
            raise InputError(
                f"'{self.name}': must be as `load_sensor` gave it for a key of its file to be swept, got a sensor made "
                "or changed in Python"
            )
        return changed_tables(self.tables, self.overrides)

    def sensor(self) -> Sensor:
        """Build the sensor.

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        if self.built is not None:
            return self.built
        return sensor_from_tables(self.tables, where=self.where, overrides=self.overrides, folder=self.folder)

    def sensor_with(self, key: str, value: float, *, whole: bool) -> Sensor:
        """Build the sensor with another value of a key.

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        number = repr(int(value)) if whole else repr(float(value))
        return sensor_from_tables(
            changed_tables(self.tables, [*self.overrides, f"{key}={number}"]),
            where=self.where,
            over=[key],
            folder=self.folder,
        )


def subject_of(name: str, sensor: Sensor) -> Subject:
    """Subject of a sensor, with its tables if `load_sensor` or `Sensor.replace` built it."""
    tables = sensor.origin
    if not isinstance(tables, SensorTables):
        return Subject(name=name, argument=name, where=name, tables={}, folder=None, built=sensor)
    return Subject(name=name, argument=name, where=tables.where, tables=tables.tables, folder=tables.folder)


def subjects(arguments: Sequence[str], assignments: Sequence[str] = ()) -> list[Subject]:
    """Load sensors from these catalogue names and files; equal names get a number.

    Args:
        assignments: KEY=VALUE for all, or SENSOR:KEY=VALUE for one

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    named_by_user: list[Subject] = []
    for argument in arguments:
        path = catalog.sensor_path(argument)
        where = argument if argument.endswith(".toml") else path.name
        subject = Subject(name=argument, argument=argument, where=where, tables=read_toml(path), folder=path.parent)
        named_by_user.append(subject)
    split = [split_sensor(assignment, [subject.argument for subject in named_by_user]) for assignment in assignments]
    name_counts: Counter[str] = Counter()
    unique = []
    for subject in named_by_user:
        overrides = tuple(text for addressee, text in split if addressee is None or addressee == subject.argument)
        name = replace(subject, overrides=overrides).sensor().name
        name_counts[name] += 1
        name = name if name_counts[name] == 1 else f"{name} ({name_counts[name]})"
        unique.append(replace(subject, overrides=overrides, name=name))
    return unique
