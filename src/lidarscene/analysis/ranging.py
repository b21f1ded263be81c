"""Signal-to-noise ratio and maximum range on the paper's plane target, from the exact SNR; no tracing, no LLVM."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..beams import Beams
from ..echoes import Ambient, Echoes, receive
from ..hits import Hits
from ..physics import sunlight
from ..sensor import Sensor

Matrix = np.ndarray[Any, Any]

_NEAREST_M, _FARTHEST_M = 1e-2, 1e6


class RangeStatus(enum.IntEnum):
    """What a maximum range means."""

    FOUND = 0
    NEVER_DETECTED = 1  # not even at 1 cm: no light, or the detector is blind
    NO_LIMIT = 2  # still detected at 1000 km: nothing stands against the signal


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A Lambertian plane wider than the spot, and the light and air around it (Table 1 by default)."""

    reflectivity: float = 0.1
    cos_incidence: float = 1.0
    cos_sun: float = 0.5
    illuminance_klux: float = 100.0
    diffuse_share: float = 0.0
    transmittance: float = 0.98
    extinction_per_m: float = 0.0


def echoes_of_plane(sensor: Sensor, target: Target, range_m: Matrix | float) -> Echoes:
    """Light on the detector from the target at these ranges: the same stage that `render` runs."""
    ranges = np.atleast_1d(np.asarray(range_m, dtype=np.float64))
    every = np.ones_like(ranges)
    sun = sunlight.sun_irradiance_w_m2(
        irradiance_at_100_klux_w_m2=sensor.optics.sun_irradiance_w_m2,
        illuminance_klux=target.illuminance_klux,
    )
    hits = Hits(
        found=ranges > 0.0,
        range_m=ranges,
        cos_incidence=target.cos_incidence * every,
        backscatter_per_sr=target.reflectivity * target.cos_incidence / math.pi * every,
        sun_scatter_per_sr=target.reflectivity * max(target.cos_sun, 0.0) / math.pi * every,
        reflectivity=target.reflectivity * every,
        cos_sun=target.cos_sun * every,
        lit=(target.cos_sun > 0.0) & (ranges > 0.0),
        face=np.zeros(len(ranges), dtype=np.int32),
    )
    beams = Beams(
        pulse=np.arange(len(ranges), dtype=np.uint32),
        origin_m=(0.0, 0.0, 0.0),
        direction=(every, 0.0 * every, 0.0 * every),
        aperture_m2=sensor.optics.aperture_m2,
    )
    ambient = Ambient(
        sun_irradiance_w_m2=sun,
        sky_irradiance_w_m2=sunlight.sky_irradiance_w_m2(
            sun_irradiance_w_m2=sun, diffuse_share=target.diffuse_share
        ),
        transmittance=target.transmittance,
        extinction_per_m=target.extinction_per_m,
    )
    return receive(beams, hits, sensor, ambient)


def snr(sensor: Sensor, target: Target, range_m: Matrix | float) -> Matrix:
    """(n,) signal-to-noise ratio (19) or (27) at these ranges; inf where there is no noise at all."""
    light = echoes_of_plane(sensor, target, range_m)
    point = sensor.working_point(light.background_power_w)
    with np.errstate(divide="ignore"):
        return np.asarray(point.signal(light.peak_power_w) / (point.noise + 0.0 * light.range_m))


def detection_margin(sensor: Sensor, target: Target, range_m: Matrix | float) -> Matrix:
    """(n,) peak signal over the comparator's level; 1 where the echo is found half of the time."""
    light = echoes_of_plane(sensor, target, range_m)
    point = sensor.working_point(light.background_power_w)
    with np.errstate(divide="ignore"):
        return np.asarray(point.signal(light.peak_power_w) / (sensor.threshold(point) + 0.0 * light.range_m))


def maximum_range_m(sensor: Sensor, target: Target) -> tuple[float, RangeStatus]:
    """Range at which the peak signal falls to the comparator's level, by bisection on the exact response.

    The signal falls and the level does not rise with range, so there is one crossing. Returns it (0 or inf
    where there is none) and what it means. Accurate to 1e-12 relative.
    """
    near, far = _NEAREST_M, _FARTHEST_M
    if not detection_margin(sensor, target, near)[0] >= 1.0:
        return 0.0, RangeStatus.NEVER_DETECTED
    if detection_margin(sensor, target, far)[0] >= 1.0:
        return math.inf, RangeStatus.NO_LIMIT
    while far / near > 1.0 + 1e-12:
        middle = math.sqrt(near * far)
        if detection_margin(sensor, target, middle)[0] >= 1.0:
            near = middle
        else:
            far = middle
    return math.sqrt(near * far), RangeStatus.FOUND


def equal_range_illuminance_klux(
    first: Sensor, second: Sensor, target: Target, *, low_klux: float = 0.01, high_klux: float = 100.0
) -> float:
    """Illuminance at which two sensors reach equally far; ValueError if they do not change places in between."""

    def ahead(illuminance_klux: float) -> bool:
        lit = replace(target, illuminance_klux=illuminance_klux)
        return maximum_range_m(first, lit)[0] > maximum_range_m(second, lit)[0]

    at_low = ahead(low_klux)
    if at_low == ahead(high_klux):
        raise ValueError(
            f"'{first.name}' and '{second.name}' do not change places between {low_klux} and {high_klux} klux"
        )
    while high_klux / low_klux > 1.0 + 1e-10:
        middle = math.sqrt(low_klux * high_klux)
        if ahead(middle) == at_low:
            low_klux = middle
        else:
            high_klux = middle
    return math.sqrt(low_klux * high_klux)
