"""Write the sensor file of one unit: the catalogue's file of its model, with the unit's beams and mode in place."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ... import catalog
from ...errors import InputError, OptionError
from ...files.atomic import put_text
from ...files.toml_edit import KeyPath, get_value, put_values, remove_values
from ...physics.optics.radiometry import time_of_flight_s
from ...sensor.sensor_file import sensor_from_tables
from ..opening import open_recording
from ..pcap_reader import json_beside
from .hesai_unit import read_corrections, read_hesai
from .ouster_unit import read_ouster
from .unit_beams import LIST_KEYS, Unit
from .velodyne_unit import read_velodyne

CYCLE_KEYS = ("cycle_us", "columns_per_turn")
"""Keys of `[scanner]` of which a file has one."""

MODEL_KEYS = (
    "rotation_hz",
    *CYCLE_KEYS,
    "start_azimuth_deg",
    "sweep_deg",
    "frame_hz",
    "firing_time_us",
    "encoder_step_deg",
)
"""Keys of `[scanner]` that come from the model where the unit's description lacks them."""

REPLACED_SOURCES = ("scanner", "laser.repetition_rate_khz", "published")
"""How the keys of `[sources]` begin that tell of numbers which the unit's file has not."""

ALL_DIGITS = 17
"""Significant digits with which any number comes back as it was."""


def read_unit(path: Path, mode: str | None = None, *, sensor_index: int = 0) -> Unit:
    """Read the maker's description of a unit: json, YAML, XML, CSV, or a recording that has one.

    Args:
        sensor_index: which sensor of an OSF, from 0

    Raises:
        InputError: if a file, a key or a value cannot be understood
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
        raise OptionError("{mode}: needs an Ouster's json or OSF, got {0}", path)
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
    """Write the sensor file; return the report that the command prints.

    Args:
        like: the catalogue's sensor whose laser, optics, detector and timing the unit shares; None: that of its model

    Raises:
        InputError: if a file, a key or a value cannot be understood
        OutputError: if a result cannot be written
    """
    if output.suffix.lower() != ".toml":
        raise OptionError("{output} {0}: the name must end in .toml", output)
    text, model, notes = unit_text(unit, source, like=like)
    put_text(output, text)
    return "\n".join(
        [f"wrote {output}: {unit.name}, {len(unit.lists['elevation_deg'])} beams, else as {model}", *notes]
    )


def unit_text(unit: Unit, source: Path, *, like: str | None = None) -> tuple[str, str, list[str]]:
    """Text of the unit's sensor file, the model that it is like, and notes on keys left out.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    model = like or unit.model
    if not model:
        beams = len(unit.lists["elevation_deg"])
        raise OptionError(
            "{0}: no sensor of the catalogue is of this kind ({1} beams); {like} (of twin: {sensor}) says which is "
            "near",
            source,
            beams,
        )
    text = catalog.path_of("sensors", model).read_text(encoding="utf-8")
    if get_value(text, ("scanner", "type")) != "spinning":
        raise OptionError("{like} {0}: must be a sensor that spins", model)
    text, notes = _file_text(unit, source, model, text)
    if model != unit.model:
        notes.append(
            f"warning: laser, optics, detector and timing are of the {model}, another product: the catalogue "
            + (f"has this one as {unit.model}" if unit.model else "lacks this one")
        )
    sensor_from_tables(tomllib.loads(text), where=str(source))  # refuses a wrong sensor before anything is written
    return text, model, notes


def with_second_returns(text: str) -> str:
    """Let the sensor of a file report two returns, as makers do in dual mode.

    Ouster's are the two strongest; the others' are the strongest and the last (Velodyne's and Hesai's manuals).
    """
    if get_value(text, ("histogram",)) is not None:
        return put_values(text, {("histogram", "stops"): 2, ("histogram", "keep"): "strongest"})
    return put_values(text, {("tdc", "stops"): 2, ("tdc", "keep"): "strongest_and_last"})


def _file_text(unit: Unit, source: Path, model: str, text: str) -> tuple[str, list[str]]:
    """The model's text with the unit's beams and mode in place, and notes on keys that were left out."""
    of_model, replaced_sources = get_value(text, ("scanner",)), get_value(text, ("sources",)) or {}
    kept, notes = _kept_keys(unit, of_model)
    # Published values belong to the model, and hold with the model's own beams only.
    removed: list[KeyPath] = [("laser", "repetition_rate_khz"), ("published",)]
    removed += [("scanner", key) for key in of_model if key not in ("type", *kept)]
    removed += [("sources", key) for key in replaced_sources if key.startswith(REPLACED_SOURCES)]
    values: dict[KeyPath, Any] = {("name",): _one_line(unit.name)}
    values["description",] = _one_line(f"{unit.name}: beams of {source.name}, all else of the catalogue's {model}")
    values |= {("scanner", key): value for key, value in unit.scanner.items()}
    values |= {("scanner", key): list(unit.lists[key]) for key in LIST_KEYS if key in unit.lists}
    values["sources", "scanner"] = _one_line(f"unit-specific: {source.name}")
    values |= {("sources", f"scanner.{key}"): f"of the catalogue's {model}" for key in kept}
    if unit.range_step_m is not None:
        receiver = "tdc" if get_value(text, ("histogram",)) is None else "histogram"
        values[receiver, "lsb_ps"] = 1e12 * float(time_of_flight_s(range_m=unit.range_step_m))
        values["sources", f"{receiver}.lsb_ps"] = _one_line(f"unit-specific: {source.name}, its profile")
    head = "".join(f"# {_one_line(comment)}\n" for comment in unit.comments)
    return head + put_values(remove_values(text, removed), values, digits=ALL_DIGITS), notes


def _kept_keys(unit: Unit, of_model: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """Keys of the model's [scanner] that the unit's description lacks and that fit it, and notes on the others."""
    kept, notes = [], []
    given = {*unit.scanner, *(CYCLE_KEYS if not unit.scanner.keys().isdisjoint(CYCLE_KEYS) else ())}
    for key in [key for key in MODEL_KEYS if key in of_model and key not in given]:
        if isinstance(of_model[key], list) and len(of_model[key]) != len(unit.lists["elevation_deg"]):
            notes.append(f"{key}: left out, since the model has it for another number of lasers")
        else:
            kept.append(key)
    return kept, notes


def _one_line(text: str) -> str:
    """Text of a maker's file as one line of UTF-8: it may hold line breaks, control characters, or half a letter."""
    whole = text.encode("utf-8", "replace").decode("utf-8")
    return " ".join("".join(letter if letter.isprintable() else " " for letter in whole).split())
