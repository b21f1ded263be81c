"""Write the sensor file of one unit: the catalogue's file of its model, with the unit's beams and mode in place."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from pathlib import Path

import tomlkit

from ... import catalog
from ...errors import InputError
from ...files.atomic import put_text
from ...files.toml_edit import get_value, put_values
from ...sensor.sensor_file import sensor_from_tables
from ..opening import open_recording
from ..pcap_reader import json_beside
from .hesai_unit import read_corrections, read_hesai
from .ouster_unit import read_ouster
from .unit_beams import LIST_KEYS, Unit
from .velodyne_unit import read_velodyne

PER_LINE = 8
"""Numbers of a list that stand in one line."""

MODEL_KEYS = (
    "rotation_hz",
    "cycle_us",
    "columns_per_turn",
    "start_azimuth_deg",
    "sweep_deg",
    "frame_hz",
    "firing_time_us",
    "encoder_step_deg",
)
"""Keys of `[scanner]` that come from the model where the unit's description lacks them."""


def read_unit(path: Path, mode: str | None = None, *, sensor_index: int = 0) -> Unit:
    """Read the maker's description of a unit: json, YAML, XML, CSV, or a recording that has one. Raises InputError.

    sensor_index  which sensor of an OSF, from 0
    """
    path = catalog.file_or_example(path)
    if not path.is_file():
        raise InputError(f"{path}: must be a file, got a folder" if path.is_dir() else f"{path}: no such file")
    if path.suffix.lower() == ".pcap" and json_beside(path).is_file():
        path = json_beside(path)
    suffix = path.suffix.lower()
    if suffix == ".osf":
        with open_recording(path, sensor_index=sensor_index) as recording:
            return read_ouster(path, mode, text=recording.unit_json)
    if suffix == ".json":
        return read_ouster(path, mode)
    if mode is not None:
        raise InputError(f"--mode: goes with an Ouster's json or OSF, got {path}")
    if suffix in (".yaml", ".yml", ".xml"):
        return read_velodyne(path)
    if suffix == ".csv":
        return read_hesai(path)
    if suffix == ".dat":
        return read_corrections(path)
    raise InputError(
        f"{path}: must be json, OSF or pcap with a json (Ouster), YAML or XML (Velodyne), CSV or dat (Hesai), "
        f"got '{path.suffix}'"
    )


def write_unit(unit: Unit, source: Path, output: Path, *, like: str | None = None) -> str:
    """Write the sensor file; return the report that the command prints. Raises InputError and OutputError.

    like  the catalogue's sensor whose laser, optics, detector and timing the unit shares; None: that of its model
    """
    if output.suffix.lower() != ".toml":
        raise InputError(f"--output {output}: the name must end in .toml")
    text, model, notes = unit_text(unit, source, like=like)
    put_text(output, text)
    return "\n".join(
        [f"wrote {output}: {unit.name}, {len(unit.lists['elevation_deg'])} beams, else as {model}", *notes]
    )


def unit_text(unit: Unit, source: Path, *, like: str | None = None) -> tuple[str, str, list[str]]:
    """Text of the unit's sensor file, the model that it is like, and notes on keys left out. Raises InputError."""
    model = like or unit.model
    if not model:
        beams = len(unit.lists["elevation_deg"])
        raise InputError(
            f"{source}: no sensor of the catalogue is of this kind ({beams} beams); --like (of twin: --sensor) says "
            "which is near"
        )
    base = catalog.path_of("sensors", model).read_text(encoding="utf-8")
    tables = _split_tables(base)
    scanner = tables.get("scanner", "")
    if 'type = "spinning"' not in scanner:
        raise InputError(f"--like {model}: must be a sensor that spins")
    text, notes = _file_text(unit, source, model, tables)
    if model != unit.model:
        notes.append(
            f"warning: laser, optics, detector and timing are of the {model}, another product: the catalogue "
            + (f"has this one as {unit.model}" if unit.model else "lacks this one")
        )
    sensor_from_tables(tomllib.loads(text), where=str(source))  # refuses a wrong sensor before anything is written
    return text, model, notes


def with_second_returns(text: str) -> str:
    """Let a sensor file that counts photons report two returns, the strongest first, as an Ouster's dual mode does."""
    if get_value(text, ("histogram",)) is None:
        return text
    return put_values(text, {("histogram", "stops"): 2, ("histogram", "keep"): "strongest"})


def _split_tables(text: str) -> dict[str, str]:
    """Split a TOML file: header of each table -> its text, in order; "" -> the text before the first."""
    tables = {"": ""}
    name = ""
    for line in text.splitlines(keepends=True):
        header = re.fullmatch(r"\[+([\w.]+)\]+\s*", line)
        if header:
            name = header[1] if line.startswith("[[") is False else f"{header[1]} {len(tables)}"
            tables[name] = ""
        tables[name] += line
    return tables


def _file_text(unit: Unit, source: Path, model: str, tables: dict[str, str]) -> tuple[str, list[str]]:
    """Text of the file, and notes on keys that were left out."""
    scanner, notes = _scanner_text(unit, tables["scanner"])
    summary = f"{unit.name}: beams of {source.name}, all else of the catalogue's {model}"
    head = "".join(f"# {_one_line(comment)}\n" for comment in unit.comments)
    head += f"name = {_toml_string(unit.name)}\ndescription = {_toml_string(summary)}\n\n"
    laser = re.sub(r"(?m)^repetition_rate_khz = .*\n", "", tables["laser"])
    # Published values belong to the model, and hold with the model's own beams only.
    other_tables = [
        text
        for name, text in tables.items()
        if name not in ("", "laser", "scanner", "sources") and not name.startswith("published")
    ]
    replaced_sources = r'(?m)^"?(scanner\b|laser\.repetition_rate_khz|published)[^\n]*\n'
    sources = re.sub(replaced_sources, "", tables.get("sources", "[sources]\n"))
    sources = sources.rstrip("\n") + f"\nscanner = {_toml_string('unit-specific: ' + source.name)}\n"
    model_keys = [key for key in MODEL_KEYS if re.search(rf"(?m)^{key} = ", scanner) and key not in unit.scanner]
    for key in model_keys:
        sources += f'"scanner.{key}" = "of the catalogue\'s {model}"\n'
    return head + laser + scanner + "".join(other_tables) + sources, notes


def _scanner_text(unit: Unit, of_model: str) -> tuple[str, list[str]]:
    """Text of the unit's [scanner], and notes; keys that the description lacks come from the model if they fit."""
    lines, notes = ['[scanner]\ntype = "spinning"\n'], []
    lines += [f"{key} = {value}\n" for key, value in unit.scanner.items()]
    beams = len(unit.lists["elevation_deg"])
    clocked = {"cycle_us", "columns_per_turn"} & unit.scanner.keys()
    for key in MODEL_KEYS:
        if key in unit.scanner or (clocked and key in ("cycle_us", "columns_per_turn")):
            continue
        entry = re.search(rf"(?ms)^{key} = (\[.*?^\]|[^\n\[]+)\n", of_model)
        if entry is None:
            continue
        if entry[1].startswith("[") and len(re.findall(r"[-\d.]+", entry[1])) != beams:
            notes.append(f"{key}: left out, since the model has it for another number of lasers")
            continue
        lines.append(entry[0])
    for key in LIST_KEYS:
        if key in unit.lists:
            lines.append(f"{key} = [\n{_list_text(unit.lists[key])}]\n")
    return "".join([*lines, "\n"]), notes


def _list_text(values: Sequence[float]) -> str:
    starts = range(0, len(values), PER_LINE)
    return "".join(
        f"    {', '.join(repr(float(number)) for number in values[first : first + PER_LINE])},\n" for first in starts
    )


def _one_line(text: str) -> str:
    """Text of a maker's file as one line of UTF-8: it may hold line breaks, control characters, or half a letter."""
    whole = text.encode("utf-8", "replace").decode("utf-8")
    return " ".join("".join(letter if letter.isprintable() else " " for letter in whole).split())


def _toml_string(text: str) -> str:
    """The line as a string of TOML."""
    return tomlkit.string(_one_line(text)).as_string()
