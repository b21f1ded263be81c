"""Changes to the tables of a sensor file: its values, and parts in place of which another sensor's stand.

`--set detector=sipm-905`, `Sensor.with_detector` and the choices of a design study come here. A part is more than its
table: a detector without the amplifier and the threshold that were made for it answers no question.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..catalog import sensor_path
from ..errors import InputError
from ..files.overrides import change_error, get_at, key_path, short_text, toml_text, toml_value, with_overrides
from ..files.toml import read_toml


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorPart:
    """Keys of a sensor file that go together.

    Attributes:
        tables: whole tables, its own first
        also: keys of other tables
        without: keys of ``tables`` that stay, unless only one of the two sensors has the table
    """

    tables: tuple[str, ...]
    also: tuple[str, ...] = ()
    without: tuple[str, ...] = ()

    def has(self, key: str) -> bool:
        """Whether this dotted key, or table, goes with the part."""
        return key in self.also or (key.partition(".")[0] in self.tables and key not in self.without)


RATE = "laser.repetition_rate_khz"

PARTS = {
    "laser": SensorPart(tables=("laser",), without=(RATE,)),
    "optics": SensorPart(tables=("optics",)),
    "scanner": SensorPart(tables=("scanner",), also=(RATE,)),
    "detector": SensorPart(
        tables=("detector", "receiver", "tdc", "sampler", "histogram"),
        without=("tdc.window_us", "tdc.blanking_ns", "tdc.keep", "tdc.stops"),
    ),
}
"""Parts of a sensor by their tables. The scanner sets the rhythm of the pulses; when the converter listens and how many
returns it reports follow from that rhythm, not from the detector. Intensities are in units of light or of the maker."""

_FILES = ("scanner.file", "optics.filter.csv")
"""Keys that name files, of the tables that parts take."""


def is_part(key: str, value: Any) -> bool:
    """Whether a change of this key to this value means a part of another sensor."""
    return key in PARTS and isinstance(value, str)


def located_parts(overrides: Iterable[str], folder: Path) -> list[str]:
    """Return assignments with sensor files of parts found in a folder, that of the file which has the assignments."""
    return [
        f"{key}={toml_text(str((folder / value).absolute()))}"
        if is_part(key, value) and value.endswith(".toml")
        else text
        for text in overrides
        for key, value in [_parsed(text)]
    ]


def split_parts(overrides: Iterable[str]) -> tuple[list[str], list[str]]:
    """Split assignments into those of parts of other sensors, and all others.

    Raises:
        InputError: for a text that cannot be the name of a sensor
    """
    parts: list[str] = []
    others: list[str] = []
    for text in overrides:
        key, value = _parsed(text)
        # Text with a brace was meant as a table, but is no TOML.
        if is_part(key, value) and (not value or value.startswith("{")):
            must = "must be the name or file of a sensor, or a table in TOML"
            raise change_error([text], f"{must}, got {short_text(value)}")
        (parts if is_part(key, value) else others).append(text)
    return parts, others


def other_parts(name: str, overrides: Iterable[str]) -> list[str]:
    """Those of the assignments whose keys do not go with a part."""
    return [text for text in overrides if not PARTS[name].has(_parsed(text)[0])]


def with_parts(tables: Mapping[str, Any], parts: Iterable[str]) -> dict[str, Any]:
    """Return tables of a sensor file with parts of other sensors, such as ``detector=sipm-905``.

    Raises:
        InputError: if a file cannot be read or lacks the part
    """
    changed = dict(tables)
    for text in parts:
        key, name = _parsed(text)
        try:
            path = sensor_path(name)
            donor = read_toml(path)
        except InputError as error:
            raise change_error([text], str(error)) from None
        if not isinstance(donor.get(key), dict):
            raise change_error([text], f"{path} must be a sensor file, got one without [{key}]")
        changed = with_part_of(changed, key, donor, path.parent)
    return changed


def with_part_of(tables: Mapping[str, Any], name: str, donor: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Tables of a sensor file with a part of the donor's, whose files lie in ``folder``, and what it rests on."""
    return _with_part(tables, PARTS[name], with_absolute_files(donor, folder))


def part_files(overrides: Iterable[str]) -> list[Path]:
    """Sensor files whose parts these assignments take."""
    return [sensor_path(_parsed(text)[1]) for text in split_parts(overrides)[0]]


def changed_tables(tables: Mapping[str, Any], overrides: Iterable[str], *, source: str | None = None) -> dict[str, Any]:
    """Tables of a sensor file with assignments made: parts of other sensors first, whatever the order.

    Source and uncertainty of a number do not hold for the one that replaces it.

    Args:
        source: of the new values; None: the assignments

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    parts, others = split_parts(overrides)
    changed = _with_derived_rate(with_overrides(with_parts(tables, parts), others), others)
    new_sources = {_parsed(text)[0]: source or f"override {text}" for text in others}
    for name, new in (("sources", new_sources), ("uncertainty", {})):
        old = changed.get(name, {})
        if isinstance(old, dict) and (old or new):
            kept = {key: entry for key, entry in old.items() if not any(_is_in(key, other) for other in new_sources)}
            changed[name] = kept | new
    return _without_unknowns(changed, lambda key: any(_is_in(key, other) for other in new_sources))


def _parsed(assignment: str) -> tuple[str, Any]:
    """Key and value of an assignment."""
    return ".".join(key_path(assignment)), toml_value(assignment.partition("=")[2])


def _is_in(key: str, table: str) -> bool:
    """Whether a dotted key is this one, or in the table of this name."""
    return key == table or key.startswith(f"{table}.")


def _with_part(tables: Mapping[str, Any], part: SensorPart, donor: Mapping[str, Any]) -> dict[str, Any]:
    """Tables with a part of the donor's, its sources and its uncertainties."""
    changed = dict(tables)
    for name in part.tables:
        if isinstance(tables.get(name), dict) and isinstance(donor.get(name), dict):
            changed[name] = _mixed(tables[name], donor[name], part, f"{name}.")
        elif name in donor:
            changed[name] = donor[name]
        else:
            changed.pop(name, None)
    for key in part.also:
        name = key.partition(".")[0]
        changed[name] = _mixed(_table(tables, name), _table(donor, name), part, f"{name}.")
    for name in ("sources", "uncertainty"):
        changed[name] = _mixed(_table(tables, name), _table(donor, name), part, "")
    for keys, file in ((part.without, tables), (part.also, donor)):
        changed["sources"] |= {key: source for key in keys for source in [_source(file, key)] if source is not None}
    return _without_unknowns(changed, part.has)


def _without_unknowns(tables: dict[str, Any], is_other: Callable[[str], bool]) -> dict[str, Any]:
    """Tables whose `published.unknowns` name no number that is another now."""
    published = _table(tables, "published")
    unknowns = published.get("unknowns")
    if not isinstance(unknowns, dict):
        return tables
    kept = {key: entry for key, entry in unknowns.items() if not is_other(key)}
    return {**tables, "published": {**published, "unknowns": kept}}


def _mixed(own: Mapping[str, Any], other: Mapping[str, Any], part: SensorPart, prefix: str) -> dict[str, Any]:
    """Own entries without those of the part, which are the other's; ``prefix`` goes before their keys."""
    kept = {key: value for key, value in own.items() if not part.has(prefix + key)}
    return kept | {key: value for key, value in other.items() if part.has(prefix + key)}


def _table(tables: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """Table of this name; an empty one for a file without."""
    table = tables.get(name)
    return table if isinstance(table, dict) else {}


def _source(tables: Mapping[str, Any], key: str) -> str | None:
    """Source of a key that the file has: its own, or its table's."""
    table, _, name = key.partition(".")
    sources = _table(tables, "sources")
    return sources.get(key, sources.get(table)) if name in _table(tables, table) else None


def with_absolute_files(tables: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Tables whose files are found from any folder."""
    names = {key: get_at(tables, key_path(key)) for key in _FILES}
    found = [f"{key}={toml_text(str((folder / name).absolute()))}" for key, name in names.items() if name is not None]
    return with_overrides(tables, found)


def _with_derived_rate(tables: dict[str, Any], overrides: Iterable[str]) -> dict[str, Any]:
    """Tables without the file's rate where overrides change the firing table, which gives another."""
    keys = [_parsed(text)[0] for text in overrides]
    fires_anew = any(key.startswith("scanner.") for key in keys) and RATE not in keys
    laser, scanner = tables.get("laser"), tables.get("scanner")
    if not (fires_anew and isinstance(laser, dict) and isinstance(scanner, dict)):
        return tables
    if scanner.get("type") != "spinning":
        return tables
    return tables | {"laser": {key: value for key, value in laser.items() if key != "repetition_rate_khz"}}
