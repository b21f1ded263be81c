"""Scenes of other programs: what trimesh holds or a Mitsuba XML file in, `Scene` out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..materials.material import Material
from .file import grey_material, xml_file
from .meshes import checked, pieces_of
from .model import Body, Part, Scene
from .submesh import SubMesh

Given = str | Material
Lookup = Callable[[str], Material]


def trimesh_scene(
    mesh: Any,
    *,
    material: Given | None,
    materials: Mapping[str, Given],
    classes: Mapping[str, str],
    settings: Mapping[str, Any],
    catalogue: Lookup,
) -> Scene:
    """A scene of a Trimesh or trimesh.Scene; arguments as of `Scene.from_trimesh`. Raises InputError."""
    import trimesh

    where = "from_trimesh"
    loaded = trimesh.Scene(mesh) if isinstance(mesh, trimesh.Trimesh) else mesh
    if not isinstance(loaded, trimesh.Scene):
        raise InputError(f"{where}: a Trimesh or a trimesh.Scene was expected, {type(mesh).__name__} came")
    pieces = pieces_of(loaded)
    checked([piece for _, piece in pieces], where)
    known = {key for _, piece in pieces for key in piece.keys}
    _refuse_unknown(materials, known, f"{where}: materials")
    _refuse_unknown(classes, {node for node, _ in pieces}, f"{where}: classes")
    surfaces = _Surfaces(catalogue)
    bodies = [
        Body(
            name=node,
            class_name=classes.get(node, node),
            parts=(_part(piece, node, _given(piece, material, materials), surfaces),),
        )
        for node, piece in pieces
        if len(piece.faces)
    ]
    return Scene(bodies=tuple(bodies), materials=surfaces.materials, **settings)


def mitsuba_scene(
    path: Path, *, materials: Mapping[str, Given], settings: Mapping[str, Any], catalogue: Lookup
) -> Scene:
    """A scene of the shapes of a Mitsuba XML file; arguments as of `Scene.from_mitsuba`. Raises InputError."""
    surfaces = _Surfaces(catalogue)
    named = {identity: surfaces.name_of(given) for identity, given in materials.items()}
    return Scene(
        **({"name": path.stem} | dict(settings)),
        base=xml_file(path),
        base_materials=named,
        materials=surfaces.materials,
    )


class _Surfaces:
    """The materials that a scene needs, by name."""

    def __init__(self, catalogue: Lookup) -> None:
        self.materials: dict[str, Material] = {}
        self._catalogue = catalogue

    def name_of(self, given: Given) -> str:
        """The name of a material, which is the scene's from now on."""
        name = given if isinstance(given, str) else given.name
        if name not in self.materials:
            self.materials[name] = self._catalogue(given) if isinstance(given, str) else given
        return name


def _given(piece: SubMesh, material: Given | None, materials: Mapping[str, Given]) -> Given | None:
    return next((materials[key] for key in piece.keys if key in materials), material)


def _part(piece: SubMesh, node: str, given: Given | None, surfaces: _Surfaces) -> Part:
    if given is None:
        if piece.grey is None:
            raise InputError(
                f"from_trimesh: no material for '{node}', which has no colour of its own; material or materials "
                "was expected"
            )
        given = grey_material(f"colour of {node}", piece.grey)
    return Part(
        vertices_m=piece.vertices_m, faces=piece.faces, material=surfaces.name_of(given), name=piece.keys[0]
    )


def _refuse_unknown(given: Mapping[str, Any], known: set[str], where: str) -> None:
    unknown = sorted(set(given) - known)
    if unknown:
        raise InputError(f"{where}: no mesh '{unknown[0]}'; there are {', '.join(sorted(known))}")
