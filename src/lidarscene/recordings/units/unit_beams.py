"""The bank of beams of one unit, in the convention of sensor files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...scan.spinning import Spinning
from ...sensor.sensor_file import load_sensor

LIST_KEYS = ("elevation_deg", "azimuth_offset_deg", "forward_mm", "left_mm", "height_mm")
"""Keys of a spinning scanner's lists that a unit's description may give."""


FARTHEST_DEG = 1.0
"""Choice: largest rms difference of elevations between a unit and its model, twice what units differ by."""


def nearest_model(names: Sequence[str], elevation_deg: Sequence[float]) -> str:
    """Name of the catalogue's sensor whose elevations are nearest to a unit's; "" if none is of its kind."""
    elevation = np.sort(np.asarray(elevation_deg, np.float64))
    apart_deg = {}
    for name in names:
        scanner = load_sensor(name).scanner
        assert isinstance(scanner, Spinning)
        nominal = np.sort(np.degrees(scanner.elevation_rad.values))
        if len(nominal) == len(elevation):
            apart_deg[name] = float(np.sqrt(np.mean((nominal - elevation) ** 2)))
    nearest = min(apart_deg, key=lambda name: apart_deg[name], default="")
    return nearest if nearest and apart_deg[nearest] <= FARTHEST_DEG else ""


def number_of(value: Any, key: str, *, whole: bool = False) -> float:
    """Finite number that a maker's file has for a key, a ``whole`` one if that is needed.

    Raises:
        ValueError: if a value is not allowed
    """
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number) or (whole and number != int(number)):
        raise ValueError(f"{key}: must be a {'whole' if whole else 'finite'} number, got {value!r}")
    return number


@dataclass(frozen=True, slots=True, kw_only=True)
class Unit:
    """One unit: lists with an entry for each beam, and other numbers of its scanner.

    Attributes:
        model: the catalogue's nearest sensor; "" if none is near
        name: product and serial number
        lists: lists by key of `[scanner]`: elevation, offset of the azimuth (counter-clockwise from above), place of
            the exit in the head
        scanner: other keys of `[scanner]` -> value
        range_step_m: step of the ranges that it sends; None: its model's
        comments: lines on parts of the description for which a sensor file has no key
    """

    model: str
    name: str
    lists: dict[str, tuple[float, ...]]
    scanner: dict[str, float] = field(default_factory=dict)
    range_step_m: float | None = None
    comments: tuple[str, ...] = ()
