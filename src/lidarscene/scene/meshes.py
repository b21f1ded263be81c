"""Mesh files in (any that trimesh reads, and USD), and primitives, as vertices and faces in float64 metres.

trimesh is kept from changing what the file says: it would merge vertices, reorder faces and forget material names, on
which labels and materials depend.
"""

from __future__ import annotations

import io
import logging
import math
import re
import warnings
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, LidarSceneError
from ..files.inputs import require_archive, require_file
from ..materials.material import Material, Spectrum
from ..maths.arrays import Numbers
from . import patterns
from .mesh_cache import SubMesh, cached
from .usd import is_usd, read_usd

LARGEST_EDGE_M = 16.0
"""Longest edge of a primitive's triangles, along an axis. The single-precision error of a hit grows with the triangle:
6e-6 of a 2 m range on a triangle of 1 km, 6e-7 on one of 20 m."""

MOST_CUTS = 512
"""Most cuts along an axis; beyond it, on planes of more than 8 km, triangles grow instead."""


def read_mesh(path: Path, pattern: patterns.Kind | None = None) -> list[SubMesh]:
    """All pieces of a mesh file, in the order of its nodes. Raises InputError, one line.

    pattern  how reflectivity varies over it, to be read too; such a file is read anew each time
    """
    require_file(path, "a mesh file")
    if pattern is not None:
        return checked(_pieces(path, pattern), str(path))
    return checked(cached(path, lambda: _pieces(path)), str(path))


def checked(pieces: list[SubMesh], where: str) -> list[SubMesh]:
    """The pieces that have triangles. Raises InputError, one line, if there are none or if numbers are invalid."""
    pieces = [piece for piece in pieces if len(piece.faces)]
    if not pieces:
        raise InputError(f"{where}: the mesh must have at least one triangle, got none")
    for piece in pieces:
        count = len(piece.vertices_m)
        # NaN, infinite, or so large that a scale could make it infinite.
        bad = count - int(np.count_nonzero((np.abs(piece.vertices_m) < 1e30).all(axis=1)))
        if bad:
            raise InputError(f"{where}: {bad} of {count} vertices are not finite numbers")
        low, high = int(piece.faces.min()), int(piece.faces.max())
        if low < 0 or high >= count:
            raise InputError(f"{where}: a face names vertex {low if low < 0 else high}, there are {count}")
    return pieces


def pieces_of(loaded: Any) -> list[tuple[str, SubMesh]]:
    """Node name and mesh of every mesh in a trimesh.Scene, including empty ones."""
    nodes = [node for node in loaded.graph.nodes_geometry if _is_mesh(loaded, node)]
    return [(str(node), _placed(loaded, node)) for node in nodes]


def _pieces(path: Path, pattern: patterns.Kind | None = None) -> list[SubMesh]:
    """The pieces that trimesh finds in the file, including empty ones. Raises InputError."""
    try:
        with warnings.catch_warnings():
            if is_usd(path):
                if pattern is not None:
                    raise InputError(
                        "pattern: must be left out with USD, whose colours are not read by vertex or texture"
                    )
                return read_usd(path)
            warnings.simplefilter("ignore")
            loaded = _loaded(path)
            pieces = pieces_of(loaded)
            if pattern is None:
                return [piece for _, piece in pieces]
            linear = path.suffix.lower() in (".glb", ".gltf")
            return [
                _patterned(piece, loaded.geometry[loaded.graph[node][1]], pattern, linear=linear)
                for node, piece in pieces
            ]
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except LidarSceneError:
        raise
    except Exception as error:
        # trimesh's readers raise whatever their parsers raise; all of it means that the file is not readable.
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{path}: cannot be read as a mesh: {reason}") from None


def _loaded(path: Path) -> Any:
    """A trimesh Scene with the file's own vertices and faces, in its order. Prints nothing."""
    import trimesh

    logging.getLogger("trimesh").addHandler(logging.NullHandler())
    with path.open("rb") as file:
        if zipfile.is_zipfile(file):
            require_archive(file)
    if path.suffix.lower() in (".gz", ".bz2", ".xz", ".tar"):
        raise ValueError(f"'{path.suffix}' must be unpacked first")
    if path.suffix.lower() != ".obj":
        return trimesh.load_scene(str(path), process=False)
    data = path.read_bytes()
    if b"mtllib" not in data:
        data = b"mtllib none.mtl\n" + data
    resolver = _mtl_resolver(path, data)
    return trimesh.load_scene(io.BytesIO(data), file_type="obj", process=False, resolver=resolver)


def _mtl_resolver(path: Path, data: bytes) -> Any:
    """Resolver for files beside an OBJ file. Its .mtl gets every material that the OBJ uses.

    trimesh drops the names of materials that the .mtl does not define; we add empty definitions.
    """
    from trimesh.resolvers import FilePathResolver

    class Resolver(FilePathResolver):  # type: ignore[misc]
        def get(self, name: str) -> bytes:
            if not name.lower().endswith(".mtl"):
                return bytes(super().get(name))
            try:
                given = bytes(super().get(name))
            except Exception:
                given = b""
            known, used = (
                set(re.findall(rb"^\s*" + word + rb"[ \t]+(.*?)\s*$", text, re.MULTILINE))
                for word, text in ((b"newmtl", given), (b"usemtl", data))
            )
            return b"\n".join([given, *(b"newmtl " + one for one in sorted(used - known))])

    return Resolver(str(path))


def _is_mesh(loaded: Any, node: Any) -> bool:
    return hasattr(loaded.geometry[loaded.graph[node][1]], "faces")


def _placed(loaded: Any, node: Any) -> SubMesh:
    """The mesh of a node, with the node's transform applied."""
    transform, name = loaded.graph[node]
    geometry = loaded.geometry[name]
    vertices = np.asarray(geometry.vertices, dtype=np.float64).reshape(-1, 3)
    material = getattr(geometry.visual, "material", None)
    return SubMesh(
        vertices_m=vertices @ transform[:3, :3].T + transform[:3, 3],
        faces=np.asarray(geometry.faces).reshape(-1, 3),
        keys=tuple(dict.fromkeys(str(key) for key in (getattr(material, "name", None), name, node) if key)),
        grey=_grey(material),
    )


def _patterned(piece: SubMesh, geometry: Any, kind: patterns.Kind, *, linear: bool) -> SubMesh:
    """The piece with its pattern; as it is if its geometry has none."""
    found = patterns.read(geometry, kind, linear=linear)
    if found is None:
        return piece
    pattern, faces = found
    if faces is None:
        return replace(piece, pattern=pattern)
    return replace(piece, pattern=pattern, vertices_m=piece.vertices_m[piece.faces.reshape(-1)], faces=faces)


_TRIMESH_DEFAULT = (102, 102, 102)


def _grey(material: Any) -> float | None:
    """Mean of the base colour in linear light, or None. trimesh stores 0 to 255, and fills in a default of its own."""
    colour = getattr(material, "baseColorFactor", None)
    if colour is None:
        colour = getattr(material, "diffuse", None)
    if colour is None or tuple(colour[:3]) == _TRIMESH_DEFAULT:
        return None
    rgb = np.asarray(colour[:3], dtype=np.float64)
    return float(np.clip(rgb.mean() / 255.0, 0.0, 1.0))


def _cuts(length_m: float) -> int:
    """Number of pieces into which a length is cut."""
    return min(max(1, math.ceil(length_m / LARGEST_EDGE_M)), MOST_CUTS)


def plane_mesh(*, size_m: tuple[float, float]) -> tuple[Numbers, Numbers]:
    """Rectangle in its xy plane, normal +z, centred: vertices (v, 3) and faces (f, 3)."""
    nx, ny = (_cuts(s) for s in size_m)
    x, y = np.linspace(-0.5, 0.5, nx + 1) * size_m[0], np.linspace(-0.5, 0.5, ny + 1) * size_m[1]
    gx, gy = np.meshgrid(x, y, indexing="ij")
    vertices = np.stack([gx.ravel(), gy.ravel(), np.zeros(gx.size)], axis=1)
    i, j = np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij")
    corner = (i * (ny + 1) + j).ravel()
    a, b, c, d = corner, corner + ny + 1, corner + ny + 2, corner + 1
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return vertices, faces


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
    return _welded(*joined(parts))


def cylinder_mesh(*, radius_m: float, height_m: float, sections: int = 64) -> tuple[Numbers, Numbers]:
    """Closed cylinder about z, centred, with ``sections`` flat sides (64: 0.12 % of the radius off a circle)."""
    rings = _cuts(height_m)
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


def joined(parts: list[tuple[Numbers, Numbers]]) -> tuple[Numbers, Numbers]:
    """Several (vertices, faces) as one mesh."""
    offsets = np.cumsum([0] + [len(vertices) for vertices, _ in parts[:-1]])
    vertices = np.concatenate([vertices for vertices, _ in parts])
    faces = np.concatenate([faces + offset for (_, faces), offset in zip(parts, offsets, strict=True)])
    return vertices, faces


def _welded(vertices: Numbers, faces: Numbers) -> tuple[Numbers, Numbers]:
    """The same mesh with equal vertices merged."""
    unique, index = np.unique(vertices, axis=0, return_inverse=True)
    return unique, index.reshape(-1)[faces]


def grey_material(name: str, grey: float) -> Material:
    """A mesh's own colour as a diffuse material: an estimate, since visible colour is not infrared reflectivity."""
    return Material(
        name=name, bsdf="diffuse", reflectivity=Spectrum.constant(grey),
        description="estimate: mean of the mesh file's base colour",
    )  # fmt: skip
