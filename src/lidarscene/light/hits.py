"""Hits: what each ray met. Geometry and scattering, never watts."""

from __future__ import annotations

from dataclasses import dataclass

from ..maths.arrays import Lanes, Mask
from ..maths.vectors import Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class Hits:
    """The surface at the end of each ray's way, in beam order, numpy or Dr.Jit.

    The way goes through panes and off mirrors; without those it is the ray, and its end the first surface.

    found               (n,) bool, whether anything was met; where not, the rest is 0, range 1, face -1
    range_m             (n,) from the sensor, all the way
    cos_incidence       (n,) in [0, 1], there, between the ray and the geometric normal
    backscatter_per_sr  (n,) f_r(w, w) cos(theta), back along the ray
    sun_scatter_per_sr  (n,) V f_r(w_sun, w) cos(theta_s), 0 in shadow
    reflectivity        (n,) diffuse hemispherical
    transmittance       (n,) the same, of light that comes out on the other side; 0.0 where all surfaces are opaque
    cos_sun             (n,) between the normal (on the ray's side) and the sun; negative if it is behind
    lit                 (n,) bool, whether the sun is seen, by a thin surface from either side
    radial_velocity_m_s (n,) of the surface against the sensor, along the ray, positive where they part; 0.0 where
                        nothing in the scene moves
    face                (n,) int32, triangle number in the world's tables; -1 where nothing was met
    goes_on             (n,) bool, of a survey: whether panes, mirrors or gaps have to do with this ray or its sunlight;
                        None where all ways were traced
    throughput          (n,) share of the light that panes and mirrors leave, one way; back it is the same again
    interactions        (n,) uint32, panes, mirrors and gaps on the way
    direction           (x, y, z) unit vector along the last of the way, or None: that of the beam
    mirrored            (n,) bool, whether one of them mirrored it: the surface is not where the beam points
    """

    found: Mask
    range_m: Lanes
    cos_incidence: Lanes
    backscatter_per_sr: Lanes
    sun_scatter_per_sr: Lanes
    reflectivity: Lanes
    cos_sun: Lanes
    lit: Mask
    face: Lanes
    transmittance: Lanes = 0.0
    radial_velocity_m_s: Lanes = 0.0
    goes_on: Mask | None = None
    throughput: Lanes = 1.0
    interactions: Lanes = 0
    mirrored: Mask = False
    direction: Vector | None = None
