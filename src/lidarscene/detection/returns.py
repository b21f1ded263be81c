"""Returns: detection, time and false alarms of pulses with one echo each.

A single Gaussian echo has a closed form: its peak, its crossing time and its measured amplitude need no search. This
module holds that case; `multi_echo` handles several sub-echoes, and agrees with this one pulse by pulse where there is
one (docs/theory.md 7 to 9).

Symbols: P_d probability of a detection, s signal at the peak, t time of flight.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..light.echoes import Echoes
from ..maths.arrays import Array, Lanes, Mask, select_state, xp
from ..maths.random import Seed
from ..physics.optics import pulse as pulse_shape
from ..physics.optics import radiometry
from ..sensor.sensor_model import Sensor
from . import ambient, comparator
from .outcomes import Outcome, Status
from .pulses import timing
from .reported_intensity import reported_intensity
from .shots import Shots


@dataclass(frozen=True, slots=True, kw_only=True)
class Returns:
    """Returns that one stop of the converter reports for n pulses; NumPy or Dr.Jit.

    reported   (n,) bool, whether this stop was used
    status     (n,) int32, a `Status`
    range_m    (n,) c t / 2 of the reported time
    amplitude  (n,) peak at the comparator, in amperes (APD) or cells (SiPM)
    intensity  (n,) on the maker's scale, `detection.reported_intensity.reported_intensity`
    width_s    (n,) time over the threshold; None: the sensor does not measure it

    The following belong to this return alone. They are None if pulses have one echo: the `Detection` has them then.

    snr, detection_probability  (n,) as in `Detection`; 0 for a false alarm
    source                      (n,) number of the sub-echo that caused the return, -1 for the even light of the air;
                                for a false alarm, the pulse's strongest sub-echo
    true_range_m                (n,) mean range of the sub-echoes, weighted by their power at the peak; the range of the
                                air if its light tripped the comparator
    """

    reported: Mask
    status: Lanes
    range_m: Lanes
    amplitude: Lanes
    intensity: Lanes
    width_s: Lanes | None = None
    photons: Lanes | None = None
    snr: Lanes | None = None
    detection_probability: Lanes | None = None
    source: Lanes | None = None
    true_range_m: Lanes | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Detection:
    """Result of the electronics for n pulses; NumPy or Dr.Jit.

    snr                    (n,) peak signal over the noise without an echo, (19) or (27); of the highest peak; 0 without
                           an echo
    detection_probability  (n,) P_d, that this echo trips the comparator; of the highest peak; 0 without an echo
    outcome                (n,) int32, an `Outcome`
    ambient                (n,) background counts, `detection.ambient.counts`
    stops                  one `Returns` for each stop, first crossing first
    source                 (n,) number of the strongest sub-echo of a surface; None: there is only one
    """

    snr: Array
    detection_probability: Array
    outcome: Array
    ambient: Lanes
    stops: tuple[Returns, ...]
    source: Lanes | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Edge:
    """Echo behind the comparator; each field (n,).

    tripped     whether it trips the comparator
    crossing_s  time at which it trips it
    reported_s  time that the converter reports
    amplitude   measured peak, in signal units
    width_s     time over the threshold; None: not measured
    probability P_d, theory (T22) or (T23)
    expected    peak signal of its mean power
    """

    tripped: Mask
    crossing_s: Lanes
    reported_s: Lanes
    amplitude: Lanes
    width_s: Lanes | None
    probability: Lanes
    expected: Lanes


@dataclass(frozen=True, slots=True, kw_only=True)
class _Alarm:
    """A false alarm as a stop reports it, each field (n,); ``status`` is that of noise or of another lidar."""

    time_s: Lanes
    amplitude: Lanes
    status: Lanes


def detect(echoes: Echoes, sensor: Sensor, *, seed: Seed, pulse: Array) -> Detection:
    """Detect pulses with one echo each: one `Returns` for each stop (docs/theory.md 7 to 9).

    seed   32-bit frame seed; every random number is keyed by (seed, stage, pulse)
    pulse  (n,) uint32 pulse numbers
    """
    ops = xp(echoes.range_m)
    point = sensor.working_point(echoes.background_power_w)
    shots = Shots(
        sensor=sensor,
        point=point,
        threshold=sensor.threshold(point),
        seed=seed,
        pulse=pulse,
        fluctuation=echoes.fluctuation,
    )
    edge = _edge(shots, echoes)
    in_window = edge.tripped & comparator.accepts_crossing(sensor, edge.crossing_s)
    in_window = in_window & comparator.is_range(edge.reported_s)
    alarms = [
        _Alarm(time_s=alarm.time_s, amplitude=alarm.amplitude, status=alarm_status(alarm.interfering))
        for generator in comparator.false_alarms(shots, echoes.interference)
        for alarm in comparator.first_alarms(generator, sensor.tdc.stops)
    ]

    echo_left = in_window
    # Merge the alarms, which come in order of time, and the one echo: each stop takes the earliest that is left. The
    # echo can be at another place among the alarms in every pulse, so the choice is made lane by lane.
    stops = []
    for stop in range(sensor.tdc.stops):
        # Alarms reported so far: all earlier stops, but for the one that holds the echo.
        alarms_used = stop - ops.where(in_window & ~echo_left, 1, 0)
        next_alarm = _nth_alarm(alarms, alarms_used)
        alarm = next_alarm.time_s < sensor.tdc.window_s
        echo_now = echo_left & ~(alarm & (next_alarm.time_s < edge.crossing_s))
        echo_left = echo_left & ~echo_now
        reported_s = ops.where(echo_now, edge.reported_s, next_alarm.time_s)
        range_m = radiometry.range_from_time_of_flight_m(time_of_flight_s=reported_s)
        amplitude = ops.where(echo_now, edge.amplitude, next_alarm.amplitude)
        width_s = None
        if edge.width_s is not None:
            interfering = interferes(next_alarm.status) if echoes.interference else None
            alarm_width_s = comparator.alarm_width_s(shots, next_alarm.amplitude, interfering=interfering)
            width_s = ops.where(echo_now, edge.width_s, alarm_width_s)
        stops.append(
            Returns(
                reported=echo_now | alarm,
                status=ops.where(echo_now, int(Status.ECHO), next_alarm.status),
                range_m=range_m,
                amplitude=amplitude,
                intensity=reported_intensity(shots, echoes, amplitude=amplitude, width_s=width_s, range_m=range_m),
                width_s=width_s,
            )
        )
    outcome = ops.where(echo_left, int(Outcome.HIDDEN), int(Outcome.KEPT))
    outcome = ops.where(in_window, outcome, int(Outcome.OUT_OF_WINDOW))
    outcome = ops.where(edge.tripped, outcome, int(Outcome.BELOW_THRESHOLD))
    outcome = ops.where(echoes.has_surface, outcome, int(Outcome.NO_SURFACE))
    quiet = point.noise.deviation <= 0.0
    return Detection(
        snr=ops.where(echoes.has_surface, edge.expected / ops.where(quiet, 1e-30, point.noise.deviation), 0.0),
        detection_probability=ops.where(echoes.has_surface, edge.probability, 0.0),
        outcome=outcome,
        ambient=ambient.counts(echoes.background_power_w, sensor, seed=seed, pulse=pulse),
        stops=tuple(stops),
    )


def _edge(shots: Shots, echoes: Echoes) -> _Edge:
    """Compute the edge of a single Gaussian echo in closed form; theory (T24) to (T26)."""
    ops, sensor = xp(echoes.range_m), shots.sensor
    fwhm = sensor.received_fwhm_s
    trip = comparator.trip(shots, echoes.peak_power_w)
    tripped = echoes.has_surface & trip.tripped
    power = ops.where(tripped, echoes.peak_power_w, 1.0)
    arrival = radiometry.time_of_flight_s(range_m=echoes.range_m)
    # With counted cells P_d is not Gaussian, so an echo may trip although its peak is below the level: at the peak
    # then.
    share = ops.where(tripped & (trip.level < trip.signal), shots.point.response.power_w(trip.level) / power, 1.0)
    early = pulse_shape.leading_edge_time_s(level=share, fwhm_s=fwhm)
    crossing = arrival + early + comparator.count_lag_s(shots, trip, share=share, peak_power_w=power)
    measured = timing.amplitude(shots, trip, lag_s=early)
    width_s = None
    if sensor.tdc.both_edges:
        width_s = comparator.width_s(shots, trip, peak_power_w=power, early_s=early)
    return _Edge(
        tripped=tripped,
        crossing_s=crossing,
        reported_s=timing.lone_pulse_time_s(
            shots, trip, arrival_s=arrival, crossing_s=crossing, measured=measured, power_w=power, width_s=width_s
        ),
        amplitude=measured,
        width_s=width_s,
        probability=trip.probability,
        expected=trip.expected,
    )


def alarm_status(interfering: Mask | None) -> Lanes:
    """`Status` of a false alarm, (n,).

    interfering  (n,) bool, whether it is another lidar's pulse; None without other lidars
    """
    if interfering is None:
        return int(Status.FALSE_ALARM)
    return xp(interfering).where(interfering, int(Status.INTERFERENCE), int(Status.FALSE_ALARM))


def interferes(status: Lanes) -> Mask:
    """True where a false alarm of this `Status` is another lidar's pulse, (n,) bool."""
    return status == int(Status.INTERFERENCE)


def _nth_alarm(alarms: list[_Alarm], index: Array) -> _Alarm:
    """Alarm number ``index`` of each pulse; the index (n,) differs from pulse to pulse."""
    alarm = alarms[0]
    for number, candidate in enumerate(alarms[1:], start=1):
        alarm = select_state(index >= number, candidate, alarm)
    return alarm
