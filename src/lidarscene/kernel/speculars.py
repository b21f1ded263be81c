"""Speculars: which surfaces of a world only mirror or let through, so that a beam goes on there."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .backend import mitsuba


@dataclass(frozen=True, slots=True, eq=False)
class Speculars:
    """Panes and mirrors of a world.

    bsdfs  panes first, then mirrors; a few, and asked by name: sampling every BSDF of the world would compile all
    panes  how many of them are panes
    kind   by Mitsuba's registry number of a shape: 0 where a beam ends, else 1 + the index into ``bsdfs``
    """

    bsdfs: tuple[Any, ...]
    panes: int
    kind: Any

    @classmethod
    def of(cls, shapes: Sequence[tuple[int, Any, Hashable]]) -> Speculars | None:
        """From registry number, Mitsuba's BSDF and identity of the material of each shape.

        None where a beam goes on nowhere.
        """
        mi = mitsuba()
        panes: dict[Hashable, Any] = {}
        mirrors: dict[Hashable, Any] = {}
        for _, bsdf, material in shapes:
            found = {"pane": panes, "mirror": mirrors}.get(_what(mi, bsdf))
            if found is not None:
                found.setdefault(material, bsdf)
        if not panes and not mirrors:
            return None
        order = [*panes, *mirrors]
        kind = np.zeros(max(number for number, _, _ in shapes) + 1, dtype=np.uint32)
        for number, _, material in shapes:
            kind[number] = order.index(material) + 1 if material in order else 0
        return cls(bsdfs=(*panes.values(), *mirrors.values()), panes=len(panes), kind=mi.UInt32(kind))

    @property
    def mirrors(self) -> int:
        """How many of the materials are mirrors."""
        return len(self.bsdfs) - self.panes


def _what(mi: Any, bsdf: Any) -> str:
    """ "pane", "mirror" or nothing: a BSDF that has other lobes too ends the beam, and so does a solid of glass."""
    flags, kinds = bsdf.flags(), mi.BSDFFlags
    if mi.has_flag(flags, kinds.Smooth) or mi.has_flag(flags, kinds.DeltaTransmission):
        return ""
    if mi.has_flag(flags, kinds.Null):
        return "pane"
    return "mirror" if mi.has_flag(flags, kinds.DeltaReflection) else ""
