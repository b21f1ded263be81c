"""An Ouster's metadata (json, of any firmware) as a unit.

The point of a beam is (r - n) (cos e cos(t + a), cos e sin(t + a), sin e) + n (cos t, sin t, 0), all of it turned and
moved by the transform from lidar to sensor: e the beam's altitude, a minus its azimuth, t the encoder's angle, which is
a full turn at column 0 and falls, n from the lidar's origin to the beam's (Ouster, sensor documentation: lidar range to
XYZ). So the exit is n before the axis, and r counts from n behind it.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...formats.described import reading
from .unit_beams import Unit

MODES = ("512x10", "512x20", "1024x10", "1024x20", "2048x10", "4096x5")
"""Columns and turns a second of the firmware."""

MODELS = {"OS-0": "os0-128", "OS-1": "os1-128", "OS-2": "os2-128"}

LIDAR_TO_SENSOR = (-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.18, 0, 0, 0, 1)
"""Of sensors whose metadata do not say [mm]."""


BEAM_ORIGIN_MM = {"OS-0": 27.67, "OS-1": 15.806, "OS-2": 13.762}
"""From the lidar's origin to that of the beams, of firmware 1 that does not say, by product."""

FIRST_ORIGIN_MM = 12.163
"""The same of an OS1 of the first generation, and of files that do not name a product (as ouster-sdk has it)."""


def read_ouster(path: Path, mode: str | None = None) -> Unit:
    """Read the metadata, in this mode of the firmware or the one that they name. Raises InputError."""
    with reading(path):
        found = dict(_leaves(json.loads(path.read_text(encoding="utf-8"))))
    altitude, azimuth = (_angles(path, found, "beam_altitude_angles"), _angles(path, found, "beam_azimuth_angles"))
    if len(altitude) != len(azimuth):
        raise InputError(
            f"{path}: beam_azimuth_angles: must have {len(altitude)} entries, as beam_altitude_angles has, "
            f"got {len(azimuth)}"
        )
    chosen = mode or str(found.get("lidar_mode", ""))
    fitting = re.fullmatch(r"(?:MODE_)?(\d+)x(\d+)", chosen)
    if not fitting:
        raise InputError(f"{path}: lidar_mode: must be one of {', '.join(MODES)}, got '{chosen}'; --mode says another")
    to_sensor, to_lidar = _transforms(path, found)
    before_mm, up_mm = to_lidar[0, 3], to_lidar[2, 3] + to_sensor[2, 3]
    product = str(found.get("prod_line") or found.get("lidar_model") or "OS")
    lists = {
        "elevation_deg": altitude,
        "azimuth_offset_deg": tuple(-one for one in azimuth),
        "forward_mm": (float(before_mm),) * len(altitude),
        "height_mm": (float(up_mm),) * len(altitude),
    }
    start_deg = math.degrees(math.atan2(to_sensor[1, 0], to_sensor[0, 0]))
    window = found.get("azimuth_window", [0, 360000])
    comments = [f"firmware {found.get('build_rev') or found.get('image_rev') or 'unknown'}"]
    if list(window) != [0, 360000]:
        comments.append(
            f"azimuth window {window[0]} to {window[1]} millidegrees is not taken over: it fires all around"
        )
    return Unit(
        model=next((name for start, name in MODELS.items() if product.startswith(start)), ""),
        name=f"{product} {found.get('prod_sn', '')}".strip(),
        lists=lists,
        scanner={
            "rotation_hz": f"-{int(fitting[2])}",
            "columns_per_turn": str(int(fitting[1])),
            "start_azimuth_deg": repr(round(start_deg, 6)),
        },
        comments=tuple(comments),
    )


def _leaves(table: Any) -> Iterator[tuple[str, Any]]:
    """Every key that is no table, whatever tables it lies in; a later firmware moved them."""
    for key, value in table.items() if isinstance(table, dict) else ():
        if isinstance(value, dict):
            yield from _leaves(value)
        else:
            yield key, value


def _angles(path: Path, found: dict[str, Any], key: str) -> tuple[float, ...]:
    values = found.get(key)
    with reading(path):
        if not isinstance(values, list) or not values:
            raise ValueError(f"must have a list {key} of an Ouster, got none")
        angles = tuple(float(one) for one in values)
        if not all(map(math.isfinite, angles)):
            raise ValueError(f"{key}: must be numbers, got one that is not finite")
    return angles


def _transforms(path: Path, found: dict[str, Any]) -> tuple[Any, Any]:
    """(4, 4) from lidar to sensor and from beam to lidar [mm]; the turns must be about z, as sensor files have them."""
    product = str(found.get("prod_line") or "")
    usual = next((mm for start, mm in BEAM_ORIGIN_MM.items() if product.startswith(start)), FIRST_ORIGIN_MM)
    before = found.get("lidar_origin_to_beam_origin_mm", usual)
    plain = (1, 0, 0, before, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1)
    with reading(path):
        to_sensor = np.array(found.get("lidar_to_sensor_transform") or LIDAR_TO_SENSOR, float).reshape(4, 4)
        to_lidar = np.array(found.get("beam_to_lidar_transform") or plain, float).reshape(4, 4)
        level = abs(to_sensor[2, 2] - 1.0) < 1e-9 and np.abs(to_sensor[:2, 3]).max() < 1e-9
        if not level or np.abs(to_lidar[:3, :3] - np.eye(3)).max() > 1e-9:
            raise ValueError("lidar_to_sensor_transform: must turn about z and move along it, got another")
    return to_sensor, to_lidar
