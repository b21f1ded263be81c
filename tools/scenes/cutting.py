"""Cutting: a mesh and a number per point in, the mesh on either side of zero out."""

import numpy as np
from modelling import Mesh, grid


def rounded_and(*fields_m, radius_m=0.0):
    """Signed distance (negative inside) to the overlap of half planes, corners rounded to `radius_m`."""
    total = fields_m[0]
    for other in fields_m[1:]:
        a, b = total + radius_m, other + radius_m
        outside = np.sqrt(np.maximum(a, 0.0) ** 2 + np.maximum(b, 0.0) ** 2)
        total = outside + np.minimum(np.maximum(a, b), 0.0) - radius_m
    return total


def band(value, low, high):
    """Signed distance to an interval, negative inside."""
    return np.maximum(low - value, value - high)


def split(mesh, field, *, snap=0.12):
    """(inside, outside): the mesh where `field` (n,) is negative and where it is positive.

    Triangles that the zero line crosses are cut there. A corner nearer to the line than `snap` of an
    edge is put on it first, so that no slivers are born.
    """
    field = np.array(field, float)
    ends = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    crossing = ends[field[ends[:, 0]] * field[ends[:, 1]] < 0]
    span = np.abs(field[crossing[:, 0]] - field[crossing[:, 1]])
    points_m, snapped = mesh.points_m.copy(), field.copy()
    for here, there in ((0, 1), (1, 0)):
        a, b = crossing[:, here], crossing[:, there]
        near = np.abs(field[a]) < snap * span
        share = (field[a] / (field[a] - field[b]))[near, None]
        points_m[a[near]] = mesh.points_m[a[near]] + share * (mesh.points_m[b] - mesh.points_m[a])[near]
        snapped[a[near]] = 0.0
    field = snapped
    points_m, field, faces = _divided(points_m, field, mesh.faces)
    side = np.sign(field)[faces].sum(axis=1)
    whole = Mesh(points_m, faces)
    return whole.kept(side < 0), whole.kept(side >= 0)


def _divided(points_m, field, faces):
    """Points, field and faces after every edge that crosses zero has a point there."""
    edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2), axis=2)
    cut = field[edges[..., 0]] * field[edges[..., 1]] < 0
    pairs, index = np.unique(edges[cut], axis=0, return_inverse=True)
    a, b = pairs[:, 0], pairs[:, 1]
    share = (field[a] / (field[a] - field[b]))[:, None]
    middle = np.full(faces.shape, -1)
    middle[cut] = len(points_m) + index.ravel()
    points_m = np.concatenate([points_m, points_m[a] + share * (points_m[b] - points_m[a])])
    field = np.concatenate([field, np.zeros(len(pairs))])
    pieces = [faces[~cut.any(axis=1)]]
    for turn in range(3):
        f, m, c = np.roll(faces, -turn, 1), np.roll(middle, -turn, 1), np.roll(cut, -turn, 1)
        two = c[:, 0] & c[:, 2] & ~c[:, 1]
        f2, m2 = f[two], m[two]
        pieces += [
            np.stack([f2[:, 0], m2[:, 0], m2[:, 2]], 1),
            np.stack([m2[:, 0], f2[:, 1], m2[:, 2]], 1),
            np.stack([f2[:, 1], f2[:, 2], m2[:, 2]], 1),
        ]
        one = c[:, 0] & ~c[:, 1] & ~c[:, 2]
        f1, m1 = f[one], m[one]
        pieces += [np.stack([f1[:, 0], m1[:, 0], f1[:, 2]], 1), np.stack([m1[:, 0], f1[:, 1], f1[:, 2]], 1)]
    return points_m, field, np.concatenate(pieces)


def border(mesh):
    """(k, 2) directed edges that belong to one face only, with the face on their left."""
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    _, index, count = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    return edges[np.sort(index[count == 1])]


def skirt(mesh, *, chosen, target_m):
    """Strips from the border edges in `chosen` (k,) bool to `target_m` (n, 3), looking as the mesh does."""
    edges = border(mesh)[chosen]
    strips = [grid([target_m[[a, b]], mesh.points_m[[a, b]]]) for a, b in edges]
    points = np.concatenate([strip.points_m for strip in strips])
    faces = np.concatenate([strip.faces + 4 * i for i, strip in enumerate(strips)])
    return Mesh(points, faces)


def normals(mesh):
    """(n, 3) unit point normals, weighted by area."""
    corners = mesh.points_m[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(mesh.points_m)
    for corner in range(3):
        np.add.at(total, mesh.faces[:, corner], normal)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)


def offset(mesh, distance_m):
    """The mesh moved along its point normals; `distance_m` (n,) or one number."""
    step = np.broadcast_to(np.asarray(distance_m, float), (len(mesh.points_m),))
    return Mesh(mesh.points_m + step[:, None] * normals(mesh), mesh.faces)
