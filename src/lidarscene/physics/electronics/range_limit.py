"""Maximum range in closed form, (29) and (30), as printed and as derived from the paper's own equations.

The closed forms show how the range depends on each number. They keep only the background's shot noise, so they are
upper bounds; the exact limit solves (19) or (27) numerically (`lidarscene.studies.ranging.plane`). At Table 1 the
derived forms give 352.751 m and 308.667 m.

Symbols: theta incidence, theta_s angle of the sun, tau_a transmittance, eta_r and eta_rs optical efficiencies.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ...maths.arrays import Lanes, xp


@dataclass(frozen=True, slots=True, kw_only=True)
class Plane:
    """A Lambertian plane wider than the spot, in sunlight.

    Attributes:
        sun_irradiance_w_m2: in the receiver's band, at normal incidence
        transmittance: transmittance of the air, one way
        cos_incidence: cosine of incidence of the beam, and cos_sun that of the sunlight
    """

    reflectivity: Lanes
    sun_irradiance_w_m2: Lanes
    transmittance: Lanes = 1.0
    cos_incidence: Lanes = 1.0
    cos_sun: Lanes = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Transceiver:
    """A lidar but for its detector.

    Attributes:
        peak_power_w: peak power of its laser, P_t
        focal_over_radius: focal length over the detector's radius
        threshold_to_noise: TNR of its comparator
        efficiency_laser: efficiency of its optics for its own light, and efficiency_sun for sunlight
    """

    peak_power_w: Lanes
    aperture_m2: Lanes
    focal_over_radius: Lanes
    threshold_to_noise: Lanes
    photon_energy_j: Lanes
    efficiency_laser: Lanes = 1.0
    efficiency_sun: Lanes = 1.0


def maximum_range_apd_m(
    plane: Plane,
    receiver: Transceiver,
    *,
    quantum_efficiency: Lanes,
    excess_noise: Lanes,
    bandwidth_hz: Lanes,
    as_printed: bool = False,
) -> Lanes:
    """Range at which the APD's SNR falls to the threshold under background shot noise alone, (29).

    excess_noise is F = M^x. Derived: factor 1 / sqrt(2), since shot noise 2 e i B has one factor 2 under the root,
    and no 1 / cos(theta_s). As printed: 1 / 2 and 1 / cos(theta_s), together 19 % too long at 60 degrees.
    """
    optics = _optics_term(plane, receiver, factor=0.5 if as_printed else math.sqrt(0.5))
    if as_printed:
        optics = optics / plane.cos_sun
    light = (
        quantum_efficiency
        * plane.reflectivity
        * receiver.aperture_m2
        / (plane.sun_irradiance_w_m2 * excess_noise * bandwidth_hz)
    )
    peak_power_w, threshold_to_noise = receiver.peak_power_w, receiver.threshold_to_noise
    ops = xp(optics, light, peak_power_w, threshold_to_noise)
    return ops.sqrt(optics * ops.sqrt(light) * peak_power_w * receiver.focal_over_radius / threshold_to_noise)


def maximum_range_sipm_m(
    plane: Plane,
    receiver: Transceiver,
    *,
    pulse_fwhm_s: Lanes,
    pde: Lanes,
    dead_time_s: Lanes,
    as_printed: bool = False,
) -> Lanes:
    """Range at which the SiPM's SNR (28) falls to the threshold, (30). As printed it has a 1 / cos(theta_s)."""
    optics = _optics_term(plane, receiver, factor=0.5) / xp(dead_time_s).sqrt(dead_time_s)
    if as_printed:
        optics = optics / plane.cos_sun
    light = pde * plane.reflectivity * receiver.aperture_m2 / plane.sun_irradiance_w_m2
    pulse = receiver.peak_power_w * pulse_fwhm_s * receiver.focal_over_radius / receiver.threshold_to_noise
    ops = xp(optics, light, pulse)
    return ops.sqrt(optics * ops.sqrt(light) * pulse)


def _optics_term(plane: Plane, receiver: Transceiver, *, factor: float) -> Lanes:
    """First bracket of (29) and (30), before its square root, without the 1 / cos(theta_s)."""
    root = xp(plane.cos_sun, receiver.efficiency_sun).sqrt(
        receiver.photon_energy_j * receiver.efficiency_sun * plane.cos_sun
    )
    return factor * plane.cos_incidence * plane.transmittance**1.5 * receiver.efficiency_laser / (math.pi * root)
