"""Air light: the backscatter of fog, rain and snow that each pulse receives.

The many small droplets of fog together send back a smooth echo. But one raindrop close to the sensor can trip the
comparator alone. So the strongest particles are drawn one by one as sub-echoes, and all weaker ones together are
even light, a `Volume`. Both together are the whole medium (docs/theory_light.md 1, docs/weather.md).

Symbols: P_t peak power, eta efficiency, A aperture, alpha extinction, beta backscatter coefficient, s strength of a
particle: its power over P_t eta A, Lambda(s) mean number of particles stronger than s.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..maths.arrays import Lanes, LookupTable, Numbers, xp
from ..maths.random import Seed
from ..physics.amplifier import high_pass
from ..physics.constants import SPEED_OF_LIGHT_M_S
from ..physics.optics import radiometry
from ..physics.weather import soft_target
from ..physics.weather.particles import Sight, Strengths, hits, medium_backscatter_per_m_sr, strengths
from ..scene.weather import Medium, Weather
from ..sensor.overlap import Alignment, Overlap
from ..sensor.sensor_model import Sensor, overlap_geometry
from .echoes import SubEchoes, Volume, hump_of

NEAREST_SHARE = 1e-3
"""Choice: share of the receiver's beam, relative to the largest one over all ranges, from which on particles are drawn:
it sees nearer ones barely."""

_LEFT_OUT = 0.27
"""Accuracy bought: particles are drawn down to this share of the weakest whose mean light trips the comparator or
histogram alone.

Weaker ones become even light, in which single particles have no echo of their own: four of them may reach a
comparator's threshold together. Of a histogram, more are drawn (see `air_light`): its photons scatter. In heavy rain
(`rain.toml`) this share lacks 1.5 % of the points, and a half 6 %."""

_DRAWS_APART = 1000
"""Random draws that each kind of particle has for itself."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AirLight:
    """Backscatter of the air around a sensor, per unit of P_t eta A.

    Attributes:
        shape: as in `light.echoes.Volume`
        near_m: as in `light.echoes.Volume`
        far_m: as in `light.echoes.Volume`
        hump_m: as in `light.echoes.Volume`
        extinction_per_m: as in `light.echoes.Volume`
        highest: as in `light.echoes.Volume`
        particles: particles that are drawn one by one: tables, and the name of their medium
        names: names of the media, the classes of the points that they cause
        strongest: name of the medium that gives most of the even light where that is brightest
    """

    shape: LookupTable
    near_m: Lanes
    far_m: Lanes
    hump_m: tuple[Lanes, Lanes]
    extinction_per_m: Lanes
    highest: LookupTable | None
    particles: tuple[tuple[Strengths, str], ...]
    names: tuple[str, ...]
    strongest: str

    @property
    def sources(self) -> tuple[str, ...]:
        """Name of the medium of each sub-echo, in the order of `sub_echoes`."""
        return tuple(name for tables, name in self.particles for _ in range(tables.count))

    def volume(self, *, scale: Lanes, end_m: Lanes, edge: tuple[Lanes, Lanes] | None = None) -> Volume:
        """Even light of some pulses.

        Args:
            scale: (n,) P_t eta A of each pulse, with the fixed transmittance of the air
            end_m: as in `light.echoes.Volume`
            edge: as in `light.echoes.Volume`
        """
        return Volume(
            shape=self.shape,
            near_m=self.near_m,
            far_m=self.far_m,
            hump_m=self.hump_m,
            scale=scale,
            end_m=end_m,
            edge=edge,
            extinction_per_m=self.extinction_per_m,
            highest=self.highest,
        )

    def sub_echoes(
        self, *, scale: Lanes, end_m: Lanes, edge: tuple[Lanes, Lanes] | None = None, seed: Seed, pulse: Lanes
    ) -> list[SubEchoes]:
        """Sub-echoes of the drops and flakes that are drawn for each pulse; power 0 behind ``end_m``.

        Args:
            scale: (n,) as of `volume`
            end_m: (n,) as of `volume`
            edge: as of `volume`
            seed: 32-bit frame seed
            pulse: (n,) uint32 pulse numbers
        """
        echoes = []
        # Each kind has random draws of its own, so that snow in a scene does not move the raindrops.
        for number, (tables, _) in enumerate(self.particles):
            for range_m, strength, aside in hits(tables, seed=seed, pulse=pulse, first_draw=number * _DRAWS_APART):
                ops = xp(range_m)
                # The pulse does not light what is behind the surface at which its part with the particle ends.
                end = end_m if edge is None else ops.where(aside < edge[1], edge[0], end_m)
                power = ops.where(range_m < end, scale * strength, 0.0)
                echoes.append(SubEchoes(range_m=range_m, peak_power_w=power, count=1))
        return echoes


def air_light(weather: Weather, sensor: Sensor, *, extinction_per_m: float) -> AirLight | None:
    """Backscatter that this sensor receives in this weather; None in clear air.

    Args:
        extinction_per_m: alpha, one way, of everything in the air
    """
    media = weather.media(sensor.laser.wavelength_m)
    if not media:
        return None
    overlap = overlap_of(sensor)
    # Light that returns after the window closes is not recorded: R = c t / 2.
    far_m = 0.5 * SPEED_OF_LIGHT_M_S * float(sensor.tdc.window_s)
    nearest_m = _nearest_m(overlap, far_m)
    area = _area_m2(sensor)
    sight = Sight(
        beam_area_m2=area,
        overlap=lambda range_m: np.asarray(overlap.share(range_m)),
        extinction_per_m=extinction_per_m,
        nearest_m=nearest_m,
        farthest_m=far_m,
        aperture_radius_m=float(sensor.optics.aperture_radius_m),
        lens_offset_m=_lens_offset_m(sensor),
    )
    # A medium is drawn only if it has discrete particles and the beam has a width: in a beam of no area none would be.
    drawn = {}
    for medium in media:
        if medium.sizes is None or medium.particle_m2_sr is None or area(np.array([far_m]))[0] == 0.0:
            continue
        drawn[medium.name] = strengths(
            sight,
            sizes=medium.sizes,
            backscatter_m2_sr=medium.particle_m2_sr,
            gain=medium.particle_gain,
            # Photons that scatter let many a weaker drop trip where shots are summed.
            count=1 if sensor.histogram is None else 4,
            down_to=_LEFT_OUT * _least_strength(sensor),
        )

    def undrawn_backscatter(medium: Medium, range_m: Numbers) -> Numbers:
        """beta of the particles of a medium that are not drawn, per m sr."""
        if medium.name in drawn:
            return drawn[medium.name].weak_backscatter_per_m_sr(range_m)
        if medium.particle_gain is not None and medium.sizes is not None and medium.particle_m2_sr is not None:
            near_m = np.geomspace(nearest_m, far_m, 200)  # the gain is smooth
            beta = medium_backscatter_per_m_sr(
                near_m,
                sight=sight,
                sizes=medium.sizes,
                backscatter_m2_sr=medium.particle_m2_sr,
                gain=medium.particle_gain,
            )
            return np.interp(range_m, near_m, beta)
        return np.full_like(range_m, medium.backscatter_per_m_sr)

    fwhm_s = float(sensor.received_fwhm_s)
    # The course over range is the same for every pulse, so the convolution with the pulse is tabulated once. Pulses
    # differ in scale and in where their light ends. The drawn particles are taken out of beta, so that none counts
    # twice.
    grid = soft_target.range_grid_m(farthest_m=far_m, fwhm_s=fwhm_s)
    shape = LookupTable(
        soft_target.volume_response(
            range_m=grid,
            backscatter_per_m_sr=lambda r: (
                np.asarray(overlap.share(r)) * sum(undrawn_backscatter(medium, r) for medium in media)
            ),
            extinction_per_m=extinction_per_m,
            fwhm_s=fwhm_s,
            nearest_m=min(nearest_m, 0.1),
        )
    )
    hump_m = hump_of(shape, far_m, float(grid[0]))
    coupling_hz, rate = sensor.receiver.ac_coupling_hz, sensor.coupling_rate
    if coupling_hz is not None and rate is not None:
        # The baseline behind the air's light recovers without a peak, so the hump stays.
        step_s = float(radiometry.time_of_flight_s(range_m=grid[1] - grid[0]))
        passed = high_pass.filter_samples(values=shape.values, step_s=step_s, coupling_hz=float(coupling_hz))
        shape = LookupTable(passed / high_pass.peak_share(rate=rate))
    # A point of even light gets the class of one medium: that which is strongest where the even light is brightest.
    at_peak = grid[[int(np.argmax(shape.values))]]
    return AirLight(
        shape=shape,
        near_m=float(grid[0]),
        far_m=far_m,
        hump_m=hump_m,
        extinction_per_m=extinction_per_m,
        highest=LookupTable(np.maximum.accumulate(shape.values[::-1])[::-1].copy()),
        particles=tuple((tables, name) for name, tables in drawn.items()),
        names=tuple(medium.name for medium in media),
        strongest=max(media, key=lambda medium: float(undrawn_backscatter(medium, at_peak)[0])).name,
    )


def _least_strength(sensor: Sensor) -> float:
    """Strength of the weakest particle that trips the comparator alone, without background.

    Without background the threshold is lowest, so no background requires weaker particles than this.
    """
    # Backwards through the electronics: from the threshold to the optical power that just reaches it.
    point = sensor.working_point(np.zeros(1))
    least_w = np.asarray(point.response.power_w(sensor.threshold(point))).ravel()[0]
    # The lidar equation at 1 m, 1 per sr and clear air gives P_t eta A, the unit of a strength.
    sent = radiometry.echo_power_w(
        peak_power_w=sensor.laser.peak_power_w,
        backscatter_per_sr=1.0,
        range_m=1.0,
        transmittance=1.0,
        aperture_m2=sensor.optics.aperture_m2,
        efficiency=sensor.optics.echo_efficiency,
    )
    return float(least_w / sent)


def overlap_of(sensor: Sensor) -> Overlap:
    """The sensor's overlap; if it has none, that of coaxial optics focused far away.

    Without an overlap the light of the air would grow without bound towards the sensor (docs/theory_light.md 1).
    """
    if sensor.optics.overlap is not None:
        return sensor.optics.overlap
    return Overlap.from_geometry(overlap_geometry(sensor.laser, sensor.optics, sensor.detector, Alignment()))


def _lens_offset_m(sensor: Sensor) -> float:
    """Distance from the laser's exit to the middle of the lens; 0 without an overlap."""
    overlap = sensor.optics.overlap
    return 0.0 if overlap is None else float(overlap.offset_m)


def _nearest_m(overlap: Overlap, far_m: float) -> float:
    """Range from which on the receiver sees at least `NEAREST_SHARE` of the share that it sees at best."""
    # Even steps of log R: the share changes fastest close to the sensor.
    ranges = np.geomspace(1e-2, far_m, 2000)
    share = np.asarray(overlap.share(ranges))
    visible = share >= NEAREST_SHARE * share.max()
    return float(ranges[int(np.argmax(visible))])


def _area_m2(sensor: Sensor) -> Callable[[Numbers], Numbers]:
    """Cross-section of the beam over range, pi times the radii on both axes; 0 for a beam of no width.

    A head that turns while it sums shots lights each drop with some of them: its beam counts as the wider one of the
    same variance, (T126).
    """
    laser = sensor.laser
    waist = 0.5 * (laser.exit_diameter_m or 0.0)
    second = laser.divergence_rad if laser.divergence_elevation_rad is None else laser.divergence_elevation_rad
    # On each axis the radius follows a hyperbola, from the exit (the waist) to the cone of the divergence.
    slopes = (math.tan(0.5 * laser.divergence_rad), math.tan(0.5 * second))

    def area(range_m: Numbers) -> Numbers:
        a, b = (np.hypot(waist, slope * range_m) for slope in slopes)
        return np.asarray(math.pi * np.hypot(a, sensor.sweep_rad / math.sqrt(3.0) * range_m) * b)

    return area
