"""Trace beams through a world: find the surface at the end of each path, and what it scatters.

A beam has one path, or two in a world with panes: through the first pane, and off it. Along each path the nearest
surface is found, again after each pane, mirror or gap; from its end one shadow ray goes to the sun. A `Hits` is
geometry and scattering, never watts. The BSDF is evaluated in two directions, back along the beam and towards the sun,
and nothing is sampled: there is no Monte Carlo noise (docs/theory.md 4, docs/theory_glass.md 1).

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
from ...maths.motion_table import MovingBodies
from ...maths.random import Seed
from ...maths.vectors import Vector
from ..device import transfer
from ..device.backend import mitsuba
from ..device.types import Bsdf, DeviceVector, Interaction, Ray, components
from ..world.mitsuba_world import World, placed_movers
from .gaps import Draws, gap_share
from .glints import specular_return
from .meeting import Meeting, Moment
from .onward import START_OFFSET_M, BeamPath, continued, kind_of, select_fields, stopped, sunlight_share
from .polarised import PolarisedBeam


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Firing:
    """Properties of rays other than origin and direction.

    Attributes:
        seed: of the frame: random numbers of the gaps
        ray: (n,) number of each ray within its pulse, for the same; 0 if it is the only one
        active: whether each ray is traced; the others meet nothing
        velocity_m_s: of the point from which each ray leaves; None: it stands still
        aim: axes and widths of the beams, for specular returns; None: there are none
        housing_m: radius of the sensor itself: what is nearer is no hit
        vectors: whether to return normals and velocities of the surfaces
        polarisation: axis across each ray along which its light swings, and the share of it that does; None: left out
        met: (range_m, face) of these rays' `Hits` in a survey, which are not asked for again; () without one
    """

    seed: Seed = 0
    ray: Lanes = 0
    active: Mask = True
    housing_m: Lanes = 0.0
    velocity_m_s: Vector | None = None
    aim: Aim | None = None
    vectors: bool = False
    polarisation: tuple[Vector, Lanes] | None = None
    met: tuple[Array, ...] = ()


def trace(
    world: World,
    beams: Beams,
    *,
    sun: Vector,
    moving: MovingBodies | None = None,
    interactions: int = INTERACTIONS,
    survey: bool = False,
    firing: Firing | None = None,
) -> tuple[Hits, ...]:
    """Return the surface at the end of each ray's paths, one `Hits` for each path, on the device.

    The first path goes through panes, off mirrors, and through gaps where the ray finds one. In a world with panes
    there is a second path: it is reflected at the first pane that the first path meets, and goes on in the same way.
    If there is no such pane it carries no light.

    Args:
        sun: (x, y, z) unit vector towards the sun
        moving: where each of the world's movers is when each ray leaves; None: as at time 0
        interactions: largest number of panes, mirrors and gaps on each path. At the next pane or mirror the path ends
            without an echo; the next porous surface counts as solid
        survey: end each ray at its first surface, and flag (`Hits.goes_on`) those that have to be traced in full: rays
            that meet a pane, mirror or porous surface, or whose sunlight comes through one. A kernel that follows all
            paths costs every ray its queries, and few rays meet glass
        firing: None: one ray to a pulse, from a sensor at rest, without specular returns, seed 0
    """
    mi = mitsuba()
    firing = firing or Firing()
    if moving is None and world.movers:
        poses = [mover.body.pose for mover in world.movers]
        moving = placed_movers(world.movers, poses, centre_m=world.centre_m)
    moment = Moment(
        world=world,
        sun=sun,
        coherent=True,
        moving=moving,
        draws=Draws(seed=firing.seed, pulse=beams.pulse, ray=firing.ray),
        aim=firing.aim,
    )
    ray = mi.Ray3f(mi.Point3f(*beams.origin_m), mi.Vector3f(*beams.direction))
    first = BeamPath(ray=ray, receding_m_s=_receding(firing.velocity_m_s, beams.direction))
    if world.speculars is None:
        survey = False
    if survey:
        return (_survey(moment, first, moment.meet(ray, firing.active), firing),)
    if world.speculars is not None and firing.polarisation is not None:
        first = dataclasses.replace(first, polarised=PolarisedBeam.start(*firing.polarisation))
    paths = _follow_paths(moment, first, interactions, firing)

    def sunshine(ray: Ray, sunny: Mask) -> tuple[Any, Lanes]:
        return _sunshine(moment, ray, sunny, interactions)

    hits = []
    for path, meeting in paths:
        hits.append(_hits(moment, path, meeting, sunshine, firing))
        transfer.split_kernel(hits[-1])
    return tuple(hits)


def _survey(moment: Moment, path: BeamPath, meeting: Meeting, firing: Firing) -> Hits:
    """Return the first surface of each ray, with `Hits.goes_on`: whether the ray has to be traced in full."""
    mi = mitsuba()
    through_glass = mi.Bool(False)

    # `_hits` asks for the sunlight once, with the shadow rays: the same rays tell whether glass is in the sun's way.
    def sunshine(ray: Ray, sunny: Mask) -> tuple[Any, Lanes]:
        nonlocal through_glass
        lit = sunny & ~moment.blocked(ray, sunny)
        through_glass = moment.glazed(ray, lit)
        return lit, 1.0

    hits = _hits(moment, path, meeting, sunshine, firing)
    goes_on = (kind_of(moment, meeting) > 0) | moment.glazed(path.ray, firing.active, meeting.t) | through_glass
    return dataclasses.replace(hits, goes_on=goes_on)


def _follow_paths(moment: Moment, path: BeamPath, interactions: int, firing: Firing) -> list[tuple[BeamPath, Meeting]]:
    """Return each path of the rays, with the surface at its end: one path, or two in a world with panes."""
    mi, active = mitsuba(), firing.active
    meeting, speculars = moment.meet(path.ray, active, firing.met), moment.world.speculars
    if speculars is None:
        return [(path, meeting)]
    if not interactions:
        return [(path, _at_last_pane(moment, path, meeting, mi.Bool(active)))]
    # `going_on` are the lanes whose path has gone on at every step so far, `mirrored` those with a second path, which
    # begins at the first pane. Without mirrors and gaps the first pane, if there is one, is met at the first step, and
    # the later steps need no code for it.
    second, mirrored, going_on = path, mi.Bool(False), mi.Bool(active)
    for number in range(interactions):
        pane = _pane_before(moment, path, meeting, going_on)
        if pane is not None and speculars.panes and (number == 0 or speculars.mirrors or speculars.gaps):
            splits = pane.valid & ~mirrored
            if speculars.gaps:
                splits &= speculars.is_pane(kind_of(moment, pane))
            reflected = continued(moment, path, pane, splits, reflected=True)
            comes_back, ended = specular_return(moment, path, pane, reflected, splits)
            second = select_fields(splits, select_fields(comes_back, ended, reflected), second)
            mirrored |= splits
        path, meeting, going_on = _step(moment, path, meeting, pane, going_on)
    meeting = _at_last_pane(moment, path, meeting, going_on)
    transfer.split_kernel(path, meeting, second, mirrored)
    if not speculars.panes:
        return [(path, meeting)]
    return [(path, meeting), _second_path(moment, second, mirrored, interactions)]


def _second_path(moment: Moment, path: BeamPath, active: Mask, interactions: int) -> tuple[BeamPath, Meeting]:
    """Follow the second path from the first pane on, on the lanes that have one."""
    import drjit as dr

    path = dataclasses.replace(path, throughput=dr.select(active, path.throughput, 0.0))
    comes_back = active & (path.glint_per_sr > 0.0)  # a specular return: the path ends at that pane
    meeting, going_on = moment.meet(path.ray, active), active & ~comes_back
    # The first pane was one interaction. A path that met a mirror before it has used up more than one.
    for _ in range(1, interactions):
        going_on = going_on & (path.interactions < interactions)
        path, meeting, going_on = _step(moment, path, meeting, _pane_before(moment, path, meeting, going_on), going_on)
    meeting = _at_last_pane(moment, path, meeting, going_on | comes_back)
    transfer.split_kernel(path, meeting)
    return path, meeting


def _pane_before(moment: Moment, path: BeamPath, meeting: Meeting, active: Mask) -> Meeting | None:
    """Return the nearest pane or porous surface in front of what was met; None in a world without any."""
    return moment.pane(path.ray, meeting.t, active) if moment.speculars.lets_through else None


def _at_last_pane(moment: Moment, path: BeamPath, meeting: Meeting, active: Mask) -> Meeting:
    """Return the end of a path that has used all its interactions: what was met, or a pane in front of it."""
    pane = _pane_before(moment, path, meeting, active)
    return meeting if pane is None else select_fields(pane.valid, pane, meeting)


def _step(
    moment: Moment, path: BeamPath, meeting: Meeting, pane: Meeting | None, active: Mask
) -> tuple[BeamPath, Meeting, Any]:
    """Take one step where ``active`` holds: through a pane or gap, or off a mirror.

    Returns:
        the path, what it meets next, and (n,) whether it has gone on
    """
    import drjit as dr

    going_on, path_before = active & False, path
    if pane is not None:
        ends, stop = stopped(moment, path, pane, meeting.t)
        going_on = pane.valid & ~ends
        path = continued(moment, path, pane, going_on, reflected=False)
        # A thin pane does not bend the ray. What stands behind it is known already, since panes are in scenes of their
        # own: only its distance is less, by the path up to the pane. That saves a query for each pane.
        nearer = meeting.t - (path.length_m - path_before.length_m)
        meeting = select_fields(ends, stop, dataclasses.replace(meeting, t=dr.select(going_on, nearer, meeting.t)))
    if moment.speculars.mirrors:
        bounce = active & ~going_on & moment.speculars.is_mirror(kind_of(moment, meeting))
        reflected = continued(moment, path, meeting, bounce, reflected=False)
        # A mirror normal to the beam ends the path with a specular return; off all others it goes on.
        comes_back, ended = specular_return(moment, path, meeting, reflected, bounce)
        path, bounce = select_fields(comes_back, ended, reflected), bounce & ~comes_back
        meeting = select_fields(bounce, moment.meet(path.ray, bounce), meeting)
        going_on |= bounce
    return path, meeting, going_on


def _hits(
    moment: Moment,
    path: BeamPath,
    meeting: Meeting,
    sunshine: Callable[[Ray, Mask], tuple[Mask, Lanes]],
    firing: Firing,
) -> Hits:
    """Return the Hits at the end of a path.

    Args:
        sunshine: from shadow rays and (n,) flags of those that matter: (n,) whether the sun is seen, and share of its
            light
    """
    import drjit as dr

    mi = mitsuba()
    world, surface, length_m = moment.world, meeting.surface, path.length_m + meeting.t
    # A sensor that drives into a wall has the wall in its housing: the echo at no distance would have no bounds.
    valid = meeting.valid & (length_m >= firing.housing_m)
    # Two-sided: meshes from elsewhere are rarely wound consistently, so a normal may point inwards. Everything here
    # happens on the side from which the ray came: the normal is turned against the ray.
    facing = dr.select(dr.dot(surface.n, meeting.local_ray.d) > 0.0, -1.0, 1.0)
    normal = surface.n * facing
    cos_sun = dr.dot(normal, meeting.to_sun)
    sunny, side = valid & (cos_sun > 0.0), normal
    # A leaf shows the sun that shines on its far side: there the shadow ray starts on that side.
    through, behind = _diffuse_transmittance(world, meeting, cos_sun)
    if behind is not None:
        sunny, side = sunny | behind, dr.select(behind, -normal, normal)
    # Above the surface, or rounding would put half of the shadow rays inside of it ("shadow acne").
    start = meeting.point_outside(surface.p + side * START_OFFSET_M)
    surface_receding = meeting.receding(start, path.ray.d)
    velocity_m_s = meeting.velocity(start) if firing.vectors else None
    receding = path.receding_m_s if surface_receding is None else path.receding_m_s + surface_receding
    lit, share = sunshine(mi.Ray3f(start, mi.Vector3f(*moment.sun)), sunny)
    backscatter, towards_sun, reflectivity = _scattering(mi, dr, world, surface, meeting.to_sun, valid, lit)
    if behind is not None:
        towards_sun = dr.select(lit & behind, through * -cos_sun * dr.inv_pi, towards_sun)
    return Hits(
        has_surface=valid,
        range_m=dr.select(valid, length_m, 1.0),  # not infinity: later stages divide by it
        cos_incidence=dr.select(valid, xp(meeting.t).minimum(-dr.dot(normal, meeting.local_ray.d), 1.0), 0.0),
        backscatter_per_sr=backscatter + path.glint_per_sr,
        sun_scatter_per_sr=towards_sun * share,
        reflectivity=reflectivity,
        transmittance=through,
        cos_sun=dr.select(valid, cos_sun, 0.0),
        lit=lit,
        radial_velocity_m_s=dr.select(valid, receding, 0.0) if is_drjit(receding) else 0.0,
        face=dr.select(valid, mi.Int32(meeting.row), -1),
        throughput=path.throughput,
        outward=_outward(moment, path, meeting),
        interactions=path.interactions,
        mirrored=path.mirrored,
        direction=tuple(path.ray.d) if is_drjit(path.interactions) else None,
        normal=_components_where(valid, meeting.direction_outside(normal)) if firing.vectors else None,
        velocity_m_s=None if velocity_m_s is None else _components_where(valid, velocity_m_s),
    )


def _outward(moment: Moment, path: BeamPath, meeting: Meeting) -> Lanes | None:
    """Return `Hits.outward` at the end of a path; None if the light's polarisation is left out."""
    import drjit as dr

    if path.polarised is None:
        return None
    # Panes and mirrors that throw the beam straight back, and retro-reflectors, keep the polarisation; all other
    # surfaces are taken to return none.
    keeps, retro = mitsuba().Bool(path.glint_per_sr > 0.0), moment.speculars.retro
    if retro is not None:
        number = dr.reinterpret_array(mitsuba().UInt32, meeting.surface.shape)
        keeps |= dr.gather(mitsuba().Bool, retro, number, meeting.valid)
    # A specular return has the root of its reflectance in `throughput`, which the way out must have too; a path that
    # carries no light has 0 there. Elsewhere both are alike.
    before = path.polarised.unpolarised.intensity
    return path.polarised.outward(keeps) * (path.throughput / dr.maximum(before, 1e-12))


def _components_where(valid: Mask, vector: DeviceVector) -> Vector:
    """Return the components of a vector, 0 where nothing was found."""
    import drjit as dr

    x, y, z = (dr.select(valid, component, 0.0) for component in components(vector))
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
    return 0.0 if velocity_m_s is None else -_speed_along(velocity_m_s, direction)


def _speed_along(velocity_m_s: Vector, direction: Vector) -> Lanes:
    return sum(v * d for v, d in zip(velocity_m_s, direction, strict=True))


def _diffuse_transmittance(world: World, meeting: Meeting, cos_sun: Array) -> tuple[Lanes, Any]:
    """Return the diffuse transmittance tau of what was met, and where sunlight on its far side is seen (T68).

    The second is None in a world in which nothing transmits diffusely.
    """
    import drjit as dr

    mi = mitsuba()
    if world.shape_transmittance is None:
        return 0.0, None
    number = dr.reinterpret_array(mi.UInt32, meeting.surface.shape)
    through = dr.gather(mi.Float, world.shape_transmittance, number, meeting.valid)
    return through, (cos_sun < 0.0) & (through > 0.0)


def _scattering(
    mi: ModuleType, dr: ModuleType, world: World, surface: Interaction, to_sun: DeviceVector, valid: Mask, lit: Mask
) -> tuple[Any, Any, Any]:
    """Return f_r cos(theta) back along the ray and towards the sun, 1/sr, and the diffuse reflectivity."""
    # Mitsuba's `eval` includes the cosine of the outgoing direction. Outgoing is `wi` itself in the first call: the
    # light returns along the ray by which it came.
    context = mi.BSDFContext()

    def scattered(bsdf: Bsdf, surface: Interaction, towards: DeviceVector, active: Mask) -> Any:
        return bsdf.eval(context, surface, towards, active)[0]

    backscatter = world.ask_bsdf(scattered, surface, surface.wi, active=valid)
    # Reciprocity: light from the sun into the ray is light along the ray into the sun's direction.
    towards_sun = world.ask_bsdf(scattered, surface, surface.to_local(to_sun), active=lit)
    number = dr.reinterpret_array(mi.UInt32, surface.shape)
    if world.speculars is not None and world.speculars.gaps:
        # A ray that ends at a porous surface has met its solid part. Mitsuba's mask returns the mean over solid and
        # gaps, so it is divided by the share that is solid.
        porous = world.speculars.is_porous(dr.gather(mi.UInt32, world.speculars.kind, number, valid))
        solid = 1.0 - gap_share(world, surface, porous)
        solid = xp(solid).maximum(solid, 1e-6)
        backscatter, towards_sun = backscatter / solid, towards_sun / solid
    reflectivity = dr.gather(mi.Float, world.shape_reflectivity, number, valid)
    # -1 in the table: a BSDF of a Mitsuba file, whose reflectivity only the BSDF itself can give.
    if world.has_foreign:

        def diffuse(bsdf: Bsdf, surface: Interaction, active: Mask) -> Any:
            return bsdf.eval_diffuse_reflectance(surface, active)[0]

        reflectivity = dr.select(reflectivity < 0.0, world.ask_bsdf(diffuse, surface, active=valid), reflectivity)
    return dr.select(valid, backscatter, 0.0), dr.select(lit, towards_sun, 0.0), reflectivity
