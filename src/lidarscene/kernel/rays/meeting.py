"""Meeting: rays in, the surface that each meets out, in a world some of which moves.

Panes, and porous surfaces with them, are asked apart from what ends or mirrors a ray: they are few, so that asking
costs little, and what stands behind them is found at once.

Rays are carried into the frame of each moving body as it stands when they leave; the nearest hit is kept, and the
surface is looked at in the frame of its own body (MITSUBA.md 5.5: hit by hit what a rebuilt scene gives).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ...light.footprint import Aim
from ...maths.paths import Placement
from ...maths.vectors import Vector
from ..device import transfer
from ..device.backend import mitsuba
from ..world.build import Mover, World
from ..world.speculars import Speculars
from .gaps import Draws


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Meeting:
    """What each ray met.

    found    whether it met anything
    t        how far from the ray's start
    surface  Mitsuba's interaction, in the frame of the body that was met
    seen     the ray in that frame
    to_sun   unit vector towards the sun in that frame
    shift    from the numbers of faces that bodies of one shape share to the body's own
    here     whether it was this one, for each of the world's movers
    """

    found: Any
    t: Any
    surface: Any
    seen: Any
    to_sun: Any
    shift: Any
    here: tuple[Any, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Moment:
    """A world as it stands for each ray when its pulse leaves.

    moving    what moves, and where it is then
    sun       unit vector towards the sun
    coherent  whether neighbouring rays are neighbours in angle
    draws     random numbers of the rays, which gaps ask for
    aim       of the beams, of which panes and mirrors may send some back; None: that is not asked
    """

    world: World
    moving: Sequence[tuple[Mover, Placement]]
    sun: Vector
    coherent: bool
    draws: Draws
    aim: Aim | None = None

    @property
    def speculars(self) -> Speculars:
        """Of a world that has any."""
        assert self.world.speculars is not None
        return self.world.speculars

    def meet(self, ray: Any, active: Any = True) -> Meeting:
        """The nearest surface of each active ray of the traced frame that is no pane."""
        return self._nearest(ray, active, self.world.scene, [mover.scene for mover, _ in self.moving])

    def pane(self, ray: Any, before: Any, active: Any) -> Meeting:
        """The nearest pane that these rays of the traced frame meet ``before`` a length."""
        panes = [mover.panes for mover, _ in self.moving]
        return self._nearest(_shorter(ray, before), active, self.world.panes, panes)

    def blocked(self, ray: Any, active: Any) -> Any:
        """Whether these rays of the traced frame meet anything that is no pane."""
        return self._any(ray, active, self.world.scene, [mover.scene for mover, _ in self.moving])

    def glazed(self, ray: Any, active: Any, before: Any = None) -> Any:
        """Whether these rays of the traced frame meet a pane, before a length if one is given."""
        panes = [mover.panes for mover, _ in self.moving]
        return self._any(_shorter(ray, before), active, self.world.panes, panes)

    def _nearest(self, ray: Any, active: Any, still: Any, moving: Sequence[Any]) -> Meeting:
        """Of the surfaces in these Mitsuba scenes, of what stands still and of each mover; None: nothing there."""
        import drjit as dr

        mi = mitsuba()
        self._apart(ray, active)
        if still is None:
            first = dr.zeros(mi.PreliminaryIntersection3f)
            first.t = dr.inf
        else:
            first = still.ray_intersect_preliminary(ray, coherent=self.coherent, active=active)
        seen, to_sun, shift = ray, mi.Vector3f(*self.sun), mi.UInt32(0)
        here: list[Any] = []
        for (mover, place), scene in zip(self.moving, moving, strict=True):
            if scene is None:
                here.append(mi.Bool(False))
                continue
            carried = _carried(mi, ray, place)
            transfer.apart(first)
            near = _near(dr, carried, mover)
            hit = scene.ray_intersect_preliminary(
                carried, coherent=self.coherent, active=near if active is True else near & active
            )
            nearer = hit.is_valid() & (hit.t < first.t)
            first, seen = dr.select(nearer, hit, first), dr.select(nearer, carried, seen)
            to_sun = dr.select(nearer, mi.Vector3f(*place.vector_within(self.sun)), to_sun)
            shift = dr.select(nearer, mover.face_shift, shift)
            here = [one & ~nearer for one in here] + [nearer]
        self._apart(first)
        found = first.is_valid() if active is True else first.is_valid() & active
        surface = self._surface(first, seen, found)
        return Meeting(
            found=found, t=first.t, surface=surface, seen=seen, to_sun=to_sun, shift=shift, here=tuple(here)
        )

    def _surface(self, first: Any, seen: Any, found: Any) -> Any:
        """Mitsuba's interaction at a hit. Of plain meshes it is put together here, from the normals of their faces:
        Mitsuba's own, which is ready for textures and soft edges, takes twice as long.
        """
        import drjit as dr

        mi = mitsuba()
        if self.world.face_normal is None:
            return first.compute_surface_interaction(seen, mi.RayFlags.All, found)
        shape = dr.reinterpret_array(mi.UInt32, first.shape)
        face = dr.gather(mi.UInt32, self.world.first_face, shape, found) + first.prim_index
        normal = mi.Normal3f(*dr.gather(mi.Vector4f, self.world.face_normal, face, found)[:3])
        surface = dr.zeros(mi.SurfaceInteraction3f)
        surface.t, surface.p, surface.n = first.t, seen(first.t), normal
        surface.shape, surface.prim_index = first.shape, first.prim_index
        surface.sh_frame = mi.Frame3f(normal)
        surface.wi = surface.to_local(-seen.d)
        return surface

    def _any(self, ray: Any, active: Any, still: Any, moving: Sequence[Any]) -> Any:
        """Whether there is a surface in these Mitsuba scenes, of what stands still and of each mover."""
        import drjit as dr

        mi = mitsuba()
        self._apart(ray, active)
        met = mi.Bool(False)
        if still is not None:
            met = still.ray_test(ray, coherent=self.coherent, active=active)
        for (mover, place), scene in zip(self.moving, moving, strict=True):
            if scene is None:
                continue
            carried = _carried(mi, ray, place)
            transfer.apart(met)
            left = active & ~met & _near(dr, carried, mover)
            met |= scene.ray_test(carried, coherent=self.coherent, active=left)
        self._apart(met)
        return met

    def outside(self, met: Meeting, point: Any) -> Any:
        """A point of the frame of what was met, in the traced one."""
        import drjit as dr

        mi = mitsuba()
        for (_, place), here in zip(self.moving, met.here, strict=True):
            point = dr.select(here, mi.Point3f(*place.point(tuple(point))), point)
        return point

    def _apart(self, *arrays: Any) -> None:
        """Nothing that one scene was asked is left to the kernel that asks the next one."""
        if self.moving or self.world.has_panes:
            transfer.apart(*arrays)


def _carried(mi: Any, ray: Any, place: Placement) -> Any:
    """A ray of the traced frame, in that of a body."""
    origin, direction = place.point_within(tuple(ray.o)), place.vector_within(tuple(ray.d))
    carried = mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*direction))
    carried.maxt = ray.maxt
    return carried


def _shorter(ray: Any, before: Any) -> Any:
    """The ray up to a length, or as long as it is."""
    if before is None:
        return ray
    ray = mitsuba().Ray3f(ray)
    ray.maxt = before
    return ray


def _near(dr: Any, ray: Any, mover: Mover) -> Any:
    """Whether a ray in the body's frame comes into the sphere around it."""
    x, y, z, radius = mover.sphere
    to = type(ray.o)(x, y, z) - ray.o
    along = dr.dot(to, ray.d)
    apart = dr.squared_norm(to - along * ray.d)
    # A little wider, for rounding: 1e-6 of the distance is ten times what single precision loses.
    room = radius + 1e-6 * dr.abs(along)
    return (apart <= room * room) & (along > -room)
