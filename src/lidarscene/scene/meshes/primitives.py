"""Primitives as vertices (v, 3) in float64 metres and faces (f, 3); small triangles for single precision."""

from __future__ import annotations

import math

import numpy as np

from ...maths.arrays import Numbers

LARGEST_EDGE_M = 16.0
"""Accuracy bought: longest edge of a primitive's triangles, along an axis. The single-precision error of a hit grows
with the triangle: 6e-6 of a 2 m range on a triangle of 1 km, 6e-7 on one of 20 m."""

MOST_CUTS = 512
"""Most cuts along an axis; beyond it, on planes of more than 8 km, triangles grow instead."""


def _cuts(length_m: float) -> int:
    """Number of pieces into which a length is cut."""
    return min(max(1, math.ceil(length_m / LARGEST_EDGE_M)), MOST_CUTS)


def plane_mesh(*, size_m: tuple[float, float]) -> tuple[Numbers, Numbers]:
    """Rectangle in its xy plane, normal +z, centred: vertices (v, 3) and faces (f, 3)."""
    nx, ny = (_cuts(s) for s in size_m)
    x, y = np.linspace(-0.5, 0.5, nx + 1) * size_m[0], np.linspace(-0.5, 0.5, ny + 1) * size_m[1]
    gx, gy = np.meshgrid(x, y, indexing="ij")
    vertices = np.stack([gx.ravel(), gy.ravel(), np.zeros(gx.size)], axis=1)
    return vertices, grid_faces(nx, ny)


def grid_faces(nx: int, ny: int) -> Numbers:
    """Faces (f, 3) of a grid of (nx + 1) (ny + 1) vertices, y fastest: two to a cell, cut along x = y, seen from +z."""
    i, j = np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij")
    corner = (i * (ny + 1) + j).ravel()
    a, b, c, d = corner, corner + ny + 1, corner + ny + 2, corner + 1
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def box_mesh(*, size_m: tuple[float, float, float]) -> tuple[Numbers, Numbers]:
    """Closed box centred on the origin, normals outward: vertices and faces."""
    parts = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        flat, faces = plane_mesh(size_m=(size_m[u], size_m[v]))
        for sign in (1.0, -1.0):
            vertices = np.zeros_like(flat)
            vertices[:, [u, v]], vertices[:, axis] = flat[:, :2], sign * size_m[axis] / 2
            parts.append((vertices, faces if sign > 0 else faces[:, ::-1]))
    return _merge_vertices(*join_meshes(parts))


def cylinder_mesh(*, radius_m: float, height_m: float, sections: int = 64) -> tuple[Numbers, Numbers]:
    """Closed cylinder about z, centred, with ``sections`` flat sides (64: 0.12 % of the radius off a circle)."""
    rings = _cuts(height_m)
    angle = np.arange(sections) * (2.0 * np.pi / sections)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1) * radius_m
    heights = np.linspace(-0.5, 0.5, rings + 1) * height_m
    side = np.concatenate([np.column_stack([circle, np.full(sections, z)]) for z in heights])
    corner = np.arange(sections)
    next_corner = (corner + 1) % sections
    faces = []
    for ring in range(rings):
        low, high = ring * sections, (ring + 1) * sections
        faces.append(np.stack([low + corner, low + next_corner, high + next_corner], axis=1))
        faces.append(np.stack([low + corner, high + next_corner, high + corner], axis=1))
    centres = np.array([[0.0, 0.0, heights[0]], [0.0, 0.0, heights[-1]]])
    bottom, top, last = len(side), len(side) + 1, rings * sections
    faces.append(np.stack([np.full(sections, bottom), next_corner, corner], axis=1))
    faces.append(np.stack([np.full(sections, top), last + corner, last + next_corner], axis=1))
    return np.concatenate([side, centres]), np.concatenate(faces)


def join_meshes(parts: list[tuple[Numbers, Numbers]]) -> tuple[Numbers, Numbers]:
    """Join several (vertices, faces) into one mesh."""
    offsets = np.cumsum([0] + [len(vertices) for vertices, _ in parts[:-1]])
    vertices = np.concatenate([vertices for vertices, _ in parts])
    faces = np.concatenate([faces + offset for (_, faces), offset in zip(parts, offsets, strict=True)])
    return vertices, faces


def _merge_vertices(vertices: Numbers, faces: Numbers) -> tuple[Numbers, Numbers]:
    """Merge equal vertices of a mesh."""
    unique, index = np.unique(vertices, axis=0, return_inverse=True)
    return unique, index.reshape(-1)[faces]
