"""Shades: a colour for each point by one column; categories have a palette, quantities a scale."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..formats.category_array import CategoryArray
from ..formats.cloud_columns import Cloud
from ..formats.cloud_description import unit_of
from ..maths.arrays import Numbers
from .scales import Scale, scale_of

PALETTE = (
    "#f09669",
    "#0069ff",
    "#fff000",
    "#a5ffe1",
    "#00a5ff",
    "#2d874b",
    "#ff6900",
    "#c3ff69",
    "#78780f",
    "#fff0b4",
    "#f078a5",
    "#e1d2ff",
)
"""Colours of kinds, apart for deuteranopes too; the page of the view has the same."""

NO_SURFACE = "#6b7280"


def rgb(colour: str) -> Numbers:
    """(3,) uint8 of "#rrggbb"."""
    return np.frombuffer(bytes.fromhex(colour[1:]), np.uint8)


class FixedColours(NamedTuple):
    """What is the same in several pictures, or else each cloud's own.

    Attributes:
        limits: lowest and highest value of a quantity (`pictures.common_scale`); None: the cloud's
        palette: "#rrggbb" of each category by its number; without one by its frequency
    """

    limits: tuple[float, float] | None = None
    palette: tuple[str, ...] = ()


OWN_COLOURS = FixedColours()


class Shades:
    """Colour of each point for one column, and the scale that explains it.

    Attributes:
        rgb: (n, 3) uint8
        kinds: (label, colour) of each category, most frequent first; empty for a quantity
        scale: scale of a quantity; None for categories
    """

    def __init__(self, cloud: Cloud, name: str, fixed: FixedColours = OWN_COLOURS) -> None:
        self.name = name
        values = np.asarray(cloud.column(name))
        unit = unit_of(cloud, name)
        self.kinds: list[tuple[str, str]] = []
        self.scale: Scale | None = None
        if (names := _category_names(cloud, name)) is not None:
            ranks = self._sort_kinds(values, names, fixed.palette)
            self.rgb = np.array([rgb(colour) for _, colour in self.kinds] or [rgb(NO_SURFACE)])[ranks]
        else:
            if unit == "rad":
                values, unit = np.degrees(values), "°"
            elif name == "pulse_width":
                values, unit = 1e9 * values, "ns"
            self.scale = scale_of(name, values, limits=fixed.limits)
            finite = np.isfinite(values)
            colours = self.scale.rgb(np.where(finite, values, 1.0))
            self.rgb = np.where(finite[:, None], colours, rgb(NO_SURFACE))
        self.label = name.replace("_", " ") + (f" [{unit}]" if unit != "1" and names is None else "")

    def _sort_kinds(self, values: Numbers, names: dict[int, str], palette: Sequence[str]) -> Numbers:
        """Number the categories by frequency; all beyond the palette share one colour."""
        categories, inverse, counts = np.unique(values, return_inverse=True, return_counts=True)
        order = np.argsort(-counts, kind="stable")
        rank = np.argsort(order, kind="stable")
        colours = iter(PALETTE)
        for value in categories[order][: len(PALETTE)].tolist():
            colour = NO_SURFACE if value < 0 else palette[value] if palette else next(colours)
            self.kinds.append(("none" if value < 0 else names.get(value, str(value)), colour))
        if len(categories) > len(PALETTE):
            self.kinds.append((f"{len(categories) - len(PALETTE)} more", "#e5e7eb"))
        return np.asarray(np.minimum(rank[inverse], len(PALETTE)), dtype=np.int64)


def _category_names(cloud: Cloud, name: str) -> dict[int, str] | None:
    """Names by value for a column of categories, None for a quantity."""
    values = cloud.column(name)
    if isinstance(values, CategoryArray):
        return dict(enumerate(values.names))
    tables = {
        "in_shadow": ("lit", "in shadow"),
        "interactions": ("direct", "after one", "after two", "after three"),
        "ghost": ("in its place", "ghost"),
        "return_number": ("none", "first", "second", "third"),
    }
    return dict(enumerate(tables[name])) if name in tables else None
