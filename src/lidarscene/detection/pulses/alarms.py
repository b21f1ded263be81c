"""Alarms: false alarms compete with echoes for the stops of the converter."""

from __future__ import annotations

from dataclasses import dataclass

from ...light.echoes import Interference
from ...maths.arrays import Array, Lanes, Mask
from .. import comparator
from ..returns import alarm_status, interferes
from ..shots import Received
from . import stops as stop_list
from .stops import Stop, Stops


@dataclass(frozen=True, slots=True, kw_only=True)
class _NextAlarm:
    """The next false alarm of each pulse; each field (n,).

    number     number of alarms drawn, this one included
    elapsed    progress of the Poisson process at this alarm
    time_s     crossing time
    amplitude  peak, in signal units
    status     `Status.FALSE_ALARM` or `Status.INTERFERENCE`
    """

    number: Lanes
    elapsed: Lanes
    time_s: Lanes
    amplitude: Lanes
    status: Lanes


def add_alarms(
    shots: Received, stops: Stops, sources: tuple[Interference, ...], number: Array, range_m: Lanes
) -> Stops:
    """Add the false alarms to the stops.

    number, range_m  (n,) source and true range that an alarm gets: those of the pulse's strongest sub-echo
    """
    for alarms in comparator.false_alarms(shots, sources):
        stops = _merge_alarms(shots, stops, alarms, number, range_m, may_interfere=bool(sources))
    return stops


def _merge_alarms(
    shots: Received, stops: Stops, alarms: comparator.Alarms, number: Array, range_m: Lanes, *, may_interfere: bool
) -> Stops:
    """Add the alarms of one generator to the stops.

    may_interfere  whether some alarms may be of other lidars
    """
    ops, tdc = shots.ops, shots.sensor.tdc
    zero, kind = ops.full(shots.wave.origin_m, 0.0), ops.full(number, 0)

    # Alarms come in the order in which the converter prefers them, and at most as many as it has stops can be kept.
    # The first is drawn before the loop: most pulses have none in the window and never enter it.
    def draw_next(draw: Lanes, elapsed: Lanes) -> _NextAlarm:
        elapsed, alarm = alarms(ops.uint32(draw), elapsed)
        return _NextAlarm(
            number=draw + 1,
            elapsed=elapsed,
            time_s=alarm.time_s,
            amplitude=alarm.amplitude,
            status=kind + alarm_status(alarm.interfering),
        )

    def active(loop_state: tuple[_NextAlarm, Stops]) -> Mask:
        return (loop_state[0].time_s < tdc.window_s) & (loop_state[0].number <= stop_list.most_alarms(tdc))

    def step(loop_state: tuple[_NextAlarm, Stops]) -> tuple[_NextAlarm, Stops]:
        next_alarm, stops = loop_state
        width_s: Lanes = zero
        interfering = interferes(next_alarm.status) if may_interfere else None
        if shots.sensor.measures_width:
            width_s = comparator.alarm_width_s(shots, next_alarm.amplitude, interfering=interfering)
        stop = Stop(
            key=stop_list.sort_key(tdc, next_alarm.time_s, next_alarm.amplitude),
            crossing_s=next_alarm.time_s,
            reported_s=next_alarm.time_s,
            amplitude=next_alarm.amplitude,
            width_s=width_s,
            snr=zero,
            probability=zero,
            source=number,
            true_range_m=range_m,
            status=next_alarm.status,
        )
        return draw_next(next_alarm.number, next_alarm.elapsed), stop_list.insert_stop(tdc, stops, stop)

    return ops.loop((draw_next(kind, ops.float32(zero)), stops), active, step)[1]
