"""Alarms: crossings that no echo of the pulse causes, by noise and by other lidars, compete with echoes for the stops.

False alarms are a Poisson process (docs/theory.md 9 and 15). They pass the converter as echoes do: its clock, with its
jitter, gives them the time that they are reported at, and their crossing decides whether they are within the window
and which of two comes first (`stops`). Two things are of echoes alone: the dead time, and the walk, which would only
move a random time.

Symbols: U threshold, sigma_0 noise without an echo, P_f probability of a false alarm, lambda rate of false alarms, tau
time in which the converter listens.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

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

NEVER_S = 1.0
"""Time of an alarm that does not happen: later than any window."""

_DRAWS = 2**16
"""Draws of the jitter for each kind of alarm, from this number on: a pulse has fewer rises, which take those before."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _NextAlarm:
    """The next false alarm of each pulse; each field (n,).

    number   number of alarms drawn, this one included
    elapsed  progress of the Poisson process at this alarm
    """

    number: Lanes
    elapsed: Lanes
    alarm: _Alarm


def add_alarms(shots: Shots, found: Found, sources: tuple[Interference, ...]) -> Stops:
    """Add the false alarms to the stops of the echoes.

    sources  pulses of other lidars on the detector
    """
    stops = found.stops
    for kind, alarms in enumerate(_generators(shots, sources), start=1):
        stops = _merge_alarms(shots, stops, alarms, found, first_draw=kind * _DRAWS)
    return stops


def _merge_alarms(shots: Shots, stops: Stops, alarms: _Alarms, found: Found, *, first_draw: int) -> Stops:
    """Add the alarms of one generator to the stops.

    first_draw  of the jitter of their times
    """
    like, tdc = stops[0], shots.sensor.tdc
    ops = xp(like.key)
    zero, number = ops.full(like.key, 0.0), ops.full(like.key, 0)

    # Alarms come in the order in which the converter prefers them, and at most as many as it has stops can be kept.
    # The first is drawn before the loop: most pulses have none in the window and never enter it.
    def draw_next(draw: Lanes, elapsed: Lanes) -> _NextAlarm:
        elapsed, alarm = alarms(ops.uint32(draw), elapsed)
        return _NextAlarm(number=draw + 1, elapsed=elapsed, alarm=alarm)

    def active(loop_state: tuple[_NextAlarm, Stops]) -> Mask:
        return (loop_state[0].alarm.time_s < tdc.window_s) & (loop_state[0].number <= stop_list.most_alarms(tdc))

    def step(loop_state: tuple[_NextAlarm, Stops]) -> tuple[_NextAlarm, Stops]:
        (following, stops) = loop_state
        alarm = following.alarm
        reported_s = comparator.converted_time_s(shots, alarm.time_s, draw=ops.uint32(following.number + first_draw))
        stop = like.with_values(
            reported_s=reported_s,
            crossing_s=alarm.time_s,
            amplitude=alarm.amplitude,
            snr=zero,
            detection_probability=zero,
            source=found.source,
            true_range_m=found.true_range_m,
            status=number + _status(alarm.interfering),
        )
        if like.width_s is not None:
            stop = replace(stop, width_s=_width_s(shots, alarm))
        key = stop_list.sort_key(tdc, stop.time_s, alarm.amplitude)
        stop = replace(stop, key=ops.where(comparator.is_range(reported_s), key, EMPTY))
        return draw_next(following.number, following.elapsed), stop_list.insert_stop(tdc, stops, stop)

    return ops.loop((draw_next(number, ops.float32(zero)), stops), active, step)[1]


def _status(interfering: Mask | None) -> Lanes:
    """`Status` of a false alarm, (n,).

    interfering  (n,) bool, whether it is another lidar's pulse; None without other lidars
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


@dataclass(frozen=True, slots=True, kw_only=True)
class _Alarm:
    """A crossing that no echo of the sensor's own pulse causes; each field (n,).

    time_s       crossing time; `NEVER_S` where there is no alarm
    amplitude    peak, in signal units
    interfering  whether it is another lidar's pulse; None without other lidars
    """

    time_s: Lanes
    amplitude: Lanes
    interfering: Mask | None


_Alarms = Callable[[Lanes, Lanes], tuple[Lanes, _Alarm]]
"""Generator of the alarms of one kind, in the order in which the converter prefers them.

``alarms(number, elapsed) -> (elapsed, alarm)`` makes alarm ``number`` (0, 1, ...) from the Poisson process' progress
before it, 0 at first, and returns the progress at it. Once an alarm is beyond the window, all later ones are."""


def _generators(shots: Shots, sources: tuple[Interference, ...]) -> list[_Alarms]:
    """Generators of each pulse's false alarms (docs/theory.md 9 and 15).

    One generator for all alarms in order of time; with ``keep = "strongest"`` one for noise and one for each source.

    sources  pulses of other lidars on the detector
    """
    converter = shots.sensor.tdc
    other_lidars = interference.crossings(shots, sources)
    # (T28): M = B_w t comparisons stay quiet with (1 - P_f)^M = exp(-lambda t) for every t. A Poisson process of rate
    # lambda does the same in continuous time. It has no memory, so it may begin when blanking ends, or run backwards
    # from the end of the window.
    # Crossings of the noise come as rarely and as independently, so they are one too.
    # Both generators begin with this number: without a rate that brings its alarm into the window there is none.
    first = random.exponential(shots.words(Stage.FALSE_ALARM, 0))
    others_hz = sum((lidar.rate_hz for lidar in other_lidars), 0.0)
    noise_rate = shots.sensor.false_alarm_rate_hz(
        shots.point, shots.threshold, first / converter.listening_s - others_hz
    )
    crossings = _Crossings(shots=shots, noise_rate_hz=noise_rate, other_lidars=other_lidars)
    if converter.keep == "strongest":
        return [partial(crossings.alarm_by_height, number) for number in range(1 + len(other_lidars))]
    return [crossings.alarm_by_time]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Crossings:
    """The Poisson processes of crossings of some pulses.

    Every random number is keyed by (seed, stage, pulse, draw), and the draw is computed from the alarm's number. So an
    alarm does not depend on chunks or threads, and no state of a generator is carried along.

    noise_rate_hz  (n,) rate lambda of crossings by noise
    other_lidars   crossings by the pulses of each other lidar
    """

    shots: Shots
    noise_rate_hz: Lanes
    other_lidars: tuple[interference.Crossings, ...]

    def alarm_by_time(self, number: Lanes, elapsed: Lanes) -> tuple[Lanes, _Alarm]:
        """Alarm ``number`` in order of time, from any source; in reverse order where the last are kept.

        number   (n,) number of the alarm, from 0
        elapsed  (n,) time of the alarm before it, in units of the mean wait 1 / rate
        """
        shots, converter, threshold, point = (self.shots, self.shots.sensor.tdc, self.shots.threshold, self.shots.point)
        ops = xp(threshold)
        rate = sum((lidar.rate_hz for lidar in self.other_lidars), self.noise_rate_hz)
        never = rate <= 0.0
        # Waits of a Poisson process are exponential: their sum is the alarm's time in units of the mean wait. Alarm i
        # takes draw 2 i for its wait and 2 i + 1 for its height.
        elapsed = elapsed + random.exponential(shots.words(Stage.FALSE_ALARM, 2 * number))
        time_s: Lanes = ops.where(never, NEVER_S, elapsed / ops.where(never, 1.0, rate))
        if converter.keep in ("last", "strongest_and_last"):
            time_s = ops.where(time_s < converter.listening_s, converter.window_s - time_s, NEVER_S)
        else:
            time_s = converter.blanking_s + time_s

        def crossing() -> interference.Assigned:
            height = random.exponential(shots.words(Stage.FALSE_ALARM, 2 * number + 1))
            # Far out, a Gaussian tail falls like exp(-U x / sigma_0^2): the excess over U is exponential.
            amplitude = threshold + height * point.noise.deviation * point.noise.deviation / threshold
            if not self.other_lidars:
                return interference.Assigned(amplitude=amplitude, interfering=None)
            return interference.assign_source(
                shots, self.other_lidars, noise_rate_hz=self.noise_rate_hz, noise_amplitude=amplitude, draw=number
            )

        # Heights cost more than times, and few pulses have an alarm: only those draw one.
        in_window = time_s < converter.window_s
        no_crossing = interference.Assigned(
            amplitude=threshold + ops.full(time_s, 0.0),
            interfering=ops.full(time_s, False) if self.other_lidars else None,
        )
        assigned = ops.where_any(in_window, crossing, no_crossing)
        time_s = ops.minimum(time_s, NEVER_S)
        return elapsed, _Alarm(time_s=time_s, amplitude=assigned.amplitude, interfering=assigned.interfering)

    def alarm_by_height(self, source: int, number: Lanes, gamma: Lanes) -> tuple[Lanes, _Alarm]:
        """Alarm ``number`` of one source in falling order of height, at a random time of the window (T53).

        source  0: noise; 1, 2, ...: another lidar
        number  (n,) number of the alarm, from 0
        gamma   (n,) Gamma of the alarm before it: expected number of crossings that are higher
        """
        shots, converter, threshold, point = (self.shots, self.shots.sensor.tdc, self.shots.threshold, self.shots.point)
        ops = xp(threshold)
        lidar = self.other_lidars[source - 1] if source else None
        rate_hz = self.noise_rate_hz if lidar is None else lidar.rate_hz
        expected = rate_hz * converter.listening_s
        stage = Stage.FALSE_ALARM if lidar is None else Stage.INTERFERENCE
        # Other lidars share a stage: each has a block of two draws for every stop.
        draw = 2 * (max(source - 1, 0) * converter.stops + number)
        # Crossings ordered by height, counted by how many are expected to be higher, are a Poisson process of rate
        # one. It ends at the expected number of all crossings, lambda tau; Gamma / (lambda tau) is the upper tail.
        gamma = gamma + random.exponential(shots.words(stage, draw))
        exists = gamma < expected

        def crossing() -> tuple[Lanes, Lanes]:
            share = ops.where(exists, gamma / ops.where(exists, expected, 1.0), 1.0)
            uniform = random.open_uniform(shots.words(stage, draw + 1)[0])
            time_s = ops.where(exists, converter.blanking_s + uniform * converter.listening_s, NEVER_S)
            if lidar is not None:
                return time_s, interference.tripping_amplitude(shots, lidar, uniform=share)
            return time_s, threshold - ops.log(share) * point.noise.deviation * point.noise.deviation / threshold

        # Few pulses have an alarm: only those draw its time and height.
        never: tuple[Lanes, Lanes] = ops.full(gamma, NEVER_S), threshold + ops.full(gamma, 0.0)
        time_s, amplitude = ops.where_any(exists, crossing, never)
        interfering = None
        if self.other_lidars:
            interfering = exists if lidar is not None else ops.full(gamma, False)
        return gamma, _Alarm(time_s=time_s, amplitude=amplitude, interfering=interfering)
