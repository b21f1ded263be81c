"""Trace: a World and Beams in, Hits out. One closest-hit and one sun-visibility query per ray."""

from __future__ import annotations

from typing import Any

from ..arrays import Array, xp
from ..beams import Beams
from ..hits import Hits
from .backend import mitsuba
from .world import World

SHADOW_OFFSET_M = 3e-4
"""How far in front of a surface its shadow ray starts. Mitsuba's own offset grows to 22 mm at 250 m and would
jump through a 5 mm pane; float32 positions at 250 m are good to 0.03 mm (MITSUBA.md 5.7)."""


def trace(world: World, beams: Beams, *, sun: tuple[Array, Array, Array], coherent: bool = True) -> Hits:
    """First surface of each ray, on the device.

    sun       (x, y, z) unit vector towards the sun
    coherent  whether neighbouring rays are neighbours in angle
    """
    import drjit as dr

    mi = mitsuba()
    direction = mi.Vector3f(*beams.direction)
    ray = mi.Ray3f(mi.Point3f(*beams.origin_m), direction)
    first = world.scene.ray_intersect_preliminary(ray, coherent=coherent)
    found = first.is_valid()
    surface = first.compute_surface_interaction(ray, mi.RayFlags.All, found)

    # Everything happens on the side of the surface that the ray came from, whatever the winding.
    facing = dr.select(dr.dot(surface.n, direction) > 0.0, -1.0, 1.0)
    normal = surface.n * facing
    to_sun = mi.Vector3f(*sun)
    cos_sun = dr.dot(normal, to_sun)
    shadow = mi.Ray3f(surface.p + normal * SHADOW_OFFSET_M, to_sun)
    sunny = found & (cos_sun > 0.0)
    lit = sunny & ~world.scene.ray_test(shadow, coherent=coherent, active=sunny)

    back, towards_sun, reflectivity = _scattering(mi, dr, world, surface, to_sun, found, lit)
    number = dr.reinterpret_array(mi.UInt32, surface.shape)
    face = dr.gather(mi.UInt32, world.first_face, number, found) + surface.prim_index
    return Hits(
        found=found,
        range_m=dr.select(found, first.t, 1.0),
        cos_incidence=dr.select(found, xp(first.t).minimum(-dr.dot(normal, direction), 1.0), 0.0),
        backscatter_per_sr=back,
        sun_scatter_per_sr=towards_sun,
        reflectivity=reflectivity,
        cos_sun=dr.select(found, cos_sun, 0.0),
        lit=lit,
        face=dr.select(found, mi.Int32(face), -1),
    )


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
