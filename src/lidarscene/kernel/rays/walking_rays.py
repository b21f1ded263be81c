"""Rays that meet walkers: bodies whose vertices are elsewhere for each pulse (`world.walkers`).

A ray in the frame of a walker goes through the tree of boxes that holds the walker at its place of the stride, and is
intersected with the triangles as they are then. It is watertight: both triangles at an edge compute the same number of
it (Pluecker coordinates, as in Embree's robust mode: I. Wald et al., ACM Trans. Graph. 33 (2014), 143).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...maths.arrays import Array, Lanes, Mask
from ...maths.motion_table import Placement, StridePlace
from ..device.backend import mitsuba
from ..device.types import DeviceVector, Hit, Ray
from ..world.walkers import LEVELS, PHASES, TRIANGLES, Walkers
from .nearby_bodies import BoxWalk, Slabs

_ROUNDING = 1e-6
"""Accuracy bought: share of the area by which a ray may miss an edge, some roundings of single precision."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WalkerShapes:
    """Shapes of walkers at the moments of n rays.

    Attributes:
        walkers: tables of all of them
        kind: eight numbers of each ray's walker, `Walkers.kind`
        before: row in the stride of the instant before; that after it follows
        share: of the way from the one to the other
        phase: share of the stride that has passed
        place: in the stride
    """

    walkers: Walkers
    kind: Any
    before: Any
    share: Any
    phase: Any
    place: StridePlace

    @classmethod
    def at(cls, walkers: Walkers, mover_index: Array, placement: Placement, active: Mask) -> WalkerShapes:
        """Return the shape of each active ray's mover as its placement says."""
        import drjit as dr

        mi = mitsuba()
        assert placement.stride is not None  # a table of motions has it
        number = 2 * mi.UInt32(mover_index)
        kind = [*dr.gather(mi.Vector4u, walkers.kind, number, active)]
        kind += [*dr.gather(mi.Vector4u, walkers.kind, number + 1, active)]
        row, vertices, _, instants = kind[:4]
        phase = mi.Float(placement.stride.phase)
        phase -= dr.floor(phase)
        place = phase * mi.Float(instants)
        before = dr.minimum(mi.UInt32(place), dr.maximum(instants, 1) - 1)
        return cls(
            walkers=walkers,
            kind=kind,
            before=row + before * vertices,
            share=place - mi.Float(before),
            phase=phase,
            place=placement.stride,
        )

    @property
    def walks(self) -> Any:
        """Whether each ray's mover walks."""
        return self.kind[7] > 0

    def nearest(self, ray: Ray, length_m: Lanes, active: Mask) -> tuple[Any, Any, Any, Any]:
        """Return the nearest triangle of each active ray within ``length_m``.

        Args:
            ray: in the frame of the walker

        Returns:
            distance, infinite without a hit; the two barycentric coordinates; number of the triangle
        """
        import drjit as dr

        mi = mitsuba()
        walk = BoxWalk(tree=self.walkers.tree(self._root), slabs=Slabs.of_ray(ray))
        first_leaf = self.kind[6]

        def step(node: Array, reach: Array, t: Array, u: Array, v: Array, triangle: Array) -> tuple[Any, ...]:
            node, leaf = walk.next_box(node, reach)
            found = leaf >= 0
            first = TRIANGLES * (first_leaf + mi.UInt32(dr.select(found, leaf, 0)))
            for number in range(TRIANGLES):
                candidate = first + number
                hit_t, hit_u, hit_v = _intersection(ray, self._corners(candidate, found))
                nearer = found & (hit_t < reach)
                t, u, v = dr.select(nearer, hit_t, t), dr.select(nearer, hit_u, u), dr.select(nearer, hit_v, v)
                triangle, reach = dr.select(nearer, candidate, triangle), dr.select(nearer, hit_t, reach)
            return node, reach, t, u, v, triangle

        start = dr.select(active & self.walks, self._root + 1, 0)
        zero = mi.Float(0.0)
        state = start, mi.Float(length_m), mi.Float(dr.inf), zero, zero, mi.UInt32(0)
        _, _, t, u, v, triangle = dr.while_loop(state, lambda node, *_: node != 0, step, mode="symbolic")
        return t, u, v, triangle

    def surface(self, face: Array, uv: DeviceVector, active: Mask) -> tuple[Any, Any]:
        """Return the unit normal of a face of each active ray's mover, and the velocity of a point on it.

        Args:
            face: of the world
            uv: barycentric coordinates of the point

        Returns:
            both in the frame of the mover; the velocity without that of the frame. Zero for a face that has no stride
        """
        import drjit as dr

        mi = mitsuba()
        number = dr.gather(mi.UInt32, self.walkers.triangle_of_face, face, active & self.walks)
        walks = number > 0
        triangle = dr.select(walks, number - 1, 0)
        a, b, c = self._corners(triangle, walks)
        moved = [self._velocity(vertex, walks) for vertex in self._vertices(triangle, walks)]
        velocity = moved[0] + uv.x * (moved[1] - moved[0]) + uv.y * (moved[2] - moved[0])
        normal = dr.normalize(dr.cross(b - a, c - a))
        return dr.select(walks, normal, 0.0), dr.select(walks, velocity, 0.0)

    @property
    def _root(self) -> Any:
        """Node of the tree around each ray's walker."""
        import drjit as dr

        mi = mitsuba()
        phase = dr.minimum(mi.UInt32(self.phase * PHASES), PHASES - 1)
        level, levels = mi.UInt32(0), self.kind[7]
        for bound in LEVELS[1:-1]:
            level += dr.select(self.place.level < bound, mi.UInt32(1), 0)
        level = dr.minimum(level, dr.maximum(levels, 1) - 1)
        return self.kind[4] + self.kind[5] * (phase * levels + level)

    def _vertices(self, triangle: Array, active: Mask) -> list[Any]:
        """Numbers of the corners of triangles within their kind."""
        import drjit as dr

        return list(dr.gather(mitsuba().Vector4u, self.walkers.corners, triangle, active)[:3])

    def _corners(self, triangle: Array, active: Mask) -> list[Any]:
        """Places of the corners of triangles."""
        return [self._vertex(vertex, active) for vertex in self._vertices(triangle, active)]

    def _vertex(self, vertex: Array, active: Mask) -> Any:
        """Place of a vertex."""
        stands, before, after = self._rows(vertex, active)
        return stands + self.place.level * (before + self.share * (after - before) - stands)

    def _velocity(self, vertex: Array, active: Mask) -> Any:
        """Velocity of a vertex."""
        stands, before, after = self._rows(vertex, active)
        instants_hz = self.place.rate_hz * mitsuba().Float(self.kind[3])
        stepping = self.place.level * instants_hz * (after - before)
        return stepping + self.place.level_rate_hz * (before + self.share * (after - before) - stands)

    def _rows(self, vertex: Array, active: Mask) -> list[Any]:
        """Place of a vertex as it stands, at the instant before and at the one after."""
        import drjit as dr

        mi, tables = mitsuba(), self.walkers
        rows = (
            (tables.standing, self.kind[2] + vertex),
            (tables.stride, self.before + vertex),
            (tables.stride, self.before + self.kind[1] + vertex),
        )
        return [mi.Vector3f(*dr.gather(mi.Vector4f, table, row, active)[:3]) for table, row in rows]


def walker_hit(walkers: Walkers, t: Array, u: Array, v: Array, triangle: Array, active: Mask) -> Hit:
    """Return the hit on a triangle of a walker as Mitsuba has those of its own scenes; a miss is not valid."""
    import drjit as dr

    mi = mitsuba()
    found = active & (t < dr.inf)
    shape, number = dr.gather(mi.Vector2u, walkers.surface, triangle, found)
    hit = dr.zeros(mi.PreliminaryIntersection3f)
    hit.valid, hit.t, hit.prim_uv, hit.prim_index = found, t, mi.Point2f(u, v), number
    hit.shape = dr.reinterpret_array(mi.ShapePtr, shape)
    return hit


def _intersection(ray: Ray, corners: list[DeviceVector]) -> tuple[Any, Any, Any]:
    """Return where rays meet triangles: distance, infinite for none, and two barycentric coordinates."""
    import drjit as dr

    mi = mitsuba()
    a, b, c = (mi.Vector3f(corner - mi.Vector3f(ray.o)) for corner in corners)
    first, second, third = c - a, a - b, b - c
    of_b = dr.dot(dr.cross(first, c + a), ray.d)
    of_c = dr.dot(dr.cross(second, a + b), ray.d)
    of_a = dr.dot(dr.cross(third, b + c), ray.d)
    total = of_a + of_b + of_c
    slack = _ROUNDING * dr.abs(total)
    inside = (dr.minimum(dr.minimum(of_a, of_b), of_c) >= -slack) | (dr.maximum(dr.maximum(of_a, of_b), of_c) <= slack)
    normal = dr.cross(second, first)
    across = dr.dot(normal, ray.d)
    t = dr.dot(a, normal) / across
    meets = inside & (across != 0.0) & (t > 0.0)
    share = dr.rcp(dr.select(total == 0.0, 1.0, total))
    return dr.select(meets, t, dr.inf), of_b * share, of_c * share
