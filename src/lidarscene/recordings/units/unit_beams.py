"""The bank of beams of one unit, in the convention of sensor files."""

from __future__ import annotations

from dataclasses import dataclass, field

LIST_KEYS = ("elevation_deg", "azimuth_offset_deg", "forward_mm", "left_mm", "height_mm")
"""Keys of a spinning scanner's lists that a unit's description may give."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Unit:
    """One unit: lists with an entry for each beam, and other numbers of its scanner.

    model       the catalogue's nearest sensor; "" if none is near
    name        product and serial number
    lists       lists by key of `[scanner]`: elevation, offset of the azimuth (counter-clockwise from above), place of
                the exit in the head
    scanner     other keys of `[scanner]` -> value as written in TOML
    comments    lines on parts of the description for which a sensor file has no key
    """

    model: str
    name: str
    lists: dict[str, tuple[float, ...]]
    scanner: dict[str, str] = field(default_factory=dict)
    comments: tuple[str, ...] = ()
