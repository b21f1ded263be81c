"""Light on flat Lambertian walls as the paper writes it, (2) to (8); surfaces, lenses and spectra in closed form.

Nothing in a render or a study runs this: tests compare with it what does (`lidarscene.physics.reference`).
"""

from __future__ import annotations

import math

import numpy as np

from ...maths.arrays import Lanes, xp
from ..optics.dielectrics import fresnel_reflectance
from ..optics.pulse import leading_edge_time_s
from ..optics.radiometry import background_power_w, echo_power_w, field_of_view_solid_angle_sr
from ..optics.receiver import top_hat_in_circle
from ..optics.solar_spectrum import SpectralCurve, box_filter, integral, irradiance_at_100_klux_w_m2


def leading_edge_slope_per_s(*, level: Lanes, fwhm_s: Lanes) -> Lanes:
    """dg/dt where g rises through ``level``."""
    return -8.0 * math.log(2.0) * level * leading_edge_time_s(level=level, fwhm_s=fwhm_s) / (fwhm_s * fwhm_s)


def time_of_flight_from_beat_s(*, beat_frequency_hz: Lanes, chirp_rate_hz_s: Lanes) -> Lanes:
    """Time of flight of a frequency-modulated continuous-wave lidar from its beat, (2). Not used here."""
    return beat_frequency_hz / chirp_rate_hz_s


def lambertian_intensity_w_sr(
    *, reflectivity: Lanes, transmittance: Lanes, peak_power_w: Lanes, cos_incidence: Lanes
) -> Lanes:
    """Radiant intensity of the spot towards the sensor, (3). The target must hold the whole spot."""
    return reflectivity * transmittance * peak_power_w * cos_incidence / math.pi


def lambertian_echo_power_w(
    *,
    peak_power_w: Lanes,
    reflectivity: Lanes,
    cos_incidence: Lanes,
    range_m: Lanes,
    transmittance: Lanes,
    aperture_m2: Lanes,
    efficiency: Lanes,
) -> Lanes:
    """Peak echo power on the detector from a Lambertian plane wider than the spot, (5)."""
    return echo_power_w(
        peak_power_w=peak_power_w,
        backscatter_per_sr=reflectivity * cos_incidence / math.pi,
        range_m=range_m,
        transmittance=transmittance,
        aperture_m2=aperture_m2,
        efficiency=efficiency,
    )


def field_of_view_area_m2(
    *, range_m: Lanes, detector_radius_m: Lanes, focal_length_m: Lanes, cos_incidence: Lanes
) -> Lanes:
    """Area of the target that the receiver sees, A_b = pi (R r_PD / f)^2 / cos(theta), under (6).

    Small angles; the target is plane and larger than that.
    """
    solid_angle = field_of_view_solid_angle_sr(detector_radius_m=detector_radius_m, focal_length_m=focal_length_m)
    return solid_angle * range_m * range_m / cos_incidence


def sun_flux_w(*, sun_irradiance_w_m2: Lanes, seen_area_m2: Lanes, cos_sun: Lanes) -> Lanes:
    """Sunlight on the part of the target that the receiver sees, Phi_s of (6).

    Args:
        sun_irradiance_w_m2: in band, at normal incidence: the integral under (6), `physics.optics.solar_spectrum`
    """
    return sun_irradiance_w_m2 * seen_area_m2 * cos_sun


def sun_intensity_w_sr(*, sun_flux_w: Lanes, reflectivity: Lanes, cos_incidence: Lanes) -> Lanes:
    """Radiant intensity of sunlight from a Lambertian target towards the sensor, I_theta_s of (7).

    The cosine of the incidence cancels against the one in `field_of_view_area_m2`.
    """
    return reflectivity * sun_flux_w / math.pi * cos_incidence


def lambertian_sun_power_w(
    *,
    sun_irradiance_w_m2: Lanes,
    reflectivity: Lanes,
    cos_sun: Lanes,
    aperture_m2: Lanes,
    field_of_view_sr: Lanes,
    transmittance: Lanes,
    efficiency: Lanes,
) -> Lanes:
    """Sunlight from a Lambertian target on the detector, (8): (6) and (7) through the aperture (4).

    The middle of (8) prints eta_r; its right side has eta_rs, which is correct. Range does not enter if the
    transmittance is that of the target's range.
    """
    return background_power_w(
        radiance_w_m2_sr=sun_irradiance_w_m2 * reflectivity * cos_sun / math.pi,
        aperture_m2=aperture_m2,
        field_of_view_sr=field_of_view_sr,
        transmittance=transmittance,
        efficiency=efficiency,
    )


def diffuse_fresnel_reflectance(index: float) -> float:
    """Reflectance of a smooth surface for light from all directions equally, from outside (index > 1).

    2 int R(mu) mu dmu by Gauss-Legendre quadrature with 64 points; 0.0659 at n = 1.33, 0.0918 at 1.5.
    """
    nodes, weights = np.polynomial.legendre.leggauss(64)
    cosines = 0.5 * (nodes + 1.0)
    reflected = fresnel_reflectance(cos_incidence=cosines, index=index)
    return float(np.dot(weights, cosines * reflected))


def wet_reflectivity(*, dry: float, index: float, internal: float = 1.0, internal_diffuse: float = 1.0) -> float:
    """Diffuse reflectivity at normal incidence of a rough surface of reflectivity ``dry`` under a film of water.

    (1 - R(0)) a b (1 - p) a_d / (1 - b p a_d^2), b the dry reflectivity: light that the surface scatters upwards is
    reflected back at the water's face with probability p = 1 - (1 - R_d) / n^2, R_d from
    `diffuse_fresnel_reflectance`, and meets the surface again.

    Lekner and Dorf, Appl. Opt. 27, 1278 (1988), their first extension of Angstrom's model. Left out: water in the
    pores also lowers the contrast of the grains (their second extension, and Twomey's), which darkens further.

    Args:
        index: n of the water
        internal: a of one passage straight down
        internal_diffuse: a_d of one passage in all directions equally, 2 E_3(alpha d)
    """
    entering = (1.0 - float(fresnel_reflectance(cos_incidence=np.float64(1.0), index=index))) * internal
    internal_reflection = 1.0 - (1.0 - diffuse_fresnel_reflectance(index)) / index**2
    leaving = (1.0 - internal_reflection) * internal_diffuse
    return entering * dry * leaving / (1.0 - dry * internal_reflection * internal_diffuse**2)


def point_share(*, off_axis_rad: Lanes, field_rad: Lanes, blur_rad: Lanes) -> Lanes:
    """Share of the light of one point that falls on the detector: the part of its blur disc in the field of view.

    Args:
        off_axis_rad: between the point's direction and the receiver's axis
    """
    return top_hat_in_circle(spot_radius=blur_rad, circle_radius=field_rad, distance=off_axis_rad)


def blind_range_m(
    *, offset_m: Lanes, exit_radius_m: Lanes, aperture_radius_m: Lanes, field_rad: Lanes, edge_rad: Lanes
) -> Lanes:
    """Range below which none of the spot reaches the detector, for parallel axes and focus at infinity.

    There o / R = phi + theta + (r_A + w_0) / R: the spot's inner edge, blurred, leaves the field of view. 0 if the
    axes are closer than the sum of the radii of exit and lens. For beams with straight edges that start
    ``exit_radius_m`` wide and open by ``edge_rad``.
    """
    ops = xp(offset_m, aperture_radius_m, field_rad, edge_rad)
    return ops.maximum(offset_m - aperture_radius_m - exit_radius_m, 0.0) / (field_rad + edge_rad)


def total(curve: SpectralCurve) -> float:
    """Integral over all wavelengths: irradiance of a spectrum, or width of the box that passes as a filter does."""
    return integral(curve, np.ones_like)


def implied_box_width_m(spectrum: SpectralCurve, *, centre_m: float, irradiance_w_m2: float) -> float:
    """Width of the box filter that passes this irradiance at 100 klux, by bisection.

    Raises:
        ValueError: if the whole spectrum has less
    """

    def passed(width_m: float) -> float:
        return irradiance_at_100_klux_w_m2(spectrum, box_filter(centre_m=centre_m, width_m=width_m))

    shortest, longest = float(spectrum.wavelength_m[0]), float(spectrum.wavelength_m[-1])
    narrow, wide = 0.0, 2.0 * max(longest - centre_m, centre_m - shortest)
    if not passed(wide) >= irradiance_w_m2 > 0.0:
        raise ValueError(
            f"irradiance must be more than 0 and at most {passed(wide):.1f} W/m2, all of this spectrum at 100 klux, "
            f"got {irradiance_w_m2} W/m2"
        )
    for _ in range(60):
        middle = 0.5 * (narrow + wide)
        narrow, wide = (middle, wide) if passed(middle) < irradiance_w_m2 else (narrow, middle)
    return 0.5 * (narrow + wide)
