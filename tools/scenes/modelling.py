"""Modelling: numbers in, triangle meshes out. Grids, lathes, tubes, boxes and moves; all in metres, z up."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Mesh:
    """Triangles over points.

    Attributes:
        points_m: (n, 3) float64
        faces: (m, 3) int64, counter-clockwise seen from outside
    """

    points_m: np.ndarray
    faces: np.ndarray

    def moved(self, *, position_m=(0.0, 0.0, 0.0), yaw_rad=0.0, scale=(1.0, 1.0, 1.0)):
        """The mesh scaled, turned about z, then shifted."""
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        faces = self.faces[:, ::-1] if np.prod(scale) < 0 else self.faces
        return Mesh((self.points_m * np.asarray(scale)) @ turn.T + np.asarray(position_m), faces)

    def turned(self, axes):
        """The mesh with local x, y, z laid along the rows of `axes`, a (3, 3) right-handed frame."""
        return Mesh(self.points_m @ np.asarray(axes, dtype=float), self.faces)

    def mirrored(self):
        """The mesh on the other side of the xz plane, still facing outwards."""
        return self.moved(scale=(1.0, -1.0, 1.0))

    def both_sides(self):
        """The mesh and its mirror image."""
        return join(self, self.mirrored())

    def flipped(self):
        """The same surface seen from the other side."""
        return Mesh(self.points_m, self.faces[:, ::-1])

    def kept(self, mask):
        """Only the faces in `mask`, (m,) bool."""
        used, faces = np.unique(self.faces[mask], return_inverse=True)
        return Mesh(self.points_m[used], faces.reshape(-1, 3))


def join(*meshes):
    """Several meshes as one."""
    starts = np.cumsum([0] + [len(mesh.points_m) for mesh in meshes[:-1]])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]
    return Mesh(np.concatenate([mesh.points_m for mesh in meshes]), np.concatenate(faces))


def curve(at, knots, values):
    """Smooth monotone-safe interpolation (Fritsch-Carlson cubic), flat beyond the ends."""
    x, y, t = np.asarray(knots, float), np.asarray(values, float), np.asarray(at, float)
    step, slope = np.diff(x), np.diff(y) / np.diff(x)
    same = slope[:-1] * slope[1:] > 0
    mean = np.where(same, slope[:-1] + slope[1:], 1.0)
    tangent = np.concatenate([slope[:1], np.where(same, 2 * slope[:-1] * slope[1:] / mean, 0.0), slope[-1:]])
    t = np.clip(t, x[0], x[-1])
    i = np.clip(np.searchsorted(x, t, side="right") - 1, 0, len(x) - 2)
    u = (t - x[i]) / step[i]
    rise = (3 * u**2 - 2 * u**3) * (y[i + 1] - y[i])
    return y[i] + rise + step[i] * (u * (1 - u) ** 2 * tangent[i] - u**2 * (1 - u) * tangent[i + 1])


def grid(points_m, *, closed=False):
    """Surface through a (rows, columns, 3) lattice; `closed` joins the last column to the first.

    Faces look along (next column) x (next row). Each cell is cut along its shorter diagonal.
    """
    points_m = np.asarray(points_m, float)
    rows, columns = points_m.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    if closed:
        index = np.concatenate([index, index[:, :1]], axis=1)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    flat = points_m.reshape(-1, 3)
    shorter = np.sum((flat[b] - flat[d]) ** 2, axis=1) < np.sum((flat[a] - flat[c]) ** 2, axis=1) - 1e-7
    one = np.where(shorter[:, None], np.stack([a, b, d], 1), np.stack([a, b, c], 1))
    two = np.where(shorter[:, None], np.stack([b, c, d], 1), np.stack([a, c, d], 1))
    return Mesh(flat, np.concatenate([one, two]))


def cap(ring_m, *, centre_m=None):
    """A fan that closes a (n, 3) ring; it looks along the ring's right-hand direction."""
    ring_m = np.asarray(ring_m, float)
    centre = ring_m.mean(axis=0) if centre_m is None else np.asarray(centre_m, float)
    here = np.arange(len(ring_m))
    faces = np.stack([here, np.roll(here, -1), np.full_like(here, len(ring_m))], axis=1)
    return Mesh(np.vstack([ring_m, centre]), faces)


def closed_loft(rings_m):
    """A solid through (rows, columns, 3) closed rings, capped at both ends."""
    rings_m = np.asarray(rings_m, float)
    return join(grid(rings_m, closed=True), cap(rings_m[-1]), cap(rings_m[0]).flipped())


def circle(count, *, radius_m=1.0):
    """(count, 2) points, counter-clockwise."""
    angle = 2 * np.pi * np.arange(count) / count
    return radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def lathe(profile_m, *, segments):
    """Turn (n, 2) points (radius, z) about z; the outside is on the right of the profile's way up."""
    profile_m, around = np.asarray(profile_m, float), circle(segments)
    rings = np.zeros((len(profile_m), segments, 3))
    rings[:, :, :2] = profile_m[:, None, :1] * around
    rings[:, :, 2] = profile_m[:, 1:]
    return grid(rings, closed=True)


def frames(path_m):
    """Two (n, 3) unit vectors across a (n, 3) path, carried along with little twist."""
    path_m = np.asarray(path_m, float)
    along = np.gradient(path_m, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    first = np.zeros_like(along)
    last = np.eye(3)[np.argmin(np.abs(along[0]))]
    for i, direction in enumerate(along):
        last = last - direction * (last @ direction)
        last = last / np.linalg.norm(last)
        first[i] = last
    return first, np.cross(along, first)


def tube(path_m, radius_m, *, segments, flatten=1.0):
    """A capped limb along a (n, 3) path; `radius_m` (n,) or one number, `flatten` scales the second axis."""
    path_m = np.asarray(path_m, float)
    radius_m = np.broadcast_to(np.asarray(radius_m, float), (len(path_m),))
    across, beside = frames(path_m)
    around = circle(segments)
    ring = around[:, :1] * across[:, None, :] + flatten * around[:, 1:] * beside[:, None, :]
    return closed_loft(path_m[:, None, :] + radius_m[:, None, None] * ring)


def ellipsoid(*, radii_m, segments=16, rows=9, power=2.0):
    """A ball with three radii about the origin; a `power` above 2 makes it boxier."""
    tilt = np.pi * (np.arange(1, rows) / rows - 0.5)
    rings = np.zeros((rows - 1, segments, 3))
    rings[:, :, :2] = np.cos(tilt)[:, None, None] * circle(segments)
    rings[:, :, 2] = np.sin(tilt)[:, None]
    poles = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    size = np.sum(np.abs(rings) ** power, axis=2, keepdims=True) ** (1 / power)
    rings = rings / size * np.asarray(radii_m)
    low, high = poles * np.asarray(radii_m)
    return join(grid(rings, closed=True), cap(rings[-1], centre_m=high), cap(rings[0], centre_m=low).flipped())


def box(*, size_m, centre_m=(0.0, 0.0, 0.0)):
    """A closed box of 12 triangles."""
    x, y, z = 0.5 * np.asarray(size_m, float)
    ring = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    lattice = np.zeros((2, 4, 3))
    lattice[:, :, :2] = ring
    lattice[:, :, 2] = [[-z], [z]]
    faces = np.concatenate([grid(lattice, closed=True).faces, [[4, 5, 6], [4, 6, 7], [2, 1, 0], [3, 2, 0]]])
    return Mesh(lattice.reshape(-1, 3) + np.asarray(centre_m, float), faces)


def rounded_box(*, size_m, centre_m=(0.0, 0.0, 0.0), radius_m, corner=3):
    """A closed box with round vertical and horizontal edges; `corner` segments per quarter."""
    half = 0.5 * np.asarray(size_m, float)
    turn = 0.5 * np.pi * np.arange(corner + 1) / corner
    inset = np.concatenate([radius_m * (1 - np.sin(turn)), radius_m * (1 - np.cos(turn))])
    height = np.concatenate([-half[2] + radius_m * (1 - np.cos(turn)), half[2] - radius_m * (1 - np.sin(turn))])
    angle = (np.pi / 2 * np.arange(4)[:, None] + turn).ravel()
    sign = np.repeat([[1, 1], [-1, 1], [-1, -1], [1, -1]], corner + 1, axis=0)
    reach = np.maximum(radius_m - inset[:, None, None], 0.0) * np.stack([np.cos(angle), np.sin(angle)], 1)
    rings = np.zeros((len(inset), len(angle), 3))
    rings[:, :, :2] = sign * (half[:2] - radius_m) + reach
    rings[:, :, 2] = height[:, None]
    solid = closed_loft(rings)
    return Mesh(solid.points_m + np.asarray(centre_m, float), solid.faces)
