"""GLB: parts in, the bytes of a binary glTF 2.0 file out, the same bytes on every run.

Coordinates are written as modelled: z up, x forward, metres. A node above all parts turns them y up, as glTF asks for.
Each part is one mesh, one node and one material, all of the part's name. Positions lie on a lattice of 2^-13 m
(0.12 mm), so that a sine that differs in its last bit on another machine does not change the file.
"""

import json
import struct
from itertools import pairwise

import numpy as np

LATTICE_M = 2.0**-13
Y_UP = [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1]  # column by column: (x, y, z) becomes (x, z, -y)
CREASE_COS = 0.80  # edges sharper than about 37 degrees stay sharp


def welded(mesh):
    """(points, faces): points on the lattice, each once; faces without area left out."""
    steps = np.rint(mesh.points_m / LATTICE_M).astype(np.int64)
    steps, index = np.unique(steps, axis=0, return_inverse=True)
    faces = index.ravel()[mesh.faces]
    corners = steps[faces]
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # A needle of some lattice steps would be one rounding error away from no area at all.
    longest = np.max(np.sum((corners - np.roll(corners, 1, axis=1)) ** 2, axis=2), axis=1)
    solid = _length(doubled.astype(float))[:, 0] > np.maximum(3.0, 2e-3 * longest)
    return steps * LATTICE_M, faces[solid]


def shaded(points_m, faces):
    """(points, normals, faces) with points doubled along sharp edges, so that flat and round both show."""
    corners = points_m[faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    unit = area / _length(area)
    corner_point = faces.ravel()
    corner_face = np.repeat(np.arange(len(faces)), 3)
    order = np.argsort(corner_point, kind="stable")
    starts = np.searchsorted(corner_point[order], np.arange(len(points_m) + 1))
    normal = np.zeros((len(corner_point), 3))
    for first, last in pairwise(starts):
        here = order[first:last]
        around = corner_face[here]
        n = unit[around]
        smooth = (n[:, None, 0] * n[:, 0] + n[:, None, 1] * n[:, 1] + n[:, None, 2] * n[:, 2]) > CREASE_COS
        normal[here] = np.sum(smooth[:, :, None] * area[around], axis=1)
    normal = np.rint(normal / _length(normal) * 4096) / 4096
    rows, index = np.unique(np.column_stack([corner_point, normal]), axis=0, return_inverse=True)
    unique_normal = rows[:, 1:] / _length(rows[:, 1:])
    return points_m[rows[:, 0].astype(int)], unique_normal, index.ravel().reshape(-1, 3)


def _length(vectors):
    return np.sqrt(vectors[:, :1] ** 2 + vectors[:, 1:2] ** 2 + vectors[:, 2:] ** 2)


def glb_bytes(parts, colours):
    """`parts` name -> Mesh and `colours` name -> (r, g, b, alpha), as one GLB file."""
    tree = {
        "asset": {"version": "2.0", "generator": "lidarscene tools/scenes/make_assets.py"},
        "scene": 0,
        "scenes": [{"nodes": [len(parts)]}],
        "nodes": [
            *({"name": name, "mesh": i} for i, name in enumerate(parts)),
            {"name": "y_up", "matrix": Y_UP, "children": list(range(len(parts)))},
        ],
        "meshes": [],
        "materials": [_material(name, colours[name]) for name in parts],
        "accessors": [],
        "bufferViews": [],
    }
    blob = bytearray()
    for i, (name, mesh) in enumerate(parts.items()):
        points, normal, faces = shaded(*welded(mesh))
        attributes = {
            "POSITION": _add(tree, blob, points.astype("<f4"), target=34962),
            "NORMAL": _add(tree, blob, normal.astype("<f4"), target=34962),
        }
        kind = "<u2" if len(points) < 65535 else "<u4"
        indices = _add(tree, blob, faces.astype(kind).ravel(), target=34963)
        primitive = {"attributes": attributes, "indices": indices, "material": i, "mode": 4}
        tree["meshes"].append({"name": name, "primitives": [primitive]})
    tree["buffers"] = [{"byteLength": len(blob)}]
    text = json.dumps(tree, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(blob), 0x004E4942) + bytes(blob)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _material(name, colour):
    look = {"baseColorFactor": list(colour), "metallicFactor": 0.0, "roughnessFactor": 0.6}
    blend = {"alphaMode": "BLEND"} if colour[3] < 1 else {}
    return {"name": name, "pbrMetallicRoughness": look, "doubleSided": True, **blend}


def _add(tree, blob, array, *, target):
    """Append an array to the blob; the index of its accessor."""
    kind = {"<f4": 5126, "<u2": 5123, "<u4": 5125}[array.dtype.str]
    accessor = {"bufferView": len(tree["bufferViews"]), "componentType": kind, "count": len(array)}
    accessor["type"] = "VEC3" if array.ndim == 2 else "SCALAR"
    accessor["min"] = array.min(axis=0).reshape(-1).tolist()
    accessor["max"] = array.max(axis=0).reshape(-1).tolist()
    tree["accessors"].append(accessor)
    view = {"buffer": 0, "byteOffset": len(blob), "byteLength": array.nbytes, "target": target}
    tree["bufferViews"].append(view)
    blob += array.tobytes() + b"\0" * (-array.nbytes % 4)
    return len(tree["accessors"]) - 1
