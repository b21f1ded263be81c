"""Signal-to-noise ratio and range on the paper's plane target, from the exact SNR; no tracing, no LLVM.

The light comes from the same stage that `render` runs, so a range limit and a rendered board agree. Every number of a
`Target`, and of a sensor's laser, optics, detector and electronics, may be an array; they broadcast with each other
and with the ranges. `stack_sensors` makes such a sensor from several.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ...light.beams import Beams
from ...light.echoes import Ambient, Echoes, receive
from ...light.fluctuations import FluctuationLaw
from ...light.hits import Hits
from ...maths.arrays import Lanes, Numbers, xp
from ...physics.electronics import range_limit
from ...physics.optics import radiometry, scintillation, sunlight
from ...scene.scene import Air
from ...sensor.detectors import WorkingPoint
from ...sensor.sensor_model import Sensor

NEAREST_M, FARTHEST_M = 1e-2, 1e6
"""Choice: nearest and farthest distance between which a range is sought."""

_CUTS = round(math.log10(FARTHEST_M / NEAREST_M) * 16)
"""Choice: 16 steps per decade of the grid on which the last crossing is sought."""

_ACCURACY = 5e-14
"""Accuracy bought: error of a range, as a share of eight decades: 1e-12 relative."""

_AT_ONCE = 4096  # most points of the grid in one call

_MOST_LOG = 700.0
"""Accuracy bought: largest logarithm of the margin: without noise, or without signal, it is infinite."""

_BLINDING_W = 1e20
"""Choice: more light than any detector resolves."""

_NOTHING = 1e-100
"""Accuracy bought: least product that counts: below it those of the closed forms underflow."""

PARTS = ("laser", "optics", "detector", "tdc", "sampler", "receiver", "histogram")
"""Parts of a sensor that decide its range."""


class RangeStatus(enum.IntEnum):
    """Meaning of a range."""

    FOUND = 0
    NEVER_DETECTED = 1  # not even at 1 cm: no light, or the detector is blind
    NO_LIMIT = 2  # still detected at 1000 km: no noise limits the signal
    SATURATED = 3  # never: not even all free cells together reach the threshold
    WINDOW = 4  # of `reported_range_m`: the signal would do for farther, but the converter's window ends


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A Lambertian plane wider than the spot, and the light and air around it (Table 1 by default).

    Attributes:
        aperture_share: effective aperture A(theta_r) of (4) over that of `Scanner.typical_share`; see
            `studies.ranging.aperture_laws`
        background_share: aperture times field of view over that on the axis, for (8); None: as ``aperture_share``
    """

    reflectivity: Lanes = 0.1
    cos_incidence: Lanes = 1.0
    cos_sun: Lanes = 0.5
    illuminance_klux: Lanes = 100.0
    diffuse_share: Lanes = 0.0
    transmittance: Lanes = 0.98
    extinction_per_m: Lanes = 0.0
    aperture_share: Lanes = 1.0
    background_share: Lanes | None = None

    @property
    def background_aperture(self) -> Lanes:
        """Share of the background's aperture, `background_share` or that of the echo."""
        return self.aperture_share if self.background_share is None else self.background_share


def conditions_shape(sensor: Sensor, target: Target) -> tuple[int, ...]:
    """Common shape of all arrays in a sensor and a target; () if there are none."""
    parts = [getattr(sensor, part) for part in PARTS if getattr(sensor, part) is not None] + [target]
    values = [getattr(part, field.name) for part in parts for field in dataclasses.fields(part)]
    return np.broadcast_shapes(*(value.shape for value in values if isinstance(value, np.ndarray)))


def stack_sensors(sensors: Sequence[Sensor]) -> Sensor | None:
    """One sensor with arrays for the numbers in which these differ; None if they differ in anything else."""
    first, changes = sensors[0], {}
    for part in PARTS:
        parts = [getattr(sensor, part) for sensor in sensors]
        if len({type(component) for component in parts}) > 1:
            return None
        if parts[0] is None:
            continue
        fields = {}
        for field in dataclasses.fields(parts[0]):
            values_of_field = [getattr(component, field.name) for component in parts]
            if all(value is values_of_field[0] or value == values_of_field[0] for value in values_of_field):
                continue
            if not all(isinstance(value, (int, float)) for value in values_of_field):
                return None
            fields[field.name] = np.array(values_of_field, dtype=np.float64)
        changes[part] = replace(parts[0], **fields)
    return replace(first, **changes)


def light_of_plane(sensor: Sensor, target: Target, range_m: Lanes) -> Echoes:
    """Light on the detector from the target, by the same stage that `render` runs; all numbers NumPy or Dr.Jit.

    Where the range is below 0, it is the sky's.
    """
    sun = sunlight.sun_irradiance_w_m2(
        irradiance_at_100_klux_w_m2=sensor.optics.sun_irradiance_w_m2, illuminance_klux=target.illuminance_klux
    )
    lit = xp(range_m, target.cos_sun).maximum(target.cos_sun, 0.0)
    hits = Hits(
        has_surface=range_m > 0.0,
        range_m=range_m,
        cos_incidence=target.cos_incidence,
        backscatter_per_sr=target.reflectivity * target.cos_incidence / math.pi,
        sun_scatter_per_sr=target.reflectivity * lit / math.pi,
        reflectivity=target.reflectivity,
        cos_sun=target.cos_sun,
        lit=target.cos_sun > 0.0,
        face=0,
    )
    beams = Beams(
        pulse=0,
        origin_m=(0.0, 0.0, 0.0),
        direction=(1.0, 0.0, 0.0),
        aperture_m2=_aperture_m2(sensor, target),
        background_aperture_m2=sensor.optics.aperture_m2 * target.background_aperture,
    )
    ambient = Ambient(
        sun_irradiance_w_m2=sun,
        sky_irradiance_w_m2=sunlight.sky_irradiance_w_m2(sun_irradiance_w_m2=sun, diffuse_share=target.diffuse_share),
        transmittance=target.transmittance,
        extinction_per_m=target.extinction_per_m,
    )
    return receive(beams, hits, sensor, ambient)


def _aperture_m2(sensor: Sensor, target: Target) -> Lanes:
    """Effective aperture of the echo."""
    return sensor.optics.aperture_m2 * (sensor.scanner.typical_share * target.aperture_share)


def echoes_of_plane(sensor: Sensor, target: Target, range_m: Numbers | float) -> Echoes:
    """`light_of_plane` at these ranges, in the common shape of ranges and conditions."""
    shape = np.broadcast_shapes(np.shape(range_m), conditions_shape(sensor, target))
    ranges = np.array(np.broadcast_to(np.asarray(range_m, dtype=np.float64), shape or (1,)))
    surface = {
        name: getattr(target, name) * np.ones_like(ranges) for name in ("reflectivity", "cos_incidence", "cos_sun")
    }
    return light_of_plane(sensor, replace(target, **surface), ranges)


def _response(sensor: Sensor, light: Echoes) -> tuple[WorkingPoint, Numbers, Numbers]:
    """The working point, the peak signal and the comparator's level, in the shape of the light."""
    point = sensor.working_point(light.background_power_w, range_m=light.range_m)
    ones = np.ones_like(light.range_m)
    height_w = light.peak_power_w * sensor.height_gain(light.curvature)
    signal, level = point.response.signal(height_w) * ones, sensor.threshold(point) * ones
    return point, np.asarray(signal), np.asarray(level)


def _ratio(signal: Numbers, level: Numbers) -> Numbers:
    """signal / level; 0 without a signal, inf if only the level is zero."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(signal > 0.0, signal / level, 0.0)


def snr(sensor: Sensor, target: Target, range_m: Numbers | float) -> Numbers:
    """(n,) signal-to-noise ratio (19) or (27) at these ranges."""
    point, signal, _ = _response(sensor, echoes_of_plane(sensor, target, range_m))
    return np.asarray(point.snr(signal))


def detection_margin(sensor: Sensor, target: Target, range_m: Numbers | float) -> Numbers:
    """(n,) peak signal over the comparator's level; at 1 the echo is detected half of the time."""
    return margin_of_light(sensor, echoes_of_plane(sensor, target, range_m))


def margin_of_light(sensor: Sensor, light: Echoes) -> Numbers:
    """(n,) `detection_margin` of these echoes."""
    _, signal, level = _response(sensor, light)
    return _ratio(signal, level)


def fluctuation_variance(sensor: Sensor, target: Target, range_m: Lanes) -> Lanes | None:
    """Relative variance of the echo's power by energy and speckle, in calm air; None if it does not fluctuate."""
    law = FluctuationLaw.of(sensor, Air())
    if law is None:
        return None
    aperture_m2 = _aperture_m2(sensor, target)
    return law.variance(range_m=range_m, cos_incidence=target.cos_incidence, aperture_m2=aperture_m2)


def expected_probability(
    sensor: Sensor,
    point: WorkingPoint,
    level: Lanes,
    peak_power_w: Lanes,
    variance: Lanes | None,
    curvature: Lanes = 1.0,
) -> Lanes:
    """P_d of an echo with its own shot noise, the mean over its fluctuation if it has one.

    Args:
        peak_power_w: its mean
        variance: `fluctuation_variance`
        curvature: `light.echoes.Echoes.curvature`
    """
    peak_power_w = peak_power_w * sensor.height_gain(curvature)

    def probability(relative_power: Lanes) -> Lanes:
        signal = point.response.signal(peak_power_w * relative_power)
        reached = point.detection_probability(level, signal, point.noise.at(signal))
        return reached * sensor.steadiness(point.noise, level, signal, curvature)

    return probability(1.0) if variance is None else scintillation.mean(probability, variance)


def detection_probability(sensor: Sensor, target: Target, range_m: Numbers | float) -> Numbers:
    """(n,) P_d with the echo's own shot noise (13): the share that `render` keeps, apart from its window."""
    light = echoes_of_plane(sensor, target, range_m)
    return probability_of_light(sensor, light, fluctuation_variance(sensor, target, light.range_m))


def probability_of_light(sensor: Sensor, light: Echoes, variance: Lanes | None) -> Numbers:
    """(n,) `detection_probability` of these echoes.

    Args:
        variance: `fluctuation_variance`
    """
    point, _, level = _response(sensor, light)
    with np.errstate(over="ignore"):  # exp(-x^2) of a vanishing noise
        return np.asarray(expected_probability(sensor, point, level, light.peak_power_w, variance, light.curvature))


def _crossing_m(excess: Callable[[Numbers], Numbers], near: Numbers, far: Numbers) -> Numbers:
    """(n,) ranges at which an excess, >= 0 at ``near`` and < 0 at ``far``, goes through 0; NaN where it does not.

    Chandrupatla's method on the logarithm of the range: a power law's own is a straight line there.
    """
    from scipy.optimize import elementwise

    ranges = near.copy()

    def of_some(share: Numbers, index: Numbers) -> Numbers:
        # The excess is of all conditions, so all are computed, those that are found too. At the ends the very ranges
        # that are known to be on either side: the nearest float may be on the other.
        start, end = near[index], far[index]
        ranges[index] = np.where(share < 1.0, start * (end / start) ** share, end)
        return excess(ranges)[index]

    ends, index = (np.zeros_like(near), np.ones_like(near)), np.arange(len(near))
    tolerances = {"xatol": _ACCURACY, "xrtol": 0.0, "fatol": 0.0, "frtol": 0.0}
    share = elementwise.find_root(of_some, ends, args=(index,), tolerances=tolerances).x
    return np.asarray(near * (far / near) ** share)


def window_m(sensor: Sensor) -> Any:
    """Range at the end of the sensor's window."""
    return radiometry.range_from_time_of_flight_m(time_of_flight_s=sensor.tdc.window_s)


def blanking_m(sensor: Sensor) -> Any:
    """Range at the end of the sensor's blanking."""
    return radiometry.range_from_time_of_flight_m(time_of_flight_s=sensor.tdc.blanking_s)


def range_at_probability_m(sensor: Sensor, target: Target, probability: float) -> float:
    """`reported_range_m` of one condition, without its status."""
    return float(reported_range_m(sensor, target, probability)[0])


def reported_range_m(sensor: Sensor, target: Target, probability: float) -> tuple[Any, Any]:
    """Farthest range that the sensor reports, and a `RangeStatus` that says what limits it: the signal or the window.

    `detection_range_m`, cut off at the converter's window; 0 if all of it lies within the blanking. Same shapes.
    """
    limit, status = detection_range_m(sensor, target, probability)
    end = window_m(sensor)
    blanked = (limit > 0.0) & (limit <= blanking_m(sensor))
    status = np.where(limit > end, RangeStatus.WINDOW, np.where(blanked, RangeStatus.NEVER_DETECTED, status))
    reported = np.where(blanked, 0.0, np.minimum(limit, end))
    if not np.shape(reported):
        return float(reported), RangeStatus(int(status))
    return reported, status


def detection_range_m(sensor: Sensor, target: Target, probability: float) -> tuple[Any, Any]:
    """Farthest range at which P_d is at least ``probability``, and a `RangeStatus`.

    It is that of the signal: a converter whose window ends before reports less, `reported_range_m`.

    Two scalars, or two arrays of the conditions' shape. 0 if there is no such range, inf if there is no limit; never
    NaN. The last crossing on a grid of 16 points per decade between 1 cm and 1000 km, to 1e-12 relative.
    """

    def excess(range_m: Numbers) -> Numbers:
        return detection_probability(sensor, target, range_m) - probability

    return _last_crossing_m(sensor, target, excess, lambda range_m: excess(range_m) >= 0.0, cuts=_CUTS)


def maximum_range_m(sensor: Sensor, target: Target) -> tuple[Any, Any]:
    """Range at which the peak signal falls to the comparator's level, and a `RangeStatus`: the paper's maximum range.

    SNR is TNR there and, without fluctuations of the echo and with Gaussian noise, P_d one half. Shapes, values and
    accuracy are those of `detection_range_m`.

    Between 1 cm and 1000 km the signal falls while, in clear air, the level stays, so there is one crossing. With
    extinction sunlight fades with range too, and a SiPM that is blinded nearby may see again farther away; with an
    overlap of two lenses nothing is seen right before them. Then the range is that of the last crossing on the grid.
    """
    several = np.any(np.asarray(target.extinction_per_m) > 0.0) or sensor.optics.overlap is not None

    def margin(range_m: Numbers) -> Numbers:
        with np.errstate(divide="ignore"):
            return np.clip(np.log(detection_margin(sensor, target, range_m)), -_MOST_LOG, _MOST_LOG)

    return _last_crossing_m(
        sensor,
        target,
        margin,
        partial(_is_detected, sensor, target),
        cuts=_CUTS if several else 1,
        unlimited=_is_noiseless(sensor, target),
    )


def _last_crossing_m(
    sensor: Sensor,
    target: Target,
    excess: Callable[[Numbers], Numbers],
    is_detected: Callable[[Numbers], Numbers],
    *,
    cuts: int,
    unlimited: Numbers | bool = False,
) -> tuple[Any, Any]:
    """Farthest range at which the target is detected, and a `RangeStatus`, in the conditions' shape.

    Args:
        excess: of ranges, in the shape of ranges and conditions: 0 at the limit, and more before it
        cuts: of the grid on which the last crossing is sought
        unlimited: where a target that is detected anywhere is so at any range
    """
    shape = conditions_shape(sensor, target)
    ones = np.ones(shape or (1,))
    grid = np.geomspace(NEAREST_M, FARTHEST_M, cuts + 1)
    # Index of the last grid range at which the target is detected; -1: none.
    calls = min(grid.size * ones.size // _AT_ONCE + 1, grid.size)  # several calls, to bound the memory
    parts = [np.multiply.outer(part, ones) for part in np.array_split(grid, calls)]
    detected = np.concatenate([is_detected(part) for part in parts])
    last = np.where(detected.any(axis=0), cuts - np.argmax(detected[::-1], axis=0), -1)
    near, far = grid[np.maximum(last, 0)], grid[np.minimum(last + 1, cuts)]
    last = np.where((last >= 0) & unlimited, cuts, last)
    found = _crossing_m(lambda range_m: excess(range_m.reshape(ones.shape)).ravel(), near.ravel(), far.ravel())
    limit = np.where(last < 0, 0.0, np.where(last == cuts, math.inf, found.reshape(ones.shape)))
    never = np.where(_is_saturated(sensor, target), RangeStatus.SATURATED, RangeStatus.NEVER_DETECTED)
    status = np.where(last < 0, never, np.where(last == cuts, RangeStatus.NO_LIMIT, RangeStatus.FOUND))
    if not shape:
        return float(limit[0]), RangeStatus(int(status[0]))
    return limit, status


def _is_detected(sensor: Sensor, target: Target, range_m: Numbers) -> Numbers:
    """True where the peak reaches the level. A zero signal is never detected, even with a level of zero."""
    _, signal, level = _response(sensor, echoes_of_plane(sensor, target, range_m))
    return np.asarray((signal >= level) & (signal > 0.0))


def _is_noiseless(sensor: Sensor, target: Target) -> Numbers:
    """True where the level is zero at the nearest range, where it is highest: then every echo is detected."""
    _, _, level = _response(sensor, echoes_of_plane(sensor, target, NEAREST_M))
    return np.asarray(level <= 0.0)


def _is_saturated(sensor: Sensor, target: Target) -> Numbers:
    """True where the level is above the detector's response to any light."""
    point, _, level = _response(sensor, echoes_of_plane(sensor, target, NEAREST_M))
    return np.asarray(point.response.signal(_BLINDING_W * np.ones_like(level)) < level)


def closed_form_range_m(sensor: Sensor, target: Target) -> Any:
    """The derived closed forms (29) and (30) for this sensor: background shot noise only.

    An upper bound of `maximum_range_m`, unless a SiPM is far from linear; for one in the time domain (30) has all light
    of the dead time around the peak, not half of the pulse. With extinction the range is on both sides, R = R_0
    exp(-3/4 alpha R), solved by Lambert's W: R = W(3/4 alpha R_0) / (3/4 alpha). inf without background, 0 without an
    echo; None for a detector without a closed form.

    Raises:
        ValueError: for a fixed threshold
    """
    if sensor.tdc.threshold_to_noise is None:
        raise ValueError(f"sensor '{sensor.name}' has a fixed threshold: the closed forms need a ratio to noise")
    laser, optics, detector = sensor.laser, sensor.optics, sensor.detector
    ones = np.ones(conditions_shape(sensor, target) or (1,))
    echo = ones * target.reflectivity * target.cos_incidence * target.transmittance * target.aperture_share
    # The sky's share of the radiance adds to cos(theta_s) under the root, so the forms hold with a sky too.
    daylight = np.maximum(target.cos_sun, 0.0) + target.diffuse_share
    # The forms have one aperture: what the background has more of it is as much more sun.
    aperture_m2 = _aperture_m2(sensor, target)
    sunlight_share = optics.aperture_m2 * target.background_aperture / np.maximum(aperture_m2, _NOTHING)
    dark = ones * target.illuminance_klux * optics.sun_irradiance_w_m2 * daylight * sunlight_share <= _NOTHING
    sun_irradiance_w_m2 = optics.sun_irradiance_w_m2 * target.illuminance_klux / 100.0 * sunlight_share
    wall = range_limit.Plane(
        reflectivity=np.where(echo > _NOTHING, target.reflectivity, 1.0),
        sun_irradiance_w_m2=np.where(dark, 1.0, sun_irradiance_w_m2),
        transmittance=target.transmittance,
        cos_incidence=target.cos_incidence,
        cos_sun=np.where(dark, 1.0, daylight),
    )
    receiver = range_limit.Transceiver(
        peak_power_w=laser.peak_power_w,
        aperture_m2=np.where(echo > _NOTHING, aperture_m2, 1.0),
        focal_over_radius=optics.focal_length_m / detector.radius_m,
        threshold_to_noise=sensor.tdc.threshold_to_noise,
        photon_energy_j=laser.photon_energy_j,
        efficiency_laser=optics.echo_efficiency,
        efficiency_sun=optics.efficiency_sun,
    )
    bound = detector.closed_form_range_m(wall, receiver, sensor.reception)
    if bound is None:
        return None
    # SNR goes with 1 / R^2, and with what the amplifier leaves of the peak over the root of that of the noise.
    response = sensor.response
    bound = bound * np.sqrt(response.peak / np.sqrt(response.noise))
    rate = 0.75 * target.extinction_per_m * ones
    thick = rate > 0.0
    if np.any(thick):  # R exp(rate R) = bound: Lambert's W
        from scipy.special import lambertw

        bound = np.where(thick, lambertw(rate * bound).real / np.where(thick, rate, 1.0), bound)
    limit = np.where(echo > _NOTHING, np.where(dark, math.inf, bound), 0.0)
    return limit if conditions_shape(sensor, target) else float(limit[0])


def equal_range_illuminance_klux(
    first: Sensor,
    second: Sensor,
    target: Target,
    *,
    probability: float | None = None,
    low_klux: float = 0.01,
    high_klux: float = 100.0,
) -> float:
    """Illuminance at which two sensors have equal range; ValueError if they do not change places in between.

    Args:
        probability: P_d at the range; None: that of `maximum_range_m`
    """

    def ahead(illuminance_klux: Numbers) -> Numbers:
        lit = replace(target, illuminance_klux=illuminance_klux)
        first_m, second_m = (
            (maximum_range_m(sensor, lit) if probability is None else detection_range_m(sensor, lit, probability))[0]
            for sensor in (first, second)
        )
        return np.asarray(first_m > second_m)

    at_ends = ahead(np.array([low_klux, high_klux]))
    if at_ends[0] == at_ends[1]:
        raise ValueError(
            f"'{first.name}' and '{second.name}' do not change places between {low_klux} and {high_klux} klux"
        )
    while high_klux / low_klux > 1.0 + 1e-10:
        illuminances_klux = np.geomspace(low_klux, high_klux, 17)
        change = int(np.argmax(ahead(illuminances_klux[1:]) != at_ends[0]))
        low_klux, high_klux = float(illuminances_klux[change]), float(illuminances_klux[change + 1])
    return math.sqrt(low_klux * high_klux)
