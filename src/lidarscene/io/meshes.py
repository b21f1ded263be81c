"""Mesh files in (anything trimesh reads), and primitives, as parts in float64 metres."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError

Matrix = np.ndarray[Any, Any]

LARGEST_EDGE_M = 16.0
"""Primitives are cut into triangles no longer than this along an axis: the single-precision error of a hit
grows with the size of the triangle that was hit (6e-6 of a 2 m range on one of 1 km, 6e-7 on one of 20 m)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SubMesh:
    """One piece of a mesh file, placed by the file's own node transforms.

    vertices_m  (v, 3) float64; faces (f, 3) integers
    keys        names it may be called by: its material's, geometry's and node's
    grey        mean of its base colour if the file gives one, else None
    """

    vertices_m: Matrix
    faces: Matrix
    keys: tuple[str, ...]
    grey: float | None = None


def read_mesh(path: Path) -> list[SubMesh]:
    """All pieces of a mesh file, in the order of its nodes. Raises InputError, one line."""
    if not path.exists():
        raise InputError(f"{path}: no such mesh file")
    pieces = _read_scene(path)
    if not any(len(piece.faces) for piece in pieces):
        raise InputError(f"{path}: the mesh is empty; at least one triangle was expected")
    for piece in pieces:
        bad = int(np.count_nonzero(~np.isfinite(piece.vertices_m).all(axis=1)))
        if bad:
            raise InputError(f"{path}: {bad} of {len(piece.vertices_m)} vertices are not finite numbers")
        if len(piece.faces) and (piece.faces.min() < 0 or piece.faces.max() >= len(piece.vertices_m)):
            raise InputError(
                f"{path}: a face names vertex {int(piece.faces.max())}, the mesh has {len(piece.vertices_m)}"
            )
    return [piece for piece in pieces if len(piece.faces)]


def _read_scene(path: Path) -> list[SubMesh]:
    import trimesh

    try:
        # process=False keeps the file's own vertices and faces, in its order.
        loaded = trimesh.load_scene(str(path), process=False)
    except Exception as error:
        # trimesh's many readers raise whatever their parser raises; all of it means "not readable".
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: cannot be read as a mesh: {reason}") from None
    pieces = []
    for node in loaded.graph.nodes_geometry:
        transform, name = loaded.graph[node]
        geometry = loaded.geometry[name]
        if not hasattr(geometry, "faces"):
            continue
        vertices = np.asarray(geometry.vertices, dtype=np.float64)
        placed = vertices @ transform[:3, :3].T + transform[:3, 3]
        material = getattr(getattr(geometry, "visual", None), "material", None)
        keys = tuple(dict.fromkeys(str(k) for k in (getattr(material, "name", None), name, node) if k))
        pieces.append(
            SubMesh(vertices_m=placed, faces=np.asarray(geometry.faces), keys=keys, grey=_grey(material))
        )
    return pieces


def _grey(material: Any) -> float | None:
    """Mean of the base colour in linear light, or None; trimesh keeps colours as 0-255 or 0-1."""
    colour = getattr(material, "baseColorFactor", None)
    if colour is None:
        colour = getattr(material, "diffuse", None)
    if colour is None:
        return None
    rgb = np.asarray(colour, dtype=np.float64)[:3]
    if np.asarray(colour).dtype == np.uint8:
        rgb = rgb / 255.0
    return float(np.clip(rgb.mean(), 0.0, 1.0))


def plane_mesh(*, size_m: tuple[float, float]) -> tuple[Matrix, Matrix]:
    """Rectangle in its xy plane, normal +z, centred: vertices (v, 3) and faces (f, 3)."""
    nx, ny = (max(1, math.ceil(s / LARGEST_EDGE_M)) for s in size_m)
    x, y = np.linspace(-0.5, 0.5, nx + 1) * size_m[0], np.linspace(-0.5, 0.5, ny + 1) * size_m[1]
    gx, gy = np.meshgrid(x, y, indexing="ij")
    vertices = np.stack([gx.ravel(), gy.ravel(), np.zeros(gx.size)], axis=1)
    i, j = np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij")
    corner = (i * (ny + 1) + j).ravel()
    a, b, c, d = corner, corner + ny + 1, corner + ny + 2, corner + 1
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return vertices, faces


def box_mesh(*, size_m: tuple[float, float, float]) -> tuple[Matrix, Matrix]:
    """Box centred on the origin, normals outward: six planes."""
    parts = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        flat, faces = plane_mesh(size_m=(size_m[u], size_m[v]))
        for sign in (1.0, -1.0):
            vertices = np.zeros_like(flat)
            vertices[:, u], vertices[:, v], vertices[:, axis] = (
                flat[:, 0],
                flat[:, 1],
                sign * size_m[axis] / 2,
            )
            parts.append((vertices, faces if sign > 0 else faces[:, ::-1]))
    return joined(parts)


def cylinder_mesh(*, radius_m: float, height_m: float, sections: int = 64) -> tuple[Matrix, Matrix]:
    """Closed cylinder about z, centred; ``sections`` flat sides (64: 0.12 % of the radius off the round)."""
    rings = max(1, math.ceil(height_m / LARGEST_EDGE_M))
    angle = np.arange(sections) * (2.0 * np.pi / sections)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1) * radius_m
    heights = np.linspace(-0.5, 0.5, rings + 1) * height_m
    side = np.concatenate([np.column_stack([circle, np.full(sections, z)]) for z in heights])
    here = np.arange(sections)
    following = (here + 1) % sections
    faces = []
    for ring in range(rings):
        low, high = ring * sections, (ring + 1) * sections
        faces.append(np.stack([low + here, low + following, high + following], axis=1))
        faces.append(np.stack([low + here, high + following, high + here], axis=1))
    centres = np.array([[0.0, 0.0, heights[0]], [0.0, 0.0, heights[-1]]])
    bottom, top, last = len(side), len(side) + 1, rings * sections
    faces.append(np.stack([np.full(sections, bottom), following, here], axis=1))
    faces.append(np.stack([np.full(sections, top), last + here, last + following], axis=1))
    return np.concatenate([side, centres]), np.concatenate(faces)


def joined(parts: list[tuple[Matrix, Matrix]]) -> tuple[Matrix, Matrix]:
    """Several (vertices, faces) as one."""
    offsets = np.cumsum([0] + [len(vertices) for vertices, _ in parts[:-1]])
    vertices = np.concatenate([vertices for vertices, _ in parts])
    faces = np.concatenate([faces + offset for (_, faces), offset in zip(parts, offsets, strict=True)])
    return vertices, faces
