"""Triangles: the shapes of a Mitsuba XML scene in, vertices and faces to draw out, as numpy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..scene import Scene
from . import base_scene
from .backend import mitsuba

Matrix = np.ndarray[Any, Any]

RINGS = 24  # of latitude, in a drawn sphere
UNIT_SQUARE = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """A shape to draw: (v, 3) float64 vertices, (f, 3) uint32 faces, its name, and what material it is of.

    material  of ours, or the id of a BSDF of the file
    """

    name: str
    vertices_m: Matrix
    faces: Matrix
    material: str


def triangles_of_base(scene: Scene, wavelength_m: float) -> list[Drawn]:
    """What a scene takes from its Mitsuba file; shapes that are not mesh, rectangle or sphere are left out."""
    if scene.base is None:
        return []
    materials = {name: material.at(wavelength_m) for name, material in scene.materials.items()}
    shapes = base_scene.load_shapes(scene.base, scene.base_materials, materials)
    drawn = ((found, _triangles(found.shape)) for found in shapes)
    return [Drawn(found.name, *made, found.material) for found, made in drawn if made is not None]


def _triangles(shape: Any) -> tuple[Matrix, Matrix] | None:
    mi = mitsuba()
    values = mi.traverse(shape)
    if shape.is_mesh():
        vertices = values["vertex_positions"].numpy().reshape(-1, 3).astype(np.float64)
        return vertices, values["faces"].numpy().reshape(-1, 3).astype(np.uint32)
    if shape.class_name() == "Rectangle":
        placed = np.array(values["to_world"].matrix, np.float64).reshape(4, 4)
        faces = np.array([(0, 1, 2), (0, 2, 3)], np.uint32)
        return UNIT_SQUARE @ placed[:3, :3].T + placed[:3, 3], faces
    if shape.class_name() == "Sphere":
        box = shape.bbox()
        low, high = (np.array(corner, np.float64).ravel() for corner in (box.min, box.max))
        vertices, faces = sphere(0.5 * float((high - low).mean()))
        return vertices + 0.5 * (low + high), faces
    return None


def sphere(radius_m: float) -> tuple[Matrix, Matrix]:
    """Vertices and faces of a sphere around the origin, in rings of latitude."""
    columns = 2 * RINGS
    polar, around = np.linspace(0.0, np.pi, RINGS + 1), np.linspace(0.0, 2.0 * np.pi, columns, endpoint=False)
    theta, phi = np.meshgrid(polar, around, indexing="ij")
    xyz = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    ring, column = np.meshgrid(np.arange(RINGS), np.arange(columns), indexing="ij")
    a, b = ring * columns + column, ring * columns + (column + 1) % columns
    halves = np.stack([a, a + columns, b, b, a + columns, b + columns], axis=-1)
    return radius_m * xyz.reshape(-1, 3), halves.reshape(-1, 3).astype(np.uint32)
