"""Mitsuba XML scenes in: their shapes by name, with BSDFs replaced where the scene file says so."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import InputError
from .backend import mitsuba
from .bsdfs import bsdf_dict


@dataclass(frozen=True, slots=True, eq=False)
class FoundShape:
    """A shape of the file: its name, how many faces it has, and its material's name and reflectivity."""

    shape: Any
    name: str
    faces: int
    material: str
    reflectivity: float | None


def load_shapes(path: Path, replaced: Mapping[str, str], materials: Mapping[str, Any]) -> list[FoundShape]:
    """Shapes of a Mitsuba XML file, in its order.

    replaced   BSDF id to material name
    materials  material name to `Material.at`
    Raises InputError for what is not XML, not a Mitsuba scene, or has no such BSDF.
    """
    mi = mitsuba()
    root = _parsed(path)
    _replace_bsdfs(root, path, replaced, materials)
    resolver = mi.file_resolver()
    resolver.prepend(str(path.parent.resolve()))
    try:
        scene = mi.load_string(ElementTree.tostring(root, encoding="unicode"), optimize=False)
    except Exception as error:
        # Mitsuba raises RuntimeError or TypeError with several lines; the last says what is wrong.
        raise InputError(f"{path}: not a Mitsuba scene: {' '.join(str(error).split())}") from None
    found = []
    for number, shape in enumerate(scene.shapes()):
        bsdf = shape.bsdf()
        identity = _plain(bsdf.id() if bsdf is not None else "", "bsdf")
        material = replaced.get(identity, identity)
        values = materials[material] if identity in replaced else None
        found.append(
            FoundShape(
                shape=shape,
                name=_plain(shape.id(), f"shape_{number}"),
                faces=shape.face_count() if shape.is_mesh() else 1,
                material=material,
                reflectivity=None if values is None else float(values["reflectivity"]),
            )
        )
    if not found:
        raise InputError(f"{path}: the scene has no shapes")
    return found


def _plain(identity: str, fallback: str) -> str:
    return identity if identity and not identity.startswith("_unnamed") else fallback


def _parsed(path: Path) -> ElementTree.Element:
    try:
        return ElementTree.parse(path).getroot()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (ElementTree.ParseError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not valid XML: {error}") from None


def _replace_bsdfs(
    root: ElementTree.Element, path: Path, replaced: Mapping[str, str], materials: Mapping[str, Any]
) -> None:
    by_id = {element.get("id"): element for element in root.iter("bsdf") if element.get("id")}
    for identity, material in replaced.items():
        if identity not in by_id:
            known = ", ".join(sorted(str(name) for name in by_id)) or "none"
            raise InputError(f"{path}: base_materials: no BSDF with id '{identity}'; it has {known}")
        element = by_id[identity]
        element.clear()
        element.set("id", identity)
        _fill(element, bsdf_dict(materials[material]))


def _fill(element: ElementTree.Element, values: dict[str, Any]) -> None:
    """Write a Mitsuba dictionary (numbers, strings, spectra and nested BSDFs) as the XML element's content."""
    element.set("type", values["type"])
    for key, value in values.items():
        if key == "type":
            continue
        if isinstance(value, dict):
            child = ElementTree.SubElement(element, "spectrum" if value["type"] == "spectrum" else "bsdf")
            if value["type"] == "spectrum":
                child.set("name", key)
                child.set("value", repr(value["value"]))
            else:
                _fill(child, value)
            continue
        kind = {bool: "boolean", str: "string"}.get(type(value), "float")
        child = ElementTree.SubElement(element, kind, name=key)
        child.set("value", str(value).lower() if kind == "boolean" else str(value))
