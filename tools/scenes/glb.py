"""GLB: parts in, the bytes of a binary glTF 2.0 file out, the same bytes on every run.

Coordinates are written as modelled: z up, x forward, metres. A node above all parts turns them y up, as glTF asks for.
Each part is one mesh, one node and one material, all of the part's name. Positions lie on a lattice of 2^-13 m
(0.12 mm), so that a sine that differs in its last bit on another machine does not change the file.
"""

import json
import struct

import numpy as np

LATTICE_M = 2.0**-13
Y_UP = [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1]  # column by column: (x, y, z) becomes (x, z, -y)


def welded(mesh):
    """(points, faces): points on the lattice, each once; faces once, and none without area."""
    steps = np.rint(mesh.points_m / LATTICE_M).astype(np.int64)
    steps, index = np.unique(steps, axis=0, return_inverse=True)
    faces = index.ravel()[mesh.faces]
    corners = steps[faces]
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # A needle of some lattice steps would be one rounding error away from no area at all.
    longest = np.max(np.sum((corners - np.roll(corners, 1, axis=1)) ** 2, axis=2), axis=1)
    faces = faces[np.sqrt(np.sum(doubled.astype(float) ** 2, axis=1)) > np.maximum(3.0, 2e-3 * longest)]
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return steps * LATTICE_M, faces[np.sort(first)]


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
        points, faces = welded(mesh)
        attributes = {"POSITION": _add(tree, blob, points.astype("<f4"), target=34962)}
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
