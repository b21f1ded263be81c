"""Light out, light back: the lidar equation (1), (3)-(5) and the solar background (6)-(8).

The paper's target is one Lambertian plane of reflectivity rho. In a scene the BSDF replaces rho / pi: `echo_power_w`
and `background_power_w` take f_r(w, w) cos(theta) and the radiance towards the sensor, and are (5) and (8) for a
Lambertian surface.

Symbols: R range, P_t and P_r peak powers, A aperture, theta incidence, theta_s angle of the sun, tau_a transmittance
one way, eta_r and eta_rs efficiencies of the optics for laser light and sunlight, f focal length, r_PD detector
radius.
"""

from __future__ import annotations

import math

from ...maths.arrays import Lanes, xp
from ..constants import PLANCK_J_S, SPEED_OF_LIGHT_M_S


def range_from_time_of_flight_m(*, time_of_flight_s: Lanes) -> Lanes:
    """Range from the round-trip time, R = c t / 2, (1), with c in vacuum (air is 2.9e-4 slower)."""
    return 0.5 * SPEED_OF_LIGHT_M_S * time_of_flight_s


def time_of_flight_s(*, range_m: Lanes) -> Lanes:
    """Round-trip time to a range, 2 R / c: (1) solved for the time."""
    return (2.0 / SPEED_OF_LIGHT_M_S) * range_m


def photon_energy_j(*, wavelength_m: float) -> float:
    """Photon energy h nu; 2.19497e-19 J at 905 nm."""
    return PLANCK_J_S * SPEED_OF_LIGHT_M_S / wavelength_m


def disc_area_m2(*, radius_m: Lanes) -> Lanes:
    """Area of a round aperture, A(0) of (4)."""
    return math.pi * radius_m * radius_m


def disc_radius_m(*, area_m2: Lanes) -> Lanes:
    """Radius of a round aperture of this area."""
    return xp(area_m2).sqrt(area_m2 / math.pi)


def aperture_solid_angle_sr(*, aperture_m2: Lanes, range_m: Lanes) -> Lanes:
    """Solid angle of the aperture seen from the spot, A / R^2, (4), for R far above the aperture's size."""
    return aperture_m2 / (range_m * range_m)


def echo_power_w(
    *,
    peak_power_w: Lanes,
    backscatter_per_sr: Lanes,
    range_m: Lanes,
    transmittance: Lanes,
    aperture_m2: Lanes,
    efficiency: Lanes,
) -> Lanes:
    """Peak echo power on the detector from any surface: (5) with f_r(w, w) cos(theta) for rho cos(theta) / pi.

    transmittance is one way and enters squared. Transmitter and receiver at one place and the far field, as in (5).
    """
    spread = aperture_solid_angle_sr(aperture_m2=aperture_m2, range_m=range_m)
    return transmittance * transmittance * efficiency * peak_power_w * backscatter_per_sr * spread


def field_of_view_solid_angle_sr(*, detector_radius_m: Lanes, focal_length_m: Lanes) -> Lanes:
    """Solid angle of the receiver's field of view, pi (r_PD / f)^2, as in (6) (small angles)."""
    ratio = detector_radius_m / focal_length_m
    return math.pi * ratio * ratio


def background_power_w(
    *, radiance_w_m2_sr: Lanes, aperture_m2: Lanes, field_of_view_sr: Lanes, transmittance: Lanes, efficiency: Lanes
) -> Lanes:
    """Power on the detector from an extended source of this radiance: (8) with L for E_sun rho cos(theta_s) / pi.

    transmittance is one way. The source fills the field of view, so range does not enter.
    """
    return radiance_w_m2_sr * aperture_m2 * field_of_view_sr * transmittance * efficiency
