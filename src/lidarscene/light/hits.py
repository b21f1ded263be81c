"""Hits: the surface that each ray met, as geometry and scattering.

Power is left to `echoes`: no field here depends on the power of the laser, on the receiver or on the air.

Symbols: f_r BSDF, theta angle of incidence, w direction back along the ray, V visibility of the sun.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..maths.arrays import Lanes, Mask, xp
from ..maths.vectors import UP, Vector, cross, dot


@dataclass(frozen=True, slots=True, kw_only=True)
class Hits:
    """The surface at the end of each ray's path, in beam order, NumPy or Dr.Jit.

    The path goes through panes and off mirrors; without those it is the ray up to the first surface.

    Attributes:
        has_surface: (n,) bool, whether a surface was met; if not, the range is 1, the face -1 and the rest 0
        range_m: (n,) length of the path from the sensor
        cos_incidence: (n,) in [0, 1], between the ray and the geometric normal at the surface
        backscatter_per_sr: (n,) f_r(w, w) cos(theta), back along the ray
        sun_scatter_per_sr: (n,) V f_r(w_sun, w) cos(theta_s), 0 in shadow
        reflectivity: (n,) diffuse hemispherical
        transmittance: (n,) diffuse hemispherical, of light that leaves on the other side; 0.0 if all are opaque
        cos_sun: (n,) between the normal on the ray's side and the sun; negative if the sun is behind
        lit: (n,) bool, whether the sun lights the surface; a thin one from either side
        radial_velocity_m_s: (n,) of the surface relative to the sensor, along the ray, positive if they move apart; 0.0
            if nothing in the scene moves
        face: (n,) int32, row of its body and material in the world's tables; -1 where nothing was met
        goes_on: (n,) bool, of a survey: whether panes, mirrors or gaps affect this ray or its sunlight; None if all
            paths were traced in full
        throughput: (n,) share of the light that panes and mirrors pass, one way; the way back takes it once more
        outward: (n,) the same of the laser's polarised light on its way out, with what its echo gains or loses on the
            way back if the surface keeps the polarisation; None: that of `throughput`
        interactions: (n,) uint32, number of panes, mirrors and gaps on the path
        direction: (x, y, z) unit vector along the last leg of the path; None: that of the beam
        mirrored: (n,) bool, whether the path was reflected: the surface is not where the beam points
        normal: (x, y, z) unit normal of the surface on the ray's side, None if it is not asked for. In the world's
            axes; `rendering.stages` turns it into the sensor's as the pulse leaves
        row_slope: (n,) relative change of the range over the azimuth [1/rad] where the beam turns on about the sensor's
            z axis and the surface goes on as a plane; None if it is not asked for
        velocity_m_s: (x, y, z) of the surface in the world, likewise; None also where nothing moves: zeros would have
            the number of lanes that they were recorded with
    """

    has_surface: Mask
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
    outward: Lanes | None = None
    interactions: Lanes = 0
    mirrored: Mask = False
    direction: Vector | None = None
    normal: Vector | None = None
    velocity_m_s: Vector | None = None
    row_slope: Lanes | None = None


LEAST_COSINE = 0.01
"""Accuracy bought: least cosine of incidence: flatter surfaces lean as this one does."""


def relative_row_slope(normal: Vector, direction: Vector) -> Lanes:
    """Relative change of the range over the azimuth, as of `Hits.row_slope`: dR / (R dphi) = -n (z x d) / (n d).

    Args:
        normal: unit normals towards the sensor, in its axes; 0 without a surface, whose change is 0
        direction: unit vectors of the beams, in the same axes
    """
    ops = xp(*normal, *direction)
    return dot(normal, cross(UP, direction)) / ops.maximum(-dot(normal, direction), LEAST_COSINE)
