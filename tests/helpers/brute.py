"""Vector optics the slow way: float64, one ray at a time, from the words of the docstrings."""

import math
from collections.abc import Iterable

import numpy as np

from lidarscene.maths.arrays import Numbers

X, Y, Z = np.eye(3)
SIDES = {"left": Y, "right": -Y, "above": Z, "below": -Z}


def about(axis: Numbers, angle: float) -> Numbers:
    """Rotation matrix, by Rodrigues."""
    x, y, z = axis / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turned: Numbers = np.eye(3) + math.sin(angle) * k + (1 - math.cos(angle)) * (k @ k)
    return turned


def mirrored(ray: Numbers, normal: Numbers) -> Numbers:
    """Mirror by splitting the ray in parts along and across the normal."""
    along: Numbers = (ray @ normal) / (normal @ normal) * normal
    return (ray - along) - along


def gimbal(
    incidence: float, side: str, outer: str, azimuth_turn: float, elevation_turn: float
) -> tuple[Numbers, float]:
    """The mirror as a body: its normal and its inner axis are turned together by the outer axis."""
    s = SIDES[side]
    normal = math.cos(incidence) * X + math.sin(incidence) * s
    incoming = mirrored(X, normal)  # the beam that leaves along x at rest
    in_plane = np.cross(X, s)  # turns x towards the side
    in_mirror = np.cross(normal, np.cross(X, s))  # in the plane of incidence and in the mirror
    # Each axis gets the sign that moves the beam left or up.
    upright = side in ("above", "below")
    moves = {True: Z, False: Y}
    axes = {}
    for name, axis in (
        ("elevation" if upright else "azimuth", in_plane),
        ("azimuth" if upright else "elevation", in_mirror),
    ):
        moved = mirrored(incoming, about(axis, 1e-3) @ normal)
        axes[name] = axis * np.sign(moved @ moves[name == "elevation"])
    inner = "azimuth" if outer == "elevation" else "elevation"
    angle = {"azimuth": azimuth_turn, "elevation": elevation_turn}
    turned = about(axes[outer], angle[outer]) @ about(axes[inner], angle[inner]) @ normal
    out = mirrored(incoming, turned)
    return out, float(-(incoming @ turned) / -(incoming @ normal))


def pair(last: str, azimuth_turn: float, elevation_turn: float) -> tuple[Numbers, float]:
    """Two mirrors at 45 degrees; the beam meets one, then the other."""
    first_axis, last_axis = (X, -Y) if last == "elevation" else (-X, Z)
    moved, side = (Y, Z) if last == "elevation" else (Z, Y)
    first, second = (azimuth_turn, elevation_turn) if last == "elevation" else (elevation_turn, azimuth_turn)
    first_normal = about(first_axis, first) @ (-(moved + side) / math.sqrt(2))
    second_normal = about(last_axis, second) @ ((X + side) / math.sqrt(2))
    between = mirrored(moved, first_normal)
    share = float((-(moved @ first_normal)) * (-(between @ second_normal)) * 2.0)
    return mirrored(between, second_normal), share


def snell(ray: Numbers, normal: Numbers, n_before: float, n_after: float) -> tuple[Numbers, float]:
    """Refract by the angles themselves; returns the ray and the growth of the beam's cross-section."""
    normal = normal if ray @ normal > 0 else -normal
    tangent = ray - (ray @ normal) * normal
    sine = float(np.linalg.norm(tangent))
    if sine < 1e-14:
        return ray, 1.0
    t_in, t_out = math.asin(sine), math.asin(n_before / n_after * sine)
    return math.cos(t_out) * normal + math.sin(t_out) * tangent / sine, math.cos(t_out) / math.cos(t_in)


def wedge(ray: Numbers, angle: float, index: float, phase: float, tilted: str) -> tuple[Numbers, float]:
    """A prism as two planes; the thick side is where they are farthest apart."""
    thick = math.cos(phase) * Y + math.sin(phase) * Z
    # Plane x = +-tan(angle) (thick . r): its normal.
    slope = math.tan(angle) * (1 if tilted == "out" else -1)
    inclined = (X - slope * thick) / np.linalg.norm(X - slope * thick)
    faces = (X, inclined) if tilted == "out" else (inclined, X)
    inside, grown = snell(ray, faces[0], 1.0, index)
    outside, growth = snell(inside, faces[1], index, 1.0)
    return outside, grown * growth


def prisms(
    angles: Iterable[float], indices: Iterable[float], phases: Iterable[float], tilted: Iterable[str]
) -> tuple[Numbers, float]:
    ray, share = X, 1.0
    for a, n, p, t in zip(angles, indices, phases, tilted, strict=True):
        ray, grown = wedge(ray, a, n, p, t)
        share *= grown
    return ray, share


def facet(incidence: float, side: str, turn: float, tilt: float) -> Numbers:
    """Direction off a facet: a polygon that is turned from where it sends the beam along x."""
    facet_normal = math.cos(incidence) * X + math.sin(incidence) * SIDES[side]
    incoming = mirrored(X, facet_normal)
    level = about(Z, turn) @ facet_normal
    return mirrored(incoming, math.cos(tilt) * level + math.sin(tilt) * Z)


def facet_share(
    incidence: float, side: str, turn: float, facets: int, inradius: float, lens: float, rays: int = 400
) -> float:
    """Part of a grid of parallel rays through the lens that meets the facet in the plane of the polygon."""
    facet_normal = math.cos(incidence) * X + math.sin(incidence) * SIDES[side]
    incoming = mirrored(X, facet_normal)
    aside = np.cross(Z, incoming)
    level = about(Z, turn) @ facet_normal
    along = np.cross(Z, level)
    grid = (np.arange(rays) + 0.5) / rays * 2 - 1
    u, v = np.meshgrid(grid, grid)
    inside = u**2 + v**2 <= 1
    start = inradius * facet_normal + lens * u[inside][:, None] * aside  # level part of the ray's place
    distance = (inradius - start @ level) / (incoming @ level)
    hit = start + distance[:, None] * incoming
    return float(np.mean(np.abs(hit @ along) <= inradius * math.tan(math.pi / facets)))
