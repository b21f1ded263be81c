"""Return the shapes of a Mitsuba XML scene as vertices and faces, for drawing.

The view draws triangles. Meshes have them; spheres, discs and cylinders of a Mitsuba file are exact for the tracer and
are approximated here, as profiles turned about an axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...maths.arrays import Numbers
from ...scene.scene import Scene
from ..device.backend import mitsuba, require_scene_trial
from ..device.gate import exclusive
from ..device.types import Shape
from . import mitsuba_xml

SEGMENTS = 48  # of a drawn circle
_POLAR = np.linspace(0.0, np.pi, SEGMENTS // 2 + 1)
PROFILES = {
    "Sphere": np.stack([np.sin(_POLAR), np.cos(_POLAR)], axis=1),
    "Disk": np.array([(0.0, 0.0), (1.0, 0.0)]),
    "Cylinder": np.array([(1.0, 0.0), (1.0, 1.0)]),
}
"""(n, 2) distance from the axis and height along it, of Mitsuba's shapes before their `to_world`."""


@dataclass(frozen=True, slots=True, eq=False)
class DrawnShape:
    """A shape to draw: its name, (v, 3) float64 vertices, (f, 3) uint32 faces, and the name of its material.

    Attributes:
        material: one of ours, or the id of a BSDF of the file
    """

    name: str
    vertices_m: Numbers
    faces: Numbers
    material: str


@exclusive
def triangles_of_base(scene: Scene, wavelength_m: float) -> list[DrawnShape]:
    """Return what a scene takes from its Mitsuba file: meshes, and shapes of the kinds in PROFILES."""
    if scene.base is None:
        return []
    require_scene_trial(scene)
    materials = {name: material.at(wavelength_m) for name, material in scene.materials.items()}
    shapes = mitsuba_xml.load_shapes(scene.base, scene.base_materials, materials, wavelength_m)
    drawn = ((shape, _triangles(shape.shape)) for shape in shapes)
    return [DrawnShape(shape.name, *triangles, shape.material) for shape, triangles in drawn if triangles is not None]


def _triangles(shape: Shape) -> tuple[Numbers, Numbers] | None:
    if shape.is_mesh():
        vertices, faces = shape.vertex_positions_buffer().numpy(), shape.faces_buffer().numpy()
        return vertices.reshape(-1, 3).astype(np.float64), faces.reshape(-1, 3).astype(np.uint32)
    if (kind := shape.class_name()) not in PROFILES:
        return None
    placed = np.array(mitsuba().traverse(shape)["to_world"].matrix, np.float64).reshape(4, 4)
    vertices, faces = revolve(PROFILES[kind])
    return vertices @ placed[:3, :3].T + placed[:3, 3], faces


def sphere(radius_m: float) -> tuple[Numbers, Numbers]:
    """Return vertices and faces of a sphere around the origin."""
    vertices, faces = revolve(PROFILES["Sphere"])
    return radius_m * vertices, faces


def revolve(profile: Numbers) -> tuple[Numbers, Numbers]:
    """Return vertices and faces of a (n, 2) profile (distance from the axis, height) turned about z."""
    # A grid of rings by segments; each cell of it is split into two triangles.
    phi = np.linspace(0.0, 2.0 * np.pi, SEGMENTS, endpoint=False)
    radius, height = (np.repeat(profile[:, i, None], SEGMENTS, axis=1) for i in (0, 1))
    vertices = np.stack([radius * np.cos(phi), radius * np.sin(phi), height], axis=-1)
    ring, column = np.meshgrid(np.arange(len(profile) - 1), np.arange(SEGMENTS), indexing="ij")
    a, b = ring * SEGMENTS + column, ring * SEGMENTS + (column + 1) % SEGMENTS
    halves = np.stack([a, a + SEGMENTS, b, b, a + SEGMENTS, b + SEGMENTS], axis=-1)
    return vertices.reshape(-1, 3), halves.reshape(-1, 3).astype(np.uint32)
