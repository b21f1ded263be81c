"""Maximum range in closed form, (29) and (30), as printed and as derived from the paper's own equations.

The closed forms show how the range depends on each number. They keep only the background's shot noise, so they are
upper bounds; the exact limit solves (19) or (27) numerically (`lidarscene.studies.ranging.plane`). At Table 1 the
derived forms give 352.751 m and 308.667 m.

Symbols: theta incidence, theta_s angle of the sun, tau_a transmittance, eta_r and eta_rs optical efficiencies.
"""

from __future__ import annotations

import math

from ...maths.arrays import Array, xp


def _optics_term(
    *, cos_incidence: Array, cos_sun: Array, transmittance: Array, efficiency_laser: Array,
    efficiency_sun: Array, photon_energy_j: Array, factor: float,
) -> Array:  # fmt: skip
    """First bracket of (29) and (30), before its square root, without the 1 / cos(theta_s)."""
    root = xp(cos_sun, efficiency_sun).sqrt(photon_energy_j * efficiency_sun * cos_sun)
    return factor * cos_incidence * transmittance**1.5 * efficiency_laser / (math.pi * root)


def maximum_range_apd_m(
    *,
    peak_power_w: Array,
    reflectivity: Array,
    aperture_m2: Array,
    sun_irradiance_w_m2: Array,
    focal_over_radius: Array,
    threshold_to_noise: Array,
    quantum_efficiency: Array,
    excess_noise: Array,
    bandwidth_hz: Array,
    photon_energy_j: Array,
    transmittance: Array = 1.0,
    efficiency_laser: Array = 1.0,
    efficiency_sun: Array = 1.0,
    cos_incidence: Array = 1.0,
    cos_sun: Array = 1.0,
    as_printed: bool = False,
) -> Array:
    """Range at which the APD's SNR falls to the threshold under background shot noise alone, (29).

    excess_noise is F = M^x. Derived: factor 1 / sqrt(2), since shot noise 2 e i B has one factor 2 under the root,
    and no 1 / cos(theta_s). As printed: 1 / 2 and 1 / cos(theta_s), together 19 % too long at 60 degrees.
    """
    optics = _optics_term(
        cos_incidence=cos_incidence, cos_sun=cos_sun, transmittance=transmittance,
        efficiency_laser=efficiency_laser, efficiency_sun=efficiency_sun,
        photon_energy_j=photon_energy_j, factor=0.5 if as_printed else math.sqrt(0.5),
    )  # fmt: skip
    if as_printed:
        optics = optics / cos_sun
    light = (
        quantum_efficiency * reflectivity * aperture_m2 / (sun_irradiance_w_m2 * excess_noise * bandwidth_hz)
    )
    ops = xp(optics, light, peak_power_w, threshold_to_noise)
    return ops.sqrt(optics * ops.sqrt(light) * peak_power_w * focal_over_radius / threshold_to_noise)


def maximum_range_sipm_m(
    *,
    peak_power_w: Array,
    pulse_fwhm_s: Array,
    reflectivity: Array,
    aperture_m2: Array,
    sun_irradiance_w_m2: Array,
    focal_over_radius: Array,
    threshold_to_noise: Array,
    pde: Array,
    dead_time_s: Array,
    photon_energy_j: Array,
    transmittance: Array = 1.0,
    efficiency_laser: Array = 1.0,
    efficiency_sun: Array = 1.0,
    cos_incidence: Array = 1.0,
    cos_sun: Array = 1.0,
    as_printed: bool = False,
) -> Array:
    """Range at which the SiPM's SNR (28) falls to the threshold, (30). As printed it has a 1 / cos(theta_s)."""
    optics = _optics_term(
        cos_incidence=cos_incidence, cos_sun=cos_sun, transmittance=transmittance,
        efficiency_laser=efficiency_laser, efficiency_sun=efficiency_sun,
        photon_energy_j=photon_energy_j, factor=0.5,
    ) / xp(dead_time_s).sqrt(dead_time_s)  # fmt: skip
    if as_printed:
        optics = optics / cos_sun
    light = pde * reflectivity * aperture_m2 / sun_irradiance_w_m2
    pulse = peak_power_w * pulse_fwhm_s * focal_over_radius / threshold_to_noise
    ops = xp(optics, light, pulse)
    return ops.sqrt(optics * ops.sqrt(light) * pulse)
