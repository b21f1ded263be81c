"""Find the surfaces of a world at which a beam goes on: panes, mirrors and porous surfaces.

A beam ends at most surfaces, and few BSDFs have to be asked where it goes on. Which kind a surface is follows from the
flags of its BSDF, so that panes of a Mitsuba file are found too. The kernel looks the kind up by the shape's number,
and samples the few BSDFs of panes and mirrors by name.

Symbols: kind 0: the beam ends; 1 to p: pane number kind - 1; p + 1 to p + m: mirror; p + m + 1: porous surface.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from ...maths.arrays import Array
from ..device import transfer
from ..device.backend import mitsuba
from ..device.types import Bsdf


@dataclass(frozen=True, slots=True, eq=False)
class Speculars:
    """Panes, mirrors and porous surfaces of a world.

    bsdfs  Mitsuba BSDFs, p panes first, then m mirrors, one for each material
    panes  p, the number of panes
    glass  index and optical depth of each pane that absorbs, opaque; None for a pane that does not
    kind   UInt32 by Mitsuba's registry number of a shape: 0, or 1 + the index into ``bsdfs``, or 1 + p + m if porous
    gaps   whether there are porous surfaces
    """

    bsdfs: tuple[Any, ...]
    panes: int
    glass: tuple[tuple[Any, Any] | None, ...]
    kind: Any
    gaps: bool

    @classmethod
    def from_shapes(cls, shapes: Sequence[tuple[int, Bsdf, Hashable, tuple[float, float] | None]]) -> Speculars | None:
        """Make the tables from (registry number, Mitsuba BSDF, identity of the material, `bsdfs.absorption`) of shapes.

        Returns None if every beam ends at its first surface.
        """
        mi = mitsuba()
        # One BSDF for each material: all shapes of a material scatter alike, and each BSDF adds code to the kernel.
        panes: dict[Hashable, Any] = {}
        mirrors: dict[Hashable, Any] = {}
        glass: list[Any] = []
        porous: set[Hashable] = set()
        for _, bsdf, material, absorbs in shapes:
            if _kind_name(mi, bsdf) == "pane" and material not in panes:
                glass.append(None if absorbs is None else transfer.opaque(absorbs))
            if _kind_name(mi, bsdf) == "porous":
                porous.add(material)
            of_kind = {"pane": panes, "mirror": mirrors}.get(_kind_name(mi, bsdf))
            if of_kind is not None:
                of_kind.setdefault(material, bsdf)
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
        """m, the number of mirrors."""
        return len(self.bsdfs) - self.panes

    @property
    def lets_through(self) -> bool:
        """True if there are panes or gaps."""
        return self.panes > 0 or self.gaps

    def is_pane(self, kind: Array) -> Any:
        """Return where a kind is a pane."""
        return (kind > 0) & (kind <= self.panes)

    def is_mirror(self, kind: Array) -> Any:
        """Return where a kind is a mirror."""
        return (kind > self.panes) & (kind <= len(self.bsdfs))

    def is_porous(self, kind: Array) -> Any:
        """Return where a kind is a porous surface."""
        return kind > len(self.bsdfs)


def lets_through(bsdf: Bsdf) -> bool:
    """Return whether light goes straight through surfaces of this BSDF, or through their gaps."""
    return _kind_name(mitsuba(), bsdf) in ("pane", "porous")


def _kind_name(mi: ModuleType, bsdf: Bsdf) -> str:
    """Return "pane", "mirror", "porous", or "" for a BSDF at which the beam ends."""
    flags, kinds = bsdf.flags(), mi.BSDFFlags
    # Mitsuba's flags: Null is light that passes straight through; Smooth is any lobe of finite density, such as a
    # diffuse one. A mask has both: it scatters where it is solid and passes where it is not.
    if mi.has_flag(flags, kinds.Null) and mi.has_flag(flags, kinds.Smooth):
        return "porous"
    # A surface that scatters beside its mirror lobe has an echo of its own. A solid dielectric bends the light, which
    # is not followed. Both end the beam.
    if mi.has_flag(flags, kinds.Smooth) or mi.has_flag(flags, kinds.DeltaTransmission):
        return ""
    if mi.has_flag(flags, kinds.Null):
        return "pane"
    return "mirror" if mi.has_flag(flags, kinds.DeltaReflection) else ""
