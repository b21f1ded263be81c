"""Read an Ouster's metadata (json, of any firmware) as a unit.

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

from ...errors import InputError, OptionError
from ...formats.cloud_description import input_errors
from ...formats.packets.layouts import OUSTER_MODES
from .unit_beams import Unit, number_of

MODELS = {"OS-0": "os0-128", "OS-1": "os1-128", "OS-2": "os2-128", "OS-DOME": "osdome-128"}
"""Start of the product's name -> the catalogue's sensor."""

REVISION_7 = {"os0-128": "os0-128-rev7", "os1-128": "os1-128-rev7", "os2-128": "os2-128-rev7"}
"""These sensors -> those of revision 7, which requires firmware 3 (ouster-ros, discussion 122). An OSDome is of it."""

FIRST_OF_REVISION_7 = (3, 0)
"""First firmware for revision 7; of ouster-sdk's recordings no older unit has it."""

FIRST_CALIBRATED = (2, 1)
"""First firmware with calibrated reflectivities (ouster.com/sensor-docs)."""

LIDAR_TO_SENSOR = (-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.18, 0, 0, 0, 1)
"""Source: ouster-sdk; transform of sensors whose metadata have none, (4, 4) row by row [mm]."""

BEAM_ORIGIN_MM = {"OS-0": 27.67, "OS-1": 15.806, "OS-2": 13.762}
"""Source: ouster-sdk; product -> distance from the lidar's origin to that of the beams, for metadata of firmware 1
without it."""

FIRST_ORIGIN_MM = 12.163
"""Source: ouster-sdk; this distance of an OS1 of the first generation, and of files that name no product."""


LOW_RATE, LOW_RATE_STEP_M = "RNG15", 0.008
"""Source: ouster-sdk, field_value_mask("RANGE") of its PacketFormat; name in all profiles of a low data rate, and the
step of their ranges."""


def read_ouster(path: Path, mode: str | None = None, *, text: str | None = None) -> Unit:
    """Read the metadata; ``mode`` of the firmware replaces the one that they name.

    Args:
        text: the metadata themselves, where ``path`` is the recording that has them; None: the file's

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    with input_errors(path):
        metadata = dict(_leaves(json.loads(path.read_bytes() if text is None else text)))
    altitude, azimuth = (
        _angles(path, metadata, "beam_altitude_angles"),
        _angles(path, metadata, "beam_azimuth_angles"),
    )
    if len(altitude) != len(azimuth):
        raise InputError(
            f"{path}: beam_azimuth_angles: must have {len(altitude)} entries, as beam_altitude_angles has, "
            f"got {len(azimuth)}"
        )
    lidar_mode = mode or str(metadata.get("lidar_mode", ""))
    mode_match = re.fullmatch(r"(?:MODE_)?(\d+)x(\d+)", lidar_mode)
    if not mode_match:
        modes = ", ".join(OUSTER_MODES)
        raise OptionError(
            "{0}: lidar_mode: must be one of {1}, got {2!r}; {mode} says another", path, modes, lidar_mode
        )
    to_sensor, to_lidar = _transforms(path, metadata)
    forward_mm, up_mm = to_lidar[0, 3], to_lidar[2, 3] + to_sensor[2, 3]
    product = str(metadata.get("prod_line") or metadata.get("lidar_model") or "OS")
    lists = {
        "elevation_deg": altitude,
        "azimuth_offset_deg": tuple(-angle for angle in azimuth),
        "forward_mm": (float(forward_mm),) * len(altitude),
        "height_mm": (float(up_mm),) * len(altitude),
    }
    start_deg = math.degrees(math.atan2(to_sensor[1, 0], to_sensor[0, 0]))
    comments = [f"firmware {metadata.get('build_rev') or metadata.get('image_rev') or 'unknown'}"]
    if (window := metadata.get("azimuth_window", [0, 360000])) != [0, 360000]:
        comments.append(f"azimuth window {window} in millidegrees is not taken over: it fires all around")
    model = next((name for start, name in MODELS.items() if product.startswith(start)), "")
    names = (str(metadata.get(key, "")) for key in ("build_rev", "image_rev"))
    if next((version for version in map(firmware_version, names) if version), (0, 0)) >= FIRST_OF_REVISION_7:
        model = REVISION_7.get(model, model)
    return Unit(
        model=model,
        name=f"{product} {metadata.get('prod_sn', '')}".strip(),
        lists=lists,
        scanner={
            "rotation_hz": -int(mode_match[2]),
            "columns_per_turn": int(mode_match[1]),
            "start_azimuth_deg": round(start_deg, 6),
        },
        range_step_m=LOW_RATE_STEP_M if LOW_RATE in str(metadata.get("udp_profile_lidar")) else None,
        comments=tuple(comments),
    )


def _leaves(table: Any) -> Iterator[tuple[str, Any]]:
    """Yield key and value of every leaf, at any depth: later firmware moved the same keys into other tables."""
    for key, value in table.items() if isinstance(table, dict) else ():
        if isinstance(value, dict):
            yield from _leaves(value)
        else:
            yield key, value


def firmware_version(name: str) -> tuple[int, int] | None:
    """Major and minor version in a name of the firmware; None if there is none, as of builds between releases."""
    version = re.search(r"(?:^|-)v(\d+)\.(\d+)", name)
    return (int(version[1]), int(version[2])) if version else None


def _angles(path: Path, metadata: dict[str, Any], key: str) -> tuple[float, ...]:
    values = metadata.get(key)
    with input_errors(path):
        if not isinstance(values, list) or not values:
            raise ValueError(f"must have a list {key} of an Ouster, got none")
        return tuple(number_of(angle, f"{key}[{beam}]") for beam, angle in enumerate(values))


def _matrix(metadata: dict[str, Any], key: str, default: tuple[float, ...]) -> Any:
    """(4, 4) transform of the metadata, which list it row by row; the default where they have none."""
    values = np.ravel(np.array(metadata.get(key) or default, object))
    if len(values) != 16:
        raise ValueError(f"{key}: must have 16 numbers, got {metadata[key]!r}")
    return np.reshape([number_of(value, f"{key}[{place}]") for place, value in enumerate(values)], (4, 4))


def _transforms(path: Path, metadata: dict[str, Any]) -> tuple[Any, Any]:
    """(4, 4) transforms from lidar to sensor and from beam to lidar [mm]; only rotations about z fit a sensor file."""
    product = str(metadata.get("prod_line") or "")
    product_mm = next((mm for start, mm in BEAM_ORIGIN_MM.items() if product.startswith(start)), FIRST_ORIGIN_MM)
    with input_errors(path):
        origin_key = "lidar_origin_to_beam_origin_mm"
        origin_mm = number_of(metadata.get(origin_key, product_mm), origin_key)
        origin_only = (1.0, 0, 0, origin_mm, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1)
        to_sensor = _matrix(metadata, "lidar_to_sensor_transform", LIDAR_TO_SENSOR)
        to_lidar = _matrix(metadata, "beam_to_lidar_transform", origin_only)
        level = abs(to_sensor[2, 2] - 1.0) < 1e-9 and np.abs(to_sensor[:2, 3]).max() < 1e-9
        if not level or np.abs(to_lidar[:3, :3] - np.eye(3)).max() > 1e-9:
            raise ValueError("lidar_to_sensor_transform: must turn about z and move along it, got another")
    return to_sensor, to_lidar
