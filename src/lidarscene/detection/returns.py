"""Returns: Echoes in, what the comparator and the TDC report out (PHYSICS.md section 5)."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Any

from ..light.echoes import Echoes
from ..maths.arrays import Array, xp
from ..physics.optics import pulse as pulse_shape
from ..physics.optics import radiometry
from ..sensor.detectors import WorkingPoint
from ..sensor.model import Sensor
from . import ambient, comparator, intensity


class Status(enum.IntEnum):
    """What a point is."""

    ECHO = 0
    FALSE_ALARM = 1
    INTERFERENCE = 2  # another lidar's pulse
    WEATHER = 3  # light from fog, rain or snow


class Outcome(enum.IntEnum):
    """What became of a pulse's echo."""

    KEPT = 0
    NO_SURFACE = 1  # the ray left the scene
    BELOW_THRESHOLD = 2  # light may have come back, the comparator did not trip
    OUT_OF_WINDOW = 3  # the echo came while the converter did not listen: too early or too late
    HIDDEN = 4  # false alarms had used up the converter's stops


OUTCOME_TEXT = {
    Outcome.NO_SURFACE: "no surface",
    Outcome.BELOW_THRESHOLD: "below threshold",
    Outcome.OUT_OF_WINDOW: "out of window",
    Outcome.HIDDEN: "hidden",
}
"""Why there is no echo point, in words."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Returns:
    """What one stop of the converter reports for each pulse; numpy or Dr.Jit.

    reported   (n,) bool, whether this stop was used
    status     (n,) int32, a `Status`
    range_m    (n,) c t / 2 of the reported time
    amplitude  (n,) peak at the comparator, in amperes (APD) or cells (SiPM)
    intensity  (n,) on the maker's scale, `detection.intensity.reported`
    width_s    (n,) time over the threshold, or None: the sensor does not measure it

    Of this return alone; None where one echo stands for the pulse and the `Detection` has them:

    snr, detection_probability  (n,) as there; 0 for a false alarm
    source                      (n,) number of the sub-echo that makes it, -1: the air; the pulse's strongest for a
                                false alarm
    true_range_m                (n,) mean of its sub-echoes' ranges by their power at the peak; of the air where its
                                light tripped the comparator
    """

    reported: Array
    status: Array
    range_m: Array
    amplitude: Array
    intensity: Array
    width_s: Array | None = None
    snr: Array | None = None
    detection_probability: Array | None = None
    source: Array | None = None
    true_range_m: Array | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Detection:
    """The electronics' view of each pulse; numpy or Dr.Jit.

    snr                    (n,) (19) or (27): peak signal over the noise without echo; 0 without an echo
    detection_probability  (n,) that this echo trips the comparator; 0 without an echo
                           Of several echoes the strongest counts.
    outcome                (n,) int32, an `Outcome`
    ambient                (n,) background counts, `detection.ambient.counts`
    stops                  one `Returns` for each stop, first crossing first
    source                 (n,) number of the strongest sub-echo of a surface, or None: there is only one
    """

    snr: Array
    detection_probability: Array
    outcome: Array
    ambient: Array
    stops: tuple[Returns, ...]
    source: Array | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Edge:
    """The echo at the comparator: whether it trips, when, and how high it looks."""

    found: Array
    crossing_s: Array
    reported_s: Array
    amplitude: Array
    width_s: Array | None
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
    in_window = edge.found & comparator.listening(sensor, edge.crossing_s)
    arriving = comparator.false_alarms(sensor, point, threshold, echoes.interference, seed=seed, pulse=pulse)
    alarms = [
        (time_s, height, alarm_status(theirs))
        for kind in arriving
        for time_s, height, theirs in comparator.first_of(kind, sensor.tdc.stops)
    ]

    echo_left = in_window
    stops = []
    for stop in range(sensor.tdc.stops):
        # Alarms come in order, so this stop holds the echo if it is still unreported and comes next.
        used = stop - _as_int(ops, in_window & ~echo_left)
        alarm_s, alarm_amplitude, status = _nth(ops, alarms, used)
        alarm = alarm_s < sensor.tdc.window_s
        echo_now = echo_left & ~(alarm & (alarm_s < edge.crossing_s))
        echo_left = echo_left & ~echo_now
        reported_s = ops.where(echo_now, edge.reported_s, alarm_s)
        range_m = radiometry.range_from_time_of_flight_m(time_of_flight_s=reported_s)
        amplitude = ops.where(echo_now, edge.amplitude, alarm_amplitude)
        width_s = None
        if edge.width_s is not None:
            width_s = comparator.alarm_width_s(
                sensor, point, threshold, alarm_amplitude, theirs=interferes(status)
            )
            width_s = ops.where(echo_now, edge.width_s, width_s)
        stops.append(
            Returns(
                reported=echo_now | alarm,
                status=ops.where(echo_now, int(Status.ECHO), status),
                range_m=range_m,
                amplitude=amplitude,
                intensity=intensity.reported(
                    echoes, sensor, point, threshold, amplitude=amplitude, width_s=width_s, range_m=range_m
                ),
                width_s=width_s,
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
    """The edge of a lone Gaussian pulse, in closed form."""
    ops = xp(echoes.range_m)
    fwhm = sensor.laser.pulse_fwhm_s
    own = comparator.trip(point, threshold, echoes.peak_power_w, seed=seed, pulse=pulse)
    found = echoes.found & own.tripped
    power = ops.where(found, echoes.peak_power_w, 1.0)
    arrival = radiometry.time_of_flight_s(range_m=echoes.range_m)
    # Counted cells may trip the comparator where the Gaussian edge stays below it: then at the peak.
    share = ops.where(found & (own.level < own.signal), point.power_w(own.level) / power, 1.0)
    early = pulse_shape.leading_edge_time_s(level=share, fwhm_s=fwhm)
    crossing = arrival + early
    measured = comparator.amplitude(own, sensor, point, threshold, lag_s=early)
    width_s = None
    if sensor.tdc.both_edges:
        width_s = comparator.width_s(
            own, sensor, point, threshold, peak_power_w=power, early_s=early, seed=seed, pulse=pulse
        )
    return _Edge(
        found=found,
        crossing_s=crossing,
        reported_s=comparator.reported_s(
            sensor,
            point,
            threshold,
            crossing,
            measured=measured,
            width_s=width_s,
            true_power_w=power,
            seed=seed,
            pulse=pulse,
        ),
        amplitude=measured,
        width_s=width_s,
        probability=own.probability,
    )


def alarm_status(theirs: Array) -> Array:
    """Noise, or another lidar's pulse; ``theirs`` is False where there is no other lidar."""
    if theirs is False:
        return int(Status.FALSE_ALARM)
    return xp(theirs).where(theirs, int(Status.INTERFERENCE), int(Status.FALSE_ALARM))


def interferes(status: Array) -> Array:
    """Whether a false alarm is another lidar's pulse; False where there is no other lidar."""
    return False if isinstance(status, int) else status == int(Status.INTERFERENCE)


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
