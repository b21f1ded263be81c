"""GLB: parts in, the bytes of a binary glTF 2.0 file out, the same bytes on every run.

Coordinates are written as modelled: z up, x forward, metres. A node above all parts turns them y up, as glTF asks for.
Each part is one mesh, one node and one material, all of the part's name. Positions lie on a lattice of 2^-13 m
(0.12 mm), so that a sine that differs in its last bit on another machine does not change the file. Turns of joints and
shares of skins are whole numbers for the same reason.
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


def glb_bytes(parts, colours, skeleton=None):
    """`parts` name -> Mesh and `colours` name -> (r, g, b, alpha), as one GLB file.

    With a `people.Skeleton` the parts are `people.Skinned`. At rest the file shows the start of the stride.
    """
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
    for i, (name, part) in enumerate(parts.items()):
        points, faces = welded(part if skeleton is None else part.mesh)
        attributes = {"POSITION": _add(tree, blob, points.astype("<f4"), target=34962)}
        if skeleton is not None:
            joints, shares = _skin_of(part, points)
            attributes["JOINTS_0"] = _add(tree, blob, joints, target=34962)
            attributes["WEIGHTS_0"] = _add(tree, blob, shares, target=34962, normalized=True)
        kind = "<u2" if len(points) < 65535 else "<u4"
        indices = _add(tree, blob, faces.astype(kind).ravel(), target=34963)
        primitive = {"attributes": attributes, "indices": indices, "material": i, "mode": 4}
        tree["meshes"].append({"name": name, "primitives": [primitive]})
    if skeleton is not None:
        _add_skeleton(tree, blob, skeleton, len(parts))
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


def _skin_of(part, points_m):
    """(joints, shares) of points: the four joints that carry each most, and 255ths of its weight."""
    rows = {tuple(row): i for i, row in enumerate(np.rint(part.mesh.points_m / LATTICE_M).astype(int).tolist())}
    found = [rows[tuple(row)] for row in np.rint(points_m / LATTICE_M).astype(int).tolist()]
    shares = np.rint(part.shares[found] * 255).astype(int)
    joints = np.argsort(-shares, axis=1, kind="stable")[:, :4]
    shares = np.take_along_axis(shares, joints, axis=1)
    shares[:, 0] += 255 - shares.sum(axis=1)
    return np.where(shares > 0, joints, 0).astype("<u1"), shares.astype("<u1")


def _add_skeleton(tree, blob, skeleton, first):
    """Append joints, skin and animations; the joints' nodes are behind the parts' and the one above them."""
    names = list(skeleton.places_m)
    number = {name: first + 1 + i for i, name in enumerate(names)}
    bound = np.tile(np.eye(4), (len(names), 1, 1))
    for i, name in enumerate(names):
        above = skeleton.parents[name]
        place = _on_lattice(skeleton.places_m[name])
        shift = place - (_on_lattice(skeleton.places_m[above]) if above else 0.0)
        if name == "pelvis":
            shift = _on_lattice(shift + skeleton.walk_m[0])
        turn = _quaternions(skeleton.walk[name][:1])[0] / 32767 if name in skeleton.walk else np.array([0, 0, 0, 1])
        below = [number[other] for other in names if skeleton.parents[other] == name]
        node = {"name": name, "translation": shift.tolist(), "rotation": turn.tolist()}
        tree["nodes"].append(node | ({"children": below} if below else {}))
        bound[i, :3, 3] = -place
    roots = [number[name] for name in names if not skeleton.parents[name]]
    tree["nodes"][first]["children"] = [*tree["nodes"][first]["children"], *roots]
    inverse = _add(tree, blob, bound.transpose(0, 2, 1).reshape(-1, 16).astype("<f4"))
    tree["skins"] = [{"joints": list(number.values()), "inverseBindMatrices": inverse, "skeleton": roots[0]}]
    for node in tree["nodes"][:first]:
        node["skin"] = 0
    tree["animations"] = []
    for kind, turns, shifts_m in (
        ("walk", skeleton.walk, skeleton.walk_m),
        ("stand", skeleton.stand, skeleton.stand_m),
    ):
        count = len(shifts_m)
        clock = np.linspace(0.0, skeleton.period_s, count) if count > 1 else np.zeros(1)
        clock = _add(tree, blob, clock.astype("<f4"))
        outputs = {(number[name], "rotation"): _quaternions(turn) for name, turn in turns.items()}
        place = _on_lattice(skeleton.places_m["pelvis"] - skeleton.places_m["ground"] + shifts_m)
        outputs[number["pelvis"], "translation"] = place.astype("<f4")
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
