"""Echoes: Beams and Hits in, the light that reaches the detector out (PHYSICS.md section 4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from .arrays import Array, xp
from .beams import Beams
from .hits import Hits
from .physics import air, radiometry, sunlight
from .sensor import Sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Ambient:
    """Light and air of a scene, in the sensor's band.

    sun_irradiance_w_m2  at normal incidence
    sky_irradiance_w_m2  diffuse
    transmittance        fixed one-way part
    extinction_per_m     the part that grows with range
    """

    sun_irradiance_w_m2: Array
    sky_irradiance_w_m2: Array
    transmittance: Array
    extinction_per_m: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Echoes:
    """Light on the detector, per pulse.

    found               (n,) bool, whether there is an echo at all
    range_m             (n,) 1 where there is none
    peak_power_w        (n,) peak of the echo, 0 where there is none
    background_power_w  (n,) sun and sky
    """

    found: Array
    range_m: Array
    peak_power_w: Array
    background_power_w: Array


def receive(beams: Beams, hits: Hits, sensor: Sensor, ambient: Ambient) -> Echoes:
    """Optical power by (5) and (8), with the BSDF for rho / pi; a beam that met nothing sees the sky.

    Panes and mirrors on the way dim the sun's light once and the echo twice.
    """
    ops = xp(hits.range_m)
    optics = sensor.optics
    transmittance = air.transmittance(
        fixed=ambient.transmittance, extinction_per_m=ambient.extinction_per_m, range_m=hits.range_m
    )
    peak = radiometry.echo_power_w(
        peak_power_w=sensor.laser.peak_power_w,
        backscatter_per_sr=hits.backscatter_per_sr,
        range_m=hits.range_m,
        transmittance=transmittance,
        aperture_m2=beams.aperture_m2,
        efficiency=optics.efficiency_laser * hits.throughput * hits.throughput,
    )
    surface = sunlight.surface_radiance_w_m2_sr(
        sun_irradiance_w_m2=ambient.sun_irradiance_w_m2,
        sun_scatter_per_sr=hits.sun_scatter_per_sr,
        sky_irradiance_w_m2=ambient.sky_irradiance_w_m2,
        reflectivity=hits.reflectivity,
    )
    sky = sunlight.sky_radiance_w_m2_sr(sky_irradiance_w_m2=ambient.sky_irradiance_w_m2)
    background = radiometry.background_power_w(
        radiance_w_m2_sr=ops.where(hits.found, surface, sky),
        aperture_m2=beams.aperture_m2,
        field_of_view_sr=radiometry.field_of_view_solid_angle_sr(
            detector_radius_m=sensor.detector.radius_m, focal_length_m=optics.focal_length_m
        ),
        transmittance=ops.where(hits.found, transmittance, ambient.transmittance),
        efficiency=optics.efficiency_sun * hits.throughput,
    )
    return Echoes(
        found=hits.found,
        range_m=hits.range_m,
        peak_power_w=ops.where(hits.found, peak, 0.0),
        background_power_w=background,
    )


def first_of(ways: Sequence[Echoes]) -> Echoes:
    """The echo of a beam's first way, under the light that all of its ways bring from sun and sky."""
    background = sum(way.background_power_w for way in ways)
    return ways[0] if len(ways) == 1 else replace(ways[0], background_power_w=background)
