"""Edits of the text of a TOML file, which keep its comments and its order.

A path is the names of the tables down to the key: ("optics", "overlap", "focus_at_m").
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from typing import Any

import tomlkit

from .overrides import get_at

DIGITS = 6
"""Significant digits of the numbers that are put."""

PER_LINE = 8
"""Numbers of a list that stand in one line."""

KeyPath = tuple[str, ...]


def put_values(text: str, values: Mapping[KeyPath, Any], *, digits: int = DIGITS) -> str:
    """Put a value under each path; tables that the file lacks are added. Numbers get this many significant digits."""
    document = tomlkit.parse(text)
    for path, value in values.items():
        table: Any = document
        for name in path[:-1]:
            if isinstance(table, list):  # of tables
                table = table[int(name)]
                continue
            if name not in table:
                table.append(name, tomlkit.table())
            table = table[name]
        table[path[-1]] = rounded(value, digits)
    return tomlkit.dumps(document)


def get_value(text: str, path: KeyPath) -> Any:
    """Value under a path; None if the file has none."""
    return get_at(tomllib.loads(text), path)


def remove_values(text: str, paths: Iterable[KeyPath]) -> str:
    """Remove the keys of these paths; those that the file lacks are skipped."""
    document = tomlkit.parse(text)
    for path in paths:
        if get_at(document, path) is not None:
            get_at(document, path[:-1]).remove(path[-1])
    return tomlkit.dumps(document)


def rounded(value: Any, digits: int = DIGITS) -> Any:
    """Value whose numbers have this many significant digits; of a long list TOML, in lines."""
    if isinstance(value, list):
        numbers, lines = [rounded(number, digits) for number in value], tomlkit.array()
        if len(numbers) <= PER_LINE:
            return numbers
        for start in range(0, len(numbers), PER_LINE):
            lines.add_line(*numbers[start : start + PER_LINE])
        lines.add_line(indent="")
        return lines
    return float(f"{value:.{digits}g}") if isinstance(value, float) else value
