"""Meshes of other libraries as pieces: of trimesh, Open3D, PyVista and Mitsuba, or plain arrays.

None of these libraries is imported: an object is known by its attributes.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...files.trimesh import trimesh
from ...maths.arrays import Numbers
from .mesh_axes import axis_of, turn_upright
from .mesh_cache import SubMesh
from .polygons import triangulate
from .reading import check_pieces, pieces_of, read_mesh, refuse_other_formats, require_vertices

VERTICES = "finite real numbers in rows of x, y, z, shape (n, 3)"
FACES = "whole numbers in rows of triangles (m, 3) or quads (m, 4)"
OBJECTS = "(vertices, faces) or a mesh of trimesh, Open3D, PyVista or Mitsuba"


def pieces_of_object(mesh: Any, where: str) -> list[SubMesh]:
    """Pieces of a mesh file or of an object of another library, z up.

    Raises:
        InputError: that begins with ``where``
    """
    if isinstance(mesh, str | os.PathLike):
        path = Path(mesh)
        refuse_other_formats(path)
        axis = axis_of(path) or "z"
        return [replace(piece, vertices_m=turn_upright(piece.vertices_m, axis)) for piece in read_mesh(path)]
    return check_pieces([piece for _, piece in named_pieces(mesh, where)], where)


def named_pieces(mesh: Any, where: str, others: str = "a mesh file") -> list[tuple[str, SubMesh]]:
    """Name and piece of each mesh of an object.

    Args:
        where: start of messages
        others: what else could be given

    Raises:
        InputError: for one of no known kind
    """
    if hasattr(mesh, "graph") and hasattr(mesh, "geometry"):  # trimesh.Scene
        return pieces_of(mesh)
    if hasattr(mesh, "faces") and hasattr(mesh, "vertices"):  # trimesh.Trimesh
        return pieces_of(trimesh().Scene(mesh))
    if hasattr(mesh, "shapes") and callable(mesh.shapes):  # mitsuba.Scene
        return [_mitsuba_piece(shape, where) for shape in mesh.shapes()]
    if hasattr(mesh, "vertex_positions_buffer"):  # mitsuba.Mesh
        return [_mitsuba_piece(mesh, where)]
    if hasattr(mesh, "triangles") and hasattr(mesh, "vertices"):  # open3d.geometry.TriangleMesh
        return [("mesh", _piece("mesh", mesh.vertices, mesh.triangles, where))]
    if hasattr(mesh, "triangle") and hasattr(mesh, "vertex"):  # open3d.t.geometry.TriangleMesh
        return [("mesh", _piece("mesh", mesh.vertex.positions.numpy(), mesh.triangle.indices.numpy(), where))]
    if hasattr(mesh, "triangulate") and hasattr(mesh, "points"):  # pyvista.PolyData
        return [_polydata_piece(mesh, where)]
    if isinstance(mesh, Sequence) and len(mesh) == 2:
        vertices, faces = mesh
        return [("mesh", _piece("mesh", vertices, faces, where))]
    raise InputError(f"{where}: must be {others}, {OBJECTS}, got {type(mesh).__name__}")


def _piece(name: str, vertices: Any, faces: Any, where: str) -> SubMesh:
    """Piece of arrays. Each quad becomes two triangles.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    vertices_m = _real_rows(vertices, (3,), f"{where}: vertices: must be {VERTICES}")
    corners, must = _real_rows(faces, (3, 4), f"{where}: faces: must be {FACES}"), f"{where}: faces: must be {FACES}"
    fractions = corners[corners != np.floor(corners)]
    if len(fractions):
        raise InputError(f"{must}, got {fractions[0]}")
    if corners.shape[1] == 4 and len(corners) > 1 and (corners[:, 0] == 3).all():
        raise InputError(f"{must}, got 3 first in each: if it counts the corners, as VTK does, give faces[:, 1:]")
    # Before they become whole: what no integer can hold names no vertex either.
    require_vertices(corners, len(vertices_m), where)
    places, named = vertices_m.astype(np.float64), corners.astype(np.int64).reshape(-1)
    triangles, _ = triangulate(places, np.full(len(corners), corners.shape[1]), named)
    return SubMesh(vertices_m=places, faces=named[triangles], keys=(name,))


def _real_rows(values: Any, lengths: Collection[int], must: str) -> Numbers:
    """Array of real numbers in rows of one of these lengths.

    Raises:
        InputError: that begins with ``must``
    """
    try:
        array = np.asanyarray(values)
    except ValueError:
        raise InputError(f"{must}, got rows of different lengths") from None
    if array.ndim != 2 or array.shape[1] not in lengths or array.dtype.kind not in "iuf":
        raise InputError(f"{must}, got {array.dtype} of shape {array.shape}")
    if np.ma.is_masked(array):
        raise InputError(f"{must}, got masked numbers")
    return np.asarray(array)


def _mitsuba_piece(shape: Any, where: str) -> tuple[str, SubMesh]:
    """Name and piece of a Mitsuba mesh, whose vertices are in the world; its keys are its own id and its BSDF's."""
    name = str(shape.id())
    if not hasattr(shape, "vertex_positions_buffer"):
        raise InputError(f"{where}: '{name}': a shape of Mitsuba must be a mesh, cube or rectangle, got {type(shape)}")
    piece = _piece(name, _triples(shape.vertex_positions_buffer()), _triples(shape.faces_buffer()), where)
    bsdf = shape.bsdf()
    keys = (name, *([str(bsdf.id())] if bsdf is not None and bsdf.id() else []))
    return name, replace(piece, keys=tuple(dict.fromkeys(keys)))


def _triples(flat: Any) -> Numbers:
    return np.array(flat).reshape(-1, 3)


def _polydata_piece(mesh: Any, where: str) -> tuple[str, SubMesh]:
    """Piece of a PyVista PolyData, whose faces are triangulated first; each begins with its number of corners."""
    triangles = mesh.triangulate()
    faces: Numbers = np.asarray(triangles.faces).reshape(-1, 4)[:, 1:]
    return "mesh", _piece("mesh", triangles.points, faces, where)
