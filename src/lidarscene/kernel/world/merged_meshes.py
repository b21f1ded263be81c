"""Merge the meshes of a Mitsuba file that have one BSDF, and keep for each face which body it belongs to.

Every shape costs time in every frame and triangles do not (`mitsuba_world`): a city of 2,367 shapes and five BSDFs
becomes six meshes, and takes a tenth of the time. Only what a BSDF reads is carried over: flat and uniform surfaces,
most of all cities, then take the short way from a table of normals (`faces`).
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from functools import cache
from typing import Any

import numpy as np

from ..device.backend import mitsuba
from ..device.types import Bsdf
from .faces import PlacedShape
from .mitsuba_xml import FileShape


def merge_by_bsdf(shapes: Sequence[FileShape], first_body: int) -> list[PlacedShape]:
    """Return the shapes of a Mitsuba file, meshes of one BSDF merged; each shape is a body.

    Args:
        first_body: index of the first shape's body; those of the others follow
    """
    # By identity: Mitsuba gives one BSDF of a file to all shapes that refer to it.
    varies = {id(shape.bsdf): shape.values is None and _varies(shape.bsdf) for shape in shapes}
    groups: dict[Hashable, list[int]] = {}
    for number, shape in enumerate(shapes):
        groups.setdefault(_merge_key(shape, varies[id(shape.bsdf)]) or number, []).append(number)
    return [
        _placed_shape([shapes[i] for i in members], [first_body + i for i in members], key)
        for key, members in groups.items()
    ]


def _merge_key(shape: FileShape, varies: bool) -> tuple[int, bool, bool] | None:
    """Return what meshes must share to become one: BSDF, smooth normals, texture coordinates; None: stays alone."""
    mitsuba_shape = shape.shape
    if not mitsuba_shape.is_mesh() or mitsuba_shape.face_count() != shape.faces or mitsuba_shape.has_flipped_normals():
        return None
    if varies and mitsuba_shape.has_mesh_attributes():
        return None
    return id(shape.bsdf), _is_smooth(mitsuba_shape), varies and mitsuba_shape.has_vertex_texcoords()


def _placed_shape(shapes: Sequence[FileShape], bodies: Sequence[int], key: Hashable) -> PlacedShape:
    face_body = np.repeat(np.array(bodies, np.int32), [shape.faces for shape in shapes])
    first = shapes[0]
    if not isinstance(key, tuple):
        return PlacedShape(first.shape, face_body, first.material, first.values)
    _, is_smooth, has_image = key
    # The BSDF of a surface that varies, or has a grain, reads texture coordinates: those of Mitsuba's own interaction.
    is_plain = not is_smooth and not (first.values is None and _varies(first.bsdf))
    mesh = first.shape if len(shapes) == 1 else _merged_mesh(shapes, is_smooth, has_image)
    return PlacedShape(mesh, face_body, first.material, first.values, is_plain=is_plain)


def _merged_mesh(shapes: Sequence[FileShape], is_smooth: bool, has_image: bool) -> Any:
    """Return one mesh of all faces of these, in order, with the BSDF of the first."""
    mi = mitsuba()
    meshes = [shape.shape for shape in shapes]
    counts = [mesh.vertex_count() for mesh in meshes]
    starts = np.cumsum([0, *counts[:-1]])
    props = mi.Properties()
    props["mesh_bsdf"] = shapes[0].bsdf
    mesh = mi.Mesh(
        shapes[0].material,
        sum(counts),
        sum(shape.faces for shape in shapes),
        props=props,
        has_vertex_normals=is_smooth,
        has_vertex_texcoords=has_image,
    )
    parameters = mi.traverse(mesh)
    faces = [mesh.faces_buffer().numpy() + np.uint32(start) for mesh, start in zip(meshes, starts, strict=True)]
    parameters["faces"] = np.concatenate(faces)
    parameters["vertex_positions"] = np.concatenate([mesh.vertex_positions_buffer().numpy() for mesh in meshes])
    if is_smooth:
        parameters["vertex_normals"] = np.concatenate([mesh.vertex_normals_buffer().numpy() for mesh in meshes])
    if has_image:
        uv = [mesh.vertex_texcoords_buffer().numpy() for mesh in meshes]
        parameters["vertex_texcoords"] = np.concatenate(uv)
    parameters.update()
    return mesh


def _is_smooth(mesh: Any) -> bool:
    """Return whether a mesh has normals other than those of its triangles; many files write the latter."""
    if not mesh.has_vertex_normals() or mesh.has_face_normals():
        return False
    vertices = mesh.vertex_positions_buffer().numpy().reshape(-1, 3).astype(np.float64)
    faces = mesh.faces_buffer().numpy().reshape(-1, 3)
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    flat = np.cross(b - a, c - a)
    area = np.linalg.norm(flat, axis=1)
    has_area = area > 0.0  # triangles without area are never met
    written = mesh.vertex_normals_buffer().numpy().reshape(-1, 3)[faces[has_area]]
    # 1e-3 is what normals with three digits in a text file are off by.
    return bool(np.any(np.abs(written - (flat[has_area] / area[has_area, None])[:, None]) > 1e-3))


def _varies(bsdf: Bsdf) -> bool:
    """Return whether a BSDF reads more than directions: a texture, a map of bumps, or a grain."""
    mi = mitsuba()
    if mi.has_flag(bsdf.flags(), mi.BSDFFlags.Anisotropic):
        return True
    # Numbers of a mesh's vertices or faces do not count as varying for Mitsuba.
    return any(texture.is_spatially_varying() or texture.class_name() == "MeshAttribute" for texture in _textures(bsdf))


def _textures(node: Any) -> list[Any]:
    """Return the textures of a Mitsuba object, and of those inside it."""
    mi = mitsuba()
    search = _search_class()()
    node.traverse(search)
    inside = [child for child in search.found if not isinstance(child, mi.Texture)]
    return [child for child in search.found if isinstance(child, mi.Texture)] + [
        texture for child in inside for texture in _textures(child)
    ]


@cache
def _search_class() -> Any:
    """Return a class that gathers the objects inside one; made at the first call: its base needs a variant."""
    mi = mitsuba()

    class Search(mi.TraversalCallback):  # type: ignore[misc,name-defined]
        def __init__(self) -> None:
            super().__init__()
            self.found: list[Any] = []

        def put(self, name: str, value: object, *about: object) -> None:
            if isinstance(value, mi.Object):
                self.found.append(value)

    return Search
