"""Instances of a Mitsuba XML scene as shapes of their own, before Mitsuba loads it.

An `instance` shows the shapes of a `shapegroup` once more, elsewhere. Each becomes copies of these shapes, so that it
is a body with a name, and its BSDFs can be replaced. The copies share their BSDFs, since each adds code to kernels.
"""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from ...errors import InputError

Element = ElementTree.Element

MOST_COPIES = 1_000_000
"""Most shapes that instances may become: each takes some kilobytes."""


def expand_instances(root: Element, path: Path) -> None:
    """Replace each instance by the shapes of its group, and remove the groups.

    A copy has the name of its instance, or else of its group, and, if the group has several shapes, its own behind it.

    Raises:
        InputError: for an instance without a group
    """
    groups = {str(shape.get("id")): shape for shape in root.iter("shape") if shape.get("type") == "shapegroup"}
    of_instances = [(parent, shape) for parent in root.iter() for shape in parent if _is_a(shape, "instance")]
    if not of_instances and not groups:
        return
    _share_bsdfs(root)
    taken = Counter(str(element.get("id")) for element in root.iter() if element.get("id"))
    copies = 0
    for parent, instance in of_instances:
        names = [str(child.get("id")) for child in instance if child.tag == "ref"]
        group = next((groups[name] for name in names if name in groups), None)
        if group is None:
            raise InputError(f"{path}: instance '{instance.get('id', '')}': no shapegroup '{', '.join(names)}'")
        shapes = list(_copies(instance, group, taken))
        copies += len(shapes)
        if copies > MOST_COPIES:
            raise InputError(f"{path}: instances must be of {MOST_COPIES} shapes at most, got more")
        place = list(parent).index(instance)
        parent[place : place + 1] = shapes
    for parent in list(root.iter()):
        for group in [child for child in parent if _is_a(child, "shapegroup")]:
            parent.remove(group)


def _is_a(element: Element, kind: str) -> bool:
    return element.tag == "shape" and element.get("type") == kind


def _share_bsdfs(root: Element) -> None:
    """Move the BSDFs of the groups' shapes to the top of the scene, and name them where they were."""
    groups = [shape for shape in root.iter("shape") if shape.get("type") == "shapegroup"]
    known = {element.get("id") for element in root.iter("bsdf")}
    for number, group in enumerate(groups):
        for place, shape in enumerate(group.findall("shape")):
            bsdf = shape.find("bsdf")
            if bsdf is None and any(ref.get("id") in known for ref in shape.findall("ref")):
                continue
            if bsdf is None:
                bsdf = ElementTree.Element("bsdf", type="diffuse")  # Mitsuba's own for a shape without
            else:
                shape.remove(bsdf)
            bsdf.attrib.setdefault("id", f"bsdf {place} of {group.get('id', f'group {number}')}")
            root.insert(0, bsdf)
            ElementTree.SubElement(shape, "ref", id=str(bsdf.get("id")))


def _copies(instance: Element, group: Element, taken: Counter[str]) -> Iterator[Element]:
    """Yield the shapes of a group where an instance puts them.

    Args:
        taken: ids of the scene so far, with those of the copies added
    """
    placed = [list(transform) for transform in instance.findall("transform") if transform.get("name") == "to_world"]
    shapes = group.findall("shape")
    for number, shape in enumerate(shapes):
        # Operations of a transform come one after the other: first the shape's in its group, then the instance's.
        shape = copy.deepcopy(shape)
        own = next((child for child in shape.findall("transform") if child.get("name") == "to_world"), None)
        if own is None:
            own = ElementTree.SubElement(shape, "transform", name="to_world")
        own.extend(operation for operations in placed for operation in copy.deepcopy(operations))
        name = instance.get("id") or group.get("id") or "instance"
        if len(shapes) > 1:
            name = f"{name}.{shape.get('id') or number}"
        taken[name] += 1
        # The instance itself has the name until its copies are there.
        repeated = taken[name] - (2 if name == instance.get("id") else 1)
        shape.set("id", name if not repeated else f"{name}.{repeated}")
        yield shape
