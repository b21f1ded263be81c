"""Speculars: which surfaces of a world mirror or let through, so that a beam goes on there."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..device import transfer
from ..device.backend import mitsuba


@dataclass(frozen=True, slots=True, eq=False)
class Speculars:
    """Panes, mirrors and porous surfaces of a world.

    bsdfs  panes first, then mirrors; a few, and asked by name: sampling every BSDF of the world would compile all
    panes  how many of them are panes
    glass  index and optical depth of each pane that absorbs, opaque; None of the others
    kind   by Mitsuba's registry number of a shape: 0 where a beam ends, else 1 + the index into ``bsdfs``, and one
           more where it may end
    gaps   whether there are any of these
    """

    bsdfs: tuple[Any, ...]
    panes: int
    glass: tuple[tuple[Any, Any] | None, ...]
    kind: Any
    gaps: bool

    @classmethod
    def of(cls, shapes: Sequence[tuple[int, Any, Hashable, Any]]) -> Speculars | None:
        """From registry number, Mitsuba's BSDF, identity of the material, and `bsdfs.absorption` of each shape.

        None where a beam goes on nowhere.
        """
        mi = mitsuba()
        panes: dict[Hashable, Any] = {}
        mirrors: dict[Hashable, Any] = {}
        glass: list[Any] = []
        porous: set[Hashable] = set()
        for _, bsdf, material, absorbs in shapes:
            if _what(mi, bsdf) == "pane" and material not in panes:
                glass.append(None if absorbs is None else transfer.opaque(absorbs))
            if _what(mi, bsdf) == "porous":
                porous.add(material)
            found = {"pane": panes, "mirror": mirrors}.get(_what(mi, bsdf))
            if found is not None:
                found.setdefault(material, bsdf)
        if not panes and not mirrors and not porous:
            return None
        order = [*panes, *mirrors]
        kind = np.zeros(max(number for number, *_ in shapes) + 1, dtype=np.uint32)
        for number, _, material, _ in shapes:
            if material in porous:
                kind[number] = len(order) + 1
            else:
                kind[number] = order.index(material) + 1 if material in order else 0
        bsdfs = (*panes.values(), *mirrors.values())
        return cls(bsdfs=bsdfs, panes=len(panes), glass=tuple(glass), kind=mi.UInt32(kind), gaps=bool(porous))

    @property
    def mirrors(self) -> int:
        """How many of the materials are mirrors."""
        return len(self.bsdfs) - self.panes

    @property
    def lets_through(self) -> bool:
        """Whether there are panes or gaps."""
        return self.panes > 0 or self.gaps

    def is_pane(self, kind: Any) -> Any:
        """Whether light goes through all of these surfaces."""
        return (kind > 0) & (kind <= self.panes)

    def is_mirror(self, kind: Any) -> Any:
        """Whether it only goes off them."""
        return (kind > self.panes) & (kind <= len(self.bsdfs))

    def is_porous(self, kind: Any) -> Any:
        """Whether some of it goes through their gaps."""
        return kind > len(self.bsdfs)


def lets_through(bsdf: Any) -> bool:
    """Whether light goes straight through surfaces of this BSDF, or through their gaps."""
    return _what(mitsuba(), bsdf) in ("pane", "porous")


def _what(mi: Any, bsdf: Any) -> str:
    """Pane, mirror, porous or nothing: other lobes beside a mirror's end the beam, and so does a solid of glass."""
    flags, kinds = bsdf.flags(), mi.BSDFFlags
    if mi.has_flag(flags, kinds.Null) and mi.has_flag(flags, kinds.Smooth):
        return "porous"
    if mi.has_flag(flags, kinds.Smooth) or mi.has_flag(flags, kinds.DeltaTransmission):
        return ""
    if mi.has_flag(flags, kinds.Null):
        return "pane"
    return "mirror" if mi.has_flag(flags, kinds.DeltaReflection) else ""
