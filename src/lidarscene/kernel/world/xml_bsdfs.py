"""Rewrite the BSDFs of a Mitsuba XML scene before Mitsuba loads it: ours in place of theirs, and all of them two-sided.

Three things are changed. BSDFs that a scene file names get our material. BSDFs of types that Mitsuba does not have,
such as the radio materials of Sionna RT, get the material of the catalogue that their name suggests. One-sided BSDFs
become two-sided: Mitsuba's `diffuse` is black from behind, and the walls of a scene made for pictures or for radio are
often wound inwards.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from ...catalog import names
from ...errors import InputError

Element = ElementTree.Element

STAND_INS = {
    "asphalt": "asphalt",
    "tarmac": "asphalt",
    "road": "asphalt",
    "brick": "brick",
    "plaster": "plaster_white",
    "stucco": "plaster_white",
    "ceiling": "plaster_white",
    "marble": "plaster_white",
    "concrete": "concrete",
    "cement": "concrete",
    "stone": "concrete",
    "granite": "concrete",
    "pavement": "concrete",
    "sidewalk": "concrete",
    "glass": "clear_glass",
    "chrome": "chrome",
    "paint": "car_paint_grey",
    "metal": "galvanised_steel",
    "steel": "galvanised_steel",
    "iron": "galvanised_steel",
    "aluminium": "brushed_aluminium",
    "aluminum": "brushed_aluminium",
    "wood": "wood",
    "timber": "wood",
    "chipboard": "wood",
    "floorboard": "wood",
    "tree": "tree_foliage",
    "foliage": "tree_foliage",
    "leaves": "tree_foliage",
    "vegetation": "tree_foliage",
    "grass": "grass",
    "lawn": "grass",
    "ground": "soil",
    "soil": "soil",
    "terrain": "soil",
    "earth": "soil",
    "dirt": "soil",
    "sand": "soil",
    "rubber": "tyre_rubber",
    "plastic": "black_plastic",
    "window": "clear_glass",
    "roof": "brick",
}
"""Word in the name of an unknown BSDF -> material of the catalogue; the first word that fits counts.

The materials of ITU-R P.2040-3, table 3, by which Sionna RT names its own, are among the words (all but `vacuum`).
Choices of ours: marble is as bright as white plaster, and sheet metal outdoors is matt, as weathered zinc is.
"""

NAMING_HINT = "base_materials can name a material for it"

ONE_SIDED = frozenset(
    {"diffuse", "plastic", "roughplastic", "pplastic", "conductor", "roughconductor", "measured", "principled"}
)
"""Mitsuba's opaque BSDFs that reflect nothing, or no diffuse light, from behind. `principled` may be of glass."""


def outermost_bsdfs(root: Element) -> Iterator[tuple[Element, Element]]:
    """Yield (parent element, BSDF) of each BSDF that is not inside another one."""
    for holder in root.iter():
        if holder.tag != "bsdf":
            yield from ((holder, child) for child in holder if child.tag == "bsdf")
    # A BSDF inside a BSDF has a holder that is a BSDF: it is passed over, as are those inside it.


def empty_named_bsdfs(root: Element, path: Path, replaced: Mapping[str, str]) -> list[tuple[Element, str]]:
    """Empty the BSDFs that a scene file names, by id, and return them with their materials.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    # A BSDF inside another one (the base of a `twosided`) may have an id, but no shape refers to it.
    by_id = {str(bsdf.get("id")): bsdf for _, bsdf in outermost_bsdfs(root) if bsdf.get("id")}
    for identity in replaced:
        if identity not in by_id:
            choices = ", ".join(sorted(by_id)) or "none"
            raise InputError(f"{path}: base_materials: no BSDF with id '{identity}'; it has {choices}")
    return [(_emptied_with_id(by_id[identity], identity), material) for identity, material in replaced.items()]


def empty_unknown_bsdfs(
    root: Element, is_known: Callable[[str], bool], scene_materials: Mapping[str, object]
) -> list[tuple[Element, str]]:
    """Empty the BSDFs that have a type which Mitsuba lacks, and return them with materials by their names.

    Those whose name says nothing stay as they are.

    Args:
        is_known: whether Mitsuba has a type
        scene_materials: materials of the scene file by name, which go before those of the catalogue
    """
    emptied: list[tuple[Element, str]] = []
    for _, bsdf in list(outermost_bsdfs(root)):
        unknown = [element for element in bsdf.iter("bsdf") if not is_known(element.get("type") or "")]
        material = _suggested_material([bsdf, *unknown], scene_materials) if unknown else None
        if material is not None:
            # A BSDF without an id gets one: by it `load_shapes` finds the material of the shapes.
            emptied.append((_emptied_with_id(bsdf, bsdf.get("id") or f"unnamed {len(emptied)}"), material))
    return emptied


def _suggested_material(bsdfs: list[Element], scene_materials: Mapping[str, object]) -> str | None:
    """Return the material that the names of BSDFs suggest: a radio material's own type, ids, and types."""
    material_names = (*scene_materials, *names("materials"))
    types = (element.get("value") for bsdf in bsdfs for element in bsdf.iter("string") if element.get("name") == "type")
    candidate_names = [*types, *(bsdf.get(key) for key in ("id", "name", "type") for bsdf in bsdfs)]
    for name in (text for text in candidate_names if text):
        if name in material_names:
            return name
        for word, material in STAND_INS.items():
            if word in name.lower():
                return material
    return None


def _emptied_with_id(element: Element, identity: str) -> Element:
    """Clear an element but for its id; returns it."""
    element.clear()
    element.set("id", identity)
    return element


def make_two_sided(root: Element) -> None:
    """Put each one-sided BSDF into a `twosided` one, and give shapes without BSDF Mitsuba's default, two-sided."""
    ids = {bsdf.get("id") for bsdf in root.iter("bsdf")}
    for shape in list(root.iter("shape")):
        has_one = any(child.tag == "bsdf" or (child.tag == "ref" and child.get("id") in ids) for child in shape)
        if not has_one and shape.get("type") not in ("instance", "shapegroup"):
            ElementTree.SubElement(shape, "bsdf", type="diffuse")
    for holder in list(root.iter()):
        if holder.tag == "bsdf" and holder.get("type") == "twosided":
            continue
        for position, bsdf in enumerate(holder):
            if bsdf.tag == "bsdf" and _is_one_sided(bsdf):
                outer = ElementTree.Element("bsdf", type="twosided")
                for key in ("id", "name"):
                    if key in bsdf.attrib:
                        outer.set(key, bsdf.attrib.pop(key))
                outer.append(bsdf)
                holder[position] = outer


def _is_one_sided(bsdf: Element) -> bool:
    # Light goes through a principled BSDF that has this number, or, in a file before version 2, of this name.
    glassy = any(parameter.get("name") in ("spec_trans", "specTrans") for parameter in bsdf)
    return bsdf.get("type") in ONE_SIDED and not glassy


def fill(element: Element, values: dict[str, Any]) -> None:
    """Write a Mitsuba dictionary (numbers, texts, spectra and nested BSDFs) as the content of an XML element."""
    element.set("type", values["type"])
    for key, value in values.items():
        if key == "type":
            continue
        if not isinstance(value, dict):
            kind = {bool: "boolean", str: "string"}.get(type(value), "float")
            text = str(value).lower() if kind == "boolean" else str(value)
            ElementTree.SubElement(element, kind, name=key, value=text)
        elif value["type"] == "spectrum":
            ElementTree.SubElement(element, "spectrum", name=key, value=repr(value["value"]))
        else:
            fill(ElementTree.SubElement(element, "bsdf"), value)
