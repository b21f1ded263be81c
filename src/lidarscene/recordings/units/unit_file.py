"""A sensor file of one unit: the catalogue's file of its model, with the unit's beams and mode in place."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from pathlib import Path

from ... import catalog
from ...errors import InputError
from ...files.atomic import put_text
from ...sensor.file import sensor_from_tables
from .hesai_unit import read_hesai
from .ouster_unit import read_ouster
from .unit_beams import OF_LISTS, Unit
from .velodyne_unit import read_velodyne

PER_LINE = 8
"""Numbers of a list in one line."""

KEPT = ("rotation_hz", "cycle_us", "columns_per_turn", "start_azimuth_deg", "firing_time_us", "encoder_step_deg")
"""Keys of `[scanner]` that the model has and a unit's description may not have."""


def unit_from(path: Path, mode: str | None = None) -> Unit:
    """Read what the maker says of a unit: json, YAML, XML or CSV. Raises InputError."""
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    suffix = path.suffix.lower()
    if suffix == ".json":
        return read_ouster(path, mode)
    if mode is not None:
        raise InputError(f"--mode: goes with an Ouster's json, got {path}")
    if suffix in (".yaml", ".yml", ".xml"):
        return read_velodyne(path)
    if suffix == ".csv":
        return read_hesai(path)
    raise InputError(f"{path}: must be json (Ouster), YAML or XML (Velodyne) or CSV (Hesai), got '{path.suffix}'")


def write_unit(unit: Unit, source: Path, output: Path, *, like: str | None = None) -> str:
    """Write the sensor file and load it; returns what there is to say. Raises InputError and OutputError.

    like  the catalogue's sensor whose laser, optics, detector and timing the unit shares; None: that of its model
    """
    if output.suffix.lower() != ".toml":
        raise InputError(f"--output {output}: the name must end in .toml")
    model = like or unit.model
    if not model:
        beams = len(unit.lists["elevation_deg"])
        raise InputError(
            f"{source}: no sensor of the catalogue is of this kind ({beams} beams); --like says which is near"
        )
    base = catalog.path_of("sensors", model).read_text(encoding="utf-8")
    parts = _parts(base)
    scanner = parts.get("scanner", "")
    if 'type = "spinning"' not in scanner:
        raise InputError(f"--like {model}: must be a sensor that spins")
    text, notes = _text(unit, source, model, parts)
    sensor_from_tables(tomllib.loads(text), where=str(source))  # what it is not, is told before anything is written
    put_text(output, text)
    return "\n".join(
        [f"wrote {output}: {unit.name}, {len(unit.lists['elevation_deg'])} beams, else as {model}", *notes]
    )


def _parts(text: str) -> dict[str, str]:
    """Each table of a file, by its header, in order; "" is what stands before the first."""
    found = {"": ""}
    name = ""
    for line in text.splitlines(keepends=True):
        header = re.fullmatch(r"\[+([\w.]+)\]+\s*", line)
        if header:
            name = header[1] if line.startswith("[[") is False else f"{header[1]} {len(found)}"
            found[name] = ""
        found[name] += line
    return found


def _text(unit: Unit, source: Path, model: str, parts: dict[str, str]) -> tuple[str, list[str]]:
    """The file, and what was left out."""
    scanner, notes = _scanner(unit, parts["scanner"])
    told = f"{unit.name}: beams of {source.name}, all else of the catalogue's {model}"
    head = "".join(f"# {one}\n" for one in unit.comments)
    head += f'name = "{_plain(unit.name)}"\ndescription = "{_plain(told)}"\n\n'
    laser = re.sub(r"(?m)^repetition_rate_khz = .*\n", "", parts["laser"])
    # What is published is of the model, and is checked with the model's own beams.
    others = [
        text
        for name, text in parts.items()
        if name not in ("", "laser", "scanner", "sources") and not name.startswith("published")
    ]
    gone = r'(?m)^"?(scanner\b|laser\.repetition_rate_khz|published)[^\n]*\n'
    sources = re.sub(gone, "", parts.get("sources", "[sources]\n"))
    sources = sources.rstrip("\n") + f'\nscanner = "unit-specific: {_plain(source.name)}"\n'
    kept = [key for key in KEPT if re.search(rf"(?m)^{key} = ", scanner) and key not in unit.scanner]
    for key in kept:
        sources += f'"scanner.{key}" = "of the catalogue\'s {model}"\n'
    return head + laser + scanner + "".join(others) + sources, notes


def _scanner(unit: Unit, of_model: str) -> tuple[str, list[str]]:
    """[scanner] of the unit; what the description does not have comes from the model, if it fits."""
    lines, notes = ['[scanner]\ntype = "spinning"\n'], []
    lines += [f"{key} = {value}\n" for key, value in unit.scanner.items()]
    beams = len(unit.lists["elevation_deg"])
    clocked = {"cycle_us", "columns_per_turn"} & unit.scanner.keys()
    for key in KEPT:
        if key in unit.scanner or (clocked and key in ("cycle_us", "columns_per_turn")):
            continue
        found = re.search(rf"(?ms)^{key} = (\[.*?^\]|[^\n\[]+)\n", of_model)
        if found is None:
            continue
        if found[1].startswith("[") and len(re.findall(r"[-\d.]+", found[1])) != beams:
            notes.append(f"{key}: left out, since the model has it for another number of lasers")
            continue
        lines.append(found[0])
    for key in OF_LISTS:
        if key in unit.lists:
            lines.append(f"{key} = [\n{_rows(unit.lists[key])}]\n")
    return "".join([*lines, "\n"]), notes


def _rows(values: Sequence[float]) -> str:
    starts = range(0, len(values), PER_LINE)
    return "".join(
        f"    {', '.join(repr(float(one)) for one in values[first : first + PER_LINE])},\n" for first in starts
    )


def _plain(text: str) -> str:
    """Without what would end a string of TOML."""
    return re.sub(r'["\\\x00-\x1f]', " ", text)
