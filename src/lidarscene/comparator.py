"""Comparator: a peak and its noise in, whether and at which level it trips, how high it looks and when it is reported."""

from __future__ import annotations

from dataclasses import dataclass

from . import noise
from .arrays import Array, xp
from .detectors import WorkingPoint
from .physics import pulse as pulse_shape
from .physics import tdc
from .physics.special import normal_tail
from .sensor import Sensor

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
    words = noise.words(seed=seed, stage=noise.STAGE_EDGE_NOISE, pulse=pulse, draw=draw)
    deviate, of_peak = noise.normal_pair(words)
    signal = point.signal(peak_power_w)
    own_noise = {"noise": point.noise, "kappa_1": point.kappa_1, "kappa_2": point.kappa_2}
    sigma = tdc.noise_at_level(level=signal, **own_noise)
    probability = point.detection_probability(threshold, signal, sigma)
    level = tdc.crossing_level(threshold=threshold, deviate=deviate, **own_noise)
    # Counted cells take the same deviate: its upper tail is uniform in (0, 1).
    tripped = normal_tail(deviate) < probability if point.exact else signal >= level
    return Trip(
        signal=signal, sigma=sigma, deviate=deviate, of_peak=of_peak,
        level=level, probability=probability, tripped=tripped,
    )  # fmt: skip


def probability(point: WorkingPoint, threshold: Array, signal: Array) -> Array:
    """P_d of a peak signal, (T22) or (T23)."""
    own_noise = {"noise": point.noise, "kappa_1": point.kappa_1, "kappa_2": point.kappa_2}
    sigma = tdc.noise_at_level(level=signal, **own_noise)
    return point.detection_probability(threshold, signal, sigma)


def amplitude(tripped: Trip, sensor: Sensor, threshold: Array, *, lag_s: Array) -> Array:
    """Measured peak: the edge's noise ``lag_s`` later, and the peak's own for what has been forgotten by then."""
    ops = xp(tripped.signal)
    kept = tdc.noise_correlation(lag_s=lag_s, bandwidth_hz=sensor.tdc.bandwidth_hz)
    peak_noise = kept * tripped.deviate + ops.sqrt(ops.maximum(1.0 - kept * kept, 0.0)) * tripped.of_peak
    return ops.maximum(tripped.signal + peak_noise * tripped.sigma, threshold)


def reported_s(
    sensor: Sensor,
    point: WorkingPoint,
    threshold: Array,
    crossing_s: Array,
    *,
    measured: Array,
    true_power_w: Array,
    seed: Array,
    pulse: Array,
    draw: Array = 0,
) -> Array:
    """Time that the converter gives a crossing: less the walk, with its own jitter and step."""
    walk = walk_s(sensor, point, threshold, measured=measured, true_power_w=true_power_w)
    return converted(sensor, crossing_s - walk, seed=seed, pulse=pulse, draw=draw)


def walk_s(
    sensor: Sensor, point: WorkingPoint, threshold: Array, *, measured: Array, true_power_w: Array
) -> Array:
    """How much earlier than its peak an echo is thought to have crossed (negative), to be taken off."""
    if sensor.tdc.walk == "raw":
        return 0.0
    fwhm = sensor.laser.pulse_fwhm_s
    power = true_power_w if sensor.tdc.walk == "none" else point.power_w(measured)
    return pulse_shape.leading_edge_time_s(level=point.power_w(threshold) / power, fwhm_s=fwhm)


def converted(sensor: Sensor, time_s: Array, *, seed: Array, pulse: Array, draw: Array = 0) -> Array:
    """The converter's own jitter and step; no time before the pulse."""
    ops = xp(time_s)
    words = noise.words(seed=seed, stage=noise.STAGE_TDC_JITTER, pulse=pulse, draw=draw)
    jitter, _ = noise.normal_pair(words)
    jittered = ops.maximum(time_s + sensor.tdc.jitter_s * jitter, 0.0)
    return tdc.quantised(time_s=jittered, least_significant_bit_s=sensor.tdc.least_significant_bit_s)


def false_alarms(
    sensor: Sensor, point: WorkingPoint, threshold: Array, *, seed: Array, pulse: Array
) -> list[tuple[Array, Array]]:
    """Time and amplitude of noise crossings of each pulse, one for every stop: those that the converter keeps.

    Crossings are a Poisson process whose rate leaves M comparisons quiet with (1 - P_f)^M, in either direction of
    time; ordered by height, the shares of the window's expected crossings that are as high are such a process
    too. Where none can come the time is far beyond any window.
    """
    ops = xp(threshold)
    window = sensor.tdc.window_s
    p_false = point.false_alarm_probability(threshold)
    rate = tdc.false_alarm_rate_hz(p_false=p_false, bandwidth_hz=sensor.tdc.bandwidth_hz)
    never = rate <= 0.0
    rate = ops.where(never, 1.0, rate)
    # Far out, a Gaussian tail falls like exp(-U x / sigma_0^2): the excess over U is exponential.
    mean_excess = point.noise * point.noise / threshold
    arrivals = []
    elapsed: Array = 0.0
    for draw in range(sensor.tdc.stops):
        first, second = noise.words(seed=seed, stage=noise.STAGE_FALSE_ALARM, pulse=pulse, draw=2 * draw)
        elapsed = elapsed + noise.exponential((first, second))
        words = noise.words(seed=seed, stage=noise.STAGE_FALSE_ALARM, pulse=pulse, draw=2 * draw + 1)
        if sensor.tdc.keep == "strongest":
            expected = rate * window
            time_s = ops.where(elapsed < expected, noise.open_uniform(words[0]) * window, NEVER_S)
            excess = ops.log(ops.maximum(expected / elapsed, 1.0)) * mean_excess
        else:
            time_s = elapsed / rate
            if sensor.tdc.keep == "last":
                time_s = ops.where(time_s < window, window - time_s, NEVER_S)
            excess = noise.exponential(words) * point.noise * point.noise / threshold
        time_s = ops.where(never, NEVER_S, time_s)
        arrivals.append((ops.minimum(time_s, NEVER_S), threshold + excess))
    return arrivals
