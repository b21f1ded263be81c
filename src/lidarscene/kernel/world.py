"""World: a `Scene` compiled for one wavelength. One mesh for each material; identity is the triangle's number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import InputError
from ..scene import Ball, Part, Scene
from . import base_scene
from .backend import mitsuba
from .bsdfs import bsdf_dict, diffuse_share

Matrix = np.ndarray[Any, Any]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class World:
    """What the kernel traces, and the tables that say what a triangle is.

    scene           Mitsuba scene; vertices are relative to ``centre_m``
    centre_m        (3,) float64: what was taken off every coordinate before it became single precision
    first_face, shape_reflectivity
                    by Mitsuba's registry number of a shape; reflectivity -1: ask the BSDF
    face_body       (f,) Int32 on the device, index into ``body_names``
    face_material   (f,) Int32 on the device, index into ``material_names``
    body_class      (b,) Int32 on the device, index into ``class_names``
    has_foreign     whether some BSDF comes from a Mitsuba file as it is
    """

    scene: Any
    centre_m: Matrix
    first_face: Any
    shape_reflectivity: Any
    face_body: Any
    face_material: Any
    body_class: Any
    body_names: tuple[str, ...]
    class_names: tuple[str, ...]
    material_names: tuple[str, ...]
    has_foreign: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Shape:
    """A Mitsuba shape and who its faces are; reflectivity None where only its BSDF knows."""

    shape: Any
    face_body: Matrix
    material: str
    reflectivity: float | None


def build_world(scene: Scene, *, wavelength_m: float, centre_m: Matrix | None = None) -> World:
    """Compile a scene.

    centre_m  (3,) point that becomes the origin of the traced coordinates: put it where the rays start, so
              that single precision is spent where it counts. A scene from a Mitsuba file keeps its origin.
    Raises InputError where a material has no data at the wavelength.
    """
    centre = np.zeros(3) if centre_m is None or scene.base else np.asarray(centre_m, dtype=np.float64)
    resolved = {name: material.at(wavelength_m) for name, material in scene.materials.items()}
    shapes = _own_shapes(scene, centre, resolved)
    body_names = [body.name for body in scene.bodies]
    class_of = [body.class_name for body in scene.bodies]
    if scene.base is not None:
        for found in base_scene.load_shapes(scene.base, scene.base_materials, resolved):
            index = np.full(found.faces, len(body_names), dtype=np.int32)
            body_names.append(found.name)
            class_of.append("unlabelled")
            shapes.append(_Shape(found.shape, index, found.material, found.reflectivity))
    if not shapes:
        raise InputError(f"scene '{scene.name}': nothing to trace, every body is empty")
    return _compiled(shapes, centre, body_names, class_of)


def _own_shapes(scene: Scene, centre: Matrix, resolved: dict[str, Any]) -> list[_Shape]:
    """One mesh for each material, over all bodies, and a shape for each exact sphere."""
    mi = mitsuba()
    grouped: dict[str, list[tuple[int, Matrix, Matrix]]] = {}
    shapes: list[_Shape] = []
    for index, body in enumerate(scene.bodies):
        for part in body.parts:
            if isinstance(part, Part):
                if not len(part.faces):
                    continue
                placed = body.pose.apply(part.vertices_m) - centre
                grouped.setdefault(part.material, []).append((index, placed, part.faces))
            else:
                shapes.append(_ball(mi, part, body.pose.position_m - centre, index, resolved))
    for material, pieces in grouped.items():
        shapes.append(_merged(mi, material, pieces, resolved[material]))
    return shapes


def _merged(mi: Any, material: str, pieces: Sequence[tuple[int, Matrix, Matrix]], values: Any) -> _Shape:
    counts = [len(vertices) for _, vertices, _ in pieces]
    starts = np.cumsum([0, *counts[:-1]])
    vertices = np.concatenate([v for _, v, _ in pieces]).astype(np.float32)
    faces = np.concatenate(
        [f.astype(np.int64) + start for (_, _, f), start in zip(pieces, starts, strict=True)]
    )
    bodies = np.concatenate([np.full(len(f), index, dtype=np.int32) for index, _, f in pieces])
    props = mi.Properties()
    props["mesh_bsdf"] = mi.load_dict(bsdf_dict(values))
    mesh = mi.Mesh(material, len(vertices), len(faces), props=props)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = vertices.ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    return _Shape(mesh, bodies, material, diffuse_share(values))


def _ball(mi: Any, ball: Ball, centre_m: Matrix, index: int, resolved: dict[str, Any]) -> _Shape:
    values = resolved[ball.material]
    shape = mi.load_dict(
        {
            "type": "sphere", "center": [float(c) for c in centre_m], "radius": float(ball.radius_m),
            "bsdf": bsdf_dict(values),
        }
    )  # fmt: skip
    return _Shape(shape, np.array([index], dtype=np.int32), ball.material, diffuse_share(values))


def _compiled(shapes: list[_Shape], centre: Matrix, body_names: list[str], class_of: list[str]) -> World:
    import drjit as dr

    mi = mitsuba()
    # Without robust intersections a ray that meets a shared edge exactly may pass between its triangles. They
    # cost 8 % of the tracing and build three times as fast (measured on street.toml); a shape group, the other
    # way to a fast build (MITSUBA.md 5.5), would lose the setting.
    settings = {"type": "scene", "embree_use_robust_intersections": True}
    children = {f"shape_{i}": shape.shape for i, shape in enumerate(shapes)}
    scene = mi.load_dict(settings | children, optimize=False)
    material_names = list(dict.fromkeys(shape.material for shape in shapes))
    counts = [len(shape.face_body) for shape in shapes]
    starts = np.cumsum([0, *counts[:-1]])
    numbers = [int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape.shape))[0]) for shape in shapes]
    first_face = np.zeros(max(numbers) + 1, dtype=np.uint32)
    reflectivity = np.zeros(max(numbers) + 1, dtype=np.float32)
    for number, start, shape in zip(numbers, starts, shapes, strict=True):
        first_face[number] = start
        reflectivity[number] = -1.0 if shape.reflectivity is None else shape.reflectivity
    class_names = tuple(dict.fromkeys(class_of))
    return World(
        scene=scene,
        centre_m=centre,
        first_face=mi.UInt32(first_face),
        shape_reflectivity=mi.Float(reflectivity),
        face_body=mi.Int32(np.concatenate([shape.face_body for shape in shapes])),
        face_material=mi.Int32(
            np.repeat(np.array([material_names.index(shape.material) for shape in shapes], np.int32), counts)
        ),
        body_class=mi.Int32(np.array([class_names.index(name) for name in class_of], dtype=np.int32)),
        body_names=tuple(body_names),
        class_names=class_names,
        material_names=tuple(material_names),
        has_foreign=any(shape.reflectivity is None for shape in shapes),
    )
