"""Echoes: Beams and Hits in, the light that reaches the detector out (PHYSICS.md section 4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from .arrays import Array, xp
from .beams import Beams
from .hits import Hits
from .physics import air, intensity, radiometry, sunlight
from .scan.vectors import Vector, dot, mixed
from .scene import Interferer
from .sensor import Sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Interference:
    """Pulses of another lidar on the detector, at random times.

    rate_hz       mean rate
    peak_power_w  (n,) median of their peaks
    spread_db     standard deviation of their level
    """

    rate_hz: Array
    peak_power_w: Array
    spread_db: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Ambient:
    """Light and air of a scene, in the sensor's band.

    sun_irradiance_w_m2  at normal incidence
    sky_irradiance_w_m2  diffuse
    transmittance        fixed one-way part
    extinction_per_m     the part that grows with range
    sun_direction        (x, y, z) unit vector towards the sun, or None: no beam looks into it
    lamps_w_m2           irradiance of all surfaces by lamps; None without
    interferers          other lidars
    """

    sun_irradiance_w_m2: Array
    sky_irradiance_w_m2: Array
    transmittance: Array
    extinction_per_m: Array
    sun_direction: Vector | None = None
    lamps_w_m2: Array | None = None
    interferers: tuple[Interferer, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Echoes:
    """Light on the detector, per pulse.

    found               (n,) bool, whether there is an echo at all
    range_m             (n,) 1 where there is none
    peak_power_w        (n,) peak of the echo, 0 where there is none
    background_power_w  (n,) sun, sky and lamps
    interference        other lidars
    white_w_m2          peak power times range squared of a white surface, as the sensor is calibrated; 1 where its
                        scale of intensity has no use for it
    """

    found: Array
    range_m: Array
    peak_power_w: Array
    background_power_w: Array
    interference: tuple[Interference, ...] = ()
    white_w_m2: Array = 1.0


def receive(beams: Beams, hits: Hits, sensor: Sensor, ambient: Ambient) -> Echoes:
    """Optical power by (5) and (8), with the BSDF for rho / pi; a beam that met nothing sees the sky, or the sun.

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
    if optics.overlap is not None:
        peak = peak * optics.overlap.share(hits.range_m)
    diffuse = ambient.sky_irradiance_w_m2
    if ambient.lamps_w_m2 is not None:
        diffuse = diffuse + ambient.lamps_w_m2
    surface = sunlight.surface_radiance_w_m2_sr(
        sun_irradiance_w_m2=ambient.sun_irradiance_w_m2,
        sun_scatter_per_sr=hits.sun_scatter_per_sr,
        sky_irradiance_w_m2=diffuse,
        reflectivity=hits.reflectivity,
    )
    sky = sunlight.sky_radiance_w_m2_sr(sky_irradiance_w_m2=ambient.sky_irradiance_w_m2)
    background = radiometry.background_power_w(
        radiance_w_m2_sr=ops.where(hits.found, surface, sky),
        aperture_m2=_background_aperture_m2(beams),
        field_of_view_sr=radiometry.field_of_view_solid_angle_sr(
            detector_radius_m=sensor.detector.radius_m, focal_length_m=optics.focal_length_m
        ),
        transmittance=ops.where(hits.found, transmittance, ambient.transmittance),
        efficiency=optics.efficiency_sun * hits.throughput,
    )
    if ambient.sun_direction is not None:
        background = background + ops.where(hits.found, 0.0, _sun_disc_w(beams, hits, sensor, ambient))
    return Echoes(
        found=hits.found,
        range_m=hits.range_m,
        peak_power_w=ops.where(hits.found, peak, 0.0),
        background_power_w=background,
        interference=tuple(
            Interference(
                rate_hz=one.rate_hz,
                peak_power_w=one.irradiance_w_m2 * beams.aperture_m2 * optics.efficiency_laser,
                spread_db=one.spread_db,
            )
            for one in ambient.interferers
        ),
        white_w_m2=_white_w_m2(beams, sensor),
    )


def _background_aperture_m2(beams: Beams) -> Array:
    """Aperture of (8)."""
    return beams.aperture_m2 if beams.background_aperture_m2 is None else beams.background_aperture_m2


def _sun_disc_w(beams: Beams, hits: Hits, sensor: Sensor, ambient: Ambient) -> Array:
    """Sunlight that comes straight into the field of view."""
    assert ambient.sun_direction is not None
    # The chord is the angle where it matters, and single precision has it there; an arc cosine would not.
    apart = mixed(1.0, hits.direction or beams.direction, -1.0, ambient.sun_direction)
    square = dot(apart, apart)
    return sunlight.sun_disc_power_w(
        sun_irradiance_w_m2=ambient.sun_irradiance_w_m2,
        sun_angle_rad=xp(square).sqrt(square),
        field_rad=sensor.detector.radius_m / sensor.optics.focal_length_m,
        aperture_m2=_background_aperture_m2(beams),
        efficiency=sensor.optics.efficiency_sun * hits.throughput,
    )


def _white_w_m2(beams: Beams, sensor: Sensor) -> Array:
    """What the sensor's scale of intensity takes for white."""
    if sensor.intensity is None or sensor.intensity.kind != "reflectivity":
        return 1.0
    return intensity.white_echo_w_m2(
        peak_power_w=sensor.laser.peak_power_w,
        aperture_m2=beams.aperture_m2,
        efficiency=sensor.optics.efficiency_laser,
    )


def first_of(ways: Sequence[Echoes]) -> Echoes:
    """The echo of a beam's first way, under the light that all of its ways bring from sun and sky."""
    background = sum(way.background_power_w for way in ways)
    return ways[0] if len(ways) == 1 else replace(ways[0], background_power_w=background)
