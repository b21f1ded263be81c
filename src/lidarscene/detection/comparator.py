"""Comparator: detection, crossing time, amplitude and width of noisy pulses, and false alarms.

Noise moves an edge in time and can lift it above the threshold or keep it below. One standard normal deviate z for
each echo stands for the noise on its whole leading edge. It decides detection and time together, so the two cannot
contradict each other, and no waveform has to be sampled (docs/theory.md 8). False alarms are a Poisson process
(docs/theory.md 9).

Symbols: U threshold, s signal, sigma(s) its noise, sigma_0 noise without an echo, z deviate, P_d and P_f probability of
a detection and of a false alarm, lambda rate of false alarms, tau time in which the converter listens.
"""

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
from ..physics.electronics.sipm_edge import Passage, late_place
from ..physics.optics import pulse as pulse_shape
from ..physics.optics import scintillation
from ..sensor.sensor_model import Sensor
from . import interference
from .shots import Shots

NEVER_S = 1.0
"""Time of an alarm that does not happen: later than any window."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trip:
    """An echo at the comparator, with the noise that was drawn for it; each field (n,).

    signal        peak s of the signal without noise
    sigma         standard deviation of the noise at the peak
    deviate       z of the leading edge, N(0, 1), theory (T24)
    peak_deviate  z' of the peak, N(0, 1), independent of the first, theory (T26a)
    level         noiseless signal at which the edge trips the comparator, theory (T25)
    probability   P_d, theory (T22) or (T23); of an echo that fluctuates, the mean over all of its powers
    tripped       whether the echo trips the comparator
    expected      signal of the mean power: ``signal`` if the echo does not fluctuate
    base          signal from which the threshold counts: 0 but for what stands on other light
    """

    signal: Lanes
    sigma: Lanes
    deviate: Lanes
    peak_deviate: Lanes
    level: Lanes
    probability: Lanes
    tripped: Mask
    expected: Lanes
    base: Lanes = 0.0
    passage: Passage | None = None
    count_lag_s: Lanes = 0.0


def level(shots: Shots, *, draw: Lanes = 0) -> Lanes:
    """Noiseless signal at which an echo's edge trips the comparator, (n,): `Trip.level` without a base."""
    deviate, _ = random.normal_pair(shots.words(Stage.EDGE_NOISE, draw))
    point = shots.point
    return tdc.crossing_level(
        threshold=shots.threshold,
        deviate=deviate,
        noise=point.noise.deviation,
        kappa_1=point.noise.kappa_1,
        kappa_2=point.noise.kappa_2,
    )


def trip(shots: Shots, peak_power_w: Lanes, *, draw: Lanes = 0, base: Lanes = 0.0) -> Trip:
    """Draw the noise of an echo and compare it with the threshold (docs/theory.md 8).

    peak_power_w  (n,) optical peak power
    draw          number of the echo in its pulse: each has its own deviates
    base          (n,) signal from which the threshold counts, that of the light on which the echo stands
    """
    point, threshold = shots.point, shots.threshold + base
    deviate, peak_deviate = random.normal_pair(shots.words(Stage.EDGE_NOISE, draw))
    signal = point.response.signal(peak_power_w)
    noise_terms = {"noise": point.noise.deviation, "kappa_1": point.noise.kappa_1, "kappa_2": point.noise.kappa_2}
    sigma = tdc.noise_at_level(level=signal, **noise_terms)
    passage = point.passage(threshold, signal, sigma)
    probability = point.detection_probability(threshold, signal, sigma) if passage is None else passage.ever
    reached = tdc.crossing_level(threshold=threshold, deviate=deviate, **noise_terms)
    # With n(s) = z sigma(s) the noisy edge reaches U where s + z sigma(s) = U. That is `level`, so the echo trips if
    # its peak is at least that high. P(s + z sigma(s) >= U) is (T22): the same z gives P_d and the crossing time.
    # Counted cells are not Gaussian and have P_d of (T23), or pass the threshold beside the peak too (T119). Q(z) is
    # uniform in (0, 1), so comparing it with P_d keeps that probability and the one deviate: a large z still means an
    # early crossing and a likely detection.
    by_probability = point.counts is not None or passage is not None
    tripped = normal_tail(deviate) < probability if by_probability else signal >= reached
    if point.response.saturation is not None:
        # The amplifier's output never rises above where it clips.
        tripped = tripped & (threshold < point.response.saturation)
    expected = signal
    if shots.fluctuation is not None:
        expected, probability = expectation(shots, peak_power_w, threshold=threshold)
    return Trip(
        signal=signal,
        sigma=sigma,
        deviate=deviate,
        peak_deviate=peak_deviate,
        level=reached,
        probability=probability,
        tripped=tripped,
        expected=expected,
        base=base,
        passage=passage,
    )


def expectation(shots: Shots, peak_power_w: Lanes, *, threshold: Lanes | None = None) -> tuple[Lanes, Lanes]:
    """Peak signal of an echo's mean power, and its P_d, (n,) each; theory (T22) or (T23).

    peak_power_w  (n,) optical peak power as drawn
    threshold     (n,) level that it must reach; None: the comparator's
    """
    level = shots.threshold if threshold is None else threshold
    point, fluctuation = shots.point, shots.fluctuation

    def probability(signal: Lanes) -> Lanes:
        noise_terms = {"noise": point.noise.deviation, "kappa_1": point.noise.kappa_1, "kappa_2": point.noise.kappa_2}
        sigma = tdc.noise_at_level(level=signal, **noise_terms)
        return point.detection_probability(level, signal, sigma)

    if fluctuation is None:
        signal = point.response.signal(peak_power_w)
        return signal, probability(signal)
    mean_w = peak_power_w / fluctuation.relative_power
    drawn = scintillation.mean(lambda power: probability(point.response.signal(mean_w * power)), fluctuation.variance)
    return point.response.signal(mean_w), drawn


def count_lag_s(shots: Shots, trip: Trip, *, share: Lanes, peak_power_w: Lanes) -> Lanes:
    """Time from the crossing of the light's edge to that of a SiPM's count, (n,) s; 0 of signals that follow the light.

    Exact for a lone Gaussian pulse; of other waveforms the light's crossing is delayed by as much.

    share         (n,) share of the peak power that makes the level, 1 if the peak is below it
    peak_power_w  (n,) peak power, above 0
    """
    edge, point = shots.point.edge, shots.point
    if edge is None or trip.passage is None or not shots.sensor.times_edge:
        return 0.0
    ops = xp(share, trip.signal)
    level = ops.minimum(trip.level, trip.signal)
    noise_terms = {"noise": point.noise.deviation, "kappa_1": point.noise.kappa_1, "kappa_2": point.noise.kappa_2}
    sigma = tdc.noise_at_level(level=level, **noise_terms)
    excess = edge.excess(share, level=level, sigma=sigma, passage=trip.passage)
    earlier_w = point.response.power_w(ops.maximum(level - excess, 1e-3 * level))
    place = edge.place(ops.where(trip.tripped, earlier_w / peak_power_w, 1.0))
    place = place + late_place(trip.passage, normal_tail(trip.deviate))
    return edge.sigma_s * place - pulse_shape.leading_edge_time_s(level=share, fwhm_s=shots.sensor.received_fwhm_s)


def amplitude(shots: Shots, trip: Trip, *, lag_s: Lanes) -> Lanes:
    """Measured peak in signal units, (n,); at least the threshold (docs/theory.md 8).

    lag_s  (n,) time between the crossing and the peak, of either sign
    """
    ops = xp(trip.signal)
    # (T26a): noise of bandwidth B_w keeps the share r of the edge's deviate until the peak; the rest is fresh. At the
    # threshold crossing and peak coincide, r = 1, and both share one deviate.
    correlation = shots.sensor.noise_correlation(lag_s)
    peak_noise = (
        correlation * trip.deviate + ops.sqrt(ops.maximum(1.0 - correlation * correlation, 0.0)) * trip.peak_deviate
    )
    return shots.point.response.measured(
        ops.maximum(trip.signal + peak_noise * trip.sigma, shots.threshold + trip.base)
    )


def trailing_level(shots: Shots, trip: Trip, *, threshold: Lanes | None = None, lag_s: Lanes, draw: Lanes = 0) -> Lanes:
    """Noiseless signal at which the falling edge leaves a level, (n,); theory (T25) and (T26a).

    The falling edge has another deviate, correlated with that of the rising edge.

    threshold  (n,) the level; None: the comparator's threshold
    lag_s      (n,) time between the two edges, of either sign
    draw       number of the echo in its pulse
    """
    ops, point = xp(trip.signal), shots.point
    words = shots.words(Stage.TRAILING_EDGE, draw)
    correlation = shots.sensor.noise_correlation(lag_s)
    deviate = (
        correlation * trip.deviate
        + ops.sqrt(ops.maximum(1.0 - correlation * correlation, 0.0)) * random.normal_pair(words)[0]
    )
    return tdc.crossing_level(
        threshold=shots.threshold if threshold is None else threshold,
        deviate=deviate,
        noise=point.noise.deviation,
        kappa_1=point.noise.kappa_1,
        kappa_2=point.noise.kappa_2,
    )


def width_s(shots: Shots, trip: Trip, *, peak_power_w: Lanes, early_s: Lanes) -> Lanes:
    """Time over the threshold of a single Gaussian pulse, (n,) s (docs/theory_receivers.md 32).

    early_s  (n,) crossing time of the rising edge relative to the peak: negative
    """
    ops, point, fwhm = xp(trip.signal), shots.point, shots.sensor.received_fwhm_s
    # The pulse is symmetric: without noise the falling edge crosses as long after the peak as the rising edge before.
    level = trailing_level(shots, trip, lag_s=2.0 * early_s)
    below = trip.tripped & (level < trip.signal)
    share = ops.where(below, point.response.power_w(level) / peak_power_w, 1.0)
    fall = -pulse_shape.leading_edge_time_s(level=share, fwhm_s=fwhm)
    if point.response.saturation is not None and point.response.recovery_s is not None:
        # A clipped pulse drains from the moment when the light has fallen back to the clipping level (T45).
        signal = ops.where(below, trip.signal, point.response.saturation)
        released = -pulse_shape.leading_edge_time_s(level=point.response.saturation / signal, fwhm_s=fwhm)
        fall = saturation.held_until(
            fall_s=fall,
            released_s=released,
            level=level,
            signal=signal,
            saturation=point.response.saturation,
            recovery_s=point.response.recovery_s,
        )
    return fall - early_s


def alarm_width_s(shots: Shots, amplitude: Lanes, *, interfering: Mask | None) -> Lanes:
    """Time over the threshold of a false alarm, (n,) s.

    A noise peak is a parabola around its top (T45a). A pulse of another lidar is assumed to be as long as the sensor's
    own.

    amplitude    (n,) peak of the alarm, in signal units
    interfering  (n,) bool, whether the alarm is another lidar's pulse; None without other lidars
    """
    sensor, threshold = shots.sensor, shots.threshold
    noise_width_s = tdc.excursion_width_s(height=amplitude, threshold=threshold, bandwidth_hz=sensor.tdc.bandwidth_hz)
    if interfering is None:
        return noise_width_s
    share = shots.point.response.power_w(threshold) / shots.point.response.power_w(amplitude)
    pulse_width_s = -2.0 * pulse_shape.leading_edge_time_s(level=share, fwhm_s=sensor.received_fwhm_s)
    return xp(threshold, amplitude).where(interfering, pulse_width_s, noise_width_s)


def reported_s(
    shots: Shots, crossing_s: Lanes, *, measured: Lanes, width_s: Lanes | None, true_power_w: Lanes, draw: Lanes = 0
) -> Lanes:
    """Time that the converter reports for a crossing, (n,) s: walk taken off, jitter and rounding added.

    crossing_s    (n,) time at which the comparator trips
    measured      (n,) measured amplitude, in signal units
    width_s       (n,) time over the threshold, or None: not measured
    true_power_w  (n,) optical peak power without noise
    draw          number of the echo in its pulse
    """
    walk = walk_s(shots, measured=measured, width_s=width_s, true_power_w=true_power_w)
    return converted_time_s(shots, crossing_s - walk, draw=draw)


def walk_s(shots: Shots, *, measured: Lanes, width_s: Lanes | None, true_power_w: Lanes) -> Lanes:
    """Walk correction, (n,) s: the assumed crossing time relative to the peak, negative or 0 (docs/theory.md 8).

    The caller subtracts it from the crossing time. ``tdc.walk`` chooses it: "raw" makes no correction, "none" takes
    the walk of the true power, "corrected" that of the power inferred from the amplitude or, of a saturated pulse,
    from the width.
    """
    sensor, point, threshold = shots.sensor, shots.point, shots.threshold
    if sensor.tdc.walk == "raw":
        return 0.0
    fwhm = sensor.received_fwhm_s
    power = true_power_w
    if sensor.tdc.walk == "corrected":
        point = point.calibrated or point
        power = point.response.inferred_power_w(measured, width_s=width_s, threshold=threshold, pulse_fwhm_s=fwhm)
    share = point.response.power_w(threshold) / power
    if point.edge is not None and sensor.times_edge:
        return point.edge.time_s(share)
    return pulse_shape.leading_edge_time_s(level=share, fwhm_s=fwhm)


def converted_time_s(shots: Shots, time_s: Lanes, *, draw: Lanes = 0) -> Lanes:
    """Add the converter's jitter to a time and round it to its step, (n,) s; 0 where that is not after the pulse."""
    ops, converter = xp(time_s), shots.sensor.tdc
    jitter, _ = random.normal_pair(shots.words(Stage.TDC_JITTER, draw))
    jittered = ops.maximum(time_s + converter.jitter_s * jitter, 0.0)
    return tdc.quantise(time_s=jittered, least_significant_bit_s=converter.least_significant_bit_s)


def is_range(reported_s: Lanes) -> Mask:
    """True for a time that a converter reports: it counts from the pulse, and 0 stands for no return, (n,) bool."""
    return reported_s > 0.0


def accepts_crossing(sensor: Sensor, crossing_s: Lanes) -> Mask:
    """True if the converter accepts a crossing at this time, (n,) bool: after blanking and within the window.

    Blanking ignores crossings and not levels: an echo that crosses while blanked gives no point, even if it is still
    above the threshold when blanking ends (docs/theory.md 9).
    """
    # Time 0 is the middle of the outgoing pulse. An echo from just in front of the sensor crosses before that, and
    # without blanking it counts.
    blanking = sensor.tdc.blanking_s
    return ((crossing_s >= blanking) | (blanking <= 0.0)) & (crossing_s < sensor.tdc.window_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class Alarm:
    """A crossing that no echo of the sensor's own pulse causes; each field (n,).

    time_s       crossing time; `NEVER_S` where there is no alarm
    amplitude    peak, in signal units
    interfering  whether it is another lidar's pulse; None without other lidars
    """

    time_s: Lanes
    amplitude: Lanes
    interfering: Mask | None


Alarms = Callable[[Lanes, Lanes], tuple[Lanes, Alarm]]
"""Generator of the alarms of one kind, in the order in which the converter prefers them.

``alarms(number, elapsed) -> (elapsed, alarm)`` makes alarm ``number`` (0, 1, ...) from the Poisson process' progress
before it, 0 at first, and returns the progress at it. Once an alarm is beyond the window, all later ones are."""


def false_alarms(shots: Shots, sources: tuple[Interference, ...]) -> list[Alarms]:
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

    def alarm_by_time(self, number: Lanes, elapsed: Lanes) -> tuple[Lanes, Alarm]:
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
            amplitude=threshold + 0.0 * time_s, interfering=in_window & False if self.other_lidars else None
        )
        assigned = ops.where_any(in_window, crossing, no_crossing)
        time_s = ops.minimum(time_s, NEVER_S)
        return elapsed, Alarm(time_s=time_s, amplitude=assigned.amplitude, interfering=assigned.interfering)

    def alarm_by_height(self, source: int, number: Lanes, gamma: Lanes) -> tuple[Lanes, Alarm]:
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
        never: tuple[Lanes, Lanes] = 0.0 * gamma + NEVER_S, threshold + 0.0 * gamma
        time_s, amplitude = ops.where_any(exists, crossing, never)
        interfering = None
        if self.other_lidars:
            interfering = exists if lidar is not None else exists & False
        return gamma, Alarm(time_s=time_s, amplitude=amplitude, interfering=interfering)


def first_alarms(alarms: Alarms, count: int) -> list[Alarm]:
    """Draw the first ``count`` alarms of a generator."""
    first: list[Alarm] = []
    elapsed: Lanes = 0.0
    for number in range(count):
        elapsed, alarm = alarms(number, elapsed)
        first.append(alarm)
    return first
