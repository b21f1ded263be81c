"""Trace: a World and Beams in, Hits out. One closest-hit and one sun-visibility query per ray and rigid frame.

Rays are carried into the frame of each moving body as it stands when they leave; the nearest hit is kept, and the
surface is looked at in the frame of its own body (MITSUBA.md 5.5: hit by hit what a rebuilt scene gives).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..arrays import Array, is_drjit, xp
from ..beams import Beams
from ..hits import Hits
from ..motion import Placement
from ..scan.vectors import Vector
from . import device
from .backend import mitsuba
from .world import Mover, World

SHADOW_OFFSET_M = 3e-4
"""How far in front of a surface its shadow ray starts. Mitsuba's own offset grows to 22 mm at 250 m and would
jump through a 5 mm pane; float32 positions at 250 m are good to 0.03 mm (MITSUBA.md 5.7)."""


def trace(
    world: World,
    beams: Beams,
    *,
    sun: Vector,
    coherent: bool = True,
    placements: Sequence[Placement] | None = None,
    sensor_velocity_m_s: Vector | None = None,
) -> Hits:
    """First surface of each ray, on the device.

    sun                  (x, y, z) unit vector towards the sun
    coherent             whether neighbouring rays are neighbours in angle
    placements           of each of the world's movers when each ray leaves; where they are at time 0 if None
    sensor_velocity_m_s  of the point that each ray leaves from; it stands still if None
    """
    import drjit as dr

    mi = mitsuba()
    direction = mi.Vector3f(*beams.direction)
    ray = mi.Ray3f(mi.Point3f(*beams.origin_m), direction)
    if placements is None:
        placements = [mover.rest for mover in world.movers]
    moving = list(zip(world.movers, placements, strict=True))
    first = world.scene.ray_intersect_preliminary(ray, coherent=coherent)
    seen, to_sun, shift = ray, mi.Vector3f(*sun), mi.UInt32(0)  # in the frame of what was hit
    met: list[Any] = []
    for mover, place in moving:
        carried = _carried(mi, ray, place)
        device.apart(first)
        hit = mover.scene.ray_intersect_preliminary(
            carried, coherent=coherent, active=_near(dr, carried, mover)
        )
        nearer = hit.is_valid() & (hit.t < first.t)
        first, seen = dr.select(nearer, hit, first), dr.select(nearer, carried, seen)
        to_sun = dr.select(nearer, mi.Vector3f(*place.vector_within(tuple(sun))), to_sun)
        shift = dr.select(nearer, mover.face_shift, shift)
        met = [one & ~nearer for one in met] + [nearer]
    found = first.is_valid()
    surface = first.compute_surface_interaction(seen, mi.RayFlags.All, found)

    # Everything happens on the side of the surface that the ray came from, whatever the winding.
    facing = dr.select(dr.dot(surface.n, seen.d) > 0.0, -1.0, 1.0)
    normal = surface.n * facing
    cos_sun = dr.dot(normal, to_sun)
    start = surface.p + normal * SHADOW_OFFSET_M
    receding = _receding(sensor_velocity_m_s, beams.direction)
    for (_, place), here in zip(moving, met, strict=True):
        at = place.point(tuple(start))
        start = dr.select(here, mi.Point3f(*at), start)
        receding = dr.select(here, receding + _along(place.velocity_at(at), beams.direction), receding)
    sunny = found & (cos_sun > 0.0)
    lit = sunny & ~_shadowed(world, moving, mi.Ray3f(start, mi.Vector3f(*sun)), sunny, coherent=coherent)

    back, towards_sun, reflectivity = _scattering(mi, dr, world, surface, to_sun, found, lit)
    number = dr.reinterpret_array(mi.UInt32, surface.shape)
    face = dr.gather(mi.UInt32, world.first_face, number, found) + surface.prim_index + shift
    return Hits(
        found=found,
        range_m=dr.select(found, first.t, 1.0),
        cos_incidence=dr.select(found, xp(first.t).minimum(-dr.dot(normal, seen.d), 1.0), 0.0),
        backscatter_per_sr=back,
        sun_scatter_per_sr=towards_sun,
        reflectivity=reflectivity,
        cos_sun=dr.select(found, cos_sun, 0.0),
        lit=lit,
        radial_velocity_m_s=dr.select(found, receding, 0.0) if is_drjit(receding) else 0.0,
        face=dr.select(found, mi.Int32(face), -1),
    )


def _carried(mi: Any, ray: Any, place: Placement) -> Any:
    """A ray of the traced frame, in that of a body."""
    origin, direction = place.point_within(tuple(ray.o)), place.vector_within(tuple(ray.d))
    return mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*direction))


def _near(dr: Any, ray: Any, mover: Mover) -> Any:
    """Whether a ray in the body's frame comes into the sphere around it."""
    x, y, z, radius = mover.sphere
    to = type(ray.o)(x, y, z) - ray.o
    along = dr.dot(to, ray.d)
    apart = dr.squared_norm(to - along * ray.d)
    # A little wider, for rounding: 1e-6 of the distance is ten times what single precision loses.
    room = radius + 1e-6 * dr.abs(along)
    return (apart <= room * room) & (along > -room)


def _shadowed(
    world: World, moving: list[tuple[Mover, Placement]], ray: Any, active: Any, *, coherent: bool
) -> Any:
    """Whether anything stands between these points and the sun, when the pulse left."""
    import drjit as dr

    mi = mitsuba()
    dark = world.scene.ray_test(ray, coherent=coherent, active=active)
    for mover, place in moving:
        carried = _carried(mi, ray, place)
        device.apart(dark)
        still_lit = active & ~dark & _near(dr, carried, mover)
        dark |= mover.scene.ray_test(carried, coherent=coherent, active=still_lit)
    return dark


def _receding(velocity_m_s: Vector | None, direction: Vector) -> Array:
    """By how much the sensor's own motion adds to the range, per second."""
    return 0.0 if velocity_m_s is None else -_along(velocity_m_s, direction)


def _along(velocity_m_s: Vector, direction: Vector) -> Array:
    return sum(v * d for v, d in zip(velocity_m_s, direction, strict=True))


def _scattering(
    mi: Any, dr: Any, world: World, surface: Any, to_sun: Any, found: Any, lit: Any
) -> tuple[Any, Any, Any]:
    """f_r cos(theta) back along the ray and towards the sun, and the diffuse reflectivity."""
    context = mi.BSDFContext()
    bsdf = surface.bsdf()
    back = bsdf.eval(context, surface, surface.wi, found)
    # Reciprocity: light from the sun into the ray is light along the ray into the sun's direction.
    towards_sun = bsdf.eval(context, surface, surface.to_local(to_sun), lit)
    number = dr.reinterpret_array(mi.UInt32, surface.shape)
    reflectivity = dr.gather(mi.Float, world.shape_reflectivity, number, found)
    if world.has_foreign:
        own = bsdf.eval_diffuse_reflectance(surface, found)[0]
        reflectivity = dr.select(reflectivity < 0.0, own, reflectivity)
    return dr.select(found, back[0], 0.0), dr.select(lit, towards_sun[0], 0.0), reflectivity
