"""Comparator: a peak and its noise in, whether and where it trips, how high it looks, when it is reported."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from ..light.echoes import Interference
from ..maths import random
from ..maths.arrays import Array, xp
from ..maths.special import normal_tail
from ..physics.electronics import saturation, tdc
from ..physics.optics import pulse as pulse_shape
from ..sensor.detectors import WorkingPoint
from ..sensor.model import Sensor
from . import interference

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

    signal: Array
    sigma: Array
    deviate: Array
    of_peak: Array
    level: Array
    probability: Array
    tripped: Array


def trip(
    point: WorkingPoint, threshold: Array, peak_power_w: Array, *, seed: Array, pulse: Array, draw: Array = 0
) -> Trip:
    """Noise on the edge: one deviate decides detection and time. ``draw`` tells the echoes of a pulse apart."""
    words = random.words(seed=seed, stage=random.STAGE_EDGE_NOISE, pulse=pulse, draw=draw)
    deviate, of_peak = random.normal_pair(words)
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


def probability(point: WorkingPoint, threshold: Array, signal: Array) -> Array:
    """P_d of a peak signal, (T22) or (T23)."""
    own_noise = {"noise": point.noise, "kappa_1": point.kappa_1, "kappa_2": point.kappa_2}
    sigma = tdc.noise_at_level(level=signal, **own_noise)
    return point.detection_probability(threshold, signal, sigma)


def amplitude(tripped: Trip, sensor: Sensor, point: WorkingPoint, threshold: Array, *, lag_s: Array) -> Array:
    """Measured peak: the edge's noise ``lag_s`` later, and the peak's own for what has been forgotten by then."""
    ops = xp(tripped.signal)
    kept = tdc.noise_correlation(lag_s=lag_s, bandwidth_hz=sensor.tdc.bandwidth_hz)
    peak_noise = kept * tripped.deviate + ops.sqrt(ops.maximum(1.0 - kept * kept, 0.0)) * tripped.of_peak
    return point.measured(ops.maximum(tripped.signal + peak_noise * tripped.sigma, threshold))


def trailing_level(
    tripped: Trip,
    sensor: Sensor,
    point: WorkingPoint,
    threshold: Array,
    *,
    lag_s: Array,
    seed: Array,
    pulse: Array,
    draw: Array = 0,
) -> Array:
    """Signal at which the falling edge, ``lag_s`` after the rising one, leaves a level: a deviate of its own, but for
    what is left of the first.
    """
    ops = xp(tripped.signal)
    words = random.words(seed=seed, stage=random.STAGE_TRAILING_EDGE, pulse=pulse, draw=draw)
    kept = tdc.noise_correlation(lag_s=lag_s, bandwidth_hz=sensor.tdc.bandwidth_hz)
    deviate = (
        kept * tripped.deviate + ops.sqrt(ops.maximum(1.0 - kept * kept, 0.0)) * random.normal_pair(words)[0]
    )
    return tdc.crossing_level(
        threshold=threshold, deviate=deviate, noise=point.noise, kappa_1=point.kappa_1, kappa_2=point.kappa_2
    )


def width_s(
    tripped: Trip,
    sensor: Sensor,
    point: WorkingPoint,
    threshold: Array,
    *,
    peak_power_w: Array,
    early_s: Array,
    seed: Array,
    pulse: Array,
) -> Array:
    """Time over the threshold of a lone Gaussian pulse whose rising edge crossed at ``early_s`` before its peak."""
    ops, fwhm = xp(tripped.signal), sensor.laser.pulse_fwhm_s
    level = trailing_level(tripped, sensor, point, threshold, lag_s=2.0 * early_s, seed=seed, pulse=pulse)
    below = tripped.tripped & (level < tripped.signal)
    share = ops.where(below, point.power_w(level) / peak_power_w, 1.0)
    fall = -pulse_shape.leading_edge_time_s(level=share, fwhm_s=fwhm)
    if point.recovery_s is not None:
        signal = ops.where(below, tripped.signal, point.saturation)
        released = -pulse_shape.leading_edge_time_s(level=point.saturation / signal, fwhm_s=fwhm)
        fall = saturation.held_until(
            fall_s=fall, released_s=released, level=level, signal=signal, saturation=point.saturation,
            recovery_s=point.recovery_s,
        )  # fmt: skip
    return fall - early_s


def alarm_width_s(
    sensor: Sensor, point: WorkingPoint, threshold: Array, amplitude: Array, *, theirs: Array
) -> Array:
    """Time over the threshold of a false alarm: of a noise peak, or of another lidar's pulse, taken as long as ours."""
    ops = xp(threshold, amplitude)
    own = tdc.excursion_width_s(height=amplitude, threshold=threshold, bandwidth_hz=sensor.tdc.bandwidth_hz)
    if theirs is False:
        return own
    share = point.power_w(threshold) / point.power_w(amplitude)
    pulse = -2.0 * pulse_shape.leading_edge_time_s(level=share, fwhm_s=sensor.laser.pulse_fwhm_s)
    return ops.where(theirs, pulse, own)


def reported_s(
    sensor: Sensor,
    point: WorkingPoint,
    threshold: Array,
    crossing_s: Array,
    *,
    measured: Array,
    width_s: Array | None,
    true_power_w: Array,
    seed: Array,
    pulse: Array,
    draw: Array = 0,
) -> Array:
    """Time that the converter gives a crossing: less the walk, with its own jitter and step."""
    walk = walk_s(sensor, point, threshold, measured=measured, width_s=width_s, true_power_w=true_power_w)
    return converted(sensor, crossing_s - walk, seed=seed, pulse=pulse, draw=draw)


def walk_s(
    sensor: Sensor,
    point: WorkingPoint,
    threshold: Array,
    *,
    measured: Array,
    width_s: Array | None,
    true_power_w: Array,
) -> Array:
    """How much earlier than its peak an echo is thought to have crossed (negative), to be taken off."""
    if sensor.tdc.walk == "raw":
        return 0.0
    fwhm = sensor.laser.pulse_fwhm_s
    power = true_power_w
    if sensor.tdc.walk == "corrected":
        power = point.told_power_w(measured, width_s=width_s, threshold=threshold, pulse_fwhm_s=fwhm)
    return pulse_shape.leading_edge_time_s(level=point.power_w(threshold) / power, fwhm_s=fwhm)


def converted(sensor: Sensor, time_s: Array, *, seed: Array, pulse: Array, draw: Array = 0) -> Array:
    """The converter's own jitter and step; no time before the pulse."""
    ops = xp(time_s)
    words = random.words(seed=seed, stage=random.STAGE_TDC_JITTER, pulse=pulse, draw=draw)
    jitter, _ = random.normal_pair(words)
    jittered = ops.maximum(time_s + sensor.tdc.jitter_s * jitter, 0.0)
    return tdc.quantised(time_s=jittered, least_significant_bit_s=sensor.tdc.least_significant_bit_s)


def listening(sensor: Sensor, crossing_s: Array) -> Array:
    """Whether the converter takes a crossing at this time at all.

    Without blanking also one before time 0: an echo from right before the sensor begins before its pulse's middle.
    """
    blanking = sensor.tdc.blanking_s
    return ((crossing_s >= blanking) | (blanking <= 0.0)) & (crossing_s < sensor.tdc.window_s)


Alarm = tuple[Array, Array, Array]
"""Time and amplitude of a crossing without an echo of ours, and whether it is another lidar's (False: no such)."""

Alarms = Callable[[Array, Array], tuple[Array, Alarm]]
"""Alarms of a kind, those that the converter rather keeps first: number of an alarm, and how far the process has come
before it, to how far it has come and the alarm. It begins at 0 with alarm 0; after one beyond the window all are."""


def false_alarms(
    sensor: Sensor,
    point: WorkingPoint,
    threshold: Array,
    sources: tuple[Interference, ...],
    *,
    seed: Array,
    pulse: Array,
) -> list[Alarms]:
    """Crossings of each pulse without an echo of ours, by kind.

    Noise crossings are a Poisson process whose rate leaves M comparisons quiet with (1 - P_f)^M, in either direction
    of time. Where none can come the time is far beyond any window. Crossings while the converter is blind are passed
    over: the process begins when it begins to listen.
    """
    others = interference.crossings(sources, point, threshold)
    p_false = point.false_alarm_probability(threshold)
    noise_rate = tdc.false_alarm_rate_hz(p_false=p_false, bandwidth_hz=sensor.tdc.bandwidth_hz)
    known = _Known(
        sensor=sensor, point=point, threshold=threshold, noise_rate_hz=noise_rate, others=others,
        seed=seed, pulse=pulse,
    )  # fmt: skip
    if sensor.tdc.keep == "strongest":
        return [partial(known.by_height, number) for number in range(1 + len(others))]
    return [known.in_time]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Known:
    """What the alarms of some pulses depend on."""

    sensor: Sensor
    point: WorkingPoint
    threshold: Array
    noise_rate_hz: Array
    others: tuple[interference.Crossings, ...]
    seed: Array
    pulse: Array

    def _words(self, stage: int, draw: Array) -> tuple[Array, Array]:
        return random.words(seed=self.seed, stage=stage, pulse=self.pulse, draw=draw)

    def in_time(self, number: Array, elapsed: Array) -> tuple[Array, Alarm]:
        """Of all sources, first or last first; ``elapsed`` in units of the mean wait."""
        ops, converter, threshold, point = xp(self.threshold), self.sensor.tdc, self.threshold, self.point
        rate = sum((one.rate_hz for one in self.others), self.noise_rate_hz)
        never = rate <= 0.0
        elapsed = elapsed + random.exponential(self._words(random.STAGE_FALSE_ALARM, 2 * number))
        time_s = ops.where(never, NEVER_S, elapsed / ops.where(never, 1.0, rate))
        if converter.keep == "last":
            time_s = ops.where(time_s < converter.listening_s, converter.window_s - time_s, NEVER_S)
        else:
            time_s = converter.blanking_s + time_s

        def crossing() -> tuple[Array, ...]:
            height = random.exponential(self._words(random.STAGE_FALSE_ALARM, 2 * number + 1))
            # Far out, a Gaussian tail falls like exp(-U x / sigma_0^2): the excess over U is exponential.
            amplitude = threshold + height * point.noise * point.noise / threshold
            if not self.others:
                return (amplitude,)
            return interference.assigned(
                self.others, point, noise_rate_hz=self.noise_rate_hz, noise_amplitude=amplitude,
                threshold=threshold, seed=self.seed, pulse=self.pulse, draw=number,
            )[::-1]  # fmt: skip

        in_window = time_s < converter.window_s
        nothing = (threshold + 0.0 * time_s,) + ((in_window & False,) if self.others else ())
        amplitude, *theirs = ops.rarely(in_window, crossing, nothing)
        return elapsed, (ops.minimum(time_s, NEVER_S), amplitude, theirs[0] if theirs else False)

    def by_height(self, source: int, number: Array, higher: Array) -> tuple[Array, Alarm]:
        """The highest crossings of noise (source 0) or of another lidar, at any time of the window.

        Ordered by height, the expected number of crossings that are as high is a Poisson process of rate one, too.
        """
        ops, converter, threshold, point = xp(self.threshold), self.sensor.tdc, self.threshold, self.point
        other = self.others[source - 1] if source else None
        rate_hz = self.noise_rate_hz if other is None else other.rate_hz
        expected = rate_hz * converter.listening_s
        stage = random.STAGE_FALSE_ALARM if other is None else random.STAGE_INTERFERENCE
        at = 2 * (max(source - 1, 0) * converter.stops + number)
        higher = higher + random.exponential(self._words(stage, at))
        place = random.open_uniform(self._words(stage, at + 1)[0])
        there = higher < expected
        share = ops.where(there, higher / ops.where(there, expected, 1.0), 1.0)
        if other is None:
            amplitude = threshold - ops.log(share) * point.noise * point.noise / threshold
        else:
            amplitude = interference.amplitude_of(other, point, threshold, uniform=share)
        theirs: Array = (there if other is not None else there & False) if self.others else False
        time_s = ops.where(there, converter.blanking_s + place * converter.listening_s, NEVER_S)
        return higher, (time_s, amplitude, theirs)


def first_of(alarms: Alarms, count: int) -> list[Alarm]:
    """So many alarms."""
    found, come = [], 0.0
    for number in range(count):
        come, alarm = alarms(number, come)
        found.append(alarm)
    return found
