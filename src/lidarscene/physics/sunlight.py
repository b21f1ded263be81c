"""Ambient light in the receiver's band: sun irradiance from illuminance, sky, and what a surface returns.

A sensor file states its in-band solar irradiance at normal incidence for 100 klux, filter included
(29.4 W/m2 in Table 1); it is linear in the illuminance.
"""

from __future__ import annotations

import math

from ..arrays import Array
from ..constants import REFERENCE_ILLUMINANCE_KLUX


def sun_irradiance_w_m2(*, irradiance_at_100_klux_w_m2: Array, illuminance_klux: Array) -> Array:
    """E_sun of (6) at another illuminance: linear, since the spectrum is taken not to change."""
    return irradiance_at_100_klux_w_m2 * illuminance_klux / REFERENCE_ILLUMINANCE_KLUX


def sky_irradiance_w_m2(*, sun_irradiance_w_m2: Array, diffuse_share: Array) -> Array:
    """Diffuse irradiance of the sky, as a share of the sun's at normal incidence."""
    return sun_irradiance_w_m2 * diffuse_share


def surface_radiance_w_m2_sr(
    *, sun_irradiance_w_m2: Array, sun_scatter_per_sr: Array, sky_irradiance_w_m2: Array, reflectivity: Array
) -> Array:
    """Radiance of a surface towards the sensor, L = E_sun V f_r(w_sun, w) cos(theta_s) + rho E_sky / pi.

    sun_scatter_per_sr holds V f_r cos(theta_s), zero in shadow. The sky is uniform and reflected by the
    diffuse part of the surface only; what of it the surroundings hide is left out.
    """
    return sun_irradiance_w_m2 * sun_scatter_per_sr + reflectivity * sky_irradiance_w_m2 / math.pi


def sky_radiance_w_m2_sr(*, sky_irradiance_w_m2: Array) -> Array:
    """Radiance of the uniform sky that a beam sees when it meets nothing."""
    return sky_irradiance_w_m2 / math.pi
