"""Change the tables of a file before they are checked, as `--set KEY=VALUE` does, and write values as TOML.

The command line gives texts; Python may give a text, several texts or a mapping.
"""

from __future__ import annotations

import json
import math
import os
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import date, time
from typing import Annotated, Any

from ..errors import InputError, OptionError
from .arguments import CHECKED_INSIDE


def with_overrides(
    tables: Mapping[str, Any], assignments: Iterable[str], *, option: str = "overrides"
) -> dict[str, Any]:
    """Return a copy of the tables with assignments ``a.b=value`` made; values are TOML, or else plain text.

    In a list of tables a part of the key is a name or a number: ``bodies.car.yaw_deg=30``.

    Args:
        option: Python's name of the argument that has them

    Raises:
        InputError: for what is no assignment, or does not fit the tables
    """
    result: dict[str, Any] = _copy(tables)
    for assignment in assignments:
        _, equals, text = assignment.partition("=")
        path = key_path(assignment)
        if not equals or not all(path):
            example = "detector.gain=60" if "detector" in tables else "sun.illuminance_klux=1"
            raise change_error([assignment], f"must be KEY=VALUE, such as {example}", option=option)
        table: Any = result
        for depth in range(1, len(path)):
            part = path[depth - 1]  # names of tables in lists have become numbers
            table = table.setdefault(part, {}) if isinstance(table, dict) else table[int(part)]
            if _is_list_of_tables(table):
                path = path[:depth] + number_list_entries(path[depth:], table)
                if not path[depth].isdecimal() or int(path[depth]) >= len(table) or depth + 1 == len(path):
                    choices = ", ".join(str(entry.get("name", i)) for i, entry in enumerate(table))
                    mistake = f"must be {'.'.join(path[:depth])}.NAME.KEY, with a name of {choices}"
                    raise change_error([assignment], mistake, option=option)
            elif not isinstance(table, dict):
                raise change_error([assignment], f"{'.'.join(path[:depth])} is a value, not a table", option=option)
        table[path[-1]] = toml_value(text)
    return result


def change_error(
    changes: Sequence[str], mistake: str, *, where: str = "", option: str = "overrides", hint: str = ""
) -> InputError:
    """Error of changes to a file's values: "FILE overrides a.b=3: MISTAKE"; the command line writes --set.

    Args:
        where: name of the file
        option: Python's name of the argument that has the changes
        hint: end of the message, in which ``{scene_overrides}`` is such a name
    """
    places = ["{0}"] * bool(where) + [f"{{{option}}} {{{number}}}" for number in range(1, len(changes) + 1)]
    return OptionError(f"{' '.join(places)}: {{{len(changes) + 1}}}{hint}", where, *changes, mistake)


Overrides = Annotated[str | Iterable[str] | Mapping[str, Any], CHECKED_INSIDE]
"""Changes to a file's values: "a.b=value", several of these, or a mapping {"a.b": value} or {"a": {"b": value}}."""


def assignments(overrides: Overrides, *, name: str = "overrides") -> tuple[str, ...]:
    """Convert overrides to assignments "a.b=value".

    Raises:
        InputError: with the option's ``name``, for other types
    """
    if isinstance(overrides, str):
        return (overrides,)
    if isinstance(overrides, Mapping):
        return tuple(_iter_assignments(overrides))
    listed = tuple(overrides) if isinstance(overrides, Iterable) else (None,)
    if all(isinstance(text, str) for text in listed):
        return listed
    raise InputError(
        f'{name}: must be "key=value", a list of these, or a dict of values by key, got {short_text(overrides)}'
    )


def _iter_assignments(tables: Mapping[str, Any], path: str = "") -> Iterator[str]:
    for key, value in tables.items():
        if isinstance(value, Mapping):
            yield from _iter_assignments(value, f"{path}{key}.")
        else:
            try:
                text = toml_text(to_builtin(value))
            except InputError as error:
                raise InputError(f"{path}{key}: {error}") from None
            yield f"{path}{key}={text}"


def to_builtin(value: Any) -> Any:
    """Convert NumPy values, also those in a list, to Python's own, and a path to text."""
    if isinstance(value, list | tuple):
        return [to_builtin(inner) for inner in value]
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    return value.tolist() if hasattr(value, "tolist") else value


def key_path(assignment: str) -> list[str]:
    """Parts of the key in ``a.b=value``: ["a", "b"]."""
    return [part.strip() for part in assignment.partition("=")[0].split(".")]


def _is_list_of_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(entry, dict) for entry in value)


def number_list_entries(path: list[str], tables: Any) -> list[str]:
    """Return the path with names of tables in lists replaced by their numbers; unknown names stay."""
    keys = []
    for part in path:
        if _is_list_of_tables(tables):
            names = [table.get("name") for table in tables]
            part = str(names.index(part)) if part in names else part
            tables = get_entry(tables, int(part)) if part.isdecimal() else None
        else:
            tables = get_entry(tables, part)
        keys.append(part)
    return keys


def toml_text(value: Any) -> str:
    """Return a value as it is written in TOML, in one line."""
    if isinstance(value, dict):
        return "{ " + ", ".join(toml_entry(key, inner) for key, inner in value.items()) + " }" if value else "{}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(toml_text(inner) for inner in value) + "]"
    if isinstance(value, (date, time)):
        return value.isoformat()
    if isinstance(value, float) and not math.isfinite(value):
        return repr(float(value))  # "inf" and "nan"; the words of JSON are none of TOML
    if not isinstance(value, str | int | float | None):
        raise InputError(f"must be a text, a number, a list or a dict, got {type(value).__name__}")
    return json.dumps(value, ensure_ascii=False)


def toml_entry(key: str, value: Any) -> str:
    """Return a key with its value, in quotes where TOML needs them."""
    return f"{key if re.fullmatch('[A-Za-z0-9_-]+', key) else toml_text(key)} = {toml_text(value)}"


def toml_value(text: str) -> Any:
    """Parse ``text`` as a TOML value; if it is none, return the text."""
    try:
        tables = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text.strip()
    return tables["value"] if len(tables) == 1 else text.strip()


def _copy(value: Any) -> Any:
    """Copy tables and lists, however deep."""
    if isinstance(value, list):
        return [_copy(inner) for inner in value]
    return {key: _copy(inner) for key, inner in value.items()} if isinstance(value, dict) else value


def split_sensor(assignment: str, among: Sequence[str]) -> tuple[str | None, str]:
    """Split SENSOR:KEY=VALUE into the sensor (None: all of them) and KEY=VALUE.

    Raises:
        InputError: if the sensor is not ``among`` these
    """
    key, equals, value = assignment.partition("=")
    sensor, colon, own_key = key.rpartition(":")
    if not colon:
        return None, assignment
    if sensor not in among:
        raise change_error([assignment], f"'{sensor}' is not among the sensors here: {', '.join(among)}")
    return sensor, f"{own_key}{equals}{value}"


def get_at(tables: Any, path: Iterable[Any]) -> Any:
    """Entry under a path of keys and indices; None without."""
    for key in path:
        tables = get_entry(tables, key)
    return tables


def get_entry(tables: Any, key: Any) -> Any:
    """Entry of a table or a list at this key or index; None without."""
    try:
        return tables[key]
    except (IndexError, KeyError, TypeError):
        return None


def short_text(value: Any) -> str:
    """Return a value much as it is written in TOML, cut to 60 characters."""
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 60 else f"{text[:57]}..."
