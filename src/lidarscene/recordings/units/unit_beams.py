"""The bank of beams of one unit, in the convention of sensor files."""

from __future__ import annotations

from dataclasses import dataclass, field

OF_LISTS = ("elevation_deg", "azimuth_offset_deg", "forward_mm", "left_mm", "height_mm")
"""Lists of a spinning scanner that a unit's description gives."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Unit:
    """One unit: lists with an entry for each beam, and what else of the scanner is known.

    model       the catalogue's sensor that it is nearest to; "" if none is
    name        of the unit: product and serial number
    lists       by key of `[scanner]`: elevation, offset of the azimuth (counter-clockwise from above), place of the
                exit in the head
    scanner     other keys of `[scanner]`, as written in TOML
    comments    what the description has that a sensor file has no key for
    """

    model: str
    name: str
    lists: dict[str, tuple[float, ...]]
    scanner: dict[str, str] = field(default_factory=dict)
    comments: tuple[str, ...] = ()
