"""Comparator: a peak and its noise in, whether and where it trips, how high it looks, when it is reported."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from ..light.echoes import Interference
from ..maths import random
from ..maths.arrays import Lanes, Mask, xp
from ..maths.random import Stage
from ..maths.special import normal_tail
from ..physics.electronics import saturation, tdc
from ..physics.optics import pulse as pulse_shape
from ..sensor.model import Sensor
from . import interference
from .shots import Shots

NEVER_S = 1.0
"""Later than any window."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trip:
    """What noise makes of a peak at the comparator.

    signal       peak of the signal, sigma its noise
    deviate      of the edge, and of_peak another of the peak, standard normal
    level        signal at which the edge trips the comparator
    probability  that it trips, and tripped whether it did
    """

    signal: Lanes
    sigma: Lanes
    deviate: Lanes
    of_peak: Lanes
    level: Lanes
    probability: Lanes
    tripped: Mask


def trip(shots: Shots, peak_power_w: Lanes, *, draw: Lanes = 0) -> Trip:
    """Noise on the edge: one deviate decides detection and time. ``draw`` tells the echoes of a pulse apart."""
    point, threshold = shots.point, shots.threshold
    deviate, of_peak = random.normal_pair(shots.words(Stage.EDGE_NOISE, draw))
    signal = point.signal(peak_power_w)
    own_noise = {"noise": point.noise, "kappa_1": point.kappa_1, "kappa_2": point.kappa_2}
    sigma = tdc.noise_at_level(level=signal, **own_noise)
    probability = point.detection_probability(threshold, signal, sigma)
    level = tdc.crossing_level(threshold=threshold, deviate=deviate, **own_noise)
    # Counted cells take the same deviate: its upper tail is uniform in (0, 1).
    tripped = normal_tail(deviate) < probability if point.exact else signal >= level
    if point.saturation is not None:
        tripped = tripped & (threshold < point.saturation)
    return Trip(
        signal=signal, sigma=sigma, deviate=deviate, of_peak=of_peak,
        level=level, probability=probability, tripped=tripped,
    )  # fmt: skip


def probability(shots: Shots, signal: Lanes) -> Lanes:
    """P_d of a peak signal, (T22) or (T23)."""
    point = shots.point
    own_noise = {"noise": point.noise, "kappa_1": point.kappa_1, "kappa_2": point.kappa_2}
    sigma = tdc.noise_at_level(level=signal, **own_noise)
    return point.detection_probability(shots.threshold, signal, sigma)


def amplitude(shots: Shots, trip: Trip, *, lag_s: Lanes) -> Lanes:
    """Measured peak: the edge's noise ``lag_s`` later, and the peak's own for what has been forgotten by then."""
    ops = xp(trip.signal)
    kept = tdc.noise_correlation(lag_s=lag_s, bandwidth_hz=shots.sensor.tdc.bandwidth_hz)
    peak_noise = kept * trip.deviate + ops.sqrt(ops.maximum(1.0 - kept * kept, 0.0)) * trip.of_peak
    return shots.point.measured(ops.maximum(trip.signal + peak_noise * trip.sigma, shots.threshold))


def trailing_level(
    shots: Shots, trip: Trip, *, threshold: Lanes | None = None, lag_s: Lanes, draw: Lanes = 0
) -> Lanes:
    """Signal at which the falling edge, ``lag_s`` after the rising one, leaves a level: a deviate of its own, but for
    what is left of the first.

    threshold  that level; the comparator's own if None
    """
    ops, point = xp(trip.signal), shots.point
    words = shots.words(Stage.TRAILING_EDGE, draw)
    kept = tdc.noise_correlation(lag_s=lag_s, bandwidth_hz=shots.sensor.tdc.bandwidth_hz)
    deviate = (
        kept * trip.deviate + ops.sqrt(ops.maximum(1.0 - kept * kept, 0.0)) * random.normal_pair(words)[0]
    )
    return tdc.crossing_level(
        threshold=shots.threshold if threshold is None else threshold, deviate=deviate,
        noise=point.noise, kappa_1=point.kappa_1, kappa_2=point.kappa_2,
    )  # fmt: skip


def width_s(shots: Shots, trip: Trip, *, peak_power_w: Lanes, early_s: Lanes) -> Lanes:
    """Time over the threshold of a lone Gaussian pulse whose rising edge crossed at ``early_s`` before its peak."""
    ops, point, fwhm = xp(trip.signal), shots.point, shots.sensor.laser.pulse_fwhm_s
    level = trailing_level(shots, trip, lag_s=2.0 * early_s)
    below = trip.tripped & (level < trip.signal)
    share = ops.where(below, point.power_w(level) / peak_power_w, 1.0)
    fall = -pulse_shape.leading_edge_time_s(level=share, fwhm_s=fwhm)
    if point.saturation is not None and point.recovery_s is not None:
        signal = ops.where(below, trip.signal, point.saturation)
        released = -pulse_shape.leading_edge_time_s(level=point.saturation / signal, fwhm_s=fwhm)
        fall = saturation.held_until(
            fall_s=fall, released_s=released, level=level, signal=signal, saturation=point.saturation,
            recovery_s=point.recovery_s,
        )  # fmt: skip
    return fall - early_s


def alarm_width_s(shots: Shots, amplitude: Lanes, *, theirs: Mask | None) -> Lanes:
    """Time over the threshold of a false alarm: of a noise peak, or of another lidar's pulse, taken as long as ours.

    theirs  whether it is another lidar's; None where there is no other lidar
    """
    sensor, threshold = shots.sensor, shots.threshold
    own = tdc.excursion_width_s(height=amplitude, threshold=threshold, bandwidth_hz=sensor.tdc.bandwidth_hz)
    if theirs is None:
        return own
    share = shots.point.power_w(threshold) / shots.point.power_w(amplitude)
    pulse = -2.0 * pulse_shape.leading_edge_time_s(level=share, fwhm_s=sensor.laser.pulse_fwhm_s)
    return xp(threshold, amplitude).where(theirs, pulse, own)


def reported_s(
    shots: Shots,
    crossing_s: Lanes,
    *,
    measured: Lanes,
    width_s: Lanes | None,
    true_power_w: Lanes,
    draw: Lanes = 0,
) -> Lanes:
    """Time that the converter gives a crossing: less the walk, with its own jitter and step."""
    walk = walk_s(shots, measured=measured, width_s=width_s, true_power_w=true_power_w)
    return converted(shots, crossing_s - walk, draw=draw)


def walk_s(shots: Shots, *, measured: Lanes, width_s: Lanes | None, true_power_w: Lanes) -> Lanes:
    """How much earlier than its peak an echo is thought to have crossed (negative), to be taken off."""
    sensor, point, threshold = shots.sensor, shots.point, shots.threshold
    if sensor.tdc.walk == "raw":
        return 0.0
    fwhm = sensor.laser.pulse_fwhm_s
    power = true_power_w
    if sensor.tdc.walk == "corrected":
        power = point.inferred_power_w(measured, width_s=width_s, threshold=threshold, pulse_fwhm_s=fwhm)
    return pulse_shape.leading_edge_time_s(level=point.power_w(threshold) / power, fwhm_s=fwhm)


def converted(shots: Shots, time_s: Lanes, *, draw: Lanes = 0) -> Lanes:
    """The converter's own jitter and step; no time before the pulse."""
    ops, converter = xp(time_s), shots.sensor.tdc
    jitter, _ = random.normal_pair(shots.words(Stage.TDC_JITTER, draw))
    jittered = ops.maximum(time_s + converter.jitter_s * jitter, 0.0)
    return tdc.quantised(time_s=jittered, least_significant_bit_s=converter.least_significant_bit_s)


def listening(sensor: Sensor, crossing_s: Lanes) -> Mask:
    """Whether the converter takes a crossing at this time at all.

    Without blanking also one before time 0: an echo from right before the sensor begins before its pulse's middle.
    """
    blanking = sensor.tdc.blanking_s
    return ((crossing_s >= blanking) | (blanking <= 0.0)) & (crossing_s < sensor.tdc.window_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class Alarm:
    """A crossing without an echo of ours.

    theirs  whether it is another lidar's pulse; None where there is no other lidar
    """

    time_s: Lanes
    amplitude: Lanes
    theirs: Mask | None


Alarms = Callable[[Lanes, Lanes], tuple[Lanes, Alarm]]
"""Alarms of a kind, those that the converter rather keeps first: number of an alarm, and how far the process has come
before it, to how far it has come and the alarm. It begins at 0 with alarm 0; after one beyond the window all are."""


def false_alarms(shots: Shots, sources: tuple[Interference, ...]) -> list[Alarms]:
    """Crossings of each pulse without an echo of ours, by kind.

    Noise crossings are a Poisson process whose rate leaves M comparisons quiet with (1 - P_f)^M, in either direction
    of time. Where none can come the time is far beyond any window. Crossings while the converter is blind are passed
    over: the process begins when it begins to listen.
    """
    converter = shots.sensor.tdc
    others = interference.crossings(shots, sources)
    p_false = shots.point.false_alarm_probability(shots.threshold)
    noise_rate = tdc.false_alarm_rate_hz(p_false=p_false, bandwidth_hz=converter.bandwidth_hz)
    crossings = _Crossings(shots=shots, noise_rate_hz=noise_rate, others=others)
    if converter.keep == "strongest":
        return [partial(crossings.by_height, number) for number in range(1 + len(others))]
    return [crossings.in_time]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Crossings:
    """What the alarms of some pulses depend on.

    noise_rate_hz  (n,) of crossings by noise
    others         crossings by each other lidar's pulses
    """

    shots: Shots
    noise_rate_hz: Lanes
    others: tuple[interference.Crossings, ...]

    def in_time(self, number: Lanes, elapsed: Lanes) -> tuple[Lanes, Alarm]:
        """Of all sources, first or last first; ``elapsed`` in units of the mean wait."""
        shots, converter, threshold, point = (
            self.shots,
            self.shots.sensor.tdc,
            self.shots.threshold,
            self.shots.point,
        )
        ops = xp(threshold)
        rate = sum((one.rate_hz for one in self.others), self.noise_rate_hz)
        never = rate <= 0.0
        elapsed = elapsed + random.exponential(shots.words(Stage.FALSE_ALARM, 2 * number))
        time_s: Lanes = ops.where(never, NEVER_S, elapsed / ops.where(never, 1.0, rate))
        if converter.keep == "last":
            time_s = ops.where(time_s < converter.listening_s, converter.window_s - time_s, NEVER_S)
        else:
            time_s = converter.blanking_s + time_s

        def crossing() -> interference.Assigned:
            height = random.exponential(shots.words(Stage.FALSE_ALARM, 2 * number + 1))
            # Far out, a Gaussian tail falls like exp(-U x / sigma_0^2): the excess over U is exponential.
            amplitude = threshold + height * point.noise * point.noise / threshold
            if not self.others:
                return interference.Assigned(amplitude=amplitude, theirs=None)
            return interference.assigned(
                shots, self.others, noise_rate_hz=self.noise_rate_hz, noise_amplitude=amplitude, draw=number
            )

        in_window = time_s < converter.window_s
        nothing = interference.Assigned(
            amplitude=threshold + 0.0 * time_s, theirs=in_window & False if self.others else None
        )
        found = ops.where_any(in_window, crossing, nothing)
        time_s = ops.minimum(time_s, NEVER_S)
        return elapsed, Alarm(time_s=time_s, amplitude=found.amplitude, theirs=found.theirs)

    def by_height(self, source: int, number: Lanes, higher: Lanes) -> tuple[Lanes, Alarm]:
        """The highest crossings of noise (source 0) or of another lidar, at any time of the window.

        Ordered by height, the expected number of crossings that are as high is a Poisson process of rate one, too.
        """
        shots, converter, threshold, point = (
            self.shots,
            self.shots.sensor.tdc,
            self.shots.threshold,
            self.shots.point,
        )
        ops = xp(threshold)
        other = self.others[source - 1] if source else None
        rate_hz = self.noise_rate_hz if other is None else other.rate_hz
        expected = rate_hz * converter.listening_s
        stage = Stage.FALSE_ALARM if other is None else Stage.INTERFERENCE
        at = 2 * (max(source - 1, 0) * converter.stops + number)
        higher = higher + random.exponential(shots.words(stage, at))
        place = random.open_uniform(shots.words(stage, at + 1)[0])
        there = higher < expected
        share = ops.where(there, higher / ops.where(there, expected, 1.0), 1.0)
        if other is None:
            amplitude: Lanes = threshold - ops.log(share) * point.noise * point.noise / threshold
        else:
            amplitude = interference.amplitude_of(shots, other, uniform=share)
        theirs = None
        if self.others:
            theirs = there if other is not None else there & False
        time_s = ops.where(there, converter.blanking_s + place * converter.listening_s, NEVER_S)
        return higher, Alarm(time_s=time_s, amplitude=amplitude, theirs=theirs)


def first_of(alarms: Alarms, count: int) -> list[Alarm]:
    """So many alarms."""
    found: list[Alarm] = []
    come: Lanes = 0.0
    for number in range(count):
        come, alarm = alarms(number, come)
        found.append(alarm)
    return found
