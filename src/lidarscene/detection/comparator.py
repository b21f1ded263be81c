"""Comparator: detection, crossing time, amplitude and width of noisy pulses, and the converter's clock.

Noise moves an edge in time and can lift it above the threshold or keep it below. One standard normal deviate z for
each echo stands for the noise on its whole leading edge. It decides detection and time together, so the two cannot
contradict each other, and no waveform has to be sampled (docs/theory.md 8).

Symbols: U threshold, s signal, sigma(s) its noise, sigma_0 noise without an echo, z deviate, P_d probability of a
detection.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..maths import random
from ..maths.arrays import Lanes, Mask, xp
from ..maths.random import Stage
from ..maths.special import normal_tail
from ..physics.electronics import saturation, tdc
from ..physics.electronics.sipm_edge import Passage, late_place
from ..physics.optics import pulse as pulse_shape
from ..physics.optics import scintillation
from ..sensor.sensor_model import Sensor
from .shots import Shots


@dataclass(frozen=True, slots=True, kw_only=True)
class Trip:
    """An echo at the comparator, with the noise that was drawn for it; each field (n,).

    Attributes:
        signal: peak s of the signal without noise
        sigma: standard deviation of the noise at the peak
        deviate: z of the leading edge, N(0, 1), theory (T24)
        peak_deviate: z' of the peak, N(0, 1), independent of the first, theory (T26a)
        level: noiseless signal at which the edge trips the comparator, theory (T25)
        probability: P_d, theory (T22) or (T23); of an echo that fluctuates, the mean over all of its powers
        tripped: whether the echo trips the comparator
        expected: signal of the mean power: ``signal`` if the echo does not fluctuate
        base: signal from which the threshold counts: 0 but for what stands on other light
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
    return shots.point.noise.crossing_level(shots.threshold, deviate)


def trip(shots: Shots, peak_power_w: Lanes, *, draw: Lanes = 0, base: Lanes = 0.0, curvature: Lanes = 1.0) -> Trip:
    """Draw the noise of an echo and compare it with the threshold (docs/theory.md 8).

    Args:
        peak_power_w: (n,) optical peak power
        draw: number of the echo in its pulse: each has its own deviates
        base: (n,) signal from which the threshold counts, that of the light on which the echo stands
        curvature: (n,) -P'' / P at its peak, 1 of a pulse as it leaves
    """
    point, threshold = shots.point, shots.threshold + base
    deviate, peak_deviate = random.normal_pair(shots.words(Stage.EDGE_NOISE, draw))
    signal = point.response.signal(peak_power_w)
    sigma = point.noise.at(signal)
    passage = point.passage(threshold, signal, sigma)
    probability = point.detection_probability(threshold, signal, sigma) if passage is None else passage.ever
    reached = point.noise.crossing_level(threshold, deviate)
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
    if shots.sensor.tdc.chatter_hz is not None:
        steady = shots.sensor.steadiness(point.noise, threshold, signal, curvature)
        tripped = tripped & (random.open_uniform(shots.words(Stage.CHATTER, draw)[0]) < steady)
        probability = probability * steady
    expected = signal
    if shots.fluctuation is not None:
        expected, probability = expectation(shots, peak_power_w, threshold=threshold, curvature=curvature)
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


def expectation(
    shots: Shots, peak_power_w: Lanes, *, threshold: Lanes | None = None, curvature: Lanes = 1.0
) -> tuple[Lanes, Lanes]:
    """Peak signal of an echo's mean power, and its P_d, (n,) each; theory (T22) or (T23).

    Args:
        peak_power_w: (n,) optical peak power as drawn
        threshold: (n,) level that it must reach; None: the comparator's
        curvature: (n,) as of `trip`
    """
    level = shots.threshold if threshold is None else threshold
    point, fluctuation = shots.point, shots.fluctuation

    def probability(signal: Lanes) -> Lanes:
        reached = point.detection_probability(level, signal, point.noise.at(signal))
        return reached * shots.sensor.steadiness(point.noise, level, signal, curvature)

    if fluctuation is None:
        signal = point.response.signal(peak_power_w)
        return signal, probability(signal)
    mean_w = peak_power_w / fluctuation.relative_power
    drawn = scintillation.mean(lambda power: probability(point.response.signal(mean_w * power)), fluctuation.variance)
    return point.response.signal(mean_w), drawn


def count_lag_s(shots: Shots, trip: Trip, *, share: Lanes, peak_power_w: Lanes) -> Lanes:
    """Time from the crossing of the light's edge to that of a SiPM's count, (n,) s; 0 of signals that follow the light.

    Exact for a lone Gaussian pulse; of other waveforms the light's crossing is delayed by as much.

    Args:
        share: (n,) share of the peak power that makes the level, 1 if the peak is below it
        peak_power_w: (n,) peak power, above 0
    """
    edge, point = shots.point.edge, shots.point
    if edge is None or trip.passage is None or not shots.sensor.times_edge:
        return 0.0
    ops = xp(share, trip.signal)
    level = ops.minimum(trip.level, trip.signal)
    excess = edge.excess(share, level=level, sigma=point.noise.at(level), passage=trip.passage)
    earlier_w = point.response.power_w(ops.maximum(level - excess, 1e-3 * level))
    place = edge.place(ops.where(trip.tripped, earlier_w / peak_power_w, 1.0))
    place = place + late_place(trip.passage, normal_tail(trip.deviate))
    return edge.sigma_s * place - pulse_shape.leading_edge_time_s(level=share, fwhm_s=shots.sensor.received_fwhm_s)


def amplitude(shots: Shots, trip: Trip, *, lag_s: Lanes) -> Lanes:
    """Measured peak in signal units, (n,); at least the threshold (docs/theory.md 8).

    Args:
        lag_s: (n,) time between the crossing and the peak, of either sign
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

    Args:
        threshold: (n,) the level; None: the comparator's threshold
        lag_s: (n,) time between the two edges, of either sign
        draw: number of the echo in its pulse
    """
    ops, words = xp(trip.signal), shots.words(Stage.TRAILING_EDGE, draw)
    correlation = shots.sensor.noise_correlation(lag_s)
    deviate = (
        correlation * trip.deviate
        + ops.sqrt(ops.maximum(1.0 - correlation * correlation, 0.0)) * random.normal_pair(words)[0]
    )
    return shots.point.noise.crossing_level(shots.threshold if threshold is None else threshold, deviate)


def width_s(shots: Shots, trip: Trip, *, peak_power_w: Lanes, early_s: Lanes) -> Lanes:
    """Time over the threshold of a single Gaussian pulse, (n,) s (docs/theory_receivers.md 2).

    Args:
        early_s: (n,) crossing time of the rising edge relative to the peak: negative
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


def reported_s(
    shots: Shots, crossing_s: Lanes, *, measured: Lanes, width_s: Lanes | None, true_power_w: Lanes, draw: Lanes = 0
) -> Lanes:
    """Time that the converter reports for a crossing, (n,) s: walk taken off, jitter and rounding added.

    Args:
        crossing_s: (n,) time at which the comparator trips
        measured: (n,) measured amplitude, in signal units
        width_s: (n,) time over the threshold, or None: not measured
        true_power_w: (n,) optical peak power without noise
        draw: number of the echo in its pulse
    """
    walk = walk_s(shots, measured=measured, width_s=width_s, true_power_w=true_power_w)
    return converted_time_s(shots, crossing_s - walk, draw=draw, height=measured)


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


def converted_time_s(shots: Shots, time_s: Lanes, *, draw: Lanes = 0, height: Lanes = 0.0) -> Lanes:
    """Time that the converter's clock gives to a time, (n,) s, of echoes and of false alarms alike.

    Its jitter is added and the sum rounded to its step; 0 where that is not after the pulse. Of a histogram the time
    stamps have the jitter, before they are counted.

    Args:
        draw: number of the time in its pulse: each has a jitter of its own
        height: (n,) measured amplitude, in signal units: strong pulses may be timed by another channel
    """
    ops, converter = xp(time_s), shots.sensor.tdc
    if shots.sensor.histogram is None:
        jitter, _ = random.normal_pair(shots.words(Stage.TDC_JITTER, draw))
        deviation = converter.jitter_s
        if converter.strong_above is not None:
            least = converter.strong_above * shots.threshold
            if converter.strong_spread is not None:
                deviate, _ = random.normal_pair(shots.words(Stage.STRONG_CHANNEL, draw))
                least = least * ops.exp(converter.strong_spread * deviate)
            is_strong = height > least
            of_strong = 0.0 if converter.strong_jitter_s is None else converter.strong_jitter_s
            deviation = ops.where(is_strong, of_strong, deviation)
        time_s = time_s + deviation * jitter
    return tdc.quantise(time_s=ops.maximum(time_s, 0.0), least_significant_bit_s=converter.least_significant_bit_s)


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
