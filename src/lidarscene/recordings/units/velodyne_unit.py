"""A Velodyne's calibration as a unit: YAML of the ROS driver, or XML of the maker's own program.

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

from ...files.optional import optional
from ...formats.described import reading
from .unit_beams import Unit

MODELS = {16: "vlp-16", 32: "hdl-32e", 64: "hdl-64e", 128: "vls-128"}
"""By number of lasers."""

Laser = tuple[int, float, float, float, float]
"""Number; vertical angle and rotation [rad]; offsets up and to the left [m]."""


def read_velodyne(path: Path) -> Unit:
    """Read the calibration. Raises InputError."""
    with reading(path):
        lasers = sorted(_from_xml(path) if path.suffix.lower() == ".xml" else _from_yaml(path))
        if [one[0] for one in lasers] != list(range(len(lasers))) or not lasers:
            raise ValueError(f"must have lasers 0, 1, 2, ..., got {', '.join(str(one[0]) for one in lasers[:5])}, ...")
    return Unit(model=MODELS.get(len(lasers), ""), name=path.stem, lists=_lists(lasers))


def _lists(lasers: list[Laser]) -> dict[str, tuple[float, ...]]:
    exits = [_exit_mm(one) for one in lasers]
    lists: dict[str, tuple[float, ...]] = {
        "elevation_deg": tuple(round(math.degrees(one[1]), 6) for one in lasers),
        "azimuth_offset_deg": tuple(round(math.degrees(one[2]), 6) for one in lasers),
    }
    for axis, key in enumerate(("forward_mm", "left_mm", "height_mm")):
        lists[key] = tuple(round(one[axis], 4) for one in exits)
    return lists if any(any(one) for one in exits) else dict(list(lists.items())[:2])


def _exit_mm(laser: Laser) -> tuple[float, float, float]:
    """In the head; the offsets are in the head turned by the laser's own rotation."""
    _, _, turned_rad, v_m, h_m = laser
    return -1e3 * h_m * math.sin(turned_rad), 1e3 * h_m * math.cos(turned_rad), 1e3 * v_m


def _from_yaml(path: Path) -> Iterator[Laser]:
    content: Any = optional("yaml", extra="velodyne").safe_load(path.read_text(encoding="utf-8"))
    lasers = content.get("lasers") if isinstance(content, dict) else None
    if not isinstance(lasers, list):
        raise ValueError("must be a calibration of a Velodyne with a list 'lasers', got none")
    for number, one in enumerate(lasers):
        missing = [key for key in ("laser_id", "vert_correction") if key not in one]
        if missing:
            raise ValueError(f"laser {number}: must have {missing[0]}, got none")
        yield (
            int(one["laser_id"]),
            float(one["vert_correction"]),
            float(one.get("rot_correction", 0.0)),
            float(one.get("vert_offset_correction", 0.0)),
            float(one.get("horiz_offset_correction", 0.0)),
        )


def _from_xml(path: Path) -> Iterator[Laser]:
    """Degrees and centimetres. Lasers that are not enabled are in the list, too, with zeros."""
    root = ElementTree.parse(path).getroot()
    enabled = [int(float(one.text or 0)) for one in root.iterfind(".//enabled_/item")]
    for one in root.iterfind(".//points_/item/px"):
        values = {key: float(one.findtext(key) or 0.0) for key in _XML}
        number = int(values["id_"])
        if enabled and not (number < len(enabled) and enabled[number]):
            continue
        yield (
            number,
            math.radians(values["vertCorrection_"]),
            math.radians(values["rotCorrection_"]),
            0.01 * values["vertOffsetCorrection_"],
            0.01 * values["horizOffsetCorrection_"],
        )


_XML = ("id_", "rotCorrection_", "vertCorrection_", "vertOffsetCorrection_", "horizOffsetCorrection_")
