"""Echoes: Beams and Hits in, the light that reaches the detector out (docs/theory.md 1 to 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..maths.arrays import Lanes, Mask, Table, xp
from ..maths.vectors import Vector, dot, mixed
from ..physics.electronics import intensity
from ..physics.optics import air, radiometry, sunlight
from ..scene.model import Interferer
from ..sensor.model import Sensor
from .beams import Beams
from .hits import Hits


@dataclass(frozen=True, slots=True, kw_only=True)
class Interference:
    """Pulses of another lidar on the detector, at random times.

    rate_hz       mean rate
    peak_power_w  (n,) median of their peaks
    spread_db     standard deviation of their level
    """

    rate_hz: Lanes
    peak_power_w: Lanes
    spread_db: Lanes


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

    sun_irradiance_w_m2: Lanes
    sky_irradiance_w_m2: Lanes
    transmittance: Lanes
    extinction_per_m: Lanes
    sun_direction: Vector | None = None
    lamps_w_m2: Lanes | None = None
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

    found: Mask
    range_m: Lanes
    peak_power_w: Lanes
    background_power_w: Lanes
    interference: tuple[Interference, ...] = ()
    white_w_m2: Lanes = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Volume:
    """Light of the air itself: one course over range for all pulses, as much of it as each pulse has.

    shape             (samples,) W at a scale of one, from 0 to far_m in even steps; already as broad as the pulse
                      makes it
    far_m             of the last sample; nothing comes from behind that
    hump_m            (from, to): outside of it the course is nowhere concave (`hump_of`)
    scale             (n,) of each pulse
    end_m             (n,) where the last of a pulse's light meets a surface: nothing comes from behind that
    extinction_per_m  alpha, for how the course ends there (T37)
    """

    shape: Table
    far_m: Lanes
    hump_m: tuple[Lanes, Lanes]
    scale: Lanes
    end_m: Lanes
    extinction_per_m: Lanes


def hump_of(shape: Table, far_m: float) -> tuple[float, float]:
    """Where a course of a `Volume` is concave, all of it from the first to the last sample."""
    values = np.asarray(shape.values, dtype=np.float64)
    bend = np.diff(values, n=2)
    concave = np.flatnonzero(bend < -1e-7 * values.max())
    if len(concave) == 0:
        return 0.0, 0.0
    step = far_m / (len(values) - 1)
    return float(concave[0] * step), float((concave[-1] + 2) * step)


@dataclass(frozen=True, slots=True, kw_only=True)
class SubEchoes:
    """Sub-echoes of n pulses, equally many of each; lane = pulse lane * count + number.

    range_m       (n count,) anything where there is no echo
    peak_power_w  (n count,) peak of the sub-echo, 0 where there is none
    """

    range_m: Lanes
    peak_power_w: Lanes
    count: int


@dataclass(frozen=True, slots=True, kw_only=True)
class EchoTrain:
    """Light on the detector, pulses of several sub-echoes, which are numbered through all parts.

    parts               sub-echoes of one kind each
    surfaces            how many of them are of surfaces, the first ones; the others are of the air
    found               (n,) bool, whether any of those met a surface
    background_power_w  (n,) sun and sky
    volume              backscatter of the air, or None
    interference        other lidars, as in `Echoes`
    white_w_m2          (n,) as in `Echoes`
    """

    parts: tuple[SubEchoes, ...]
    surfaces: int
    found: Mask
    background_power_w: Lanes
    volume: Volume | None = None
    interference: tuple[Interference, ...] = ()
    white_w_m2: Lanes = 1.0


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
        # The sky is the same on both sides.
        reflectivity=hits.reflectivity + hits.transmittance,
    )
    sky = sunlight.sky_radiance_w_m2_sr(sky_irradiance_w_m2=ambient.sky_irradiance_w_m2)
    background = radiometry.background_power_w(
        radiance_w_m2_sr=ops.where(hits.found, surface, sky),
        aperture_m2=background_aperture_m2(beams),
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


def background_aperture_m2(beams: Beams) -> Lanes:
    """Aperture of (8)."""
    return beams.aperture_m2 if beams.background_aperture_m2 is None else beams.background_aperture_m2


def _sun_disc_w(beams: Beams, hits: Hits, sensor: Sensor, ambient: Ambient) -> Lanes:
    """Sunlight that comes straight into the field of view."""
    assert ambient.sun_direction is not None
    # The chord is the angle where it matters, and single precision has it there; an arc cosine would not.
    apart = mixed(1.0, hits.direction or beams.direction, -1.0, ambient.sun_direction)
    square = dot(apart, apart)
    return sunlight.sun_disc_power_w(
        sun_irradiance_w_m2=ambient.sun_irradiance_w_m2,
        sun_angle_rad=xp(square).sqrt(square),
        field_rad=sensor.detector.radius_m / sensor.optics.focal_length_m,
        aperture_m2=background_aperture_m2(beams),
        efficiency=sensor.optics.efficiency_sun * hits.throughput,
    )


def _white_w_m2(beams: Beams, sensor: Sensor) -> Lanes:
    """What the sensor's scale of intensity takes for white."""
    if sensor.intensity is None or sensor.intensity.kind != "reflectivity":
        return 1.0
    return intensity.white_echo_w_m2(
        peak_power_w=sensor.laser.peak_power_w,
        aperture_m2=beams.aperture_m2,
        efficiency=sensor.optics.efficiency_laser,
    )


def with_all_background(ways: Sequence[Echoes]) -> list[Echoes]:
    """The ways of a beam, the first of them with the light of sun and sky that all of them bring."""
    if len(ways) == 1:
        return list(ways)
    background = sum(way.background_power_w for way in ways)
    return [replace(ways[0], background_power_w=background), *ways[1:]]
