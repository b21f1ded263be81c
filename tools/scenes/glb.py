"""GLB: parts in, the bytes of a binary glTF 2.0 file out, the same bytes on every run.

Coordinates are written as modelled: z up, x forward, metres. A node above all parts turns them y up, as glTF asks for.
Each part is one mesh, one node and one material, all of the part's name; "mirrors/paint" is mesh and node "mirrors" of
a material "paint". Positions lie on a lattice of 2^-13 m
(0.12 mm), so that a sine that differs in its last bit on another machine does not change the file. Turns of joints and
shares of skins are whole numbers for the same reason.
"""

import json
import struct
from dataclasses import dataclass, field

import numpy as np
from modelling import Mesh

LATTICE_M = 2.0**-13
Y_UP = [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1]  # column by column: (x, y, z) becomes (x, z, -y)


@dataclass(frozen=True, slots=True)
class Skinned:
    """A mesh whose points are carried by joints: (v, j) shares."""

    mesh: Mesh
    shares: np.ndarray


@dataclass(frozen=True, slots=True)
class Clip:
    """An animation over one stride, at even times.

    Attributes:
        period_s: of the stride
        turns: joint -> (n, 3) turns (about x, -y and z, in this order, radians)
        shifts_m: joint -> (n, 3) shifts
    """

    period_s: float
    turns: dict
    shifts_m: dict = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Skeleton:
    """Joints and their animations.

    Attributes:
        places_m: name -> (3,) in the mesh
        parents: name -> name of the joint above, "" for one on the ground
        clips: name -> Clip; at rest is the start of the first
    """

    places_m: dict
    parents: dict
    clips: dict


def welded(mesh):
    """(points, faces) of a part: points on the lattice, each once; faces once, and none without area."""
    mesh = mesh.mesh if isinstance(mesh, Skinned) else mesh
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


def glb_bytes(parts, colours, skeleton=None):
    """`parts` name -> Mesh and `colours` name -> (r, g, b, alpha), as one GLB file.

    With a `Skeleton` parts may be `Skinned`. At rest the file shows the start of the stride.
    """
    tree = {
        "asset": {"version": "2.0", "generator": "lidarscene tools/scenes/make_assets.py"},
        "scene": 0,
        "scenes": [{"nodes": [len(parts)]}],
        "nodes": [
            *({"name": _shown(name), "mesh": i} for i, name in enumerate(parts)),
            {"name": "y_up", "matrix": Y_UP, "children": list(range(len(parts)))},
        ],
        "meshes": [],
        "materials": [_material(name, colours[name]) for name in parts],
        "accessors": [],
        "bufferViews": [],
    }
    blob = bytearray()
    for i, (name, part) in enumerate(parts.items()):
        points, faces = welded(part)
        attributes = {"POSITION": _add(tree, blob, points.astype("<f4"), target=34962)}
        if isinstance(part, Skinned):
            joints, shares = _skin_of(part, points)
            attributes["JOINTS_0"] = _add(tree, blob, joints, target=34962)
            attributes["WEIGHTS_0"] = _add(tree, blob, shares, target=34962, normalized=True)
        kind = "<u2" if len(points) < 65535 else "<u4"
        indices = _add(tree, blob, faces.astype(kind).ravel(), target=34963)
        primitive = {"attributes": attributes, "indices": indices, "material": i, "mode": 4}
        tree["meshes"].append({"name": _shown(name), "primitives": [primitive]})
    if skeleton is not None:
        _add_skeleton(tree, blob, skeleton, [isinstance(part, Skinned) for part in parts.values()])
    tree["buffers"] = [{"byteLength": len(blob)}]
    text = json.dumps(tree, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(blob), 0x004E4942) + bytes(blob)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _shown(name):
    """Name of a part without that of its material."""
    return name.partition("/")[0]


def _material(name, colour):
    look = {"baseColorFactor": list(colour), "metallicFactor": 0.0, "roughnessFactor": 0.6}
    blend = {"alphaMode": "BLEND"} if colour[3] < 1 else {}
    return {"name": name.rpartition("/")[2], "pbrMetallicRoughness": look, "doubleSided": True, **blend}


def _skin_of(part, points_m):
    """(joints, shares) of points: the four joints that carry each most, and 255ths of its weight."""
    rows = {tuple(row): i for i, row in enumerate(np.rint(part.mesh.points_m / LATTICE_M).astype(int).tolist())}
    found = [rows[tuple(row)] for row in np.rint(points_m / LATTICE_M).astype(int).tolist()]
    shares = np.rint(part.shares[found] * 255).astype(int)
    shares = np.pad(shares, ((0, 0), (0, max(4 - shares.shape[1], 0))))
    joints = np.argsort(-shares, axis=1, kind="stable")[:, :4]
    shares = np.take_along_axis(shares, joints, axis=1)
    shares[:, 0] += 255 - shares.sum(axis=1)
    return np.where(shares > 0, joints, 0).astype("<u1"), shares.astype("<u1")


def _add_skeleton(tree, blob, skeleton, skinned):
    """Append joints, skin and animations; the joints' nodes are behind the parts' and the one above them."""
    first, names = len(skinned), list(skeleton.places_m)
    number = {name: first + 1 + i for i, name in enumerate(names)}
    rest = next(iter(skeleton.clips.values()))
    bound = np.tile(np.eye(4), (len(names), 1, 1))
    for i, name in enumerate(names):
        above, place = skeleton.parents[name], _on_lattice(skeleton.places_m[name])
        shift = place - (_on_lattice(skeleton.places_m[above]) if above else 0.0)
        if name in rest.shifts_m:
            shift = _on_lattice(shift + rest.shifts_m[name][0])
        turn = _quaternions(rest.turns[name][:1])[0] / 32767 if name in rest.turns else np.array([0, 0, 0, 1])
        below = [number[other] for other in names if skeleton.parents[other] == name]
        node = {"name": name, "translation": shift.tolist(), "rotation": turn.tolist()}
        tree["nodes"].append(node | ({"children": below} if below else {}))
        bound[i, :3, 3] = -place
    roots = [number[name] for name in names if not skeleton.parents[name]]
    tree["nodes"][first]["children"] = [*tree["nodes"][first]["children"], *roots]
    inverse = _add(tree, blob, bound.transpose(0, 2, 1).reshape(-1, 16).astype("<f4"))
    skin = {"joints": list(number.values()), "inverseBindMatrices": inverse}
    tree["skins"] = [skin | ({"skeleton": roots[0]} if len(roots) == 1 else {})]
    for node, is_skinned in zip(tree["nodes"], skinned, strict=False):
        if is_skinned:
            node["skin"] = 0
    tree["animations"] = []
    for kind, clip in skeleton.clips.items():
        count = max(len(values) for values in clip.turns.values())
        clock = np.linspace(0.0, clip.period_s, count) if count > 1 else np.zeros(1)
        clock = _add(tree, blob, clock.astype("<f4"))
        outputs = {(number[name], "rotation"): _quaternions(turn) for name, turn in clip.turns.items()}
        for name, shifts_m in clip.shifts_m.items():
            below_m = skeleton.places_m[name] - skeleton.places_m[skeleton.parents[name]]
            outputs[number[name], "translation"] = _on_lattice(below_m + shifts_m).astype("<f4")
        animation = {"name": kind, "samplers": [], "channels": []}
        for (node, path), values in outputs.items():
            normalized = path == "rotation"
            sampler = {"input": clock, "output": _add(tree, blob, values, normalized=normalized)}
            animation["channels"].append(
                {"sampler": len(animation["samplers"]), "target": {"node": node, "path": path}}
            )
            animation["samplers"].append(sampler)
        tree["animations"].append(animation)


def _on_lattice(place_m):
    return np.rint(np.asarray(place_m) / LATTICE_M) * LATTICE_M


def _quaternions(turns):
    """(n, 4) of whole numbers, 32767 being 1: turns about x, -y and z, the last one first."""
    whole = np.tile([0.0, 0.0, 0.0, 1.0], (len(turns), 1))
    for axis, sign in ((0, 1), (1, -1), (2, 1)):
        half = 0.5 * sign * turns[:, axis]
        step = np.zeros((len(turns), 4))
        step[:, axis], step[:, 3] = np.sin(half), np.cos(half)
        whole = _product(whole, step)
    return np.rint(32767 * whole).astype("<i2")


def _product(a, b):
    """Product of (n, 4) quaternions (x, y, z, w)."""
    (ax, ay, az, aw), (bx, by, bz, bw) = a.T, b.T
    return np.stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ],
        axis=1,
    )


def _add(tree, blob, array, *, target=None, normalized=False):
    """Append an array to the blob; the index of its accessor."""
    kind = {"<f4": 5126, "<u2": 5123, "<u4": 5125, "|u1": 5121, "<i2": 5122}[array.dtype.str]
    accessor = {"bufferView": len(tree["bufferViews"]), "componentType": kind, "count": len(array)}
    accessor["type"] = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}[array[0].size]
    if normalized:
        accessor["normalized"] = True
    else:
        accessor["min"] = array.min(axis=0).reshape(-1).tolist()
        accessor["max"] = array.max(axis=0).reshape(-1).tolist()
    tree["accessors"].append(accessor)
    view = {"buffer": 0, "byteOffset": len(blob), "byteLength": array.nbytes}
    if target is not None:
        view["target"] = target
    tree["bufferViews"].append(view)
    blob += array.tobytes() + b"\0" * (-array.nbytes % 4)
    return len(tree["accessors"]) - 1
