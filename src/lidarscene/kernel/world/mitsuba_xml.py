"""Load the shapes of a Mitsuba XML scene, with BSDFs replaced by our materials where the scene file says so.

Users have Mitsuba scenes made for pictures, whose BSDFs say nothing about 905 nm. Shapes are what we take from them,
and BSDFs if nothing better is named. Replacing happens in the XML, before Mitsuba loads it: a loaded shape cannot
change its BSDF.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...errors import InputError
from ...files.inputs import LARGEST_TEXT, require_file
from ..device.backend import mitsuba, only_own_files, own_plugins
from ..device.types import Bsdf, Shape
from .bsdfs import bsdf_dict, diffuse_share

Element = ElementTree.Element


@dataclass(frozen=True, slots=True, eq=False)
class FoundShape:
    """A shape of the file: its name, number of faces, and the name and diffuse reflectivity of its material.

    reflectivity  None if the BSDF is the file's own
    """

    shape: Any
    name: str
    faces: int
    material: str
    reflectivity: float | None


def load_shapes(
    path: Path, replaced: Mapping[str, str], materials: Mapping[str, dict[str, object]]
) -> list[FoundShape]:
    """Return the shapes of a Mitsuba XML file, in its order.

    replaced   from BSDF id to material name
    materials  from material name to `Material.at`
    Raises InputError if the file is no XML or no Mitsuba scene, lacks such a BSDF, or has instances.
    """
    root = _parsed(path)
    _insert_included(root, path.parent, [])
    _keep_to_mitsuba(root, path)
    _replace_bsdfs(root, path, replaced, materials)
    shapes = _loaded(root, path).shapes()
    if not shapes:
        raise InputError(f"{path}: the scene has no shapes")
    return [
        _found(shape, f"shape_{number}", path, replaced, materials) for number, shape in enumerate(shapes)
    ]


def _found(
    shape: Shape,
    unnamed: str,
    path: Path,
    replaced: Mapping[str, str],
    materials: Mapping[str, dict[str, object]],
) -> FoundShape:
    name = _plain(shape.id(), unnamed)
    if shape.class_name() == "Instance":
        raise InputError(f"{path}: shape '{name}' must be a plain shape, got an instance")
    bsdf = shape.bsdf()
    identity = _plain(bsdf.id() if bsdf is not None else "", "bsdf")
    is_ours = identity in replaced
    material = replaced[identity] if is_ours else identity
    if not is_ours:
        _require_answer(bsdf, f"{path}: BSDF '{identity}' of shape '{name}'")
        # A BSDF of the file may have the name of a material of ours; both are then in the cloud's list of names.
        if material in materials:
            material = f"{identity} of {path.name}"
    return FoundShape(
        shape=shape,
        name=name,
        faces=shape.primitive_count(),
        material=material,
        reflectivity=diffuse_share(materials[material]) if is_ours else None,
    )


def _require_answer(bsdf: Bsdf, where: str) -> None:
    """Raise InputError for a BSDF that cannot answer at one wavelength, such as Mitsuba's `hair`."""
    import drjit as dr

    mi = mitsuba()
    # Asking only records operations; nothing is computed. What would fail in the middle of a frame fails here.
    try:
        surface = dr.zeros(mi.SurfaceInteraction3f)
        bsdf.eval(mi.BSDFContext(), surface, mi.Vector3f(0.0, 0.0, 1.0))
        bsdf.eval_diffuse_reflectance(surface)
    except Exception as error:
        raise InputError(f"{where}: cannot be used: {' '.join(str(error).split())}") from None


def _plain(identity: str, fallback: str) -> str:
    """Return an id of the file, or the fallback where Mitsuba has made one up."""
    return identity if identity and not identity.startswith("_unnamed") else fallback


def _parsed(path: Path) -> Element:
    require_file(path, "a Mitsuba XML scene", largest=LARGEST_TEXT)
    try:
        return _shallow(ElementTree.parse(path).getroot())
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise InputError(f"{path}: not valid XML: {error}") from None


DEEPEST = 100
"""Elements within each other: Mitsuba follows them with its stack, and ends the program where that is full."""

MOST_INCLUDED = 1000
"""Files in all: ten that each include ten are a million after six steps."""


def _shallow(root: Element) -> Element:
    """The same element. Raises ValueError if the nesting is too deep."""
    level = [root]
    for _ in range(DEEPEST):
        level = [child for element in level for child in element]
        if not level:
            return root
    raise ValueError(f"must be nested {DEEPEST} deep at most, got more")


def _insert_included(element: Element, folder: Path, files: list[Path], depth: int = 0) -> None:
    """Replace each <include> by the content of its file, so that BSDFs in there can be replaced too.

    As in Mitsuba, paths are relative to the first file, and names may hold parameters of <default>.

    files  that were included so far
    """
    # From the last child to the first: an insertion does not shift the positions that are still to come.
    defaults = _defaults(element)
    for position, child in reversed(list(enumerate(element))):
        name = _filled_in(child.get("filename") or "", defaults) if child.tag == "include" else ""
        if not name or "$" in name:
            continue
        files.append(folder / name)
        if depth > 15 or len(files) > MOST_INCLUDED:
            raise InputError(f"{folder / name}: files include each other")  # Mitsuba's own limit is 15, too
        inner = _parsed(folder / name)
        _insert_included(inner, folder, files, depth + 1)
        element[position : position + 1] = list(inner) if inner.tag == "scene" else [inner]


def _defaults(element: Element) -> dict[str, str]:
    """Return the values of parameters by name."""
    return {str(one.get("name")): str(one.get("value")) for one in element.iter("default")}


def _filled_in(text: str, parameters: Mapping[str, str]) -> str:
    """Return a text of the file with the values of its parameters in place of $name."""
    # Longer names first: $scene_dir is not $scene followed by "_dir".
    for name in sorted(parameters, key=len, reverse=True):
        text = text.replace(f"${name}", parameters[name])
    return text


def _keep_to_mitsuba(root: Element, path: Path) -> None:
    """Name all files by absolute paths, and raise InputError for a plugin that is not Mitsuba's own.

    Mitsuba looks for plugins, which are native code, where it looks for files: in `plugins/` of any folder that it
    was told of, and by a relative or absolute path in the name of a type. A scene from elsewhere must not run code.
    """
    parameters, known = _defaults(root), own_plugins()
    folders = [path.parent.resolve()]
    for parent in list(root.iter()):
        # Integrators are not used, and some of Mitsuba's own are Python, which are no plugins.
        for one in [child for child in parent if child.tag in ("path", "integrator")]:
            if one.tag == "path":
                folders.append(folders[0] / _filled_in(one.get("value") or "", parameters))
            parent.remove(one)
    for element in root.iter():
        kind = element.get("type")
        if kind is not None and _filled_in(kind, parameters) not in known:
            raise InputError(
                f"{path}: {element.tag} type: must be one of Mitsuba's own plugins, got '{kind[:60]}'"
            )
        key = "value" if element.tag == "string" and element.get("name") == "filename" else "filename"
        name = _filled_in(element.get(key) or "", parameters)
        found = next((folder / name for folder in (*folders, Path.cwd()) if (folder / name).is_file()), None)
        if name and found is not None:
            element.set(key, str(found))


def _loaded(root: Element, path: Path) -> Any:
    """Return the Mitsuba scene; files in it are named by absolute paths."""
    mi = mitsuba()
    try:
        with only_own_files():
            return mi.load_string(ElementTree.tostring(root, encoding="unicode"), optimize=False)
    except Exception as error:
        # Mitsuba raises RuntimeError and others, with its own source line and our line numbers in front.
        reason = re.sub(
            r"^(\[\S+\]\s*|(At|While loading) string \([^)]*\):\s*)+", "", " ".join(str(error).split())
        )
        raise InputError(f"{path}: not a Mitsuba scene: {reason}") from None


def _replace_bsdfs(
    root: Element, path: Path, replaced: Mapping[str, str], materials: Mapping[str, dict[str, object]]
) -> None:
    """Write our BSDFs over those of the file, by id."""
    # A BSDF inside another one (the base of a `twosided`) may have an id, but no shape refers to it.
    inner = {id(child) for bsdf in root.iter("bsdf") for child in bsdf.iter("bsdf") if child is not bsdf}
    by_id = {str(b.get("id")): b for b in root.iter("bsdf") if b.get("id") and id(b) not in inner}
    for identity, material in replaced.items():
        if identity not in by_id:
            choices = ", ".join(sorted(by_id)) or "none"
            raise InputError(f"{path}: base_materials: no BSDF with id '{identity}'; it has {choices}")
        element = by_id[identity]
        element.clear()
        element.set("id", identity)
        _fill(element, bsdf_dict(materials[material]))


def _fill(element: Element, values: dict[str, Any]) -> None:
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
            _fill(ElementTree.SubElement(element, "bsdf"), value)
