"""Read a Velodyne's calibration as a unit: YAML of the ROS driver, or XML of the maker's own program.

The point at range r of a laser with vertical angle e, rotation a and offsets v (up) and h (to the left) is, in the head
turned by a: x = r cos e, y = h, z = r sin e + v (HDL-64E S3 manual, 63-HDL64ES3, as velodyne-decoder has it). So the
exit is at (0, h, v). Corrections of the distance are of the range that is reported, which is right here without them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from ...files.optional import import_optional
from ...formats.cloud_description import input_errors
from .unit_beams import Unit, nearest_model, number_of

MODELS = ("vlp-16", "vlp-32c", "hdl-32e", "hdl-64e", "vls-128")
"""The catalogue's sensors."""

LEAST_MM = 0.1
"""Choice: least distance of an exit from an axis of the head that is written."""

Laser = tuple[int, float, float, float, float]
"""Number; vertical angle and rotation [rad]; offsets up and to the left [m]."""


def read_velodyne(path: Path) -> Unit:
    """Read the calibration of one unit.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    with input_errors(path):
        lasers = sorted(_read_xml(path) if path.suffix.lower() == ".xml" else _read_yaml(path))
        if [laser[0] for laser in lasers] != list(range(len(lasers))) or not lasers:
            raise ValueError(
                f"must have lasers 0, 1, 2, ..., got {', '.join(str(laser[0]) for laser in lasers[:5])}, ..."
            )
    lists = _scanner_lists(lasers)
    return Unit(model=nearest_model(MODELS, lists["elevation_deg"]), name=path.stem, lists=lists)


def _scanner_lists(lasers: list[Laser]) -> dict[str, tuple[float, ...]]:
    exits_mm = [_exit_mm(laser) for laser in lasers]
    lists: dict[str, tuple[float, ...]] = {
        "elevation_deg": tuple(round(math.degrees(laser[1]), 6) for laser in lasers),
        "azimuth_offset_deg": tuple(round(math.degrees(laser[2]), 6) for laser in lasers),
    }
    for axis, key in enumerate(("forward_mm", "left_mm", "height_mm")):
        lists[key] = tuple(round(exit_mm[axis], 4) for exit_mm in exits_mm)
    return lists if any(any(exit_mm) for exit_mm in exits_mm) else dict(list(lists.items())[:2])


def _exit_mm(laser: Laser) -> tuple[float, float, float]:
    """Exit (x, y, z) of a laser in the head; the offsets are in axes turned by the laser's own rotation.

    Less than `LEAST_MM` is none: a sensor file takes such lengths for metres.
    """
    _, _, rotation_rad, v_m, h_m = laser
    exit_mm = -1e3 * h_m * math.sin(rotation_rad), 1e3 * h_m * math.cos(rotation_rad), 1e3 * v_m
    x, y, z = (0.0 if abs(length_mm) < LEAST_MM else length_mm for length_mm in exit_mm)
    return x, y, z


def _read_yaml(path: Path) -> Iterator[Laser]:
    content: Any = import_optional("yaml", extra="velodyne").safe_load(path.read_text(encoding="utf-8"))
    lasers = content.get("lasers") if isinstance(content, dict) else None
    if not isinstance(lasers, list):
        raise ValueError("must be a calibration of a Velodyne with a list 'lasers', got none")
    for number, laser in enumerate(lasers):
        if not isinstance(laser, dict):
            raise ValueError(f"laser {number}: must be a table, got {laser!r}")
        missing_keys = [key for key in _YAML[:2] if key not in laser]
        if missing_keys:
            raise ValueError(f"laser {number}: must have {missing_keys[0]}, got none")
        yield _laser({key: laser.get(key, 0.0) for key in _YAML}, number)


def _read_xml(path: Path) -> Iterator[Laser]:
    """Read degrees and centimetres. The file lists lasers that are not enabled, too, with zeros: skip them."""
    root = ElementTree.parse(path).getroot()
    flags = [flag.text or 0 for flag in root.iterfind(".//enabled_/item")]
    enabled = [number_of(flag, f"enabled_ {number}", whole=True) for number, flag in enumerate(flags)]
    for place, laser in enumerate(root.iterfind(".//points_/item/px")):
        number, vertical_deg, rotation_deg, up_cm, left_cm = _laser(
            {key: laser.findtext(key) or 0.0 for key in _XML}, place
        )
        if enabled and not (number < len(enabled) and enabled[number]):
            continue
        yield number, math.radians(vertical_deg), math.radians(rotation_deg), 0.01 * up_cm, 0.01 * left_cm


def _laser(values: dict[str, Any], place: int) -> Laser:
    """Laser in the file's units, from its values in the order of `Laser`; ``place`` is its place in the list."""
    number, *others = (
        number_of(value, f"laser {place}: {key}", whole=not n) for n, (key, value) in enumerate(values.items())
    )
    vertical, rotation, up, left = others
    return int(number), vertical, rotation, up, left


_YAML = ("laser_id", "vert_correction", "rot_correction", "vert_offset_correction", "horiz_offset_correction")
_XML = ("id_", "vertCorrection_", "rotCorrection_", "vertOffsetCorrection_", "horizOffsetCorrection_")
