"""Load the shapes of a Mitsuba XML scene, with BSDFs replaced by our materials where the scene file says so.

Users have Mitsuba scenes made for pictures, whose BSDFs say nothing about 905 nm. Shapes are what we take from them,
and BSDFs if nothing better is named. Replacing happens in the XML, before Mitsuba loads it (`xml_bsdfs`): a type that
Mitsuba does not have must not reach it.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...files.inputs import LARGEST_TEXT, require_file
from ...materials.material_file import catalogue_material
from ...maths.arrays import Numbers
from ...maths.vectors import box_around
from ..device.backend import mitsuba, mitsuba_plugins, without_outside_files
from ..device.gate import exclusive
from ..device.types import Bsdf
from . import xml_bsdfs
from .bsdfs import bsdf_dict, diffuse_share
from .xml_instances import expand_instances

Element = ElementTree.Element


@dataclass(frozen=True, slots=True, eq=False)
class FileShape:
    """A shape of the file: its name, number of faces, BSDF, and the name of its material.

    Attributes:
        values: `Material.at`; None if the BSDF is the file's own
        assumed: name of the BSDF if the material was chosen by it; empty if not
    """

    shape: Any
    name: str
    faces: int
    bsdf: Any
    material: str
    values: Mapping[str, Any] | None
    assumed: str = ""

    @property
    def reflectivity(self) -> float | None:
        """Diffuse reflectivity; None if the BSDF is the file's own."""
        return None if self.values is None else diffuse_share(self.values)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FileContent:
    """What a file holds.

    Attributes:
        shapes: number of shapes, those of instances included
        triangles: of those that are meshes
        materials: names of their BSDFs
        box_m: (2, 3) lowest and highest corner around all shapes
        left_out: kinds of elements that are not used, and how many there are of each
    """

    shapes: int
    triangles: int
    materials: tuple[str, ...]
    box_m: Numbers
    left_out: Mapping[str, int]


@exclusive
def file_content(path: Path) -> FileContent:
    """Load the shapes of a Mitsuba XML file and return what it holds.

    Raises:
        InputError: as of `load_shapes`
    """
    shapes = load_shapes(path, {}, {}, _ANY_WAVELENGTH_M)
    boxes = [shape.shape.bbox() for shape in shapes]
    corners = np.array([np.ravel(corner) for box in boxes for corner in (box.min, box.max)])
    elements = Counter(element.tag for element in _parse(path).iter())
    return FileContent(
        shapes=len(shapes),
        triangles=sum(shape.faces for shape in shapes if shape.shape.is_mesh()),
        materials=tuple(dict.fromkeys(shape.material for shape in shapes)),
        box_m=box_around(corners),
        left_out={f"{kind}s": elements[kind] for kind in ("emitter", "sensor", "medium") if elements[kind]},
    )


_ANY_WAVELENGTH_M = 905e-9
"""Choice: wavelength of materials that stand in for unknown BSDFs, where only their names count."""


def load_shapes(
    path: Path, replaced: Mapping[str, str], materials: Mapping[str, dict[str, object]], wavelength_m: float
) -> list[FileShape]:
    """Return the shapes of a Mitsuba XML file, in its order.

    Args:
        replaced: BSDF id -> material name
        materials: material name -> `Material.at`
        wavelength_m: for materials of the catalogue, where a BSDF that Mitsuba does not have suggests one

    Raises:
        InputError: if the file is no XML or no Mitsuba scene, lacks such a BSDF, or an instance's group
    """
    root = _parse(path)
    _insert_included(root, path.parent, [])
    _resolve_aliases(root)
    expand_instances(root, path)
    parameters, plugins = _default_parameters(root), mitsuba_plugins()
    replaced_elements = xml_bsdfs.empty_named_bsdfs(root, path, replaced)
    stand_ins = xml_bsdfs.empty_unknown_bsdfs(
        root, lambda kind: not kind or _fill_parameters(kind, parameters) in plugins, materials
    )
    _resolve_files_and_plugins(root, path)
    xml_bsdfs.make_two_sided(root)
    used_materials = dict(materials)
    for element, material in replaced_elements + stand_ins:
        if material not in used_materials:
            used_materials[material] = catalogue_material(material).at(wavelength_m)
        xml_bsdfs.fill(element, bsdf_dict(used_materials[material]))
    shapes = _load(root, path).shapes()
    if not shapes:
        raise InputError(f"{path}: the scene has no shapes")
    replaced = {str(element.get("id")): material for element, material in replaced_elements + stand_ins}
    by_name = {str(element.get("id")) for element, _ in stand_ins}
    answers: dict[int, Any] = {}
    file_shapes: list[FileShape] = []
    for number, shape in enumerate(shapes):
        name, bsdf = _declared_id_or(shape.id(), f"shape_{number}"), shape.bsdf()
        identity = _declared_id_or(bsdf.id() if bsdf is not None else "", "bsdf")
        material = replaced.get(identity, identity)
        if identity not in replaced:
            if id(bsdf) not in answers:
                if fault := _fault(bsdf):
                    # Every kernel asks all BSDFs that are alive: what a traceback kept of this one would stop them all.
                    del shapes, shape, bsdf, answers, file_shapes
                    raise InputError(
                        f"{path}: BSDF '{identity}' of shape '{name}': cannot be used: {fault}; {xml_bsdfs.NAMING_HINT}"
                    )
                answers[id(bsdf)] = bsdf
            # A BSDF of the file may have the name of a material of ours; both are then in the cloud's list of names.
            if material in used_materials:
                material = f"{identity} of {path.name}"
        file_shapes.append(
            FileShape(
                shape=shape,
                name=name,
                faces=shape.primitive_count(),
                bsdf=bsdf,
                material=material,
                values=used_materials[material] if identity in replaced else None,
                assumed=identity if identity in by_name else "",
            )
        )
    return file_shapes


def _fault(bsdf: Bsdf) -> str:
    """Return why a BSDF cannot be evaluated at one wavelength (Mitsuba's `hair`); "" if it can."""
    import drjit as dr

    mi = mitsuba()
    # Asking only records operations; nothing is computed. What would fail in the middle of a frame fails here.
    try:
        surface = dr.zeros(mi.SurfaceInteraction3f)
        bsdf.eval(mi.BSDFContext(), surface, mi.Vector3f(0.0, 0.0, 1.0))
        bsdf.eval_diffuse_reflectance(surface)
    except Exception as error:
        return " ".join(str(error).split())
    return ""


def _declared_id_or(identity: str, fallback: str) -> str:
    """Return an id of the file, or the fallback where Mitsuba made up the id."""
    return identity if identity and not identity.startswith("_unnamed") else fallback


def _parse(path: Path) -> Element:
    require_file(path, "a Mitsuba XML scene", largest=LARGEST_TEXT)
    try:
        return _require_shallow(ElementTree.parse(path).getroot())
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise InputError(f"{path}: not valid XML: {error}") from None


DEEPEST = 100
"""Elements within each other: Mitsuba follows them with its stack, and ends the program where that is full."""

MOST_INCLUDED = 1000
"""Files in all: ten that each include ten are a million after six steps."""


def _require_shallow(root: Element) -> Element:
    """Return the element itself.

    Raises:
        ValueError: if the nesting is too deep
    """
    level = [root]
    for _ in range(DEEPEST):
        level = [child for element in level for child in element]
        if not level:
            return root
    raise ValueError(f"must be nested {DEEPEST} deep at most, got more")


def _insert_included(element: Element, folder: Path, files: list[Path], depth: int = 0) -> None:
    """Replace each <include> by the content of its file, so that BSDFs in there can be replaced too.

    As in Mitsuba, paths are relative to the first file, and names may hold parameters of <default>.

    Args:
        files: that were included so far
    """
    # From the last child to the first: an insertion does not shift the positions that are still to come.
    defaults = _default_parameters(element)
    for position, child in reversed(list(enumerate(element))):
        name = _fill_parameters(child.get("filename") or "", defaults) if child.tag == "include" else ""
        if not name or "$" in name:
            continue
        files.append(folder / name)
        if depth > 15 or len(files) > MOST_INCLUDED:
            raise InputError(f"{folder / name}: files include each other")  # Mitsuba's own limit is 15, too
        inner = _parse(folder / name)
        _insert_included(inner, folder, files, depth + 1)
        element[position : position + 1] = list(inner) if inner.tag == "scene" else [inner]


def _resolve_aliases(root: Element) -> None:
    """Refer by its own id to what has another one by an <alias>, so that each BSDF and group is found by one."""
    for holder in list(root.iter()):
        for alias in reversed(holder.findall("alias")):  # one may be of an earlier one
            for ref in root.iter("ref"):
                if ref.get("id") == alias.get("as"):
                    ref.set("id", alias.get("id", ""))
            holder.remove(alias)


def _default_parameters(element: Element) -> dict[str, str]:
    """Return the default values of parameters by name."""
    return {str(parameter.get("name")): str(parameter.get("value")) for parameter in element.iter("default")}


def _fill_parameters(text: str, parameters: Mapping[str, str]) -> str:
    """Return a text of the file with the values of its parameters in place of $name."""
    # Longer names first: $scene_dir is not $scene followed by "_dir".
    for name in sorted(parameters, key=len, reverse=True):
        text = text.replace(f"${name}", parameters[name])
    return text


def _resolve_files_and_plugins(root: Element, path: Path) -> None:
    """Name all files by absolute paths, and raise InputError for a plugin that is not Mitsuba's own.

    Mitsuba looks for plugins, which are native code, where it looks for files: in `plugins/` of any folder in
    its search path, and by a relative or absolute path in the name of a type. A scene from elsewhere must not run code.
    """
    parameters, plugins = _default_parameters(root), mitsuba_plugins()
    folders, working_folder = [path.parent.resolve()], Path.cwd()
    for parent in list(root.iter()):
        # Integrators are not used, and some of Mitsuba's own are Python, which are no plugins.
        for removed in [child for child in parent if child.tag in ("path", "integrator")]:
            if removed.tag == "path":
                folders.append(folders[0] / _fill_parameters(removed.get("value") or "", parameters))
            parent.remove(removed)
    for element in root.iter():
        kind = element.get("type")
        if kind is not None and _fill_parameters(kind, parameters) not in plugins:
            hint = f"; {xml_bsdfs.NAMING_HINT}, by its id" if element.tag == "bsdf" else ""
            raise InputError(
                f"{path}: {element.tag} type: must be one of Mitsuba's own plugins, got '{kind[:60]}'{hint}"
            )
        key = "value" if element.tag == "string" and element.get("name") == "filename" else "filename"
        name = _fill_parameters(element.get(key) or "", parameters)
        if not name:
            continue
        file = next((folder / name for folder in (*folders, working_folder) if (folder / name).is_file()), None)
        if file is not None:
            element.set(key, str(file))


def _load(root: Element, path: Path) -> Any:
    """Return the Mitsuba scene; files in it are named by absolute paths."""
    mi = mitsuba()
    try:
        with without_outside_files():
            return mi.load_string(ElementTree.tostring(root, encoding="unicode"), optimize=False)
    except Exception as error:
        # Mitsuba raises RuntimeError and others, with its own source line and our line numbers in front.
        reason = re.sub(r"^(\[\S+\]\s*|(At|While loading) string \([^)]*\):\s*)+", "", " ".join(str(error).split()))
        hint = f"; {xml_bsdfs.NAMING_HINT}, by its id" if "bsdf" in reason.lower() else ""
        raise InputError(f"{path}: not a Mitsuba scene: {reason}{hint}") from None
