"""Trace beams through a world: find the surface at the end of each path, and what it scatters.

A beam has one path, or two in a world with panes: through the first pane, and off it. Along each path the nearest
surface is asked for, again after each pane, mirror or gap; from its end one shadow ray goes to the sun. A `Hits` is
geometry and scattering, never watts. The BSDF is evaluated in two directions, back along the beam and towards the sun,
and nothing is sampled: there is no Monte Carlo noise (docs/theory.md 4 and 26).

The steps along a path are unrolled by Python, not looped on the device. Their number is small and selects code, and a
world without panes and mirrors has none of it in its kernel.

Symbols: theta angle of incidence, theta_s angle of the sun, f_r BSDF (1/sr), tau diffuse transmittance.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from ...light.beams import Beams
from ...light.footprint import Aim
from ...light.hits import Hits
from ...light.limits import INTERACTIONS
from ...maths.arrays import Array, Lanes, Mask, is_drjit, xp
from ...maths.paths import Moving
from ...maths.vectors import Vector
from ..device.backend import mitsuba
from ..device.types import DeviceVector, Ray, Surface, components
from ..world.build import World
from .gaps import Draws, gap_share
from .glints import returned
from .meeting import Meeting, Moment
from .nearby import boxes_of
from .onward import START_OFFSET_M, Way, chosen, gone_on, kind_of, stopped, sunlight_share


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Firing:
    """What rays have besides where they start and where they go.

    seed          of the frame: random numbers of the gaps
    ray           (n,) number of each ray within its pulse, for the same; 0 if it is the only one
    velocity_m_s  of the point from which each ray leaves; None: it stands still
    aim           axes and widths of the beams, for specular returns; None: there are none
    housing_m     radius of the sensor itself: what is nearer is no hit
    vectors       whether normals and velocities of the surfaces are wanted
    """

    seed: Lanes = 0
    ray: Lanes = 0
    housing_m: Lanes = 0.0
    velocity_m_s: Vector | None = None
    aim: Aim | None = None
    vectors: bool = False


def trace(
    world: World,
    beams: Beams,
    *,
    sun: Vector,
    moving: Moving | None = None,
    interactions: int = INTERACTIONS,
    survey: bool = False,
    firing: Firing | None = None,
) -> tuple[Hits, ...]:
    """Return the surface at the end of each ray's paths, one `Hits` for each path, on the device.

    The first path goes through panes, off mirrors, and through gaps where the ray finds one. In a world with panes
    there is a second path: it is reflected at the first pane that the first path meets, and goes on in the same way.
    If there is no such pane it carries no light.

    sun           (x, y, z) unit vector towards the sun
    moving        where each of the world's movers is when each ray leaves; None: as at time 0
    interactions  largest number of panes, mirrors and gaps on each path. At the next pane or mirror the path ends
                  without an echo; the next porous surface counts as solid
    survey        end each ray at its first surface, and flag (`Hits.goes_on`) those that have to be traced in full:
                  rays that meet a pane, mirror or porous surface, or whose sunlight comes through one. A kernel that
                  follows all paths costs every ray its queries, and few rays meet glass
    firing        None: one ray to a pulse, from a sensor at rest, without specular returns, seed 0
    """
    mi = mitsuba()
    firing = firing or Firing()
    moving = moving or world.rest
    moment = Moment(
        world=world,
        sun=sun,
        coherent=True,
        moving=moving,
        boxes=() if moving is None else boxes_of(moving.paths.boxes_m),
        draws=Draws(seed=firing.seed, pulse=beams.pulse, ray=firing.ray),
        aim=firing.aim,
    )
    ray = mi.Ray3f(mi.Point3f(*beams.origin_m), mi.Vector3f(*beams.direction))
    first = Way(ray=ray, receding_m_s=_receding(firing.velocity_m_s, beams.direction))
    if world.speculars is None:
        survey = False
    if survey:
        return (_surveyed(moment, first, moment.meet(ray), firing),)
    ways = _ways(moment, first, interactions)

    def sunshine(ray: Ray, sunny: Mask) -> tuple[Any, Lanes]:
        return _sunshine(moment, ray, sunny, interactions)

    return tuple(_ended(moment, way, met, sunshine, firing) for way, met in ways)


def _surveyed(moment: Moment, way: Way, met: Meeting, firing: Firing) -> Hits:
    """Return the first surface of each ray, with `Hits.goes_on`: whether the ray has to be traced in full."""
    mi = mitsuba()
    through_glass = mi.Bool(False)

    # `_ended` asks for the sunlight once, with the shadow rays: the same rays tell whether glass is in the sun's way.
    def sunshine(ray: Ray, sunny: Mask) -> tuple[Any, Lanes]:
        nonlocal through_glass
        lit = sunny & ~moment.blocked(ray, sunny)
        through_glass = moment.glazed(ray, lit)
        return lit, 1.0

    hits = _ended(moment, way, met, sunshine, firing)
    goes_on = (kind_of(moment, met) > 0) | moment.glazed(way.ray, True, met.t) | through_glass
    return dataclasses.replace(hits, goes_on=goes_on)


def _ways(moment: Moment, way: Way, interactions: int) -> list[tuple[Way, Meeting]]:
    """Return each path of the rays, with the surface at its end: one path, or two in a world with panes."""
    mi = mitsuba()
    met, speculars = moment.meet(way.ray), moment.world.speculars
    if speculars is None:
        return [(way, met)]
    if not interactions:
        return [(way, _at_last_pane(moment, way, met, mi.Bool(True)))]
    # `on` are the lanes whose path has gone on at every step so far, `mirrored` those that have left a second path at a
    # pane. That happens once for each ray, at its first pane. Without mirrors and gaps the first pane, if there is one,
    # is met at the first step, and the later steps need no code for it.
    second, mirrored, on = way, mi.Bool(False), mi.Bool(True)
    for number in range(interactions):
        pane = _pane_before(moment, way, met, on)
        if pane is not None and speculars.panes and (number == 0 or speculars.mirrors or speculars.gaps):
            here = pane.found & ~mirrored
            if speculars.gaps:
                here &= speculars.is_pane(kind_of(moment, pane))
            off = gone_on(moment, way, pane, here, reflected=True)
            back, ended = returned(moment, way, pane, off, here)
            second = chosen(here, chosen(back, ended, off), second)
            mirrored |= here
        way, met, on = _a_step_on(moment, way, met, pane, on)
    met = _at_last_pane(moment, way, met, on)
    if not speculars.panes:
        return [(way, met)]
    second, end = _mirrored(moment, second, mirrored, interactions)
    return [(way, met), (second, end)]


def _mirrored(moment: Moment, way: Way, active: Mask, interactions: int) -> tuple[Way, Meeting]:
    """Follow the second path from the first pane on, on the lanes that have one."""
    import drjit as dr

    way = dataclasses.replace(way, throughput=dr.select(active, way.throughput, 0.0))
    back = active & (way.glint_per_sr > 0.0)  # a specular return: the path ends at that pane
    met, on = moment.meet(way.ray, active), active & ~back
    # The first pane was one interaction. A path that met a mirror before it has used up more than one.
    for _ in range(1, interactions):
        on = on & (way.interactions < interactions)
        way, met, on = _a_step_on(moment, way, met, _pane_before(moment, way, met, on), on)
    return way, _at_last_pane(moment, way, met, on | back)


def _pane_before(moment: Moment, way: Way, met: Meeting, on: Mask) -> Meeting | None:
    """Return the nearest pane or porous surface in front of what was met; None in a world without any."""
    return moment.pane(way.ray, met.t, on) if moment.speculars.lets_through else None


def _at_last_pane(moment: Moment, way: Way, met: Meeting, on: Mask) -> Meeting:
    """Return the end of a path that has used all its interactions: what was met, or a pane in front of it."""
    pane = _pane_before(moment, way, met, on)
    return met if pane is None else chosen(pane.found, pane, met)


def _a_step_on(moment: Moment, way: Way, met: Meeting, pane: Meeting | None, on: Mask) -> tuple[Way, Meeting, Any]:
    """Take one step where ``on`` holds: through a pane or gap, or off a mirror.

    Returns the path, what it meets next, and (n,) whether it has gone on.
    """
    import drjit as dr

    gone, before = on & False, way
    if pane is not None:
        ends = stopped(moment, way, pane)
        gone = pane.found & ~ends
        way = chosen(gone, gone_on(moment, way, pane, gone, reflected=False), way)
        # A thin pane does not bend the ray. What stands behind it is known already, since panes are in scenes of their
        # own: only its distance is less, by the path up to the pane. That saves a query for each pane.
        nearer = met.t - (way.length_m - before.length_m)
        met = chosen(ends, pane, dataclasses.replace(met, t=dr.select(gone, nearer, met.t)))
    if moment.speculars.mirrors:
        bounce = on & ~gone & moment.speculars.is_mirror(kind_of(moment, met))
        off = gone_on(moment, way, met, bounce, reflected=False)
        # A mirror normal to the beam ends the path with a specular return; off all others it goes on.
        back, ended = returned(moment, way, met, off, bounce)
        way, bounce = chosen(back, ended, chosen(bounce, off, way)), bounce & ~back
        met = chosen(bounce, moment.meet(way.ray, bounce), met)
        gone |= bounce
    return way, met, gone


def _ended(
    moment: Moment, way: Way, met: Meeting, sunshine: Callable[[Ray, Mask], tuple[Mask, Lanes]], firing: Firing
) -> Hits:
    """Return the Hits at the end of a path.

    sunshine  from shadow rays and (n,) flags of those that matter: (n,) whether the sun is seen, and share of its light
    """
    import drjit as dr

    mi = mitsuba()
    world, surface, length_m = moment.world, met.surface, way.length_m + met.t
    # A sensor that drives into a wall has the wall in its housing: the echo at no distance would have no bounds.
    found = met.found & (length_m >= firing.housing_m)
    # Two-sided: meshes from elsewhere are rarely wound consistently, so a normal may point inwards. Everything here
    # happens on the side from which the ray came: the normal is turned against the ray.
    facing = dr.select(dr.dot(surface.n, met.seen.d) > 0.0, -1.0, 1.0)
    normal = surface.n * facing
    cos_sun = dr.dot(normal, met.to_sun)
    sunny, side = found & (cos_sun > 0.0), normal
    # A leaf shows the sun that shines on its far side: there the shadow ray starts on that side.
    through, behind = _let_through(world, met, cos_sun)
    if behind is not None:
        sunny, side = sunny | behind, dr.select(behind, -normal, normal)
    # Above the surface, or rounding would put half of the shadow rays inside of it ("shadow acne").
    start = met.outside(surface.p + side * START_OFFSET_M)
    away = met.receding(start, way.ray.d)
    receding = way.receding_m_s if away is None else way.receding_m_s + away
    lit, share = sunshine(mi.Ray3f(start, mi.Vector3f(*moment.sun)), sunny)
    back, towards_sun, reflectivity = _scattering(mi, dr, world, surface, met.to_sun, found, lit)
    if behind is not None:
        towards_sun = dr.select(lit & behind, through * -cos_sun * dr.inv_pi, towards_sun)
    # A triangle's number within its shape, the shape's first number in the world's tables, and the shift to the body
    # where several bodies share the shape. Body, class and material are looked up by it later, for kept points only.
    number = dr.reinterpret_array(mi.UInt32, surface.shape)
    face = dr.gather(mi.UInt32, world.first_face, number, found) + surface.prim_index + met.shift
    return Hits(
        found=found,
        range_m=dr.select(found, length_m, 1.0),  # not infinity: later stages divide by it
        cos_incidence=dr.select(found, xp(met.t).minimum(-dr.dot(normal, met.seen.d), 1.0), 0.0),
        backscatter_per_sr=back + way.glint_per_sr,
        sun_scatter_per_sr=towards_sun * share,
        reflectivity=reflectivity,
        transmittance=through,
        cos_sun=dr.select(found, cos_sun, 0.0),
        lit=lit,
        radial_velocity_m_s=dr.select(found, receding, 0.0) if is_drjit(receding) else 0.0,
        face=dr.select(found, mi.Int32(face), -1),
        throughput=way.throughput,
        interactions=way.interactions,
        mirrored=way.mirrored,
        direction=tuple(way.ray.d) if is_drjit(way.interactions) else None,
        normal=_where(found, met.turned(normal)) if firing.vectors else None,
        velocity_m_s=_where(found, met.velocity(start)) if firing.vectors else None,
    )


def _where(found: Mask, vector: DeviceVector) -> Vector:
    """Return the components of a vector, 0 where nothing was found."""
    import drjit as dr

    x, y, z = (dr.select(found, component, 0.0) for component in components(vector))
    return x, y, z


def _sunshine(moment: Moment, ray: Ray, sunny: Mask, interactions: int) -> tuple[Any, Lanes]:
    """Return whether the sun is seen along these shadow rays, and the share of its light that arrives."""
    speculars = moment.world.speculars
    if speculars is None or not speculars.lets_through:
        return sunny & ~moment.blocked(ray, sunny), 1.0
    share = sunlight_share(moment, ray, sunny, interactions=interactions)
    return share > 0.0, share


def _receding(velocity_m_s: Vector | None, direction: Vector) -> Lanes:
    """Rate at which the sensor's own motion lengthens the range, m/s."""
    return 0.0 if velocity_m_s is None else -_along(velocity_m_s, direction)


def _along(velocity_m_s: Vector, direction: Vector) -> Lanes:
    return sum(v * d for v, d in zip(velocity_m_s, direction, strict=True))


def _let_through(world: World, met: Meeting, cos_sun: Array) -> tuple[Lanes, Any]:
    """Return the diffuse transmittance tau of what was met, and where sunlight on its far side is seen (T68).

    The second is None in a world in which nothing transmits diffusely.
    """
    import drjit as dr

    mi = mitsuba()
    if world.shape_transmittance is None:
        return 0.0, None
    number = dr.reinterpret_array(mi.UInt32, met.surface.shape)
    through = dr.gather(mi.Float, world.shape_transmittance, number, met.found)
    return through, (cos_sun < 0.0) & (through > 0.0)


def _scattering(
    mi: ModuleType, dr: ModuleType, world: World, surface: Surface, to_sun: DeviceVector, found: Mask, lit: Mask
) -> tuple[Any, Any, Any]:
    """Return f_r cos(theta) back along the ray and towards the sun, 1/sr, and the diffuse reflectivity."""
    # Mitsuba's `eval` includes the cosine of the outgoing direction. Outgoing is `wi` itself in the first call: the
    # light returns along the ray by which it came.
    context = mi.BSDFContext()
    bsdf = surface.bsdf()
    back = bsdf.eval(context, surface, surface.wi, found)
    # Reciprocity: light from the sun into the ray is light along the ray into the sun's direction.
    towards_sun = bsdf.eval(context, surface, surface.to_local(to_sun), lit)
    number = dr.reinterpret_array(mi.UInt32, surface.shape)
    if world.speculars is not None and world.speculars.gaps:
        # A ray that ends at a porous surface has met its solid part. Mitsuba's mask returns the mean over solid and
        # gaps, so it is divided by the share that is solid.
        porous = world.speculars.is_porous(dr.gather(mi.UInt32, world.speculars.kind, number, found))
        solid = 1.0 - gap_share(surface, porous)
        solid = xp(solid).maximum(solid, 1e-6)
        back, towards_sun = back / solid, towards_sun / solid
    reflectivity = dr.gather(mi.Float, world.shape_reflectivity, number, found)
    # -1 in the table: a BSDF of a Mitsuba file, of which only the BSDF itself knows the reflectivity.
    if world.has_foreign:
        own = bsdf.eval_diffuse_reflectance(surface, found)[0]
        reflectivity = dr.select(reflectivity < 0.0, own, reflectivity)
    return dr.select(found, back[0], 0.0), dr.select(lit, towards_sun[0], 0.0), reflectivity
