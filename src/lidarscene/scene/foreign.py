"""Scenes of other programs: a mesh of another library or a Mitsuba XML file in, a `Scene` out.

They describe shapes but neither materials in the infrared nor sensors, so both are arguments.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..files.inputs import LARGEST_TEXT, require_file
from ..materials.material import Material
from .meshes.mesh_cache import SubMesh
from .meshes.mesh_objects import named_pieces
from .meshes.reading import check_pieces, grey_material
from .scene import Body, Part, Scene, add_material

MaterialChoice = str | Material


def object_scene(
    mesh: Any,
    *,
    material: MaterialChoice | None,
    materials: Mapping[str, MaterialChoice],
    classes: Mapping[str, str],
    settings: Mapping[str, Any],
) -> Scene:
    """Make a scene of a mesh of another library; arguments as for `load_scene`.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    where = "load_scene"
    pieces = named_pieces(mesh, "scene", "a name, a file, a Scene")
    check_pieces([piece for _, piece in pieces], where)
    piece_names = {key for _, piece in pieces for key in piece.keys}
    _refuse_unknown(materials, piece_names, f"{where}: materials")
    _refuse_unknown(classes, {node for node, _ in pieces}, f"{where}: classes")
    scene_materials: dict[str, Material] = {}
    bodies = [
        Body(
            name=node,
            class_name=classes.get(node, node),
            parts=(_part(piece.of_its_faces(), node, _material_for(piece, material, materials), scene_materials),),
        )
        for node, piece in pieces
        if len(piece.faces)
    ]
    return Scene(bodies=tuple(bodies), materials=scene_materials, **settings)


def mitsuba_scene(path: Path, *, materials: Mapping[str, MaterialChoice], settings: Mapping[str, Any]) -> Scene:
    """Make a scene of the shapes of a Mitsuba XML file; arguments as for `load_scene`.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    scene_materials: dict[str, Material] = {}
    base_materials = {
        identity: add_material(scene_materials, material, "load_scene") for identity, material in materials.items()
    }
    return Scene(
        **({"name": path.stem} | dict(settings)),
        base=xml_file(path),
        base_materials=base_materials,
        materials=scene_materials,
    )


def _material_for(
    piece: SubMesh, material: MaterialChoice | None, materials: Mapping[str, MaterialChoice]
) -> MaterialChoice | None:
    return next((materials[key] for key in piece.keys if key in materials), material)


def _part(piece: SubMesh, node: str, material: MaterialChoice | None, scene_materials: dict[str, Material]) -> Part:
    """Part of a piece with its material, or else with its own colour.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    if material is None:
        if piece.grey is None:
            raise InputError(
                f"load_scene: '{node}' has no colour of its own and must have a material, as in "
                "load_scene(mesh, material='brick')"
            )
        material = grey_material(f"colour of {node}", piece.grey)
    return Part(
        vertices_m=piece.vertices_m,
        faces=piece.faces,
        material=add_material(scene_materials, material, "load_scene"),
        name=piece.keys[0],
        in_box=piece.in_box,
    )


def _refuse_unknown(choices: Mapping[str, Any], names: set[str], where: str) -> None:
    unknown = sorted(set(choices) - names)
    if unknown:
        raise InputError(f"{where}: no mesh '{unknown[0]}'; there are {', '.join(sorted(names))}")


def is_xml(path: Path) -> bool:
    """Return True for the name of a Mitsuba XML file."""
    return path.suffix.lower() == ".xml"


def xml_file(path: Path, where: str = "") -> Path:
    """The absolute path, if it is an XML file that exists: Mitsuba opens it later, perhaps from another folder.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    try:
        require_file(path, "a Mitsuba XML scene", largest=LARGEST_TEXT)
    except InputError as error:
        raise InputError(f"{where}{error}") from None
    if not is_xml(path):
        raise InputError(f"{where}{path}: the name of a Mitsuba scene must end in .xml")
    return path.absolute()
