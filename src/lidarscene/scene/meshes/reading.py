"""Mesh files in (glTF, USD, any that trimesh reads), as vertices and faces in float64, in the file's own lengths.

trimesh runs without processing: it would merge vertices, reorder faces and drop material names, on which labels and
materials depend.
"""

from __future__ import annotations

import io
import logging
import os
import re
import warnings
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError, LidarSceneError
from ...files.inputs import LARGEST_PART, require_archive, require_file
from ...files.trimesh import signals_heard, trimesh
from ...materials.material import Material
from ...maths.arrays import Numbers
from . import reflectivity_patterns
from .gltf import read_gltf
from .gltf_document import declaration
from .mesh_axes import GLTF
from .mesh_cache import SubMesh, WalkingClips, read_cached
from .polygons import obj_in_triangles, off_in_triangles, ply_as_text, triangulate
from .usd import is_usd, read_stage

NOT_READ = {
    ".blend": ("a Blender file", "open it in Blender"),
    ".fbx": ("an FBX file", "import it into Blender"),
    ".dae": ("a Collada file", "import it into Blender up to version 4,"),
    ".3ds": ("a 3D Studio file", "import it into Blender"),
    ".max": ("a 3ds Max file", "export FBX from 3ds Max, import that into Blender"),
    ".step": ("a STEP file of CAD", "export OBJ or STL from FreeCAD; or import that into Blender"),
    ".stp": ("a STEP file of CAD", "export OBJ or STL from FreeCAD; or import that into Blender"),
}
"""Suffixes of scenes and meshes of other programs: what they are, and the way to glTF."""


def refuse_other_formats(path: Path) -> None:
    """Raise InputError for a file of `NOT_READ`, with what converts it."""
    if path.suffix.lower() in NOT_READ:
        noun, first_step = NOT_READ[path.suffix.lower()]
        raise InputError(
            f"{path}: {noun}, which is not read; {first_step} and export glTF (File, Export, glTF 2.0), a .glb"
        )


def read_mesh(
    path: Path, pattern: reflectivity_patterns.Kind | None = None, clips: WalkingClips | None = None
) -> list[SubMesh]:
    """Read all pieces of a mesh file, in the order of its nodes.

    Args:
        pattern: kind of reflectivity pattern to read too; such a file is not cached
        clips: animations of a walker, whose stride is read too

    Raises:
        InputError: one line
    """
    require_file(path, "a mesh file")
    if path.name.encode(errors="ignore").decode() != path.name:
        raise InputError(f"{path}: the name of a mesh file must be UTF-8")
    if path.suffix.lower() in GLTF:
        declaration(path).check(path)
    if clips is not None and path.suffix.lower() not in GLTF:
        raise InputError(f"{path}: animation must go with a glTF file, got '{path.suffix}'")
    if pattern is not None:
        return check_pieces(_pieces(path, pattern, clips), str(path))
    return check_pieces(read_cached(path, lambda: _pieces(path, clips=clips), clips), str(path))


def check_pieces(pieces: list[SubMesh], where: str) -> list[SubMesh]:
    """Keep the pieces that have triangles, and the vertices that these have: others are in no picture and in no box.

    Raises:
        InputError: one line, if there are none or numbers are invalid
    """
    pieces = [piece for piece in pieces if len(piece.faces)]
    if not pieces:
        cloud = "; a point cloud is for `lidarscene view`" if where.lower().endswith(".ply") else ""
        raise InputError(f"{where}: the mesh must have at least one triangle, got none{cloud}")
    for piece in pieces:
        count = len(piece.vertices_m)
        places_m = [piece.vertices_m[None], *([] if piece.stride is None else [piece.stride.vertices_m])]
        # NaN, infinite, or so large that a scale could make it infinite.
        if not all(each.min(initial=0.0) > -1e30 and each.max(initial=0.0) < 1e30 for each in places_m):
            finite = np.all([(np.abs(each) < 1e30).all(axis=(0, 2)) for each in places_m], axis=0)
            raise InputError(f"{where}: {np.count_nonzero(~finite)} of {count} vertices are not finite numbers")
        require_vertices(piece.faces, count, where)
    return [piece.of_its_faces() for piece in pieces]


def require_vertices(faces: Numbers, count: int, where: str) -> None:
    """Raise InputError unless all corners of the faces are among so many vertices."""
    outside = faces[(faces < 0) | (faces >= count)]
    if outside.size:
        raise InputError(f"{where}: a face names vertex {outside[0]}, there are {count}")


def pieces_of(loaded: Any) -> list[tuple[str, SubMesh]]:
    """Node name and mesh of every mesh in a trimesh.Scene, including empty ones."""
    nodes = [node for node in loaded.graph.nodes_geometry if _is_mesh(loaded, node)]
    return [(str(node), _place_mesh(loaded, node)) for node in nodes]


def _pieces(
    path: Path, pattern: reflectivity_patterns.Kind | None = None, clips: WalkingClips | None = None
) -> list[SubMesh]:
    """Read the pieces of a file, including empty ones.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    try:
        with warnings.catch_warnings():
            if is_usd(path):
                if pattern is not None:
                    raise InputError(
                        "pattern: must be left out with USD, whose colours are not read by vertex or texture"
                    )
                return read_stage(path).pieces
            if path.suffix.lower() in GLTF:
                return read_gltf(path, pattern, clips)
            warnings.simplefilter("ignore")
            with signals_heard():  # else a texture is left out for good: the mesh without it goes into the cache
                loaded = _load_trimesh(path)
                pieces = pieces_of(loaded)
            if pattern is None:
                return [piece for _, piece in pieces]
            return [_add_pattern(piece, loaded.geometry[loaded.graph[node][1]], pattern) for node, piece in pieces]
    except InputError as error:
        raise InputError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None
    except LidarSceneError:
        raise
    except Exception as error:
        refuse_other_formats(path)
        # trimesh passes on any exception of its parsers; each means that the file is not readable.
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{path}: cannot be read as a mesh: {reason}") from None


def _load_trimesh(path: Path) -> Any:
    """A trimesh Scene with the file's own vertices and faces, in its order. Prints nothing."""
    logging.getLogger("trimesh").addHandler(logging.NullHandler())
    with path.open("rb") as file:
        if zipfile.is_zipfile(file):
            require_archive(file)
    if path.suffix.lower() in (".gz", ".bz2", ".xz", ".tar"):
        raise ValueError(f"'{path.suffix}' must be unpacked first")
    suffix = path.suffix.lower()
    if suffix == ".ply":
        return _load_ply(path)
    if suffix not in (".obj", ".off"):
        return trimesh().load_scene(str(path), process=False, resolver=_resolver(path))
    data = path.read_bytes()
    if suffix == ".off":
        mesh = trimesh().load_mesh(io.BytesIO(off_in_triangles(data)), file_type="off", process=False)
        return trimesh().Scene({path.name: mesh})
    data = obj_in_triangles(data if b"mtllib" in data else b"mtllib none.mtl\n" + data)
    return trimesh().load_scene(io.BytesIO(data), file_type="obj", process=False, resolver=_resolver(path, data))


def _load_ply(path: Path) -> Any:
    """A trimesh Scene of a PLY file, whose polygons are cut into triangles."""

    def load(data: bytes, **settings: bool) -> Any:
        file = io.BytesIO(data)
        return trimesh().load(file, file_type="ply", process=False, resolver=_resolver(path), **settings)

    data = path.read_bytes()
    try:
        mesh = load(data)
    except ValueError:
        data = ply_as_text(data)
        mesh = load(data)
    polygons = _ply_polygons(mesh)
    if polygons and mesh.visual.kind == "texture":
        # trimesh splits vertices where textures meet; the polygons are those of the file's own vertices.
        mesh = load(data, fix_texture=False)
    if not polygons:
        return trimesh().Scene({path.name: mesh})
    counts, corners = np.array([len(polygon) for polygon in polygons]), np.concatenate(polygons).astype(np.int64)
    require_vertices(corners, len(mesh.vertices), str(path))
    triangles, polygon = triangulate(np.asarray(mesh.vertices), counts, corners)
    colours = np.asarray(mesh.visual.face_colors) if mesh.visual.kind == "face" else None
    mesh.faces = corners[triangles]
    if colours is not None:
        mesh.visual.face_colors = colours[polygon]
    return trimesh().Scene({path.name: mesh})


def _ply_polygons(mesh: Any) -> list[Any]:
    """Corners of the faces of a PLY file as trimesh keeps them; none if they are all triangles."""
    faces = (mesh.metadata.get("_ply_raw") or {}).get("face", {}).get("data")
    names = ("vertex_index", "vertex_indices")
    if isinstance(faces, dict):
        faces = next((faces[name] for name in names if name in faces), None)
    elif getattr(getattr(faces, "dtype", None), "names", None):
        faces = faces[next((name for name in names if name in faces.dtype.names), faces.dtype.names[0])]["f1"]
    polygons = [] if faces is None else list(faces)
    return polygons if any(len(polygon) > 3 for polygon in polygons) else []


def _resolver(path: Path, data: bytes = b"") -> Any:
    """Resolver for files beside a mesh file: regular ones of at most `LARGEST_PART` bytes.

    The .mtl of an OBJ file, whose content is ``data``, gets every material that the OBJ uses: trimesh drops the names
    of materials that the .mtl does not define, so we add empty definitions.
    """
    from trimesh.resolvers import FilePathResolver

    class Resolver(FilePathResolver):  # type: ignore[misc]
        def namespaced(self, namespace: str) -> Any:
            return Resolver(os.path.join(self.parent, namespace))

        def get(self, name: str) -> bytes:
            # All places where a version of trimesh looks for it.
            for place in (name.strip(), name.strip().lstrip("/"), os.path.basename(name)):
                path = os.path.join(self.parent, place)
                if place and os.path.lexists(path):
                    require_file(path, "a file of a mesh", largest=LARGEST_PART)
            if not name.lower().endswith(".mtl"):
                return bytes(super().get(name))
            try:
                library = bytes(super().get(name))
            except InputError:
                raise
            except Exception:
                library = b""
            defined_names, used_names = (
                set(re.findall(rb"^\s*" + word + rb"[ \t]+(.*?)\s*$", text, re.MULTILINE))
                for word, text in ((b"newmtl", library), (b"usemtl", data))
            )
            return b"\n".join(
                [library, *(b"newmtl " + material_name for material_name in sorted(used_names - defined_names))]
            )

    return Resolver(str(path))


def _is_mesh(loaded: Any, node: Any) -> bool:
    return hasattr(loaded.geometry[loaded.graph[node][1]], "faces")


def _place_mesh(loaded: Any, node: Any) -> SubMesh:
    """Mesh of a node, with the node's transform applied."""
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


def _add_pattern(piece: SubMesh, geometry: Any, kind: reflectivity_patterns.Kind) -> SubMesh:
    """Add the pattern of the geometry to a piece; without one the piece is unchanged."""
    pattern_and_faces = reflectivity_patterns.read_pattern(geometry, kind)
    if pattern_and_faces is None:
        return piece
    pattern, faces = pattern_and_faces
    if faces is None:
        return replace(piece, pattern=pattern)
    return replace(piece, pattern=pattern, vertices_m=piece.vertices_m[piece.faces.reshape(-1)], faces=faces)


_TRIMESH_DEFAULT = (102, 102, 102)


def _grey(material: Any) -> float | None:
    """Mean of the base colour in linear light, or None. trimesh stores 0 to 255, and a default of its own."""
    colour = getattr(material, "baseColorFactor", None)
    if colour is None:
        colour = getattr(material, "diffuse", None)
    if colour is None or tuple(colour[:3]) == _TRIMESH_DEFAULT:
        return None
    rgb = np.asarray(colour[:3], dtype=np.float64)
    return float(np.clip(rgb.mean() / 255.0, 0.0, 1.0))


def grey_material(name: str, grey: float) -> Material:
    """Diffuse material of a mesh's own colour: an estimate, since visible colour is not infrared reflectivity."""
    return Material(name=name, reflectivity=grey, description="estimate: mean of the mesh file's base colour")
