"""Find the surface that each ray meets, in a world whose bodies may move.

What moves is not moved: each body has a Mitsuba scene in its own frame, and the rays are transformed into that frame
as the body stands when their pulse leaves. The nearest hit of all scenes is kept. So nothing is ever rebuilt, which
costs Embree up to a second in a large scene, and every pulse sees the bodies at its own time. The hits are those of a
scene rebuilt for every pulse (tests/chain/test_motion.py).

Panes and porous surfaces are in scenes of their own. They are few, so that asking for them costs little, and one query
in the other scene finds what stands behind them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from ...light.footprint import Aim
from ...maths.arrays import Lanes, Mask
from ...maths.paths import Placement
from ...maths.vectors import Vector
from ..device import transfer
from ..device.backend import mitsuba
from ..device.types import DeviceVector, Hit, Ray, TracedScene, components
from ..world.build import Mover, World
from ..world.speculars import Speculars
from .gaps import Draws


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Meeting:
    """What each ray met, one element for each ray.

    found    whether it met anything
    t        distance from the ray's start, metres
    surface  Mitsuba's interaction, in the frame of the body that was met
    seen     the ray in that frame
    to_sun   unit vector towards the sun in that frame
    shift    what to add to the face number: bodies of one shape share a mesh, but have faces of their own in the tables
    here     for each of the world's movers, whether it is the body that was met
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
    coherent  whether neighbouring rays are neighbours in angle: Embree then traces them in packets, up to twice as fast
    draws     random numbers of the rays, for gaps
    aim       axes and widths of the beams, for specular returns; None: there are none
    """

    world: World
    moving: Sequence[tuple[Mover, Placement]]
    sun: Vector
    coherent: bool
    draws: Draws
    aim: Aim | None = None

    @property
    def speculars(self) -> Speculars:
        """The world's panes, mirrors and porous surfaces; ask only a world that has some."""
        assert self.world.speculars is not None
        return self.world.speculars

    def meet(self, ray: Ray, active: Mask = True) -> Meeting:
        """Return the nearest surface of each active ray, panes left out. Rays are in the traced frame."""
        return self._nearest(ray, active, self.world.scene, [mover.scene for mover, _ in self.moving])

    def pane(self, ray: Ray, before: Lanes, active: Mask) -> Meeting:
        """Return the nearest pane or porous surface of each active ray, at most ``before`` metres away."""
        panes = [mover.panes for mover, _ in self.moving]
        return self._nearest(_shorter(ray, before), active, self.world.panes, panes)

    def blocked(self, ray: Ray, active: Mask) -> Any:
        """Return whether each active ray meets anything, panes left out."""
        return self._any(ray, active, self.world.scene, [mover.scene for mover, _ in self.moving])

    def glazed(self, ray: Ray, active: Mask, before: Lanes | None = None) -> Any:
        """Return whether each active ray meets a pane or porous surface, at most ``before`` metres away if given."""
        panes = [mover.panes for mover, _ in self.moving]
        return self._any(_shorter(ray, before), active, self.world.panes, panes)

    def _nearest(
        self, ray: Ray, active: Mask, still: TracedScene | None, moving: Sequence[TracedScene | None]
    ) -> Meeting:
        """Return the nearest surface among several Mitsuba scenes; a scene that is None is empty.

        still   of what stands still, in the traced frame
        moving  of each mover, in the mover's frame
        """
        import drjit as dr

        mi = mitsuba()
        self._apart(ray, active)
        if still is None:
            first = dr.zeros(mi.PreliminaryIntersection3f)
            first.t = dr.inf
        else:
            # A preliminary intersection has distance, shape and triangle only. The full one calls each shape's own
            # code through a table; it is made once, of the nearest hit.
            first = still.ray_intersect_preliminary(ray, coherent=self.coherent, active=active)
        seen, to_sun, shift = ray, mi.Vector3f(*self.sun), mi.UInt32(0)
        here: list[Any] = []
        for (mover, place), scene in zip(self.moving, moving, strict=True):
            if scene is None:
                here.append(mi.Bool(False))
                continue
            carried = _carried(mi, ray, place)
            transfer.apart(first)
            # Most rays miss most bodies: a sphere around the body is asked before its triangles.
            near = _near(dr, carried, mover)
            hit = scene.ray_intersect_preliminary(
                carried, coherent=self.coherent, active=near if active is True else near & active
            )
            # Rigid motion keeps lengths, so that distances of different frames compare. A miss has t = infinity.
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

    def _surface(self, first: Hit, seen: Ray, found: Mask) -> Any:
        """Return Mitsuba's interaction at a hit, as far as our BSDFs ask for it."""
        import drjit as dr

        mi = mitsuba()
        if self.world.face_normal is None:
            return first.compute_surface_interaction(seen, mi.RayFlags.All, found)
        # Plain meshes are flat and look the same all over: point, normal and incoming direction are all that their
        # BSDFs read. Mitsuba's own interaction is ready for textures and smooth normals, and takes twice as long.
        shape = dr.reinterpret_array(mi.UInt32, first.shape)
        face = dr.gather(mi.UInt32, self.world.first_face, shape, found) + first.prim_index
        # The table has four numbers a face: Dr.Jit gathers four neighbours in one load, three in three.
        normal = mi.Normal3f(*dr.gather(mi.Vector4f, self.world.face_normal, face, found)[:3])
        surface = dr.zeros(mi.SurfaceInteraction3f)
        surface.t, surface.p, surface.n = first.t, seen(first.t), normal
        surface.shape, surface.prim_index = first.shape, first.prim_index
        surface.sh_frame = mi.Frame3f(normal)  # BSDFs want wi in the frame whose z is the normal
        surface.wi = surface.to_local(-seen.d)
        return surface

    def _any(
        self, ray: Ray, active: Mask, still: TracedScene | None, moving: Sequence[TracedScene | None]
    ) -> Any:
        """Return whether each ray meets any surface of several Mitsuba scenes; `_nearest` says which these are."""
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
            undecided = active & ~met & _near(dr, carried, mover)
            met |= scene.ray_test(carried, coherent=self.coherent, active=undecided)
        self._apart(met)
        return met

    def outside(self, met: Meeting, point: DeviceVector) -> Any:
        """Transform points from the frame of the body that was met to the traced frame."""
        import drjit as dr

        mi = mitsuba()
        for (_, place), here in zip(self.moving, met.here, strict=True):
            point = dr.select(here, mi.Point3f(*place.point(components(point))), point)
        return point

    def _apart(self, *arrays: object) -> None:
        """Keep the queries of several scenes in kernels of their own, if there are several (`transfer.apart`)."""
        if self.moving or self.world.has_panes:
            transfer.apart(*arrays)


def _carried(mi: ModuleType, ray: Ray, place: Placement) -> Any:
    """Transform rays from the traced frame to that of a body."""
    origin, direction = place.point_within(components(ray.o)), place.vector_within(components(ray.d))
    carried = mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*direction))
    carried.maxt = ray.maxt
    return carried


def _shorter(ray: Ray, before: Lanes | None) -> Any:
    """Return rays that end at a length; None: they stay as they are."""
    if before is None:
        return ray
    ray = mitsuba().Ray3f(ray)  # a copy: Mitsuba's rays are mutable, and the caller keeps his
    ray.maxt = before
    return ray


def _near(dr: ModuleType, ray: Ray, mover: Mover) -> Any:
    """Return whether rays in the body's frame pass through the sphere around it."""
    x, y, z, radius = mover.sphere
    to = mitsuba().Point3f(x, y, z) - ray.o
    along = dr.dot(to, ray.d)
    # The vector from the sphere's centre to the nearest point of the ray: its square keeps its precision, while
    # |to|^2 - along^2 would be the difference of two large numbers.
    apart = dr.squared_norm(to - along * ray.d)
    # The sphere is a little wider, for rounding: 1e-6 of the distance is ten times the error of single precision.
    room = radius + 1e-6 * dr.abs(along)
    return (apart <= room * room) & (along > -room)
