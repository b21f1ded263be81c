"""Ambient light in the receiver's band: sun, sky, and the radiance of what they light.

A sensor file states its in-band solar irradiance at normal incidence for 100 klux, behind its filter (29.4 W/m2 in
Table 1). It is linear in the illuminance.

Symbols: E_sun and E_sky irradiances, L radiance, V 1 in the sun and 0 in shadow, theta_s angle of the sun.
"""

from __future__ import annotations

import math

from ...maths.arrays import Lanes
from ..constants import REFERENCE_ILLUMINANCE_KLUX
from .receiver import circles_overlap

SUN_RADIUS_RAD = math.radians(959.63 / 3600.0)
"""Source: Auwers 1891, still used by almanacs; angular radius of the sun's disc at one astronomical unit, 0.26656
degrees. Over the year it varies by 1.7 %, as the distance does."""


def sun_irradiance_w_m2(*, irradiance_at_100_klux_w_m2: Lanes, illuminance_klux: Lanes) -> Lanes:
    """E_sun of (6) at another illuminance: linear, because the spectrum keeps its shape."""
    return irradiance_at_100_klux_w_m2 * illuminance_klux / REFERENCE_ILLUMINANCE_KLUX


def sky_irradiance_w_m2(*, sun_irradiance_w_m2: Lanes, diffuse_share: Lanes) -> Lanes:
    """Diffuse irradiance of the sky, as a share of the sun's at normal incidence."""
    return sun_irradiance_w_m2 * diffuse_share


def surface_radiance_w_m2_sr(
    *, sun_irradiance_w_m2: Lanes, sun_scatter_per_sr: Lanes, sky_irradiance_w_m2: Lanes, reflectivity: Lanes
) -> Lanes:
    """Radiance of a surface towards the sensor, L = E_sun V f_r(w_sun, w) cos(theta_s) + rho E_sky / pi.

    The sky is uniform and reflected by the diffuse part of the surface only. Parts of the sky hidden by the
    surroundings count too.

    Args:
        sun_scatter_per_sr: V f_r cos(theta_s), zero in shadow
    """
    return sun_irradiance_w_m2 * sun_scatter_per_sr + reflectivity * sky_irradiance_w_m2 / math.pi


def sky_radiance_w_m2_sr(*, sky_irradiance_w_m2: Lanes) -> Lanes:
    """Radiance of the uniform sky that a beam sees when it meets nothing."""
    return sky_irradiance_w_m2 / math.pi


def sun_disc_radiance_w_m2_sr(*, sun_irradiance_w_m2: Lanes) -> Lanes:
    """Radiance of the sun's disc, E_sun over its solid angle; taken as uniform (its limb is darker)."""
    return sun_irradiance_w_m2 / (math.pi * SUN_RADIUS_RAD * SUN_RADIUS_RAD)


def sun_disc_power_w(
    *, sun_irradiance_w_m2: Lanes, sun_angle_rad: Lanes, field_rad: Lanes, aperture_m2: Lanes, efficiency: Lanes
) -> Lanes:
    """Power of direct sunlight on the detector: radiance of the disc times the solid angle shared with the field of
    view.

    Args:
        sun_irradiance_w_m2: irradiance at the sensor: the air is accounted for
        sun_angle_rad: angle from the receiver's axis to the centre of the disc
        field_rad: half angle of the round field of view; small angles
    """
    seen_sr = circles_overlap(
        first_radius=field_rad, second_radius=SUN_RADIUS_RAD + 0.0 * field_rad, distance=sun_angle_rad
    )
    radiance = sun_disc_radiance_w_m2_sr(sun_irradiance_w_m2=sun_irradiance_w_m2)
    return radiance * seen_sr * aperture_m2 * efficiency
