"""Returns: Echoes in, what the comparator and the TDC report out (PHYSICS.md section 5)."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Any

from . import ambient, intensity, interference, noise
from .arrays import Array, xp
from .detectors import WorkingPoint
from .echoes import Echoes
from .physics import pulse as pulse_shape
from .physics import radiometry, tdc
from .physics.special import normal_tail
from .sensor import Sensor


class Status(enum.IntEnum):
    """What a point is."""

    ECHO = 0
    FALSE_ALARM = 1
    INTERFERENCE = 2  # another lidar's pulse


class Outcome(enum.IntEnum):
    """What became of a pulse's echo."""

    KEPT = 0
    NO_SURFACE = 1  # the ray left the scene
    BELOW_THRESHOLD = 2  # light may have come back, the comparator did not trip
    OUT_OF_WINDOW = 3  # the echo came after the converter had stopped listening
    HIDDEN = 4  # false alarms had used up the converter's stops


@dataclass(frozen=True, slots=True, kw_only=True)
class Returns:
    """What one stop of the converter reports for each pulse; numpy or Dr.Jit.

    reported   (n,) bool, whether this stop was used
    status     (n,) int32, a `Status`
    range_m    (n,) c t / 2 of the reported time
    amplitude  (n,) peak at the comparator, in amperes (APD) or cells (SiPM)
    intensity  (n,) on the maker's scale, `intensity.reported`
    """

    reported: Array
    status: Array
    range_m: Array
    amplitude: Array
    intensity: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Detection:
    """The electronics' view of each pulse; numpy or Dr.Jit.

    snr                    (n,) (19) or (27): peak signal over the noise without echo; 0 without an echo
    detection_probability  (n,) that this echo trips the comparator; 0 without an echo
    outcome                (n,) int32, an `Outcome`
    ambient                (n,) background counts, `ambient.counts`
    stops                  one `Returns` for each stop, first crossing first
    """

    snr: Array
    detection_probability: Array
    outcome: Array
    ambient: Array
    stops: tuple[Returns, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Edge:
    """The echo at the comparator: whether it trips, when, and how high it looks."""

    found: Array
    crossing_s: Array
    reported_s: Array
    amplitude: Array
    probability: Array


def detect(echoes: Echoes, sensor: Sensor, *, seed: Array, pulse: Array) -> Detection:
    """Threshold, detection, false alarms and time of every pulse.

    seed   32-bit frame seed; every random number is keyed by (seed, stage, pulse)
    pulse  (n,) uint32 pulse numbers
    """
    ops = xp(echoes.range_m)
    point = sensor.working_point(echoes.background_power_w)
    threshold = sensor.threshold(point)
    edge = _edge(echoes, sensor, point, threshold, seed=seed, pulse=pulse)
    in_window = edge.found & (edge.crossing_s < sensor.tdc.window_s)
    others = interference.crossings(echoes.interference, point, threshold)
    alarms = _false_alarms(sensor, point, threshold, others, seed=seed, pulse=pulse)

    echo_left = in_window
    stops = []
    for stop in range(sensor.tdc.stops):
        # Alarms come in order, so this stop holds the echo if it is still unreported and comes next.
        used = stop - _as_int(ops, in_window & ~echo_left)
        alarm_s, alarm_amplitude, alarm_status = _nth(ops, alarms, used)
        alarm = alarm_s < sensor.tdc.window_s
        echo_now = echo_left & ~(alarm & (alarm_s < edge.crossing_s))
        echo_left = echo_left & ~echo_now
        range_m = _range(ops, sensor, ops.where(echo_now, edge.reported_s, alarm_s))
        amplitude = ops.where(echo_now, edge.amplitude, alarm_amplitude)
        stops.append(
            Returns(
                reported=echo_now | alarm,
                status=ops.where(echo_now, int(Status.ECHO), alarm_status),
                range_m=range_m,
                amplitude=amplitude,
                intensity=intensity.reported(echoes, sensor, point, amplitude=amplitude, range_m=range_m),
            )
        )
    outcome = ops.where(echo_left, int(Outcome.HIDDEN), int(Outcome.KEPT))
    outcome = ops.where(in_window, outcome, int(Outcome.OUT_OF_WINDOW))
    outcome = ops.where(edge.found, outcome, int(Outcome.BELOW_THRESHOLD))
    outcome = ops.where(echoes.found, outcome, int(Outcome.NO_SURFACE))
    signal = point.signal(echoes.peak_power_w)
    quiet = point.noise <= 0.0
    return Detection(
        snr=ops.where(echoes.found, signal / ops.where(quiet, 1e-30, point.noise), 0.0),
        detection_probability=ops.where(echoes.found, edge.probability, 0.0),
        outcome=outcome,
        ambient=ambient.counts(echoes.background_power_w, sensor, seed=seed, pulse=pulse),
        stops=tuple(stops),
    )


def _edge(
    echoes: Echoes, sensor: Sensor, point: WorkingPoint, threshold: Array, *, seed: Array, pulse: Array
) -> _Edge:
    """Noise on the edge: one deviate decides detection and time; the peak's own joins it for the amplitude."""
    ops = xp(echoes.range_m)
    fwhm = sensor.laser.pulse_fwhm_s
    words = noise.words(seed=seed, stage=noise.STAGE_EDGE_NOISE, pulse=pulse)
    deviate, of_peak = noise.normal_pair(words)
    signal = point.signal(echoes.peak_power_w)
    own_noise = {"noise": point.noise, "kappa_1": point.kappa_1, "kappa_2": point.kappa_2}
    sigma = tdc.noise_at_level(level=signal, **own_noise)
    probability = point.detection_probability(threshold, signal, sigma)
    level = tdc.crossing_level(threshold=threshold, deviate=deviate, **own_noise)
    # Counted cells take the same deviate: its upper tail is uniform in (0, 1).
    tripped = normal_tail(deviate) < probability if point.exact else signal >= level
    found = echoes.found & tripped
    if point.saturation is not None:
        found = found & (threshold < point.saturation)
    power = ops.where(found, echoes.peak_power_w, 1.0)
    arrival = radiometry.time_of_flight_s(range_m=echoes.range_m)
    # Counted cells may trip the comparator where the Gaussian edge stays below it: then at the peak.
    share = ops.where(found & (level < signal), point.power_w(level) / power, 1.0)
    early = pulse_shape.leading_edge_time_s(level=share, fwhm_s=fwhm)
    crossing = arrival + early
    # What shifted the edge is still in the peak if that comes within the noise's memory.
    kept = tdc.noise_correlation(lag_s=early, bandwidth_hz=sensor.tdc.bandwidth_hz)
    peak_noise = kept * deviate + ops.sqrt(ops.maximum(1.0 - kept * kept, 0.0)) * of_peak
    amplitude = point.measured(ops.maximum(signal + peak_noise * sigma, threshold))
    walk = _walk_s(sensor, point, threshold, measured=amplitude, true_power_w=power)
    return _Edge(
        found=found,
        crossing_s=crossing,
        reported_s=_converted(ops, sensor, crossing - walk, seed=seed, pulse=pulse),
        amplitude=amplitude,
        probability=probability,
    )


def _walk_s(
    sensor: Sensor, point: WorkingPoint, threshold: Array, *, measured: Array, true_power_w: Array
) -> Array:
    """How much earlier than its peak an echo is thought to have crossed (negative), to be taken off."""
    if sensor.tdc.walk == "raw":
        return 0.0
    fwhm = sensor.laser.pulse_fwhm_s
    power = true_power_w if sensor.tdc.walk == "none" else point.power_w(measured)
    return pulse_shape.leading_edge_time_s(level=point.power_w(threshold) / power, fwhm_s=fwhm)


def _converted(ops: Any, sensor: Sensor, time_s: Array, *, seed: Array, pulse: Array) -> Array:
    """The converter's own jitter and step; no time before the pulse."""
    jitter, _ = noise.normal_pair(noise.words(seed=seed, stage=noise.STAGE_TDC_JITTER, pulse=pulse))
    jittered = ops.maximum(time_s + sensor.tdc.jitter_s * jitter, 0.0)
    return tdc.quantised(time_s=jittered, least_significant_bit_s=sensor.tdc.least_significant_bit_s)


def _false_alarms(
    sensor: Sensor,
    point: WorkingPoint,
    threshold: Array,
    others: tuple[interference.Crossings, ...],
    *,
    seed: Array,
    pulse: Array,
) -> list[tuple[Array, Array, Array]]:
    """Time, amplitude and status of the first crossings without an echo of ours, one for every stop, in order.

    Noise crossings are a Poisson process whose rate leaves M comparisons quiet with (1 - P_f)^M. Where none can
    come the time is far beyond any window.
    """
    ops = xp(threshold)
    p_false = point.false_alarm_probability(threshold)
    noise_rate = tdc.false_alarm_rate_hz(p_false=p_false, bandwidth_hz=sensor.tdc.bandwidth_hz)
    rate = sum((one.rate_hz for one in others), noise_rate)
    never = rate <= 0.0
    arrivals = []
    elapsed: Array = 0.0
    for draw in range(sensor.tdc.stops):
        first, second = noise.words(seed=seed, stage=noise.STAGE_FALSE_ALARM, pulse=pulse, draw=2 * draw)
        wait = noise.exponential((first, second))
        elapsed = elapsed + wait
        height = noise.exponential(
            noise.words(seed=seed, stage=noise.STAGE_FALSE_ALARM, pulse=pulse, draw=2 * draw + 1)
        )
        # Far out, a Gaussian tail falls like exp(-U x / sigma_0^2): the excess over U is exponential.
        amplitude = threshold + height * point.noise * point.noise / threshold
        status: Array = int(Status.FALSE_ALARM)
        if others:
            theirs, amplitude = interference.assigned(
                others, point, noise_rate_hz=noise_rate, noise_amplitude=amplitude, threshold=threshold,
                seed=seed, pulse=pulse, draw=draw,
            )  # fmt: skip
            status = ops.where(theirs, int(Status.INTERFERENCE), status)
        time_s = ops.where(never, 1.0, elapsed / ops.where(never, 1.0, rate))
        arrivals.append((ops.minimum(time_s, 1.0), amplitude, status))
    return arrivals


def _nth(ops: Any, alarms: list[tuple[Array, Array, Array]], index: Array) -> tuple[Array, Array, Array]:
    """The index-th alarm of each pulse (index differs by pulse)."""
    time_s, amplitude, status = alarms[0]
    for number, (later_s, later_amplitude, later_status) in enumerate(alarms[1:], start=1):
        chosen = index >= number
        time_s = ops.where(chosen, later_s, time_s)
        amplitude = ops.where(chosen, later_amplitude, amplitude)
        status = ops.where(chosen, later_status, status)
    return time_s, amplitude, status


def _as_int(ops: Any, flag: Array) -> Array:
    return ops.where(flag, 1, 0)


def _range(ops: Any, sensor: Sensor, time_s: Array) -> Array:
    return radiometry.range_from_time_of_flight_m(time_of_flight_s=time_s)
