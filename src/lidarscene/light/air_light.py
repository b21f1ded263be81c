"""Air light: what floats or falls in a scene and a sensor in, what each pulse gets back from it out.

The many small particles together are a `Volume`, the few strong ones are sub-echoes of their own; the two make up
the whole medium (`physics.weather.particles`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..maths.arrays import Lanes, Numbers, Table, xp
from ..physics.constants import SPEED_OF_LIGHT_M_S
from ..physics.optics import radiometry
from ..physics.weather import soft_target
from ..physics.weather.particles import MEAN_HITS, Sight, Strengths, hits, strengths
from ..physics.weather.precipitation import Sizes
from ..scene.weather import Medium, Weather
from ..sensor.model import Sensor
from ..sensor.overlap import Overlap
from .echoes import SubEchoes, Volume, hump_of

NEAREST_SHARE = 1e-3
"""Particles are drawn from where the receiver sees this share of its beam on: nearer ones are lost in the dark."""

_LEFT_OUT = 0.5
"""Particles are drawn down to this share of what the comparator sees, so that two which are left to the even light do
not reach it together. At a share of one 4 % of the points of heavy rain are missing, at a quarter 0.4 % more come."""

_DRAWS_APART = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class AirLight:
    """Backscatter of the air around a sensor, per unit of P_t eta A.

    shape, far_m, hump_m, extinction_per_m
                          as in `light.echoes.Volume`
    particles             drawn one by one: tables, and the number of their medium in ``names``
    names                 of the media: classes of the points that they cause
    strongest             number of the medium that gives most of the rest
    """

    shape: Table
    far_m: Lanes
    hump_m: tuple[Lanes, Lanes]
    extinction_per_m: Lanes
    particles: tuple[tuple[Strengths, str], ...]
    names: tuple[str, ...]
    strongest: str

    @property
    def sources(self) -> tuple[str, ...]:
        """Name of the medium of each sub-echo, in the order of `sub_echoes`."""
        return tuple(name for tables, name in self.particles for _ in range(tables.count))

    def volume(self, *, scale: Lanes, end_m: Lanes) -> Volume:
        """Of pulses with this P_t eta A and fixed transmittance, whose light ends at ``end_m``."""
        return Volume(
            shape=self.shape, far_m=self.far_m, hump_m=self.hump_m,
            scale=scale, end_m=end_m, extinction_per_m=self.extinction_per_m,
        )  # fmt: skip

    def sub_echoes(self, *, scale: Lanes, end_m: Lanes, seed: Lanes, pulse: Lanes) -> list[SubEchoes]:
        """Drops and flakes of each pulse before its light ends."""
        found = []
        for number, (tables, _) in enumerate(self.particles):
            for range_m, strength in hits(tables, seed=seed, pulse=pulse, first_draw=number * _DRAWS_APART):
                ops = xp(range_m)
                power = ops.where(range_m < end_m, scale * strength, 0.0)
                found.append(SubEchoes(range_m=range_m, peak_power_w=power, count=1))
        return found


def air_light(weather: Weather, sensor: Sensor, *, extinction_per_m: float) -> AirLight | None:
    """What this weather sends back to this sensor, or None in clear air.

    extinction_per_m  alpha, one way, of all that is in the air
    """
    media = weather.media(sensor.laser.wavelength_m)
    if not media:
        return None
    overlap = overlap_of(sensor)
    far_m = 0.5 * SPEED_OF_LIGHT_M_S * float(sensor.tdc.window_s)
    nearest_m = _nearest_m(overlap, far_m)
    area = _area_m2(sensor)
    sight = Sight(
        beam_area_m2=area, overlap=lambda range_m: np.asarray(overlap.share(range_m)),
        extinction_per_m=extinction_per_m, nearest_m=nearest_m, farthest_m=far_m,
    )  # fmt: skip
    drawn = {}
    for medium in media:
        if medium.sizes is None or medium.particle_m2_sr is None or area(np.array([far_m]))[0] == 0.0:
            continue
        drawn[medium.name] = _enough(
            _least_strength(sensor), sight, sizes=medium.sizes, backscatter_m2_sr=medium.particle_m2_sr
        )

    def left(medium: Medium, range_m: Numbers) -> Numbers:
        """beta of what is not drawn."""
        if medium.name in drawn:
            return drawn[medium.name].weak_backscatter_per_m_sr(range_m)
        return np.full_like(range_m, medium.backscatter_per_m_sr)

    fwhm_s = float(sensor.laser.pulse_fwhm_s)
    grid = soft_target.range_grid_m(farthest_m=far_m, fwhm_s=fwhm_s)
    shape = Table(
        soft_target.volume_response(
            range_m=grid,
            backscatter_per_m_sr=lambda r: np.asarray(overlap.share(r)) * sum(left(medium, r) for medium in media),
            extinction_per_m=extinction_per_m, fwhm_s=fwhm_s, nearest_m=min(nearest_m, 0.1),
        )
    )  # fmt: skip
    at_peak = grid[[int(np.argmax(shape.values))]]
    return AirLight(
        shape=shape,
        far_m=far_m,
        hump_m=hump_of(shape, far_m),
        extinction_per_m=extinction_per_m,
        particles=tuple((tables, name) for name, tables in drawn.items()),
        names=tuple(medium.name for medium in media),
        strongest=max(media, key=lambda medium: float(left(medium, at_peak)[0])).name,
    )


def _enough(
    least: float, sight: Sight, *, sizes: Sizes, backscatter_m2_sr: Callable[..., Lanes]
) -> Strengths:
    """With as many particles for each pulse as it takes until those left out are weaker than `_LEFT_OUT` ``least``."""
    for count in MEAN_HITS:
        found = strengths(sight, sizes=sizes, backscatter_m2_sr=backscatter_m2_sr, count=count)
        if math.exp(found.log_strength.values[-1]) < _LEFT_OUT * least:
            break
    return found


def _least_strength(sensor: Sensor) -> float:
    """Strength of a particle that the comparator can see, in the dark."""
    point = sensor.working_point(np.zeros(1))
    seen_w = np.asarray(point.power_w(sensor.threshold(point))).ravel()[0]
    sent = radiometry.echo_power_w(
        peak_power_w=sensor.laser.peak_power_w, backscatter_per_sr=1.0, range_m=1.0, transmittance=1.0,
        aperture_m2=sensor.optics.aperture_m2, efficiency=sensor.optics.efficiency_laser,
    )  # fmt: skip
    return float(seen_w / sent)


def overlap_of(sensor: Sensor) -> Overlap:
    """The sensor's own, or that of one whose axes are one and whose focus is far away.

    Without it the air right before the sensor would give any amount of light.
    """
    if sensor.optics.overlap is not None:
        return sensor.optics.overlap
    return Overlap.of(
        sensor.laser.spot,
        aperture_radius_m=float(sensor.optics.aperture_radius_m),
        field_rad=float(sensor.detector.radius_m / sensor.optics.focal_length_m),
    )


def _nearest_m(overlap: Overlap, far_m: float) -> float:
    ranges = np.geomspace(1e-2, far_m, 2000)
    share = np.asarray(overlap.share(ranges))
    seen = share >= NEAREST_SHARE * share.max()
    return float(ranges[int(np.argmax(seen))])


def _area_m2(sensor: Sensor) -> Callable[[Numbers], Numbers]:
    """pi w^2 on the beam's two axes; 0 of a beam without a width."""
    laser = sensor.laser
    waist = 0.5 * (laser.exit_diameter_m or 0.0)
    second = (
        laser.divergence_rad if laser.divergence_elevation_rad is None else laser.divergence_elevation_rad
    )
    slopes = (math.tan(0.5 * laser.divergence_rad), math.tan(0.5 * second))

    def area(range_m: Numbers) -> Numbers:
        a, b = (np.hypot(waist, slope * range_m) for slope in slopes)
        return np.asarray(math.pi * a * b)

    return area
