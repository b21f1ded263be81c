"""Waveform: the power on the detector as a function of time, with its derivatives.

The comparator and the samplers need power and slope at any place. A sum of Gaussian pulses and a tabulated course of
the air's light give both in closed form, so no grid of time bins limits the resolution (docs/theory_light.md 5).

Behind an amplifier's low pass the pulses are wider; AC coupling takes an undershoot off them
(docs/theory_receivers.md 5). Power is then that of an unfiltered echo with the same peak signal.

Symbols: u place in units of sigma_p, the standard deviation of the received pulse; P power; c speed of light.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..maths.arrays import Array, Lanes, Numbers, xp
from ..physics.amplifier import high_pass
from ..physics.electronics.pulse_sums import SIGMAS_PER_FWHM, Shape, comb_parts, even_sum, raised, sum_of_pulses
from ..physics.optics import pulse as pulse_shape
from ..physics.optics import radiometry
from ..physics.weather import soft_target
from ..sensor.sensor_model import Sensor
from .echoes import EchoTrain, Volume

FAR = 1e30
"""Choice: place of an interval that a pulse does not have: beyond every window."""

_BEFORE = 8.0
"""Accuracy bought: distance before the first possible peak at which a sum of pulses counts as zero, in sigma_p."""

_FADING = -4.0, 2.0
"""Accuracy bought: interval, in sigma_p about the place of steepest fall, in which the air's light may peak because a
surface ends it: it is concave before that place, by less than 1e-3 of itself beyond the first of these, and where it
also rises steeply a little behind it."""

_WEAK_W = 1e-12
"""Choice: power at which every detector is linear."""

_HALF_STEP = 0.5
"""Accuracy bought: step of the differences that stand for a volume's derivatives, in sigma_p: its course bends little
over that."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Undershoot:
    """Undershoot that AC coupling subtracts from the pulses (`physics.amplifier.high_pass`).

    Attributes:
        rate: w: recovery of the baseline, per sigma_p; the peaks of the pulses come early by as much
        depths: (n,) each, power of every sub-echo, as far as the amplifier passes it
    """

    rate: Lanes
    depths: Sequence[Lanes]

    def at(self, place: Lanes, centres: Sequence[Lanes]) -> Shape:
        """Undershoot at a place, (n,) W, and its first and second derivative by place."""
        value: Lanes = 0.0
        slope: Lanes = 0.0
        bend: Lanes = 0.0
        for centre, depth in zip(centres, self.depths, strict=True):
            terms = high_pass.undershoot(place=place - centre - self.rate, rate=self.rate)
            value, slope, bend = (total + depth * part for total, part in zip((value, slope, bend), terms, strict=True))
        return value, slope, bend


@dataclass(frozen=True, slots=True, kw_only=True)
class Waveform:
    """Power on the detector over place, for each pulse; theory (T50).

    A place u is at the range origin_m + u unit_m.

    Attributes:
        origin_m: (n,) range of the pulse's first sub-echo
        unit_m: c sigma_p / 2
        fwhm_s: width of the received pulse; (n,) of echoes that are broadened, as is ``unit_m``
        centres: (n,) each, place of every sub-echo
        heights: (n,) each, power of every sub-echo; 0 without one
        volume: even light of the air, or None
        undershoot: undershoot of an AC-coupled amplifier, or None
        broadening: (n,) width over that of the pulse as it leaves; 1 of echoes that are as long
    """

    # Places count from the first sub-echo in units of sigma_p. So the numbers near an echo are small, where single
    # precision is finest, and every sub-echo is exp(-(u - u_k)^2 / 2) without a scale.

    origin_m: Lanes
    unit_m: Lanes
    fwhm_s: Lanes
    centres: Sequence[Lanes]
    heights: Sequence[Lanes]
    volume: Volume | None
    undershoot: Undershoot | None = None
    broadening: Lanes = 1.0

    @property
    def lone(self) -> bool:
        """True if each pulse has one echo at most, and no other light."""
        return len(self.centres) == 1 and self.volume is None and self.undershoot is None

    def at(self, place: Lanes) -> Shape:
        """Power and its first and second derivative by place, (n,) each."""
        value, slope, bend = sum_of_pulses(place=self._pulse_place(place), centres=self.centres, heights=self.heights)
        if self.undershoot is not None:
            undershoot = self.undershoot.at(place, self.centres)
            value, slope, bend = value - undershoot[0], slope - undershoot[1], bend - undershoot[2]
        if self.volume is None:
            return value, slope, bend
        # The air's course is a table and has no derivative in closed form: differences over half steps take its place.
        before, middle, after = (
            _volume_w(self.volume, self.range_m(place + step), self.fwhm_s) for step in (-_HALF_STEP, 0.0, _HALF_STEP)
        )
        return (
            value + middle,
            slope + (after - before) / (2.0 * _HALF_STEP),
            bend + (after - 2.0 * middle + before) / (_HALF_STEP * _HALF_STEP),
        )

    def comb(self, start: Lanes, spacing: Lanes, middle: Lanes, *, half: float = 5.0, recurrent: bool = False) -> Comb:
        """Prepare the waveform at evenly spaced places.

        Args:
            start: (n,) first place
            spacing: (n,) distance between two places
            middle: (n,) middle of all places
            half: largest distance of a place from it
            recurrent: whether the factor that all parts share is one of the parts
        """
        parts, growths = comb_parts(
            start=self._pulse_place(start),
            spacing=spacing,
            middle=self._pulse_place(middle),
            centres=self.centres,
            heights=self.heights,
            half=half,
        )
        if not recurrent:
            return Comb(wave=self, middle=middle, half=half, growths=growths, parts=parts)
        # Of a Gaussian at even distances the factor from one place to the next grows by a constant factor, too.
        off, ops = self._pulse_place(start) - self._pulse_place(middle), xp(start)
        shared = ops.exp(-0.5 * off * off - raised(half)), ops.exp(-spacing * (off + 0.5 * spacing))
        shrinks = xp(spacing).exp(-spacing * spacing)
        return Comb(wave=self, middle=middle, half=half, growths=growths, parts=(*shared, *parts), shrinks=shrinks)

    def air_w(self, place: Lanes) -> Lanes:
        """Power of the air's even light at a place, (n,) W; 0 without any."""
        return 0.0 if self.volume is None else _volume_w(self.volume, self.range_m(place), self.fwhm_s)

    def _pulse_place(self, place: Lanes) -> Lanes:
        """Place on the pulses without AC coupling, which moves their peaks earlier by a calibrated amount."""
        return place if self.undershoot is None else place - self.undershoot.rate

    def range_m(self, place: Lanes) -> Lanes:
        """Range [m] of the light at a place, (n,)."""
        return self.origin_m + place * self.unit_m

    def start(self, first: Lanes) -> Lanes:
        """Place at which the waveform begins, (n,): there is no light before it.

        Args:
            first: (n,) start of the first of the `intervals`
        """
        ops = xp(first, self.origin_m)
        begin = first - _BEFORE
        if self.volume is None:
            return begin
        # The air's light may rise without a concave place over many metres before its first one.
        near = (self.volume.near_m - self.origin_m) / self.unit_m
        return ops.where(self.volume.scale > 0.0, ops.minimum(begin, near), begin)

    def intervals(self) -> list[tuple[Array, Array]]:
        """Intervals (start, end) of places, (n,) each, outside of which the waveform has no peak."""
        # A peak needs a negative second derivative of the sum, and so of at least one of its terms. A Gaussian has that
        # within one sigma of its centre, a volume's course on its hump, and again where a surface ends it: there a
        # pulse may rise while the air's light falls. An interval that a pulse does not have starts at the far end and
        # ends before everything, so no search enters it.
        # The undershoot only bends a recovering baseline, which rises: it moves peaks by 2 w at most.
        ops = xp(*self.centres, self.origin_m)
        reach = 1.0 if self.undershoot is None else 1.0 + 2.0 * self.undershoot.rate
        intervals = [
            (ops.where(height > 0.0, centre - 1.0, FAR), ops.where(height > 0.0, centre + reach, -FAR))
            for centre, height in zip(self.centres, self.heights, strict=True)
        ]
        if self.volume is not None:
            start, end = ((edge - self.origin_m) / self.unit_m for edge in self.volume.hump_m)
            lit = self.volume.scale > 0.0
            intervals.append((ops.where(lit, start, FAR), ops.where(lit, end, -FAR)))
            for end_m, share in self.volume.ends:
                ended = lit & (end_m < self.volume.far_m) & (share > 0.0)
                steepest = (end_m - self.origin_m) / self.unit_m + self.unit_m * (
                    2.0 * self.volume.extinction_per_m + 2.0 / end_m
                )
                before, behind = (steepest + offset for offset in _FADING)
                intervals.append((ops.where(ended, before, FAR), ops.where(ended, behind, -FAR)))
        return intervals


@dataclass(frozen=True, slots=True, kw_only=True)
class Comb:
    """A waveform at evenly spaced places (docs/theory_receivers.md 4).

    Each sub-echo's part at a place is its part at the place before times a constant. So a sample costs a multiplication
    for each sub-echo instead of an exponential. The factor that all of them share costs an exponential at each place,
    or two multiplications: then rounding grows with the square of the places, to 1e-5 for 22 of them.

    Attributes:
        wave: the waveform
        middle: (n,) middle of all places
        half: largest distance of a place from it
        parts: (n,) each, every sub-echo's part at the first place; a loop over the places carries them along
        growths: (n,) each, the factor from one place to the next
        shrinks: (n,) factor by which the growth of the shared factor changes; it and its growth come first among the
            parts. None: it is computed at each place
    """

    wave: Waveform
    middle: Lanes
    half: float
    parts: Sequence[Lanes]
    growths: Sequence[Lanes]
    shrinks: Lanes | None = None

    def power_w(self, place: Lanes, parts: Sequence[Lanes]) -> Lanes:
        """Power at a place, (n,) W, from the parts there."""
        wave, middle = self.wave, self.wave._pulse_place(self.middle)
        if self.shrinks is None:
            value = even_sum(place=wave._pulse_place(place), middle=middle, parts=parts, half=self.half)
        else:
            value = parts[0] * sum(parts[2:])
        if wave.undershoot is not None:
            value = value - wave.undershoot.at(place, wave.centres)[0]
        return value if wave.volume is None else value + _volume_w(wave.volume, wave.range_m(place), wave.fwhm_s)

    def advance(self, parts: Sequence[Lanes]) -> tuple[Lanes, ...]:
        """Advance the parts from one place to the next."""
        if self.shrinks is None:
            return tuple(part * growth for part, growth in zip(parts, self.growths, strict=True))
        shared, growth, *of_echoes = parts
        onward = (part * growth for part, growth in zip(of_echoes, self.growths, strict=True))
        return shared * growth, growth * self.shrinks, *onward


def waveform(pulse_train: EchoTrain, sensor: Sensor) -> Waveform:
    """Build the waveforms of n pulses."""
    ops = xp(pulse_train.parts[0].range_m)
    # Sub-echo k of every pulse becomes an array of its own: loops over sub-echoes then run over arrays of n pulses.
    ranges, heights = (
        [
            ops.column(getattr(part, name), number, part.count)
            for part in pulse_train.parts
            for number in range(part.count)
        ]
        for name in ("range_m", "peak_power_w")
    )
    broadening: Lanes = 1.0 if pulse_train.broadening is None else pulse_train.broadening
    fwhm_s = sensor.received_fwhm_s * broadening
    unit = radiometry.range_from_time_of_flight_m(time_of_flight_s=fwhm_s / SIGMAS_PER_FWHM)
    nearest = ops.full(heights[0], FAR)
    for distance, height in zip(ranges, heights, strict=True):
        nearest = ops.where(height > 0.0, ops.minimum(nearest, distance), nearest)
    # A sub-echo without light has height 0 and adds nothing, so its place does not matter.
    origin = ops.where(nearest < FAR, nearest, 0.0)
    centres = [
        ops.where(height > 0.0, (distance - origin) / unit, 0.0)
        for distance, height in zip(ranges, heights, strict=True)
    ]
    passed, undershoot = couple_pulses(heights, pulse_train.background_power_w, sensor)
    return Waveform(
        origin_m=origin,
        unit_m=unit,
        fwhm_s=fwhm_s,
        centres=centres,
        heights=passed,
        volume=pulse_train.volume,
        undershoot=undershoot,
        broadening=broadening,
    )


def couple_pulses(
    heights: Sequence[Lanes], background_power_w: Lanes, sensor: Sensor
) -> tuple[Sequence[Lanes], Undershoot | None]:
    """Pass pulses of these peak powers through AC coupling; returns their heights, and the undershoot or None.

    Args:
        heights: (n,) each, power of every sub-echo
    """
    rate = sensor.coupling_rate
    if rate is None:
        return heights, None
    point, peak_share = sensor.working_point(background_power_w), high_pass.peak_share(rate=rate)
    # The undershoot is of the signal. A later echo that is weak enough to be lost in it lies where the detector is
    # linear: the signal is brought back to power as for weak light.
    power_per_signal = _WEAK_W / point.response.signal(_WEAK_W + 0.0 * background_power_w)
    depths = [
        point.response.measured(point.response.signal(height)) * power_per_signal / peak_share for height in heights
    ]
    return [height / peak_share for height in heights], Undershoot(rate=rate, depths=depths)


def sample_power_and_signal(pulse_train: EchoTrain, sensor: Sensor, times_s: Numbers) -> tuple[Numbers, Numbers]:
    """Optical power [W] and mean detector signal over time, without noise: each (n, times), NumPy.

    The signal is what comes through the amplifier; the power is that on the detector, the air's even light in it as the
    amplifier passes it.

    Args:
        times_s: (times,) time since the middle of the pulse left
    """
    power, received = _sample_powers_w(pulse_train, sensor, times_s)
    point = sensor.working_point(np.asarray(pulse_train.background_power_w)[:, None])
    return power, np.asarray(point.response.signal(received))


def sample_power_w(pulse_train: EchoTrain, sensor: Sensor, times_s: Numbers) -> Numbers:
    """Optical power over time, without the background: (n, times) W, NumPy.

    Args:
        times_s: (times,) time since the middle of the pulse left
    """
    return _sample_powers_w(pulse_train, sensor, times_s)[0]


def _sample_powers_w(pulse_train: EchoTrain, sensor: Sensor, times_s: Numbers) -> tuple[Numbers, Numbers]:
    """Power over time on the detector, and as the amplifier passes it, without the background: (n, times) W each."""
    times = np.asarray(times_s, dtype=np.float64)
    power = np.zeros((np.size(pulse_train.background_power_w), len(times)))
    received, background = power.copy(), np.asarray(pulse_train.background_power_w)[:, None]
    broadening = 1.0 if pulse_train.broadening is None else np.asarray(pulse_train.broadening)[:, None]
    sigma_s = broadening * (float(sensor.received_fwhm_s) / SIGMAS_PER_FWHM)
    fwhm_s = broadening * sensor.laser.pulse_fwhm_s
    for part in pulse_train.parts:
        arrival = np.asarray(radiometry.time_of_flight_s(range_m=np.asarray(part.range_m, dtype=np.float64)))
        peak = np.asarray(part.peak_power_w)
        for first in range(part.count):
            lanes = slice(first, None, part.count)
            pulses = pulse_shape.gaussian_pulse(time_s=times - arrival[lanes, None], fwhm_s=fwhm_s)
            power += peak[lanes, None] * pulses
            if not sensor.receiver.filters:
                continue
            peaks, place = peak[lanes, None], (times - arrival[lanes, None]) / sigma_s
            (height,), undershoot = couple_pulses([peaks], background, sensor)
            if undershoot is not None:
                received -= undershoot.at(place, [0.0])[0]
                place = place - undershoot.rate
            received += height * np.exp(-0.5 * place * place)
    if pulse_train.volume is not None:
        air = pulse_train.volume
        scale, end_m, *edge = (np.asarray(values)[:, None] for values in (air.scale, air.end_m, *(air.edge or ())))
        range_m = radiometry.range_from_time_of_flight_m(time_of_flight_s=times)
        by_pulse = replace(air, scale=scale, end_m=end_m, edge=(edge[0], edge[1]) if edge else None)
        even = _volume_w(by_pulse, range_m, sensor.received_fwhm_s)
        power, received = power + even * sensor.peak_share, received + even
    return power, received if sensor.receiver.filters else power


def _volume_w(air: Volume, range_m: Lanes, fwhm_s: Lanes) -> Lanes:
    """Power of the air's even light, (n,) W; it ends where the pulse's light meets surfaces (T37)."""
    ops = xp(range_m, air.scale)
    along = air.along(range_m)
    unblocked = sum(
        share
        * soft_target.share_before_surface(
            range_m=range_m, surface_m=end_m, extinction_per_m=air.extinction_per_m, fwhm_s=fwhm_s
        )
        for end_m, share in air.ends
    )
    inside = (along > 0.0) & (along < 1.0)
    return ops.where(inside, air.scale * unblocked * air.shape.at(along), 0.0)
