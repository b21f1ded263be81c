"""Import report: what a mesh file, a USD stage or a Mitsuba scene holds, as it was understood.

A format's words have the format's meaning, and not all of them can be honoured. What was taken for a metre, which axis
for up, and what was left out shows here before a frame is rendered. It is the same for every kind of file.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..kernel.world.mitsuba_xml import FileContent, file_content
from ..maths.arrays import Numbers
from ..scene.foreign import is_xml
from ..scene.meshes.gltf_document import HONOURED, declaration
from ..scene.meshes.mesh_axes import GLTF, axis_of, turn_upright
from ..scene.meshes.mesh_cache import SubMesh
from ..scene.meshes.reading import check_pieces, read_mesh
from ..scene.meshes.usd import is_usd, read_stage
from ..scene.sizes import size_text

TAKEN = "taken, the file does not say"

SAID = "by the format"


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportReport:
    """What a file holds.

    Attributes:
        kind: of the file
        meshes: number of meshes, of Mitsuba shapes
        triangles: of all of them, where they stand
        materials: names by which a scene file gives materials
        extensions: extensions of the format that the file uses
        skins: number of skinned meshes' skins
        unit: length of 1 in the file
        up: axis that points up in the file
        size_m: edges of the box around the whole, in metres, the last one upwards
        honoured: what was read as the format means it
        left_out: what was not read
    """

    kind: str
    meshes: int
    triangles: int
    materials: tuple[str, ...]
    extensions: tuple[str, ...] = ()
    skins: int = 0
    unit: str = f"1 m, {TAKEN}"
    up: str = f"z, {TAKEN}"
    size_m: tuple[float, ...]
    honoured: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()

    def text(self) -> str:
        """Lines of text."""
        lines = {
            "format": self.kind,
            "meshes": f"{self.meshes:,}, of {self.triangles:,} triangles",
            "materials": ", ".join(self.materials),
            "extensions": ", ".join(self.extensions),
            "skins": f"{self.skins or ''}",
            "unit": self.unit,
            "up": self.up,
            "size": f"{size_text(self.size_m)} m",
            "honoured": "; ".join(self.honoured),
            "left out": "; ".join(self.left_out),
        }
        return "\n".join(f"  {label:<12}{value or 'none'}" for label, value in lines.items())

    def as_dict(self) -> dict[str, Any]:
        """Entries for JSON."""
        return asdict(self)


def import_report(path: Path) -> ImportReport:
    """Read a mesh file, a USD stage or a Mitsuba XML scene, and say what it holds.

    Raises:
        InputError: if a file, a key or a value cannot be understood
        LidarSceneError: without an optional package that its format needs
    """
    if is_xml(path):
        return _of_mitsuba(file_content(path))
    if is_usd(path):
        return _of_stage(path)
    pieces = read_mesh(path)
    if path.suffix.lower() in GLTF:
        return _of_gltf(path, pieces)
    return ImportReport(
        kind=path.suffix[1:].upper(),
        meshes=len(pieces),
        triangles=_triangles(pieces),
        materials=_names(pieces),
        size_m=_size_m(pieces, path),
    )


def _of_gltf(path: Path, pieces: list[SubMesh]) -> ImportReport:
    declared = declaration(path)
    honoured = [name for name in declared.used if name in HONOURED]
    if declared.skins:
        honoured.append("skins, in the pose in which their joints rest")
    if declared.masked:
        honoured.append(f"gaps of {', '.join(declared.masked)} (alphaMode MASK)")
    return ImportReport(
        kind="glTF 2",
        meshes=declared.meshes,
        triangles=_triangles(pieces),
        materials=_names(pieces),
        extensions=declared.used,
        skins=declared.skins,
        unit=f"1 m, {SAID}",
        up=f"y, {SAID}",
        size_m=_size_m(pieces, path),
        honoured=tuple(honoured),
        left_out=(
            *declared.left_out,
            *(f"image {name}, which is not there" for name in declared.missing),
            *declared.unread,
        ),
    )


def _of_stage(path: Path) -> ImportReport:
    stage = read_stage(path)
    pieces = check_pieces(stage.pieces, str(path))
    return ImportReport(
        kind="USD",
        meshes=len(pieces),
        triangles=_triangles(pieces),
        materials=_names(pieces),
        unit=f"{stage.unit_m:g} m, by the stage",
        up=f"{stage.up}, by the stage",
        size_m=_size_m(pieces, path),
        left_out=tuple(f"{kind}: {count}" for kind, count in stage.left_out.items()),
    )


def _of_mitsuba(content: FileContent) -> ImportReport:
    low, high = content.box_m
    return ImportReport(
        kind="Mitsuba XML",
        meshes=content.shapes,
        triangles=content.triangles,
        materials=content.materials,
        size_m=tuple((high - low).tolist()),
        left_out=tuple(f"{kind}: {count}" for kind, count in content.left_out.items()),
    )


def _names(pieces: list[SubMesh]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(piece.keys[0] for piece in pieces if piece.keys))


def _triangles(pieces: list[SubMesh]) -> int:
    return sum(len(piece.faces) for piece in pieces)


def _size_m(pieces: list[SubMesh], path: Path) -> tuple[float, ...]:
    corners: Numbers = turn_upright(np.concatenate([piece.vertices_m for piece in pieces]), axis_of(path) or "z")
    return tuple(np.ptp(corners, axis=0).tolist())
