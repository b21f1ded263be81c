"""Find the surface that each ray meets, in a world whose bodies may move.

What moves is not moved: each body has a Mitsuba scene in its own frame, and the rays are transformed into that frame
as the body stands when their pulse leaves. The nearest hit of all scenes is kept. So nothing is ever rebuilt, which
costs Embree up to a second in a large scene, and every pulse sees the bodies at its own time. The hits are those of a
scene rebuilt for every pulse (tests/chain/test_motion.py). A ray asks only the bodies that it comes near (`nearby`),
one after the other, in a loop that most rays never enter.

Panes and porous surfaces are in scenes of their own. They are few, so that asking for them costs little, and one query
in the other scene finds what stands behind them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from ...light.footprint import Aim
from ...maths.arrays import Array, Lanes, Mask
from ...maths.paths import Moving, Placement
from ...maths.vectors import Vector
from ..device import transfer
from ..device.backend import mitsuba
from ..device.types import DeviceVector, Hit, Ray, TracedScene, components
from ..world.build import World
from ..world.speculars import Speculars
from .gaps import Draws
from .nearby import MOST, Box, around, passed


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Meeting:
    """What each ray met, one element for each ray.

    found    whether it met anything
    t        distance from the ray's start, metres
    surface  Mitsuba's interaction, in the frame of the body that was met
    seen     the ray in that frame
    to_sun   unit vector towards the sun in that frame
    shift    what to add to the face number: bodies of one shape share a mesh, but have faces of their own in the tables
    place    of the body that was met, where ``moved``; None in a world in which nothing moves
    moved    whether the body that was met is one that moves
    """

    found: Any
    t: Any
    surface: Any
    seen: Any
    to_sun: Any
    shift: Any
    place: Placement | None
    moved: Any

    def outside(self, point: DeviceVector) -> Any:
        """Transform points from the frame of the body that was met to the traced frame."""
        import drjit as dr

        if self.place is None:
            return point
        return dr.select(self.moved, mitsuba().Point3f(*self.place.point(components(point))), point)

    def turned(self, direction: DeviceVector) -> Any:
        """Transform directions from the frame of the body that was met to the traced frame."""
        import drjit as dr

        if self.place is None:
            return direction
        return dr.select(self.moved, mitsuba().Vector3f(*self.place.vector(components(direction))), direction)

    def velocity(self, point: DeviceVector) -> Any:
        """Velocity [m/s] of the body that was met, at points of the traced frame, in its axes."""
        import drjit as dr

        still = mitsuba().Vector3f(0.0)
        if self.place is None:
            return still
        return dr.select(self.moved, mitsuba().Vector3f(*self.place.velocity_at(components(point))), still)

    def receding(self, point: DeviceVector, along: DeviceVector) -> Any:
        """Velocity of the body that was met, at points of the traced frame, along a vector; None: nothing moves."""
        import drjit as dr

        if self.place is None:
            return None
        speed = sum(v * d for v, d in zip(self.place.velocity_at(components(point)), along, strict=True))
        return dr.select(self.moved, speed, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Moment:
    """A world as it stands for each ray when its pulse leaves.

    moving    where the world's movers are then; None: nothing moves
    boxes     around the way of each of them
    sun       unit vector towards the sun
    coherent  whether neighbouring rays are neighbours in angle: Embree then traces them in packets, up to twice as fast
    draws     random numbers of the rays, for gaps
    aim       axes and widths of the beams, for specular returns; None: there are none
    """

    world: World
    sun: Vector
    coherent: bool
    draws: Draws
    moving: Moving | None = None
    boxes: Sequence[Box] = ()
    aim: Aim | None = None

    @property
    def speculars(self) -> Speculars:
        """The world's panes, mirrors and porous surfaces; ask only a world that has some."""
        assert self.world.speculars is not None
        return self.world.speculars

    def meet(self, ray: Ray, active: Mask = True) -> Meeting:
        """Return the nearest surface of each active ray, panes left out. Rays are in the traced frame."""
        return self._nearest(ray, active, self.world.scene, [mover.scene for mover in self.world.movers])

    def pane(self, ray: Ray, before: Lanes, active: Mask) -> Meeting:
        """Return the nearest pane or porous surface of each active ray, at most ``before`` metres away."""
        panes = [mover.panes for mover in self.world.movers]
        return self._nearest(_shorter(ray, before), active, self.world.panes, panes)

    def blocked(self, ray: Ray, active: Mask) -> Any:
        """Return whether each active ray meets anything, panes left out."""
        return self._any(ray, active, self.world.scene, [mover.scene for mover in self.world.movers])

    def glazed(self, ray: Ray, active: Mask, before: Lanes | None = None) -> Any:
        """Return whether each active ray meets a pane or porous surface, at most ``before`` metres away if given."""
        panes = [mover.panes for mover in self.world.movers]
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
        met = mi.Int32(-1)
        for group, near in self._near(ray, active, moving):
            transfer.apart(first)
            _, first, met = dr.while_loop(
                (near, first, met), _any_left, partial(self._nearer, ray, group), mode="symbolic"
            )
        self._apart(first)
        found = first.is_valid() if active is True else first.is_valid() & active
        seen, to_sun, shift, place = self._seen(ray, met)
        return Meeting(
            found=found,
            t=first.t,
            surface=self._surface(first, seen, found),
            seen=seen,
            to_sun=to_sun,
            shift=shift,
            place=place,
            moved=met >= 0,
        )

    def _seen(self, ray: Ray, met: Array) -> tuple[Any, Any, Any, Placement | None]:
        """Return each ray in the frame of the mover that it met, the sun and the face's shift there, and that frame.

        met  number of the mover, -1 for what stands still
        """
        import drjit as dr

        mi = mitsuba()
        to_sun, shift = mi.Vector3f(*self.sun), mi.UInt32(0)
        if self.moving is None:
            return ray, to_sun, shift, None
        moving = self.moving

        # A loop of one round at most: packets of rays that met nothing that moves have no part in it.
        def there(todo: Array, *_: object) -> tuple[Any, ...]:
            place = moving.at(met)
            carried = _carried(ray, place)
            own = dr.gather(mi.UInt32, self.world.mover_shift, mi.UInt32(met), todo)
            towards = mi.Vector3f(*place.vector_within(self.sun))
            return mi.Bool(False), carried.o, carried.d, towards, own, _numbers(place)

        state = met >= 0, ray.o, ray.d, to_sun, shift, [mi.Float(0.0) for _ in range(_NUMBERS)]
        _, o, d, to_sun, shift, numbers = dr.while_loop(state, lambda todo, *_: todo, there, mode="symbolic")
        return _ray(o, d, ray.maxt), to_sun, shift, _placement(numbers)

    def _nearer(self, ray: Ray, group: _Group, near: Array, first: Hit, met: Array) -> tuple[Any, Any, Any]:
        """Ask one more body of a group; the state of the loop in `_nearest`."""
        import drjit as dr

        which, left, there = self._next(near, group)
        carried = _carried(ray, there)
        hit = group.scene.ray_intersect_preliminary(carried, coherent=self.coherent, active=near != 0)
        # Rigid motion keeps lengths, so that distances of different frames compare. A miss has t = infinity.
        nearer = hit.is_valid() & (hit.t < first.t)
        return left, dr.select(nearer, hit, first), dr.select(nearer, which, met)

    def _next(self, near: Array, group: _Group) -> tuple[Any, Any, Placement]:
        """Return the number of the next body that a ray is near to, which are left, and where that body is."""
        import drjit as dr

        assert self.moving is not None
        which = mitsuba().Int32(dr.tzcnt(near) + group.first)
        return which, near & (near - 1), self.moving.at(which)

    def _near(self, ray: Ray, active: Mask, scenes: Sequence[TracedScene | None]) -> list[tuple[_Group, Any]]:
        """Return groups of movers, and for each which of them the rays come near: bit i says so of its body i."""
        groups = self._groups(scenes)
        if not groups:
            return []
        boxes = [self.boxes[group.first : group.first + group.count] for group in groups]
        return list(zip(groups, passed(ray, boxes, around(self.boxes), active), strict=True))

    def _groups(self, scenes: Sequence[TracedScene | None]) -> list[_Group]:
        """Return the movers that share a scene, as many at a time as `passed` has bits; empty scenes left out."""
        groups: list[_Group] = []
        if self.moving is None:
            return groups
        for number, scene in enumerate(scenes):
            if scene is None:
                continue
            last = groups[-1] if groups else None
            if last is not None and last.scene is scene and last.count < MOST:
                groups[-1] = replace(last, count=last.count + 1)
            else:
                groups.append(_Group(scene=scene, first=number, count=1))
        return groups

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

    def _any(self, ray: Ray, active: Mask, still: TracedScene | None, moving: Sequence[TracedScene | None]) -> Any:
        """Return whether each ray meets any surface of several Mitsuba scenes; `_nearest` says which these are."""
        import drjit as dr

        mi = mitsuba()
        self._apart(ray, active)
        met = mi.Bool(False)
        if still is not None:
            met = still.ray_test(ray, coherent=self.coherent, active=active)
        for group, near in self._near(ray, active & ~met, moving):
            transfer.apart(met)
            _, met = dr.while_loop((near, met), _any_left, partial(self._blocking, ray, group), mode="symbolic")
        self._apart(met)
        return met

    def _blocking(self, ray: Ray, group: _Group, near: Array, met: Array) -> tuple[Any, Any]:
        """Ask one more body of a group; the state of the loop in `_any`."""
        import drjit as dr

        _, left, there = self._next(near, group)
        met |= group.scene.ray_test(_carried(ray, there), coherent=self.coherent, active=near != 0)
        return dr.select(met, 0, left), met

    def _apart(self, *arrays: object) -> None:
        """Keep the queries of several scenes in kernels of their own, if there are several (`transfer.apart`)."""
        if self.moving is not None or self.world.has_panes:
            transfer.apart(*arrays)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Group:
    """Bodies that share a Mitsuba scene: ``count`` of them, from number ``first`` of the world's movers on."""

    scene: TracedScene
    first: int
    count: int


def _any_left(near: Array, *_: object) -> Any:
    """Whether a loop over bodies goes on."""
    return near != 0


def _carried(ray: Ray, place: Placement) -> Any:
    """Transform rays from the traced frame to that of a body."""
    mi = mitsuba()
    origin, direction = place.point_within(components(ray.o)), place.vector_within(components(ray.d))
    return _ray(mi.Point3f(*origin), mi.Vector3f(*direction), ray.maxt)


def _ray(origin: DeviceVector, direction: DeviceVector, maxt: Lanes) -> Any:
    ray = mitsuba().Ray3f(origin, direction)
    ray.maxt = maxt
    return ray


_NUMBERS = 18
"""Of a placement: its place, rotation, velocity and angular velocity."""


def _numbers(place: Placement) -> list[Any]:
    """Return the numbers of a placement one after the other, as a loop carries them."""
    parts = place.origin_m, place.rotation, place.velocity_m_s, place.turning_rad_s
    return [mitsuba().Float(number) for part in parts if part is not None for number in part]


def _placement(numbers: Sequence[Array]) -> Placement:
    """Return the placement of these `_numbers`."""
    (x, y, z), rotation = numbers[:3], tuple(numbers[3:12])
    (vx, vy, vz), (wx, wy, wz) = numbers[12:15], numbers[15:]
    return Placement(origin_m=(x, y, z), rotation=rotation, velocity_m_s=(vx, vy, vz), turning_rad_s=(wx, wy, wz))


def _shorter(ray: Ray, before: Lanes | None) -> Any:
    """Return rays that end at a length; None: they stay as they are."""
    if before is None:
        return ray
    ray = mitsuba().Ray3f(ray)  # a copy: Mitsuba's rays are mutable, and the caller keeps his
    ray.maxt = before
    return ray
