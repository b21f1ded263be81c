"""Waveform: an EchoTrain in, the power on the detector as a function of time out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..maths.arrays import Array, Lanes, Numbers, xp
from ..physics.electronics.pulse_sums import SIGMAS_PER_FWHM, Shape, even_sum, evenly, sum_of_pulses
from ..physics.optics import pulse as pulse_shape
from ..physics.optics import radiometry
from ..physics.weather import soft_target
from ..sensor.model import Sensor
from .echoes import EchoTrain, Volume

_FAR = 1e30
"""Place of an interval that a pulse does not have; beyond every window."""

_HALF_STEP = 0.5
"""Over which the slope of a volume's course is taken, in sigma_p: a course bends little over that."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Waveform:
    """What comes back of each pulse, in units of the pulse's width around the pulse's first sub-echo.

    origin_m, unit_m  a place u is at the range origin_m + u unit_m; unit_m is c sigma_p / 2
    fwhm_s            of the laser's pulse
    centres, heights  of each sub-echo, (n,) places and powers; height 0 where there is none
    volume            backscatter of the air, or None
    """

    origin_m: Lanes
    unit_m: Lanes
    fwhm_s: Lanes
    centres: Sequence[Lanes]
    heights: Sequence[Lanes]
    volume: Volume | None

    def at(self, place: Lanes) -> Shape:
        """Power and its two derivatives there."""
        value, slope, bend = sum_of_pulses(at=place, centres=self.centres, heights=self.heights)
        if self.volume is None:
            return value, slope, bend
        before, here, after = (
            _volume_w(self.volume, self.range_m(place + step), self.fwhm_s)
            for step in (-_HALF_STEP, 0.0, _HALF_STEP)
        )
        return (
            value + here,
            slope + (after - before) / (2.0 * _HALF_STEP),
            bend + (after - 2.0 * here + before) / (_HALF_STEP * _HALF_STEP),
        )

    def evenly(self, start: Lanes, spacing: Lanes, middle: Lanes) -> Comb:
        """The same at places that follow each other evenly, 2 t_FWHM to either side of the middle."""
        parts, growths = evenly(
            start=start, spacing=spacing, middle=middle, centres=self.centres, heights=self.heights
        )
        return Comb(wave=self, middle=middle, growths=growths, parts=parts)

    def range_m(self, place: Lanes) -> Lanes:
        """Range from which light comes at this place."""
        return self.origin_m + place * self.unit_m

    def intervals(self) -> list[tuple[Array, Array]]:
        """From where to where the waveform can be concave: only there can it have a peak.

        A Gaussian is concave within one sigma of its centre; a volume's course on its hump.
        """
        ops = xp(*self.centres, self.origin_m)
        found = [
            (ops.where(height > 0.0, centre - 1.0, _FAR), ops.where(height > 0.0, centre + 1.0, -_FAR))
            for centre, height in zip(self.centres, self.heights, strict=True)
        ]
        if self.volume is not None:
            start, end = ((edge - self.origin_m) / self.unit_m for edge in self.volume.hump_m)
            there = self.volume.scale > 0.0
            found.append((ops.where(there, start, _FAR), ops.where(there, end, -_FAR)))
        return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Comb:
    """A waveform at places that follow each other evenly.

    parts    of each sub-echo at the first place: what a loop over the places takes along
    growths  what multiplies these from place to place
    """

    wave: Waveform
    middle: Lanes
    parts: Sequence[Lanes]
    growths: Sequence[Lanes]

    def power_w(self, place: Lanes, parts: Sequence[Lanes]) -> Lanes:
        """At a place, from the parts there."""
        wave, value = self.wave, even_sum(at=place, middle=self.middle, parts=parts)
        return (
            value if wave.volume is None else value + _volume_w(wave.volume, wave.range_m(place), wave.fwhm_s)
        )

    def following(self, parts: Sequence[Lanes]) -> tuple[Lanes, ...]:
        """Parts at the next place."""
        return tuple(part * growth for part, growth in zip(parts, self.growths, strict=True))


def waveform(pulse_train: EchoTrain, sensor: Sensor) -> Waveform:
    """The sub-echoes of each pulse, taken apart into one array for each."""
    ops = xp(pulse_train.parts[0].range_m)
    ranges, heights = (
        [
            ops.column(getattr(part, name), number, part.count)
            for part in pulse_train.parts
            for number in range(part.count)
        ]
        for name in ("range_m", "peak_power_w")
    )
    unit = radiometry.range_from_time_of_flight_m(
        time_of_flight_s=sensor.laser.pulse_fwhm_s / SIGMAS_PER_FWHM
    )
    nearest = ops.full(heights[0], _FAR)
    for distance, height in zip(ranges, heights, strict=True):
        nearest = ops.where(height > 0.0, ops.minimum(nearest, distance), nearest)
    origin = ops.where(nearest < _FAR, nearest, 0.0)
    centres = [
        ops.where(height > 0.0, (distance - origin) / unit, 0.0)
        for distance, height in zip(ranges, heights, strict=True)
    ]
    return Waveform(
        origin_m=origin, unit_m=unit, fwhm_s=sensor.laser.pulse_fwhm_s,
        centres=centres, heights=heights, volume=pulse_train.volume,
    )  # fmt: skip


def sampled(pulse_train: EchoTrain, sensor: Sensor, times_s: Numbers) -> tuple[Numbers, Numbers]:
    """Optical power and the detector's mean signal against time, without noise: each (n, times), numpy.

    times_s  (times,) after the pulse left
    """
    times = np.asarray(times_s, dtype=np.float64)
    power = np.zeros((np.size(pulse_train.background_power_w), len(times)))
    for part in pulse_train.parts:
        arrival = np.asarray(radiometry.time_of_flight_s(range_m=np.asarray(part.range_m, dtype=np.float64)))
        peak = np.asarray(part.peak_power_w)
        for first in range(part.count):
            lanes = slice(first, None, part.count)
            pulses = pulse_shape.gaussian_pulse(
                time_s=times - arrival[lanes, None], fwhm_s=sensor.laser.pulse_fwhm_s
            )
            power += peak[lanes, None] * pulses
    if pulse_train.volume is not None:
        scale, end_m = (
            np.asarray(values)[:, None] for values in (pulse_train.volume.scale, pulse_train.volume.end_m)
        )
        range_m = radiometry.range_from_time_of_flight_m(time_of_flight_s=times)
        power += _volume_w(
            replace(pulse_train.volume, scale=scale, end_m=end_m), range_m, sensor.laser.pulse_fwhm_s
        )
    point = sensor.working_point(np.asarray(pulse_train.background_power_w)[:, None])
    return power, np.asarray(point.signal(power))


def _volume_w(air: Volume, range_m: Lanes, fwhm_s: Lanes) -> Lanes:
    """Backscatter of the air; it ends where the last light meets a surface."""
    ops = xp(range_m, air.scale)
    left = soft_target.share_before_surface(
        range_m=range_m, surface_m=air.end_m, extinction_per_m=air.extinction_per_m, fwhm_s=fwhm_s
    )
    inside = (range_m > 0.0) & (range_m < air.far_m)
    return ops.where(inside, air.scale * left * air.shape.at(range_m / air.far_m), 0.0)
