"""Echoes: the signal and background power that each ray brings to the detector.

The lidar equation turns the geometry of `Hits` into watts, before any electronics: what the detector makes of the power
is another stage, so a missing point can be traced back to a lack of light or to noise (docs/theory.md 1 to 3).

Symbols: P_t peak power of the laser, eta efficiency of the optics, A aperture of the receiver, alpha extinction of the
air, V(R) course of the air's light over range.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..maths.arrays import Lanes, LookupTable, Mask, xp
from ..maths.vectors import Vector, dot, weighted_sum
from ..physics.electronics import intensity
from ..physics.electronics.pulse_sums import SIGMAS_PER_FWHM
from ..physics.optics import air, pulse, radiometry, receiver, sunlight
from ..scene.scene import Interferer
from ..sensor.sensor_model import Sensor
from .beams import Beams
from .hits import Hits


@dataclass(frozen=True, slots=True, kw_only=True)
class Interference:
    """Pulses of another lidar on the detector, at random times (docs/theory_light.md 3).

    Attributes:
        rate_hz: mean rate of its pulses
        peak_power_w: (n,) median of their peak powers
        spread_db: standard deviation of their levels
    """

    rate_hz: Lanes
    peak_power_w: Lanes
    spread_db: Lanes


@dataclass(frozen=True, slots=True, kw_only=True)
class Ambient:
    """Light and air of a scene, in the sensor's spectral band.

    Attributes:
        sun_irradiance_w_m2: irradiance of the sun at normal incidence
        sky_irradiance_w_m2: diffuse irradiance of the sky
        transmittance: transmittance of the air, one way, the part that does not depend on range
        extinction_per_m: alpha, for the part that does
        sun_direction: (x, y, z) unit vector towards the sun; None: no beam looks into it
        lamps_w_m2: irradiance of all surfaces by lamps; None: there are none
        interferers: other lidars
    """

    sun_irradiance_w_m2: Lanes
    sky_irradiance_w_m2: Lanes
    transmittance: Lanes
    extinction_per_m: Lanes
    sun_direction: Vector | None = None
    lamps_w_m2: Lanes | None = None
    interferers: tuple[Interferer, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Fluctuation:
    """Scatter of echoes about their means, by speckle and turbulence; each field (n,).

    Attributes:
        variance: relative variance of the power
        relative_power: power that was drawn, over its mean
    """

    variance: Lanes
    relative_power: Lanes


@dataclass(frozen=True, slots=True, kw_only=True)
class Echoes:
    """Light on the detector, for each ray; each array (n,).

    Attributes:
        has_surface: bool, whether there is an echo
        range_m: range of the echo; 1 without one
        peak_power_w: peak power of the echo; 0 without one
        background_power_w: power of sun, sky and lamps
        interference: pulses of other lidars
        white_w_m2: peak power times range squared of a white surface, for which the sensor is calibrated; 1 if its
            intensity scale does not need it
        fluctuation: of the peak power, which is drawn; None: it is the mean
        broadening: length of the echo over that of the pulse, (T49b); None: as long
        row_slope: relative change of its range over the azimuth [1/rad], as in `Hits`; None: it is not used
    """

    has_surface: Mask
    range_m: Lanes
    peak_power_w: Lanes
    background_power_w: Lanes
    interference: tuple[Interference, ...] = ()
    white_w_m2: Lanes = 1.0
    fluctuation: Fluctuation | None = None
    broadening: Lanes | None = None
    row_slope: Lanes | None = None

    @property
    def curvature(self) -> Lanes:
        """-P'' / P at the peak, 1 of a pulse as it leaves."""
        return 1.0 if self.broadening is None else 1.0 / (self.broadening * self.broadening)


@dataclass(frozen=True, slots=True, kw_only=True)
class Volume:
    """Even light of the air: one course over range for all pulses, scaled for each pulse; theory (T36) and (T37).

    Attributes:
        shape: (samples,) V(R) from near_m to far_m in even steps, convolved with the pulse, in W at a scale of one
        near_m: range of the first sample: no light comes from before it. Below 0 where the first of the pulse comes
            back while its middle has not left yet
        far_m: range of the last sample: no light comes from behind it
        hump_m: (from, to): the course is not concave outside of it (`hump_of`)
        scale: (n,) P_t eta A of each pulse
        end_m: (n,) range at which the last of a pulse's light meets a surface: none comes from behind it
        extinction_per_m: alpha, for the way in which the course ends there
        edge: (n,) nearer range at which a part of the light meets a surface, and (n,) its share; None: there is none
        highest: (samples,) largest value of V from each of these ranges on; None: not known
    """

    shape: LookupTable
    far_m: Lanes
    hump_m: tuple[Lanes, Lanes]
    scale: Lanes
    end_m: Lanes
    extinction_per_m: Lanes
    edge: tuple[Lanes, Lanes] | None = None
    near_m: Lanes = 0.0
    highest: LookupTable | None = None

    @property
    def ends(self) -> list[tuple[Lanes, Lanes]]:
        """Each range at which light meets a surface, and the share of the light."""
        if self.edge is None:
            return [(self.end_m, 1.0)]
        return [self.edge, (self.end_m, 1.0 - self.edge[1])]

    def along(self, range_m: Lanes) -> Lanes:
        """Place of a range in the course: 0 at the first sample, 1 at the last."""
        return (range_m - self.near_m) / (self.far_m - self.near_m)

    def highest_w(self, range_m: Lanes) -> Lanes:
        """Bound of the power from a range on, (n,) W; infinite for one that is lit where the bound is not known."""
        if self.highest is None:
            return xp(self.scale).where(self.scale > 0.0, math.inf, 0.0)
        return self.scale * self.highest.at(self.along(range_m))


def hump_of(shape: LookupTable, far_m: float, near_m: float = 0.0) -> tuple[float, float]:
    """Range interval (from, to) [m] that holds all places where the course of a `Volume` is concave.

    Only there can the air's light have a peak, so only there does the search for peaks look (`detection.rises`).
    """
    values = np.asarray(shape.values, dtype=np.float64)
    # Bend i is of samples i to i + 2. What rounding makes of a straight course is far below 1e-7 of its peak.
    bend = np.diff(values, n=2)
    concave = np.flatnonzero(bend < -1e-7 * values.max())
    if len(concave) == 0:
        return near_m, near_m
    step = (far_m - near_m) / (len(values) - 1)
    return near_m + float(concave[0] * step), near_m + float((concave[-1] + 2) * step)


@dataclass(frozen=True, slots=True, kw_only=True)
class SubEchoes:
    """Sub-echoes of n pulses, the same number of each; lane = pulse lane * count + number.

    Attributes:
        range_m: (n count,) range; undefined without an echo
        peak_power_w: (n count,) peak power; 0 without an echo
        count: sub-echoes of each pulse
    """

    range_m: Lanes
    peak_power_w: Lanes
    count: int


@dataclass(frozen=True, slots=True, kw_only=True)
class EchoTrain:
    """Light on the detector, for pulses with several sub-echoes, theory (T50).

    Attributes:
        parts: groups of sub-echoes; a sub-echo's number counts through all parts
        surfaces: number of sub-echoes that are of surfaces, which come first; the others are of the air, and the last
            may be stray
        has_surface: (n,) bool, whether any ray of the pulse met a surface
        background_power_w: (n,) power of sun, sky and lamps
        volume: even light of the air, or None
        interference: pulses of other lidars, as in `Echoes`
        white_w_m2: (n,) as in `Echoes`
        stray: whether the last sub-echo is stray light of other channels (`light.stray_light`)
        fluctuation: of all sub-echoes together, as in `Echoes`
        broadening: of all sub-echoes, that of the strongest, as in `Echoes`
        row_slope: mean over the rays of the strongest path, as in `Echoes`
    """

    parts: tuple[SubEchoes, ...]
    surfaces: int
    has_surface: Mask
    background_power_w: Lanes
    volume: Volume | None = None
    interference: tuple[Interference, ...] = ()
    white_w_m2: Lanes = 1.0
    fluctuation: Fluctuation | None = None
    stray: bool = False
    broadening: Lanes | None = None
    row_slope: Lanes | None = None

    def part(self, first: int, count: int, *, of: int) -> EchoTrain:
        """Light of ``count`` of ``of`` pulses from number ``first`` on; NumPy arrays."""

        def lanes(values: Any, each: int = 1) -> Any:
            return values[first * each : (first + count) * each] if np.size(values) == of * each else values

        return replace(
            self,
            parts=tuple(
                replace(
                    part, range_m=lanes(part.range_m, part.count), peak_power_w=lanes(part.peak_power_w, part.count)
                )
                for part in self.parts
            ),
            has_surface=lanes(self.has_surface),
            background_power_w=lanes(self.background_power_w),
            volume=None
            if self.volume is None
            else replace(
                self.volume,
                scale=lanes(self.volume.scale),
                end_m=lanes(self.volume.end_m),
                edge=self.volume.edge and (lanes(self.volume.edge[0]), lanes(self.volume.edge[1])),
            ),
            interference=tuple(
                replace(source, peak_power_w=lanes(source.peak_power_w)) for source in self.interference
            ),
            white_w_m2=lanes(self.white_w_m2),
            broadening=lanes(self.broadening),
            row_slope=lanes(self.row_slope),
            fluctuation=None
            if self.fluctuation is None
            else Fluctuation(
                variance=lanes(self.fluctuation.variance), relative_power=lanes(self.fluctuation.relative_power)
            ),
        )


def receive(beams: Beams, hits: Hits, sensor: Sensor, ambient: Ambient, *, lone: bool = True) -> Echoes:
    """Signal and background power of each ray, by (5) and (8) with the BSDF in place of rho / pi.

    A ray that met no surface sees the sky, or the sun.

    Args:
        lone: each ray is the only one of its pulse, and stands for the whole spot
    """
    ops = xp(hits.range_m)
    optics = sensor.optics
    transmittance = air.transmittance(
        fixed=ambient.transmittance, extinction_per_m=ambient.extinction_per_m, range_m=hits.range_m
    )
    # The echo passes panes and mirrors twice, on its way out and back; the background only on its way back.
    outward = hits.throughput if hits.outward is None else hits.outward
    peak = radiometry.echo_power_w(
        peak_power_w=sensor.laser.peak_power_w,
        backscatter_per_sr=hits.backscatter_per_sr,
        range_m=hits.range_m,
        transmittance=transmittance,
        aperture_m2=beams.aperture_m2,
        efficiency=optics.echo_efficiency * echo_share(beams) * hits.throughput * outward,
    )
    # Close by, the spot lies partly outside of the field of view or is out of focus: only a share of the echo
    # reaches the detector.
    if optics.overlap is not None:
        peak = peak * optics.overlap.share(hits.range_m)
    broadening = _broadening(hits, sensor) if lone and sensor.laser.slope_broadening else None
    if broadening is not None:
        peak = peak / broadening
    # Lamps light surfaces from all sides, as the sky does. But a ray that meets nothing sees only the sky.
    diffuse = ambient.sky_irradiance_w_m2
    if ambient.lamps_w_m2 is not None:
        diffuse = diffuse + ambient.lamps_w_m2
    surface = sunlight.surface_radiance_w_m2_sr(
        sun_irradiance_w_m2=ambient.sun_irradiance_w_m2,
        sun_scatter_per_sr=hits.sun_scatter_per_sr,
        sky_irradiance_w_m2=diffuse,
        # The sky is equally bright on both sides of a thin surface, so what it transmits adds to what it reflects.
        reflectivity=hits.reflectivity + hits.transmittance,
    )
    sky = sunlight.sky_radiance_w_m2_sr(sky_irradiance_w_m2=ambient.sky_irradiance_w_m2)
    # The air dims a surface's light along its path. The sky has no range, so only the fixed part dims it.
    background = radiometry.background_power_w(
        radiance_w_m2_sr=ops.where(hits.has_surface, surface, sky),
        aperture_m2=background_aperture_m2(beams),
        field_of_view_sr=radiometry.field_of_view_solid_angle_sr(
            detector_radius_m=sensor.detector.radius_m, focal_length_m=optics.focal_length_m
        ),
        transmittance=ops.where(hits.has_surface, transmittance, ambient.transmittance),
        efficiency=optics.efficiency_sun * beams.receiver_share * hits.throughput,
    )
    # Only a ray that ends at no surface can look into the sun.
    if ambient.sun_direction is not None:
        background = background + ops.where(hits.has_surface, 0.0, _sun_disc_w(beams, hits, sensor, ambient))
    return Echoes(
        has_surface=hits.has_surface,
        range_m=hits.range_m,
        peak_power_w=ops.where(hits.has_surface, peak, 0.0),
        background_power_w=background,
        # Its pulses arrive directly: no range and no surface of ours is in their power, only our aperture and optics.
        interference=tuple(
            Interference(
                rate_hz=lidar.rate_hz,
                peak_power_w=lidar.irradiance_w_m2
                * beams.aperture_m2
                * (optics.efficiency_laser * beams.receiver_share),
                spread_db=lidar.spread_db,
            )
            for lidar in ambient.interferers
        ),
        white_w_m2=_white_w_m2(beams, sensor),
        broadening=broadening,
        row_slope=hits.row_slope,
    )


def _broadening(hits: Hits, sensor: Sensor) -> Lanes:
    """Length of the echo of a whole spot over that of the pulse as received, (n,); theory (T49b)."""
    spot = sensor.laser.spot
    return pulse.slope_broadening(
        spot_rad=receiver.spot_radius_rad(
            exit_radius_m=spot.exit_radius_m, half_divergence_rad=spot.half_divergence_rad, range_m=hits.range_m
        ),
        range_m=hits.range_m,
        cos_incidence=xp(hits.range_m).where(hits.has_surface, hits.cos_incidence, 1.0),
        unit_m=radiometry.range_from_time_of_flight_m(time_of_flight_s=sensor.received_fwhm_s / SIGMAS_PER_FWHM),
    )


def echo_share(beams: Beams) -> Lanes:
    """Share of an echo's power that the wear of the sensor leaves, a scalar or (n,)."""
    return beams.laser_share * beams.receiver_share


def background_aperture_m2(beams: Beams) -> Lanes:
    """Aperture of the background in (8), a scalar or (n,)."""
    return beams.aperture_m2 if beams.background_aperture_m2 is None else beams.background_aperture_m2


def _sun_disc_w(beams: Beams, hits: Hits, sensor: Sensor, ambient: Ambient) -> Lanes:
    """Power of the sun's disc in the field of view, (n,) W; theory (T42)."""
    assert ambient.sun_direction is not None
    # Near the sun the chord between two unit vectors equals the angle, and single precision resolves it. An arc cosine
    # of a number close to 1 would lose it.
    chord = weighted_sum(1.0, hits.direction or beams.direction, -1.0, ambient.sun_direction)
    square = dot(chord, chord)
    return sunlight.sun_disc_power_w(
        sun_irradiance_w_m2=ambient.sun_irradiance_w_m2,
        sun_angle_rad=xp(square).sqrt(square),
        field_rad=sensor.detector.radius_m / sensor.optics.focal_length_m,
        aperture_m2=background_aperture_m2(beams),
        efficiency=sensor.optics.efficiency_sun * beams.receiver_share * hits.throughput,
    )


def _white_w_m2(beams: Beams, sensor: Sensor) -> Lanes:
    """Echo of a white surface on the sensor's intensity scale, W m2; 1 if the scale does not need it."""
    if sensor.intensity is None or sensor.intensity.kind != "reflectivity":
        return 1.0
    white_w_m2 = intensity.white_echo_w_m2(
        peak_power_w=sensor.laser.peak_power_w, aperture_m2=beams.aperture_m2, efficiency=sensor.calibrated_efficiency
    )
    # A laser whose reflectivities read too high is calibrated to a white echo that is too weak.
    gain = sensor.scanner.intensity_gain(beams.pulse)
    return white_w_m2 if gain is None else white_w_m2 / gain


def gather_background(paths: Sequence[Echoes]) -> list[Echoes]:
    """Add the background of all paths of a ray to the first path.

    A pane splits a ray into paths. The background of all reaches the detector, but a pulse has only one background.
    """
    if len(paths) == 1:
        return list(paths)
    background = sum(path.background_power_w for path in paths)
    return [replace(paths[0], background_power_w=background), *paths[1:]]
