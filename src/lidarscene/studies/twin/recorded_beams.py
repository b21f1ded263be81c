"""Sensor file with the beams that a list of points shows: elevations, azimuths, firings in a turn, sector."""

from __future__ import annotations

import math
import tomllib
from typing import Any

import numpy as np

from ...files.toml_edit import KeyPath, get_value, put_values, remove_values
from ...maths.arrays import Numbers
from ...scan.spinning import Spinning
from ...sensor.sensor_file import sensor_from_tables
from .sensor_grid import SensorGrid, rows_of

EXIT_KEYS = ("forward_mm", "left_mm", "height_mm")
"""Keys of `[scanner]` that say where the beams start."""


def with_recorded_beams(text: str, grid: SensorGrid, recording: str) -> tuple[str, str]:
    """Put the recorded beams into the file of a sensor that spins; returns the text, and a note on what has changed.

    The time from firing to firing stays, so another number of firings in a turn means another rate of turns.

    Args:
        grid: list of points on this sensor's grid
        recording: its name, for the sources

    Raises:
        InputError: if the file does not take the values
    """
    scanner = sensor_from_tables(tomllib.loads(text), where=recording).scanner
    assert isinstance(scanner, Spinning)
    rows, columns, table = rows_of(scanner), grid.sweep.shape[1], get_value(text, ("scanner",))
    rotation_hz = float(table["rotation_hz"])
    values: dict[str, Any] = {}
    notes = [f"{columns} columns a turn"]
    if columns != rows.columns[0]:
        rotation_hz *= rows.columns[0] / columns
        values["rotation_hz"] = rotation_hz
        if "columns_per_turn" in table:
            values["columns_per_turn"] = round(table["columns_per_turn"] * columns / rows.columns[0])
    if grid.sector_rad is not None and "sweep_deg" not in table:
        begin, span = np.degrees(grid.sector_rad).tolist()
        values |= {"sweep_deg": min(span + 360.0 / columns, 360.0), "frame_hz": abs(rotation_hz)}
        values["start_azimuth_deg"] = begin if rotation_hz > 0.0 else (begin + span + 180.0) % 360.0 - 180.0
        notes.append(f"a sector of {span:.3g} degrees")
    channels = np.unique(scanner.lasers_by_place.values)
    entry = np.searchsorted(channels, table.get("channel") or np.arange(scanner.lasers))
    values["elevation_deg"] = np.degrees(grid.elevation_rad)[entry].tolist()
    off_deg = np.degrees(grid.elevation_rad - rows.elevation_rad)
    notes.append(f"elevations {float(np.sqrt(np.mean(off_deg**2))):.2g} degrees (rms) from the file's")
    removed = ["elevation_shift_deg", "elevation_scale"]
    if scanner.start_m is not None and grid.sweep.origin_m is None:
        removed += EXIT_KEYS
        notes.append("all from one point")
    text = remove_values(text, [("scanner", key) for key in removed])
    text = _put(text, values, recording)
    offset_deg = np.degrees(_azimuth_shifts(text, grid, recording))
    if np.any(offset_deg):
        offsets = np.asarray(table.get("azimuth_offset_deg") or np.zeros(scanner.lasers)) + offset_deg[entry]
        text = _put(text, {"azimuth_offset_deg": offsets.tolist()}, recording)
    return text, f"beams of the recording: {', '.join(notes)}"


def _put(text: str, values: dict[str, Any], recording: str) -> str:
    """Put values of the scanner into a sensor file, each with its source."""
    paths: dict[KeyPath, Any] = {("scanner", key): value for key, value in values.items()}
    return put_values(text, paths | {("sources", f"scanner.{key}"): f"recorded: {recording}" for key in values})


def _azimuth_shifts(text: str, grid: SensorGrid, recording: str) -> Numbers:
    """Angle from each channel's beams to its recorded columns [rad], less than a step; 0 where it is not known."""
    scanner = sensor_from_tables(tomllib.loads(text), where=recording).scanner
    assert isinstance(scanner, Spinning)
    pulse, step = np.arange(scanner.lasers, dtype=np.uint32), 2.0 * math.pi / grid.sweep.shape[1]
    x, y, _ = (np.asarray(component, np.float64) for component in scanner.direction(pulse))
    channels, place = np.unique(np.asarray(scanner.channel(pulse)), return_index=True)
    assert len(channels) == len(grid.azimuth_rad)
    shift = grid.azimuth_rad - np.arctan2(y, x)[place]
    return np.nan_to_num(shift - step * np.rint(shift / step))
