"""Multi-echo: finder for pulses with several sub-echoes, at a comparator and TDC.

The sub-echoes of a pulse overlap and add up to a waveform. The comparator sees its rises: from a valley to a peak. Each
rise has its own deviate, as the echo has in `single_echo`, and the same formulas hold for it. The waveform is not
sampled: `rises` walks from peak to peak, and crossings are roots of the waveform (docs/theory_light.md 5).

Symbols: P power over time, z deviate of a rise, P_d probability that it trips, sigma_p width of the laser pulse.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from ..light.echoes import EchoTrain
from ..light.waveform import waveform
from ..maths.arrays import Array, Lanes, Mask, select_state
from ..maths.random import Seed
from ..physics.electronics import tdc as tdc_formulas
from ..physics.electronics.pulse_sums import Shape, crossing
from ..sensor.electronics import MultiLevel
from ..sensor.sensor_model import Sensor
from . import comparator
from . import stops as stop_list
from .outcomes import Status
from .pulses import crossing_sources, echo_memory, timing
from .rises import Rise, visit_all
from .samplers import read
from .shots import Received
from .sources import strongest
from .stops import EMPTY, Found, Stop, Stops


@dataclass(frozen=True, slots=True, kw_only=True)
class _Pulse:
    """Last peak of a peak-finding receiver, until later light shows that it is a pulse of its own; each field (n,).

    Attributes:
        stop: return that the peak would give
        peak: place of its peak
        top: signal there
        height: signal there with the noise by which it is compared with others
        lowest: lowest signal since
    """

    stop: Stop
    peak: Lanes
    top: Lanes
    height: Lanes
    lowest: Lanes


@dataclass(frozen=True, slots=True, kw_only=True)
class _RiseSearch:
    """State of the search over the rises of each pulse; each field (n,).

    Attributes:
        high: whether the rise before tripped the comparator
        tripped: whether any rise has tripped it
        in_window: whether the converter has taken any crossing
        last: place of the last crossing that it took
        highest: place of the highest peak
        highest_w: power there, behind a matched filter if the receiver has one
        stops: crossings that the converter keeps so far, best first
        pulse: the last peak, which is not yet among the stops; None of a receiver that times edges
        memory: earlier echoes, as far as the detector remembers them
        at_highest: what earlier echoes leave at the highest peak; None: nothing
    """

    high: Mask
    tripped: Mask
    in_window: Mask
    last: Lanes
    highest: Lanes
    highest_w: Lanes
    stops: Stops
    pulse: _Pulse | None
    memory: echo_memory.Memory
    at_highest: echo_memory.Residue | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Rises(Received):
    """Comparator and TDC at work on the waveforms of some pulses: each rise may be a return.

    Attributes:
        surfaces: number of sub-echoes that are of surfaces; they come before those of the air
        stray: whether the last sub-echo is stray light of other channels
    """

    surfaces: int
    stray: bool

    @classmethod
    def of(cls, train: EchoTrain, sensor: Sensor, *, seed: Seed, pulse: Array) -> Rises:
        """Prepare the search; arguments as of `receiver.detect`."""
        point = sensor.working_point(train.background_power_w)
        return cls(
            sensor=sensor,
            point=point,
            threshold=sensor.threshold(point),
            wave=waveform(train, sensor),
            seed=seed,
            pulse=pulse,
            surfaces=train.surfaces,
            stray=train.stray,
            fluctuation=train.fluctuation,
        )

    def search(self) -> Found:
        """Visit all rises and keep the best crossings of each pulse."""
        state = self._visit_all()
        number, range_m = strongest(self.wave, self.surfaces)
        ops, lit = self.ops, state.highest_w > 0.0
        point = self.point if state.at_highest is None else state.at_highest.working_point(self.point)
        power, _, bend = self._at_highest(state)
        curved = timing.curvature_of(self, power, bend, mask=lit)
        height_w = ops.where(lit, power, 0.0) * self.sensor.height_gain(curved)
        signal, probability = comparator.expectation(replace(self, point=point), height_w, curvature=curved)
        return Found(
            stops=tuple(self._with_status(stop) for stop in state.stops),
            tripped=state.tripped,
            in_window=state.in_window,
            snr=ops.where(lit, self.point.snr(signal), 0.0),
            detection_probability=ops.where(lit, probability, 0.0),
            source=number,
            true_range_m=range_m,
        )

    def _at_highest(self, state: _RiseSearch) -> Shape:
        """Power at the highest peak, and its first and second derivative, which the search passes no derivatives of.

        They follow from the waveform once more. The power does not change with the place of the peak, where P' is 0,
        but the second derivative does. A step of Newton's, u - P' / P'', leaves the place as it is, and its derivative
        by any number p is that of the root, -P'_p / P''.
        """
        ops, shape = self.ops, self.wave.at(state.highest)
        if not self.sensor.matches and self.sensor.tdc.chatter_hz is None:
            return shape  # nothing depends on how the peak bends
        _, slope, bend = shape
        bends = bend < 0.0
        return self.wave.at(state.highest - ops.where(bends, slope / ops.where(bends, bend, -1.0), 0.0))

    def _with_status(self, stop: Stop) -> Stop:
        """Status of a return by the light that caused it."""
        ops = self.ops
        assert stop.source is not None
        is_weather = (stop.source < 0) | (stop.source >= self.surfaces)
        status = ops.where(is_weather, int(Status.WEATHER), int(Status.ECHO))
        if self.stray:
            status = ops.where(stop.source == len(self.wave.centres) - 1, int(Status.STRAY), status)
        return replace(stop, status=status)

    def _visit_all(self) -> _RiseSearch:
        """Visit all rises in order of time."""
        ops, like, tdc = self.ops, self.wave.origin_m, self.sensor.tdc
        zero, never, earliest = ops.full(like, 0.0), ops.full(like, False), ops.full(like, EMPTY)
        peaks = self.sensor.finds_peaks
        # What caused a return is told by its source, after the search.
        empty = Stop(
            status=None,
            key=earliest,
            crossing_s=zero,
            reported_s=zero,
            amplitude=zero,
            width_s=zero if self.sensor.measures_width else None,
            snr=zero,
            detection_probability=zero,
            source=ops.full(like, 0),
            true_range_m=zero,
        )
        start = _RiseSearch(
            high=never,
            tripped=never,
            in_window=never,
            last=earliest,
            highest=zero,
            highest_w=zero,
            stops=stop_list.empty_stops(tdc, empty),
            pulse=_Pulse(stop=empty, peak=earliest, top=zero, height=zero, lowest=zero) if peaks else None,
            memory=(memory := echo_memory.empty_memory(self)),
            at_highest=echo_memory.Residue(floor=zero, held=zero, share=zero + 1.0) if memory else None,
        )
        state = visit_all(self.wave, self._visit_peak if peaks else self._visit_edge, start)
        if state.pulse is None:
            return state
        return replace(state, stops=stop_list.insert_stop(tdc, state.stops, state.pulse.stop, later=True))

    def _visit_edge(self, rise: Rise, state: _RiseSearch) -> _RiseSearch:
        """Draw the noise of one rise; keep its crossing if the converter accepts it and it is among the best."""
        ops, tdc = self.ops, self.sensor.tdc
        peak_w = ops.where(rise.exists, rise.top[0], 0.0)
        residue = echo_memory.find_residue(self, rise, state.memory)
        converter = self if residue is None else replace(self, point=residue.working_point(self.point))
        trip = comparator.trip(converter, peak_w, draw=rise.number, curvature=timing.curvature(self, rise))
        # A comparator makes an edge only if it was low. After a rise that tripped it, it falls in the valley if the
        # signal there is below the level, which includes this rise's own noise. Else both rises are one long pulse.
        valley = self.point.response.signal(rise.valley_w)
        in_valley = (valley if residue is None else ops.maximum(valley, residue.floor)) >= trip.level
        edge = rise.exists & trip.tripped & ~(state.high & in_valley)
        place = converter._crossing(rise, trip, edge, in_valley)
        trip = converter._with_lag(rise, trip)
        crossing_s = self.time_s(place) + trip.count_lag_s
        # The dead time counts from the last crossing that was taken, not from every crossing.
        ready = (place - state.last) * self.sigma_s >= tdc.dead_time_s
        accepted = edge & comparator.accepts_crossing(self.sensor, crossing_s) & ready
        # Sampling a pulse is the expensive part: only lanes whose crossing may be kept go through it.
        measured = accepted & stop_list.may_keep(tdc, crossing_s, state.stops)
        new_stop = converter._stop(rise, trip, measured, place, in_valley, crossing_s)
        accepted = accepted & (new_stop.occupied | ~measured)
        return self._advance(
            state,
            rise,
            trip,
            residue,
            tripped=state.tripped | edge,
            in_window=state.in_window | accepted,
            high=ops.where(rise.exists, trip.tripped, state.high),
            last=ops.where(accepted, place, state.last),
            stops=stop_list.insert_stop(tdc, state.stops, new_stop, later=True),
            pulse=None,
        )

    def _visit_peak(self, rise: Rise, state: _RiseSearch) -> _RiseSearch:
        """Draw the noise of one rise, and decide whether it is a pulse of its own or part of the last one.

        It is one of its own if the light has fallen below the threshold since the last pulse, or by a threshold and
        risen by one. Else the higher of both stands for them, as it does where they follow each other within a dead
        time.
        """
        ops, tdc, last_pulse = self.ops, self.sensor.tdc, state.pulse
        assert last_pulse is not None
        peak_w = ops.where(rise.exists, rise.top[0], 0.0)
        residue = echo_memory.find_residue(self, rise, state.memory)
        converter = self if residue is None else replace(self, point=residue.working_point(self.point))
        curved = timing.curvature(self, rise)
        gain = self.sensor.height_gain(curved)
        valley = self.point.response.signal(self.sensor.lasting_gain * rise.valley_w)
        if residue is not None:
            valley = ops.maximum(valley, residue.floor)
        lowest = ops.minimum(last_pulse.lowest, valley)
        trip_level = comparator.level(self, draw=rise.number)
        # After a pulse a rise counts from the lowest light since, where that is above the level: fog, which holds the
        # signal high for many metres, does not hide what rises out of it.
        held = state.high & (lowest >= trip_level)
        base = ops.where(held, self._base_signal(lowest), 0.0)
        trip = comparator.trip(converter, gain * peak_w, draw=rise.number, base=base, curvature=curved)
        tripped = rise.exists & trip.tripped
        in_valley = valley >= trip.level
        place = converter._crossing(rise, trip, tripped, in_valley, gain)
        # What does not trip above other light is part of a pulse that does not stand on it.
        trip = replace(converter._with_lag(rise, trip), base=ops.where(tripped, base, 0.0))
        crossing_s = self.time_s(place) + trip.count_lag_s
        separate = (rise.peak - last_pulse.peak) * self.sigma_s >= tdc.dead_time_s
        separate = separate & (~held | (last_pulse.top >= self.threshold + base))
        fresh = tripped & separate
        # Of an edge that was blanked there is nothing to raise.
        joins = tripped | (held & last_pulse.stop.occupied if self.sensor.times_edge else held)
        accepted = (fresh | (rise.exists & ~separate & joins)) & comparator.accepts_crossing(self.sensor, crossing_s)
        measured = accepted & stop_list.may_keep(tdc, crossing_s, state.stops)
        new_stop = converter._stop(rise, trip, measured, place, in_valley, crossing_s)
        # Of two peaks that are one pulse the higher counts. Noise chooses between like ones, unless they share it.
        height, lag_s = self._compared(trip, new_stop, measured), (rise.peak - last_pulse.peak) * self.sigma_s
        apart = tdc_formulas.noise_change(lag_s=lag_s, crossing_bandwidth_hz=self.sensor.crossing_bandwidth_hz)
        higher = apart * (height - last_pulse.height) + (1.0 - apart) * (trip.signal - last_pulse.top) > 0.0
        accepted = accepted & (fresh | higher) & (new_stop.occupied | ~measured)
        finished = replace(last_pulse.stop, key=ops.where(accepted & separate, last_pulse.stop.key, EMPTY))
        stop = new_stop
        if self.sensor.times_edge:
            # The edge of a pulse stays where it was, if what comes later only raises it.
            same_edge = replace(
                last_pulse.stop,
                key=stop_list.sort_key(tdc, last_pulse.stop.time_s, new_stop.amplitude),
                amplitude=new_stop.amplitude,
                snr=new_stop.snr,
                detection_probability=new_stop.detection_probability,
            )
            stop = select_state(tripped, new_stop, same_edge)
        pulse = _Pulse(
            stop=select_state(accepted, stop, last_pulse.stop),
            peak=ops.where(accepted, rise.peak, last_pulse.peak),
            top=ops.where(accepted, trip.signal, last_pulse.top),
            height=ops.where(accepted, height, last_pulse.height),
            # Light of a pulse that is not taken, as in the blanking, holds later light up as well.
            lowest=ops.where(accepted | fresh, trip.signal, ops.where(rise.exists, lowest, last_pulse.lowest)),
        )
        return self._advance(
            state,
            rise,
            trip,
            residue,
            tripped=state.tripped | tripped,
            in_window=state.in_window | accepted,
            high=ops.where(rise.exists, tripped | held, state.high),
            last=state.last,
            stops=stop_list.insert_stop(tdc, state.stops, finished, later=True),
            pulse=pulse,
        )

    def _compared(self, trip: comparator.Trip, stop: Stop, measured: Mask) -> Lanes:
        """Height by which a peak is compared with others of its dead time, (n,): the measured one.

        Those of several levels are steps, and on lasting light only bounds: there the noise of the edge stands for it.
        """
        if isinstance(self.sensor.sampler, MultiLevel):
            return trip.signal + trip.deviate * trip.sigma
        return self.ops.where(measured, stop.amplitude, trip.signal)

    def _base_signal(self, lowest: Lanes) -> Lanes:
        """Signal from which the threshold counts for a pulse on top of other light, (n,).

        Args:
            lowest: (n,) lowest signal of that light since the last pulse
        """
        sampler = self.sensor.sampler
        if not isinstance(sampler, MultiLevel):
            return lowest
        # Fixed levels make an edge only if one of them is above that light.
        base: Lanes = self.ops.full(lowest, -EMPTY)
        for factor in reversed(sampler.levels):
            candidate = (factor - 1.0) * self.threshold
            base = self.ops.where(candidate + self.threshold > lowest, candidate, base)
        return base

    def _advance(
        self, state: _RiseSearch, rise: Rise, trip: comparator.Trip, residue: echo_memory.Residue | None, **changed: Any
    ) -> _RiseSearch:
        """State after a rise: the fields that both kinds of receiver update, and those that one of them ``changed``."""
        ops = self.ops
        gain = self.sensor.height_gain(timing.curvature(self, rise))
        peak_w = ops.where(rise.exists, gain * rise.top[0], 0.0)
        higher = peak_w > state.highest_w
        return _RiseSearch(
            highest=ops.where(higher, rise.peak, state.highest),
            highest_w=ops.maximum(state.highest_w, peak_w),
            memory=echo_memory.update_memory(self, rise, trip.signal, residue, state.memory),
            at_highest=None if residue is None else select_state(higher, residue, state.at_highest),
            **changed,
        )

    def _crossing(self, rise: Rise, trip: comparator.Trip, edge: Mask, in_valley: Mask, gain: Lanes = 1.0) -> Lanes:
        """Place at which a rise trips the comparator, (n,): where the waveform reaches the level.

        If the valley is above the level, it is the valley. If the peak is below it, as counted cells allow, it is the
        peak.

        Args:
            gain: (n,) gain of a matched filter
        """
        ops = self.ops
        reaches = edge & ~in_valley & (trip.level < trip.signal)
        level_w = ops.where(reaches, self.point.response.power_w(trip.level) / gain, 1.0)
        place = crossing(self.wave.at, level_w, far=rise.valley, peak=rise.peak, top=rise.top, mask=reaches)
        return ops.where(reaches, place, ops.where(in_valley, rise.valley, rise.peak))

    def _with_lag(self, rise: Rise, trip: comparator.Trip) -> comparator.Trip:
        """Add the time by which a SiPM's count lags behind the light."""
        ops = self.ops
        reaches = rise.exists & trip.tripped & (trip.level < trip.signal)
        peak_w = ops.where(reaches, rise.top[0], 1.0)
        share = ops.where(reaches, self.point.response.power_w(trip.level) / peak_w, 1.0)
        return replace(trip, count_lag_s=comparator.count_lag_s(self, trip, share=share, peak_power_w=peak_w))

    def _stop(
        self, rise: Rise, trip: comparator.Trip, accepted: Mask, place: Lanes, in_valley: Mask, crossing_s: Lanes
    ) -> Stop:
        """Measure a crossing with the sampler, as a stop; lanes that are not ``accepted`` get the key `EMPTY`.

        So do those whose time is no range.
        """
        ops = self.ops
        reading = read(self, rise, trip, place, mask=accepted)
        key = stop_list.sort_key(self.sensor.tdc, crossing_s, reading.amplitude)
        source, true_range = crossing_sources.crossing_source(
            self,
            rise,
            surfaces=self.surfaces,
            stray=self.stray,
            place=place,
            in_valley=in_valley,
            measured=reading.place,
        )
        return Stop(
            key=ops.where(accepted & comparator.is_range(reading.reported_s), key, EMPTY),
            crossing_s=crossing_s,
            reported_s=reading.reported_s,
            amplitude=reading.amplitude,
            width_s=reading.width_s if self.sensor.measures_width else None,
            snr=self.point.snr(trip.expected),
            detection_probability=trip.probability,
            source=source,
            true_range_m=true_range,
            status=None,
        )
