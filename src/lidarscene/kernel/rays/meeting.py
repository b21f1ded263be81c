"""Find the surface that each ray meets, in a world whose bodies may move.

What moves is not moved: all movers are in one Mitsuba scene, each in a cell of its own, and the rays are transformed
into the frame of a body as it stands when their pulse leaves, and from there to its cell. The nearest of all hits is
kept. So nothing is ever rebuilt, which costs Embree up to a second in a large scene, and every pulse sees the bodies at
its own time. The hits are those of a scene rebuilt for every pulse (tests/chain/test_motion.py). A ray asks only the
bodies near it (`nearby_bodies`), one after the other, in a loop that most rays never enter.

Panes and porous surfaces are in scenes of their own. They are few, so that asking for them costs little, and one query
in the other scene finds what stands behind them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from ...light.footprint import Aim
from ...maths.arrays import Array, Lanes, Mask, xp
from ...maths.motion_table import MovingBodies, Placement
from ...maths.vectors import Vector
from ..device.backend import mitsuba
from ..device.types import DeviceVector, Hit, Interaction, Ray, TracedScene, components
from ..world.mitsuba_world import World
from ..world.mover_scene import MoverScene
from ..world.speculars import Speculars
from .gaps import Draws
from .nearby_bodies import BoxWalk, CellPassage, Slabs
from .walking_rays import WalkerShapes, walker_hit


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Meeting:
    """The nearest surface of each of n rays; each field has one element for each ray.

    Attributes:
        valid: whether the ray meets a surface
        t: distance from the ray's start, metres
        surface: Mitsuba's interaction: directions in the frame of the body that is met, points in the scene asked
        local_ray: the ray in that frame
        to_sun: unit vector towards the sun in that frame
        offset: where the origin of that frame is in the scene asked; None in a world in which nothing moves
        row: of what is met in the tables of bodies and materials: bodies that move share faces, but have rows of their
            own there
        placement: of the body that is met, where ``is_mover``; None in a world in which nothing moves
        is_mover: whether the body that is met moves
    """

    valid: Any
    t: Any
    surface: Any
    local_ray: Any
    to_sun: Any
    offset: Any
    row: Any
    placement: Placement | None
    is_mover: Any

    def point_outside(self, point: DeviceVector) -> Any:
        """Transform points of the scene that was asked to the traced frame."""
        import drjit as dr

        if self.placement is None:
            return point
        moved = self.placement.point(components(point - self.offset))
        return dr.select(self.is_mover, mitsuba().Point3f(*moved), point)

    def direction_outside(self, direction: DeviceVector) -> Any:
        """Transform directions from the frame of the body that was met to the traced frame."""
        import drjit as dr

        if self.placement is None:
            return direction
        return dr.select(self.is_mover, mitsuba().Vector3f(*self.placement.vector(components(direction))), direction)

    def velocity(self, point: DeviceVector) -> Any:
        """Velocity [m/s] of the body that was met, at points of the traced frame, in its axes; None: nothing moves."""
        import drjit as dr

        if self.placement is None:
            return None
        mi = mitsuba()
        velocity_m_s = mi.Vector3f(*self.placement.velocity_at(components(point)))
        return dr.select(self.is_mover, velocity_m_s, mi.Vector3f(0.0))

    def receding(self, point: DeviceVector, along: DeviceVector) -> Any:
        """Speed [m/s] of the body that was met, at points of the traced frame, along a vector; None: nothing moves."""
        import drjit as dr

        if self.placement is None:
            return None
        speed = sum(v * d for v, d in zip(self.placement.velocity_at(components(point)), along, strict=True))
        return dr.select(self.is_mover, speed, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Moment:
    """A world as it stands for each ray when its pulse leaves.

    Attributes:
        moving: where the world's movers are then; None: nothing moves
        sun: unit vector towards the sun
        coherent: whether neighbouring rays are neighbours in angle: Embree then traces them in packets, up to twice as
            fast
        draws: random numbers of the rays, for gaps
        aim: axes and widths of the beams, for specular returns; None: there are none
    """

    world: World
    sun: Vector
    coherent: bool
    draws: Draws
    moving: MovingBodies | None = None
    aim: Aim | None = None

    @property
    def speculars(self) -> Speculars:
        """The world's panes, mirrors and porous surfaces; only for a world that has some."""
        assert self.world.speculars is not None
        return self.world.speculars

    def meet(self, ray: Ray, active: Mask = True, met: tuple[Array, ...] = ()) -> Meeting:
        """Return the nearest surface of each active ray, panes left out. Rays are in the traced frame.

        Args:
            met: `Firing.met`
        """
        return self._nearest(ray, active, self.world.scene, self.world.mover_scene, met)

    def pane(self, ray: Ray, before: Lanes, active: Mask) -> Meeting:
        """Return the nearest pane or porous surface of each active ray, at most ``before`` metres away."""
        return self._nearest(_cut_to_length(ray, before), active, self.world.panes, self.world.mover_panes)

    def blocked(self, ray: Ray, active: Mask) -> Any:
        """Return whether each active ray meets anything, panes left out."""
        return self._meets_any(ray, active, self.world.scene, self.world.mover_scene)

    def glazed(self, ray: Ray, active: Mask, before: Lanes | None = None) -> Any:
        """Return whether each active ray meets a pane or porous surface, at most ``before`` metres away if given."""
        return self._meets_any(_cut_to_length(ray, before), active, self.world.panes, self.world.mover_panes)

    def _nearest(
        self, ray: Ray, active: Mask, still: TracedScene | None, movers: MoverScene | None, met: tuple[Array, ...] = ()
    ) -> Meeting:
        """Return the nearest surface in two Mitsuba scenes.

        Args:
            still: of what stands still, in the traced frame; None: empty
            movers: of what moves; None: empty
            met: `Firing.met`
        """
        import drjit as dr

        mi = mitsuba()
        if still is None:
            first = dr.zeros(mi.PreliminaryIntersection3f)
            first.t = dr.inf
        else:
            # A preliminary intersection has distance, shape and triangle only. The full one calls each shape's own
            # code through a table; it is made once, of the nearest hit.
            unknown = active & (met[1] < 0) if met else active
            first = still.ray_intersect_preliminary(ray, coherent=self.coherent, active=unknown)
            if met:
                first = self._with_met(first, *met)
        mover_index = mi.Int32(-1)
        if movers is not None:
            # What is behind the nearest hit so far is not asked.
            first, mover_index = self._ask_nearby(
                ray,
                active,
                (first, mover_index),
                lambda hit, _: xp(ray.maxt).minimum(ray.maxt, hit.t),
                partial(self._nearer_of_mover, ray, movers),
            )
        valid = first.is_valid() if active is True else first.is_valid() & active
        shape = dr.reinterpret_array(mi.UInt32, first.shape)
        face = dr.gather(mi.UInt32, self.world.first_face, shape, valid) + first.prim_index
        local_ray, to_sun, offset, normal, row, placement = self._in_mover_frame(
            ray, mover_index, movers, first, shape, face
        )
        return Meeting(
            valid=valid,
            t=first.t,
            surface=self._surface(first, face, local_ray, valid, offset, normal),
            local_ray=local_ray,
            to_sun=to_sun,
            offset=offset,
            row=row,
            placement=placement,
            is_mover=mover_index >= 0,
        )

    def _with_met(self, first: Hit, range_m: Array, face: Array) -> Any:
        """Return hits in a still world of plain meshes with those that a survey has found, where ``face`` is not -1."""
        import drjit as dr

        mi, known = mitsuba(), face >= 0
        number = mi.UInt32(dr.gather(mi.Float, self.world.face_normal, 4 * face + 3, known))
        in_shape = mi.UInt32(face) - dr.gather(mi.UInt32, self.world.first_face, number, known)
        first.valid, first.t = known | first.valid, dr.select(known, range_m, first.t)
        first.shape = dr.select(known, dr.reinterpret_array(mi.ShapePtr, number), first.shape)
        first.prim_index = dr.select(known, in_shape, first.prim_index)
        return first

    def _in_mover_frame(
        self, ray: Ray, mover_index: Array, movers: MoverScene | None, first: Hit, shape: Array, face: Array
    ) -> tuple[Any, Any, Any, Any, Any, Placement | None]:
        """Return each ray in the frame of the mover it met; in that frame the sun; offset, row and placement.

        Before the row comes the normal of a walker, zero for all else; None where nobody walks. The velocity of the
        placement is that of the point of a walker that was met.

        Args:
            mover_index: -1 for what stands still
            movers: scene in which the mover was met
            first: the hit
            shape: number in Mitsuba's registry of what was met
            face: number of its face, which is the row of what stands still
        """
        import drjit as dr

        mi = mitsuba()
        to_sun, offset = mi.Vector3f(*self.sun), mi.Vector3f(0.0)
        if self.moving is None:
            return ray, to_sun, None, None, face, None
        numbers = [mi.Float(0.0) for _ in range(_NUMBERS)]
        if movers is None:
            return ray, to_sun, offset, None, face, _placement_of_numbers(numbers)
        moving, world, walkers = self.moving, self.world, movers.walkers

        # A loop of one round at most: packets of rays that met nothing that moves have no part in it.
        def into_frame(todo: Array, *_: object) -> tuple[Any, ...]:
            place = moving.placement(mover_index)
            carried = _ray_in_frame(ray, place)
            row = dr.gather(mi.UInt32, world.mover_rows, mi.UInt32(mover_index), todo)
            row += dr.gather(mi.UInt32, world.mover_shape, shape, todo)
            towards = mi.Vector3f(*place.vector_within(self.sun))
            offset = movers.offset(mover_index, todo)
            normal = mi.Vector3f(0.0)
            if walkers is not None:
                shapes = WalkerShapes.at(walkers, mover_index, place, todo)
                normal, velocity = shapes.surface(face, first.prim_uv, todo)
                place = place.faster_by(components(velocity))
            return mi.Bool(False), carried.o, carried.d, towards, offset, normal, row, _placement_numbers(place)

        state = mover_index >= 0, ray.o, ray.d, to_sun, offset, mi.Vector3f(0.0), face, numbers
        _, o, d, to_sun, offset, normal, row, numbers = dr.while_loop(
            state, lambda todo, *_: todo, into_frame, mode="symbolic"
        )
        in_frame = _make_ray(o, d, ray.maxt)
        return in_frame, to_sun, offset, None if walkers is None else normal, row, _placement_of_numbers(numbers)

    def _ask_nearby(
        self,
        ray: Ray,
        active: Mask,
        state: tuple[object, ...],
        length: Callable[..., Lanes],
        ask: Callable[..., tuple[object, ...]],
    ) -> tuple[Any, ...]:
        """Ask each mover that a ray comes near, one after the other, and return the last state.

        Args:
            length: how far a ray in this state still matters, metres; below 0 for one that is done
            ask: takes the mover's number, whether the ray comes near any, the mover's placement, and the state; returns
                the new state
        """
        import drjit as dr

        if self.moving is None or self.moving.motions.boxes is None:
            return state
        moving, walk = self.moving, BoxWalk(tree=self.moving.motions.boxes, slabs=Slabs.of_ray(ray))

        def step(node: Array, *state: object) -> tuple[object, ...]:
            node, mover_index = walk.next_box(node, length(*state))
            is_near = mover_index >= 0
            mover_index = dr.select(is_near, mover_index, 0)
            return (node, *ask(mover_index, is_near, moving.placement(mover_index), *state))

        first = walk.start(active, length(*state))
        return tuple(dr.while_loop((first, *state), lambda node, *_: node != 0, step, mode="symbolic")[1:])

    def _nearer_of_mover(
        self,
        ray: Ray,
        movers: MoverScene,
        candidate: Array,
        is_near: Array,
        placement: Placement,
        first: Hit,
        mover_index: Array,
    ) -> tuple[Any, Any]:
        """Intersect one more mover, as a step of `_ask_nearby`; returns the nearest hit so far and its mover."""
        import drjit as dr

        in_frame = _ray_in_frame(ray, placement)
        hit, asked = dr.zeros(mitsuba().PreliminaryIntersection3f), mitsuba().Bool(False)
        hit.t = dr.inf
        if movers.scene is not None:
            cell = CellPassage.of_ray(in_frame, movers, candidate, is_near)
            asked = cell.passes & (cell.start_m <= first.t)
            hit = movers.scene.ray_intersect_preliminary(cell.ray, coherent=self.coherent, active=asked)
            hit.t += cell.start_m
        if movers.walkers is not None:
            shapes = WalkerShapes.at(movers.walkers, candidate, placement, is_near)
            length = xp(ray.maxt).minimum(ray.maxt, first.t)
            t, u, v, triangle = shapes.nearest(in_frame, length, is_near)
            asked |= is_near & shapes.walks
            met = walker_hit(movers.walkers, t, u, v, triangle, is_near)
            hit = dr.select(met.t < hit.t, met, hit)
        # Rigid motion keeps lengths, so that distances of different frames compare. A miss has t = infinity.
        # Of two at one distance the first mover is met, whatever order the boxes are in.
        tied = (hit.t == first.t) & (candidate < mover_index)
        nearer = asked & hit.is_valid() & ((hit.t < first.t) | tied)
        return dr.select(nearer, hit, first), dr.select(nearer, candidate, mover_index)

    def _surface(
        self,
        first: Hit,
        face: Array,
        local_ray: Ray,
        valid: Mask,
        offset: DeviceVector | None,
        walking: DeviceVector | None,
    ) -> Any:
        """Return `Meeting.surface` at a hit, with the fields that our BSDFs read.

        Args:
            walking: normal of a walker, zero for all else; None where nobody walks
        """
        import drjit as dr

        mi = mitsuba()
        in_scene = local_ray
        if offset is not None:
            in_scene = _make_ray(mi.Point3f(local_ray.o + offset), local_ray.d, local_ray.maxt)
        walks = mi.Bool(False) if walking is None else dr.squared_norm(walking) > 0.0
        if self.world.face_normal is None:
            surface = first.compute_surface_interaction(in_scene, mi.RayFlags.All, valid)
            # Mitsuba has walkers as they stand.
            if walking is not None:
                surface = dr.select(walks, _flat(mi.SurfaceInteraction3f(surface), first, in_scene, walking), surface)
            return surface
        # Plain meshes are flat and look the same all over: point, normal and incoming direction are all that their
        # BSDFs read. Mitsuba's own interaction is ready for textures and smooth normals, and takes twice as long.
        # The table has four numbers a face: Dr.Jit gathers four neighbours in one load, three in three.
        normal = mi.Vector3f(*dr.gather(mi.Vector4f, self.world.face_normal, face, valid)[:3])
        if walking is not None:
            normal = dr.select(walks, walking, normal)
        surface = dr.zeros(mi.SurfaceInteraction3f)
        surface.shape, surface.prim_index = first.shape, first.prim_index
        return _flat(surface, first, in_scene, normal)

    def _meets_any(self, ray: Ray, active: Mask, still: TracedScene | None, movers: MoverScene | None) -> Any:
        """Return whether each ray meets any surface of two Mitsuba scenes; `_nearest` says which these are."""
        import drjit as dr

        mi = mitsuba()
        is_blocked = mi.Bool(False)
        if still is not None:
            is_blocked = still.ray_test(ray, coherent=self.coherent, active=active)
        if movers is not None:
            (is_blocked,) = self._ask_nearby(
                ray,
                active,
                (is_blocked,),
                lambda is_blocked: dr.select(is_blocked, -1.0, ray.maxt),
                partial(self._blocked_by_mover, ray, movers),
            )
        return is_blocked

    def _blocked_by_mover(
        self, ray: Ray, movers: MoverScene, candidate: Array, is_near: Array, placement: Placement, is_blocked: Array
    ) -> tuple[Any]:
        """Intersect one more mover, as a step of `_ask_nearby`; returns whether the rays are blocked."""
        import drjit as dr

        in_frame = _ray_in_frame(ray, placement)
        if movers.scene is not None:
            cell = CellPassage.of_ray(in_frame, movers, candidate, is_near)
            meets = movers.scene.ray_test(cell.ray, coherent=self.coherent, active=cell.passes)
            is_blocked |= cell.passes & meets
        if movers.walkers is not None:
            shapes = WalkerShapes.at(movers.walkers, candidate, placement, is_near)
            is_blocked |= shapes.nearest(in_frame, ray.maxt, is_near & ~is_blocked)[0] < dr.inf
        return (is_blocked,)


def _flat(surface: Interaction, first: Hit, ray: Ray, normal: DeviceVector) -> Any:
    """Return an interaction with the point, normal and incoming direction of a hit on a flat surface."""
    mi = mitsuba()
    surface.t, surface.p, surface.n = first.t, ray(first.t), mi.Normal3f(normal)
    surface.sh_frame = mi.Frame3f(surface.n)  # BSDFs want wi in the frame whose z is the normal
    surface.wi = surface.to_local(-ray.d)
    return surface


def _ray_in_frame(ray: Ray, place: Placement) -> Any:
    """Transform rays from the traced frame to that of a body."""
    mi = mitsuba()
    origin, direction = place.point_within(components(ray.o)), place.vector_within(components(ray.d))
    return _make_ray(mi.Point3f(*origin), mi.Vector3f(*direction), ray.maxt)


def _make_ray(origin: DeviceVector, direction: DeviceVector, maxt: Lanes) -> Any:
    ray = mitsuba().Ray3f(origin, direction)
    ray.maxt = maxt
    return ray


_NUMBERS = 18
"""Count of the numbers of a placement: origin (3), rotation (9), velocity (3) and angular velocity (3)."""


def _placement_numbers(place: Placement) -> list[Any]:
    """Return the numbers of a placement one after the other, as a loop carries them."""
    parts = place.origin_m, place.rotation, place.velocity_m_s, place.turning_rad_s
    return [mitsuba().Float(number) for part in parts if part is not None for number in part]


def _placement_of_numbers(numbers: Sequence[Array]) -> Placement:
    """Return the placement of these `_placement_numbers`."""
    (x, y, z), rotation = numbers[:3], tuple(numbers[3:12])
    (vx, vy, vz), (wx, wy, wz) = numbers[12:15], numbers[15:]
    return Placement(origin_m=(x, y, z), rotation=rotation, velocity_m_s=(vx, vy, vz), turning_rad_s=(wx, wy, wz))


def _cut_to_length(ray: Ray, before: Lanes | None) -> Any:
    """Return rays that end after ``before`` metres; None: unchanged."""
    if before is None:
        return ray
    ray = mitsuba().Ray3f(ray)  # a copy: Mitsuba's rays are mutable, and the caller still uses his
    ray.maxt = before
    return ray
