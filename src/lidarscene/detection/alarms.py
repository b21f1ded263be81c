"""Alarms: crossings that no echo of the pulse causes, by noise and by other lidars, compete with echoes for the stops.

False alarms are a Poisson process (docs/theory.md 9). They pass the converter as echoes do: its clock, with its
jitter, gives them the time that they are reported at, and their crossing decides whether they are within the window
and which of two comes first (`stops`). Two things are of echoes alone: the dead time of a comparator, and the walk,
which would only move a random time. Peaks of a histogram are held apart, whatever causes them.

Symbols: U threshold, sigma_0 noise without an echo, P_f probability of a false alarm, lambda rate of false alarms, tau
time in which the converter listens.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from ..light.echoes import Interference
from ..maths import random
from ..maths.arrays import Lanes, Mask, xp
from ..maths.random import Stage
from ..physics.electronics import tdc
from ..physics.optics import pulse as pulse_shape
from . import comparator, interference
from . import stops as stop_list
from .outcomes import Status
from .shots import Shots
from .stops import EMPTY, Found, Stops

_NEVER_S = 1.0
"""Choice: time of an alarm that does not happen: later than any window."""

_STEEP = 2.5
"""Choice: threshold, in deviations of the noise, below which alarms have the tail of this one: near 0 a Gaussian falls
slowly, and the highest of some hundred alarms is 3 deviations high."""

_DRAWS = 2**16
"""Draws of the jitter for each kind of alarm, from this number on: a pulse has fewer rises, which take those before."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Alarm:
    """A crossing that no echo of the sensor's own pulse causes; each field (n,).

    Attributes:
        time_s: crossing time
        amplitude: peak, in signal units
        interfering: whether it is another lidar's pulse; None: it is not
    """

    time_s: Lanes
    amplitude: Lanes
    interfering: Mask | None


class _Alarms(Protocol):
    """Alarms of one kind, in the order in which the converter prefers them.

    Every random number is keyed by (seed, stage, pulse, draw), and the draw is computed from the alarm's number. So an
    alarm does not depend on chunks or threads, and no state of a generator is carried along but the progress of the
    Poisson process at it, 0 before the first.
    """

    def advance(self, number: Lanes, elapsed: Lanes) -> Lanes:
        """Progress (n,) at alarm ``number`` (0, 1, ...), from that at the alarm before it."""

    def happens(self, elapsed: Lanes) -> Mask:
        """True where the alarm at this progress is within the window, (n,) bool; if not, all later ones are beyond."""

    def alarm(self, number: Lanes, elapsed: Lanes) -> _Alarm:
        """Alarm ``number``, at this progress."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _AlarmsByTime:
    """Alarms of all sources in order of time; in reverse order where the last are kept.

    Attributes:
        noise_rate_hz: (n,) rate lambda of crossings by noise
        rate_hz: (n,) that of all crossings
        other_lidars: crossings by the pulses of each other lidar
    """

    shots: Shots
    noise_rate_hz: Lanes
    rate_hz: Lanes
    other_lidars: tuple[interference.Crossings, ...]

    def advance(self, number: Lanes, elapsed: Lanes) -> Lanes:
        """Time in units of the mean wait 1 / rate."""
        # Waits of a Poisson process are exponential, and add up to the alarm's time. Alarm i takes draw 2 i for its
        # wait and 2 i + 1 for its height.
        return elapsed + random.exponential(self.shots.words(Stage.FALSE_ALARM, 2 * number))

    def happens(self, elapsed: Lanes) -> Mask:
        """True before the end of the window, or behind its start where the last are kept."""
        converter = self.shots.sensor.tdc
        if self._backwards:
            return self._wait_s(elapsed) < converter.listening_s
        return converter.blanking_s + self._wait_s(elapsed) < converter.window_s

    def alarm(self, number: Lanes, elapsed: Lanes) -> _Alarm:
        """An alarm at this time, of a random source."""
        shots, converter = self.shots, self.shots.sensor.tdc
        wait_s = self._wait_s(elapsed)
        time_s = converter.window_s - wait_s if self._backwards else converter.blanking_s + wait_s
        amplitude = _noise_amplitude(shots, random.exponential(shots.words(Stage.FALSE_ALARM, 2 * number + 1)))
        if not self.other_lidars:
            return _Alarm(time_s=time_s, amplitude=amplitude, interfering=None)
        assigned = interference.assign_source(
            shots, self.other_lidars, noise_rate_hz=self.noise_rate_hz, noise_amplitude=amplitude, draw=number
        )
        return _Alarm(time_s=time_s, amplitude=assigned.amplitude, interfering=assigned.interfering)

    @property
    def _backwards(self) -> bool:
        return self.shots.sensor.tdc.keep in ("last", "strongest_and_last")

    def _wait_s(self, elapsed: Lanes) -> Lanes:
        ops, never = xp(self.rate_hz), self.rate_hz <= 0.0
        return ops.where(never, _NEVER_S, elapsed / ops.where(never, 1.0, self.rate_hz))


@dataclass(frozen=True, slots=True, kw_only=True)
class _AlarmsByHeight:
    """Alarms of one source in falling order of height, at random times of the window (T53).

    Crossings ordered by height, counted by how many are expected to be higher, are a Poisson process of rate one. It
    ends at the expected number of all crossings, lambda tau; Gamma / (lambda tau) is the upper tail.

    Attributes:
        rate_hz: (n,) rate of the source's crossings
        lidar: whose pulses they are; None: noise
        first_draw: draw of the first alarm
    """

    shots: Shots
    rate_hz: Lanes
    lidar: interference.Crossings | None
    first_draw: int

    def advance(self, number: Lanes, elapsed: Lanes) -> Lanes:
        """Gamma, the expected number of crossings that are higher."""
        return elapsed + random.exponential(self.shots.words(self._stage, self.first_draw + 2 * number))

    def happens(self, elapsed: Lanes) -> Mask:
        """True of one of the expected crossings."""
        return elapsed < self._expected

    def alarm(self, number: Lanes, elapsed: Lanes) -> _Alarm:
        """An alarm as high as the share of the crossings that are higher says."""
        shots, converter = self.shots, self.shots.sensor.tdc
        ops, exists = xp(elapsed), self.happens(elapsed)
        share = ops.where(exists, elapsed / ops.where(exists, self._expected, 1.0), 1.0)
        uniform = random.open_uniform(shots.words(self._stage, self.first_draw + 2 * number + 1)[0])
        time_s = converter.blanking_s + uniform * converter.listening_s
        if self.lidar is not None:
            amplitude = interference.tripping_amplitude(shots, self.lidar, uniform=share)
            return _Alarm(time_s=time_s, amplitude=amplitude, interfering=ops.full(elapsed, True))
        return _Alarm(time_s=time_s, amplitude=_noise_amplitude(shots, -ops.log(share)), interfering=None)

    @property
    def _stage(self) -> Stage:
        return Stage.FALSE_ALARM if self.lidar is None else Stage.INTERFERENCE

    @property
    def _expected(self) -> Lanes:
        return self.rate_hz * self.shots.sensor.tdc.listening_s


def add_alarms(shots: Shots, found: Found, sources: tuple[Interference, ...]) -> Stops:
    """Add the false alarms to the stops of the echoes (docs/theory.md 9).

    Args:
        sources: pulses of other lidars on the detector
    """
    stops = found.stops
    for kind, alarms in enumerate(_kinds(shots, sources), start=1):
        stops = _merge_alarms(shots, stops, alarms, found, first_draw=kind * _DRAWS)
    return stops


def _kinds(shots: Shots, sources: tuple[Interference, ...]) -> Sequence[_Alarms]:
    """Kinds of alarms: one for all in order of time; with ``keep = "strongest"`` noise, and each other lidar."""
    converter = shots.sensor.tdc
    other_lidars = interference.crossings(shots, sources)
    # (T28): M = B_w t comparisons stay quiet with (1 - P_f)^M = exp(-lambda t) for every t. A Poisson process of rate
    # lambda does the same in continuous time. It has no memory, so it may begin when blanking ends, or run backwards
    # from the end of the window.
    # Crossings of the noise come as rarely and as independently, so they are one too.
    # Both kinds begin with this number: without a rate that brings its alarm into the window there is none.
    first = random.exponential(shots.words(Stage.FALSE_ALARM, 0))
    others_hz = sum((lidar.rate_hz for lidar in other_lidars), 0.0)
    noise_hz = shots.sensor.false_alarm_rate_hz(shots.point, shots.threshold, first / converter.listening_s - others_hz)
    if converter.keep == "strongest":
        noise = _AlarmsByHeight(shots=shots, rate_hz=noise_hz, lidar=None, first_draw=0)
        # Other lidars share a stage: each has a block of two draws for every stop.
        return noise, *(
            _AlarmsByHeight(shots=shots, rate_hz=lidar.rate_hz, lidar=lidar, first_draw=2 * number * converter.stops)
            for number, lidar in enumerate(other_lidars)
        )
    rate_hz = sum((lidar.rate_hz for lidar in other_lidars), noise_hz)
    return (_AlarmsByTime(shots=shots, noise_rate_hz=noise_hz, rate_hz=rate_hz, other_lidars=other_lidars),)


def _noise_amplitude(shots: Shots, excess: Lanes) -> Lanes:
    """Peak of noise that trips, (n,) in signal units, from a standard exponential number."""
    # Far out, a Gaussian tail falls like exp(-U x / sigma_0^2): the excess over U is exponential.
    sigma = shots.point.noise.deviation
    steepest = xp(shots.threshold, sigma).maximum(shots.threshold, _STEEP * sigma)
    return shots.threshold + excess * sigma * sigma / steepest


def _merge_alarms(shots: Shots, stops: Stops, alarms: _Alarms, found: Found, *, first_draw: int) -> Stops:
    """Add the alarms of one kind to the stops.

    Args:
        first_draw: of the jitter of their times
    """
    like, converter = stops[0], shots.sensor.tdc
    ops, apart_s = xp(like.key), _least_distance_s(shots)
    zero, begin = ops.full(like.key, 0.0), ops.full(like.key, 0)
    # Alarms come in the order in which the converter prefers them, and at most as many as it has stops can be kept. But
    # any of those that come from the last one on may be the strongest.
    most = _DRAWS if converter.keep == "strongest_and_last" else converter.stops

    # Whether there is a first one is known before the loop: most pulses have none in the window and never enter it.
    def active(loop_state: tuple[Lanes, Lanes, Lanes, Stops]) -> Mask:
        _, kept, elapsed, _ = loop_state
        return alarms.happens(elapsed) & (kept < most)

    def step(loop_state: tuple[Lanes, Lanes, Lanes, Stops]) -> tuple[Lanes, Lanes, Lanes, Stops]:
        number, kept, elapsed, stops = loop_state
        alarm = alarms.alarm(ops.uint32(number), elapsed)
        reported_s = comparator.converted_time_s(shots, alarm.time_s, draw=ops.uint32(number + first_draw))
        stop = like.with_values(
            reported_s=reported_s,
            crossing_s=alarm.time_s,
            amplitude=alarm.amplitude,
            snr=zero,
            detection_probability=zero,
            source=found.source,
            true_range_m=found.true_range_m,
            status=begin + _status(alarm.interfering),
        )
        if like.width_s is not None:
            stop = replace(stop, width_s=_width_s(shots, alarm))
        taken = comparator.accepts_crossing(shots.sensor, alarm.time_s) & comparator.is_range(reported_s)
        if apart_s is not None:
            for other in stops:
                taken = taken & ~(other.occupied & (ops.abs(other.time_s - stop.time_s) < apart_s))
        key = ops.where(taken, stop_list.sort_key(converter, stop.time_s, alarm.amplitude), EMPTY)
        stops = stop_list.insert_stop(converter, stops, replace(stop, key=key))
        number, kept = number + 1, kept + ops.where(taken, 1, 0)
        return number, kept, alarms.advance(ops.uint32(number), elapsed), stops

    elapsed = alarms.advance(ops.uint32(begin), ops.float32(zero))
    first: tuple[Lanes, Lanes, Lanes, Stops] = begin, begin, elapsed, stops
    return ops.loop(first, active, step)[3]


def _least_distance_s(shots: Shots) -> Lanes | None:
    """Least distance of two peaks of a histogram that are both reported; None of a comparator, which has crossings."""
    histogram, separation_s = shots.sensor.histogram, shots.sensor.tdc.dead_time_s
    if histogram is None:
        return None
    # Between two peaks there is a bin that is lower.
    return xp(separation_s, histogram.bin_s).maximum(separation_s, 2.0 * histogram.bin_s)


def _status(interfering: Mask | None) -> Lanes:
    """`Status` of a false alarm, (n,).

    Args:
        interfering: (n,) bool, whether it is another lidar's pulse; None without other lidars
    """
    if interfering is None:
        return int(Status.FALSE_ALARM)
    return xp(interfering).where(interfering, int(Status.INTERFERENCE), int(Status.FALSE_ALARM))


def _width_s(shots: Shots, alarm: _Alarm) -> Lanes:
    """Time over the threshold of a false alarm, (n,) s.

    A noise peak is a parabola around its top (T45a). A pulse of another lidar is assumed to be as long as the sensor's
    own.
    """
    sensor, threshold, amplitude = shots.sensor, shots.threshold, alarm.amplitude
    noise_width_s = tdc.excursion_width_s(height=amplitude, threshold=threshold, bandwidth_hz=sensor.tdc.bandwidth_hz)
    if alarm.interfering is None:
        return noise_width_s
    share = shots.point.response.power_w(threshold) / shots.point.response.power_w(amplitude)
    pulse_width_s = -2.0 * pulse_shape.leading_edge_time_s(level=share, fwhm_s=sensor.received_fwhm_s)
    return xp(threshold, amplitude).where(alarm.interfering, pulse_width_s, noise_width_s)
