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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SurfaceOptics:
    """A shape's surface as `Speculars` sees it.

    Attributes:
        number: the shape's in Mitsuba's registry
        bsdf: Mitsuba's
        material: its identity
        absorbs: `bsdfs.absorption`
        is_retro: whether it sends light straight back, polarised as it came
        free_path_m: mean free path of light behind a porous surface; 0: it stops rays where they meet it
    """

    number: int
    bsdf: Any
    material: Hashable
    absorbs: tuple[float, float] | None
    is_retro: bool
    free_path_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Speculars:
    """Panes, mirrors and porous surfaces of a world.

    Attributes:
        bsdfs: Mitsuba BSDFs, p panes first, then m mirrors, one for each material
        panes: p, the number of panes
        glass: index and optical depth of each pane that absorbs, opaque; None for a pane that does not
        kind: UInt32 by Mitsuba's registry number of a shape: 0, or 1 + the index into ``bsdfs``, or 1 + p + m if porous
        gaps: whether there are porous surfaces
        index: refractive index of each pane, opaque; None for one that passes all light
        retro: Bool by registry number: retro-reflectors; None if there are none
        free_path_m: Float by registry number: `SurfaceOptics.free_path_m`; None if all are 0
    """

    bsdfs: tuple[Any, ...]
    panes: int
    glass: tuple[tuple[Any, Any] | None, ...]
    kind: Any
    gaps: bool
    index: tuple[Any | None, ...]
    retro: Any
    free_path_m: Any

    @classmethod
    def from_shapes(cls, shapes: Sequence[SurfaceOptics]) -> Speculars | None:
        """Make the tables; None if every beam ends at its first surface."""
        mi = mitsuba()
        # One BSDF for each material: all shapes of a material scatter alike, and each BSDF adds code to the kernel.
        panes: dict[Hashable, Any] = {}
        mirrors: dict[Hashable, Any] = {}
        glass: list[Any] = []
        index: list[Any] = []
        porous: set[Hashable] = set()
        for shape in shapes:
            kind_name, material = _kind_name(mi, shape.bsdf), shape.material
            if kind_name == "pane" and material not in panes:
                glass.append(None if shape.absorbs is None else transfer.opaque(shape.absorbs))
                # Mitsuba's `null` is a pane without an index.
                parameters = mi.traverse(shape.bsdf)
                index.append(transfer.opaque(float(parameters["eta"].numpy()[0])) if "eta" in parameters else None)
            if kind_name == "porous":
                porous.add(material)
            of_kind = {"pane": panes, "mirror": mirrors}.get(kind_name)
            if of_kind is not None:
                of_kind.setdefault(material, shape.bsdf)
        if not panes and not mirrors and not porous:
            return None
        order = [*panes, *mirrors]
        rows = max(shape.number for shape in shapes) + 1
        kind, retro = np.zeros(rows, dtype=np.uint32), np.zeros(rows, dtype=bool)
        free_path_m = np.zeros(rows, dtype=np.float32)
        for shape in shapes:
            retro[shape.number] = shape.is_retro
            free_path_m[shape.number] = shape.free_path_m
            if shape.material in porous:
                kind[shape.number] = len(order) + 1
            else:
                kind[shape.number] = order.index(shape.material) + 1 if shape.material in order else 0
        return cls(
            bsdfs=(*panes.values(), *mirrors.values()),
            panes=len(panes),
            glass=tuple(glass),
            kind=transfer.unsigned_numbers(kind),
            gaps=bool(porous),
            index=tuple(index),
            retro=mi.Bool(retro) if retro.any() else None,
            free_path_m=transfer.from_numpy(free_path_m) if free_path_m.any() else None,
        )

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
