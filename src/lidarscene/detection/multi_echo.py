"""Multi-echo: an EchoTrain in, what the comparator and the TDC report of its waveform out.

Every rise of the waveform has its own deviate, as `returns` has one for its single echo. The waveform is nowhere
sampled: rises are visited one after the other (`rises`), crossings are roots.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..light.echoes import EchoTrain, Interference
from ..light.waveform import waveform
from ..maths.arrays import Array, Lanes, Mask, chosen, xp
from ..physics.electronics.pulse_sums import crossing
from ..physics.optics import radiometry
from ..sensor.model import Sensor
from . import ambient, comparator, intensity
from .returns import Detection, Outcome, Returns, Status, alarm_status, interferes
from .rises import Rise, visit_all
from .samplers import read
from .shots import Received

_EMPTY = -1e30
"""Key of a stop that nothing uses yet."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Stop:
    """A stop of the converter and the crossing that it holds.

    key         the larger, the rather the crossing is kept; `_EMPTY` if the stop is unused
    crossing_s  when the comparator tripped
    reported_s  time, amplitude and width as the sampler has them
    snr, probability  of the rise
    source      number of the sub-echo that gives most of it, -1: the air
    true_range_m  mean range of the light at the peak
    status      a `Status`; None while there are echoes alone
    """

    key: Lanes
    crossing_s: Lanes
    reported_s: Lanes
    amplitude: Lanes
    width_s: Lanes
    snr: Lanes
    probability: Lanes
    source: Lanes
    true_range_m: Lanes
    status: Lanes | None = None


def detect(pulse_train: EchoTrain, sensor: Sensor, *, seed: Lanes, pulse: Array) -> Detection:
    """Crossings of every pulse's waveform, and false alarms: those that the converter keeps, in order of time.

    seed   32-bit frame seed
    pulse  (n,) uint32 pulse numbers
    """
    point = sensor.working_point(pulse_train.background_power_w)
    converter = _Converter(
        sensor=sensor, point=point, threshold=sensor.threshold(point), wave=waveform(pulse_train, sensor),
        seed=seed, pulse=pulse, surfaces=pulse_train.surfaces,
    )  # fmt: skip
    found = converter.search()
    strongest = converter.strongest()
    stops = converter.with_alarms(found.stops, pulse_train.interference, *strongest)
    if sensor.tdc.keep != "first":
        stops = _in_time(stops)
    return converter.detection(pulse_train, found, stops, strongest[0])


@dataclass(frozen=True, slots=True, kw_only=True)
class _Found:
    """What the search knows of each pulse.

    high       whether the comparator was tripped by the rise before
    tripped    whether any rise tripped it
    in_window  whether any crossing was taken
    last       place of the last crossing that was taken
    highest    place of the highest peak, and its power
    stops      the crossings that the converter keeps, so far
    """

    high: Mask
    tripped: Mask
    in_window: Mask
    last: Lanes
    highest: Lanes
    highest_w: Lanes
    stops: tuple[_Stop, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Coming:
    """The next alarm of each pulse.

    number      of it
    elapsed     how far the process of alarms has come
    """

    number: Lanes
    elapsed: Lanes
    time_s: Lanes
    amplitude: Lanes
    status: Lanes


@dataclass(frozen=True, slots=True, kw_only=True)
class _Brightest:
    """Of some sub-echoes at a place.

    number  of the brightest
    slope   how steeply the light of all of them rises
    mean    their mean place by light
    """

    number: Lanes
    slope: Lanes
    mean: Lanes


@dataclass(frozen=True, slots=True, kw_only=True)
class _Converter(Received):
    """Comparator and TDC over the waveforms of some pulses.

    surfaces  how many sub-echoes, the first ones, are of surfaces
    """

    surfaces: int

    def key(self, time_s: Lanes, amplitude: Lanes) -> Lanes:
        """The larger, the rather a crossing is kept."""
        return {"first": -time_s, "last": time_s, "strongest": amplitude}[self.sensor.tdc.keep]

    def search(self) -> _Found:
        """All rises, and the best crossings of each pulse."""
        ops, like = self.ops, self.wave.origin_m
        nothing, never, number = ops.full(like, 0.0), ops.full(like, False), ops.full(like, 0)
        empty = _Stop(
            key=ops.full(like, _EMPTY), crossing_s=nothing, reported_s=nothing, amplitude=nothing, width_s=nothing,
            snr=nothing, probability=nothing, source=number, true_range_m=nothing,
        )  # fmt: skip
        start = _Found(
            high=never, tripped=never, in_window=never, last=ops.full(like, _EMPTY), highest=nothing, highest_w=nothing,
            stops=(empty,) * self.sensor.tdc.stops,
        )  # fmt: skip
        found = visit_all(self.wave, self._visit, start)
        status = ops.full(like, int(Status.ECHO))
        return replace(found, stops=tuple(replace(stop, status=status) for stop in found.stops))

    def _visit(self, rise: Rise, found: _Found) -> _Found:
        """One rise: does it trip, is the comparator ready for it, is it worth a stop?"""
        ops, tdc = self.ops, self.sensor.tdc
        peak_w = ops.where(rise.found, rise.top[0], 0.0)
        trip = comparator.trip(self, peak_w, draw=rise.number)
        # The comparator falls in the valley if that lies below the level, which has the rise's own noise.
        in_valley = self.point.signal(rise.valley_w) >= trip.level
        edge = rise.found & trip.tripped & ~(found.high & in_valley)
        place = self._crossing(rise, trip, edge, in_valley)
        crossing_s = self.time_s(place)
        ready = (place - found.last) * self.sigma_s >= tdc.dead_time_s
        taken = edge & comparator.listening(self.sensor, crossing_s) & ready
        taken_now = taken & self._may_keep(crossing_s, found.stops)
        new = self._stop(rise, trip, taken_now, place, in_valley, crossing_s)
        return _Found(
            high=ops.where(rise.found, trip.tripped, found.high),
            tripped=found.tripped | edge,
            in_window=found.in_window | taken,
            last=ops.where(taken, place, found.last),
            highest=ops.where(peak_w > found.highest_w, rise.peak, found.highest),
            highest_w=ops.maximum(found.highest_w, peak_w),
            stops=self._with(found.stops, new),
        )

    def _may_keep(self, crossing_s: Lanes, stops: tuple[_Stop, ...]) -> Mask:
        """Whether a crossing at this time can be among the best: what is measured of others is not asked for."""
        if self.sensor.tdc.keep == "strongest":
            return True
        return self.key(crossing_s, 0.0) > stops[-1].key

    def _with(self, stops: tuple[_Stop, ...], new: _Stop) -> tuple[_Stop, ...]:
        """The best crossings so far and one behind them in time."""
        return _appended(stops, new) if self.sensor.tdc.keep == "first" else _inserted(stops, new)

    def _crossing(self, rise: Rise, trip: comparator.Trip, edge: Mask, in_valley: Mask) -> Lanes:
        """Place at which a rise trips the comparator: in the valley if it is above the level there.

        Counted cells may trip it where the waveform stays below the level: then at the peak.
        """
        ops = self.ops
        reaches = edge & ~in_valley & (trip.level < trip.signal)
        level_w = ops.where(reaches, self.point.power_w(trip.level), 1.0)
        place = crossing(self.wave.at, level_w, far=rise.valley, peak=rise.peak, top=rise.top, wanted=reaches)
        return ops.where(reaches, place, ops.where(in_valley, rise.valley, rise.peak))

    def _stop(
        self,
        rise: Rise,
        trip: comparator.Trip,
        taken: Mask,
        place: Lanes,
        in_valley: Mask,
        crossing_s: Lanes,
    ) -> _Stop:
        """What the converter would report of a crossing; not taken, it has the lowest key."""
        ops = self.ops
        reading = read(self, rise, trip, place, wanted=taken)
        key = ops.where(taken, self.key(crossing_s, reading.amplitude), _EMPTY)
        source, true_range = self._source(rise, place, in_valley)
        return _Stop(
            key=key, crossing_s=crossing_s, reported_s=reading.reported_s, amplitude=reading.amplitude,
            width_s=reading.width_s, snr=self.snr(trip.signal), probability=trip.probability,
            source=source, true_range_m=true_range,
        )  # fmt: skip

    def snr(self, signal: Lanes) -> Lanes:
        """(19) or (27)."""
        return signal / self.ops.where(self.point.noise <= 0.0, 1e-30, self.point.noise)

    def _source(self, rise: Rise, place: Lanes, in_valley: Mask) -> tuple[Lanes, Lanes]:
        """Number of the sub-echo that makes a crossing, and its true range; -1 for the even light of the air.

        It is of the air if the air's light rises more steeply there than that of the surfaces: fog that trips the
        comparator may rise on to the peak of a surface far behind, and a surface may trip it on top of brighter fog.
        Near the peak, where nothing rises any more, and in the valley what rises between them counts.
        """
        ops, wave = self.ops, self.wave
        surface = self._brightest(rise.peak, 0, self.surfaces)
        if wave.volume is None:
            return surface.number, wave.range_m(surface.mean)
        between = ops.maximum(rise.peak - 1.0, 0.5 * (rise.valley + rise.peak))
        edge = ops.where(in_valley, between, ops.minimum(place, between))
        particle = self._brightest(edge, self.surfaces, len(wave.centres))
        slope, of_surfaces = wave.at(edge)[1], self._brightest(edge, 0, self.surfaces).slope
        of_air, even = slope > 2.0 * of_surfaces, slope > of_surfaces + 2.0 * particle.slope
        range_m = wave.range_m(ops.where(of_air, ops.where(even, place, particle.mean), surface.mean))
        number = ops.where(of_air, ops.where(even, -1, particle.number), surface.number)
        # Air right before the lens trips the comparator while the pulse still leaves: no range is below 0.
        return number, ops.maximum(range_m, 0.0)

    def _brightest(self, place: Lanes, first: int, end: int) -> _Brightest:
        """Of the sub-echoes from ``first`` to before ``end``, at a place."""
        ops, wave = self.ops, self.wave
        strongest, number = ops.full(place, -1.0), ops.full(place, 0)
        total: Lanes = ops.full(place, 0.0)
        slope: Lanes = 0.0
        for k in range(first, end):
            ahead = wave.centres[k] - place
            part = wave.heights[k] * ops.exp(-0.5 * ahead * ahead)
            number = ops.where(part > strongest, k, number)
            strongest = ops.maximum(part, strongest)
            total, slope = total + part, slope + part * ahead
        lit = total > 0.0
        mean = place + ops.where(lit, slope / ops.where(lit, total, 1.0), 0.0)
        return _Brightest(number=number, slope=slope, mean=mean)

    def strongest(self) -> tuple[Array, Lanes]:
        """Number and range of each pulse's strongest sub-echo of a surface."""
        ops, wave = self.ops, self.wave
        number, highest = ops.full(wave.origin_m, 0), ops.full(wave.origin_m, 0.0)
        place = ops.full(wave.origin_m, 0.0)
        for k, (centre, height) in enumerate(zip(wave.centres[: self.surfaces], wave.heights, strict=False)):
            number = ops.where(height > highest, k, number)
            place = ops.where(height > highest, centre, place)
            highest = ops.maximum(height, highest)
        return number, wave.range_m(place)

    def with_alarms(
        self, stops: tuple[_Stop, ...], sources: tuple[Interference, ...], number: Array, range_m: Lanes
    ) -> tuple[_Stop, ...]:
        """False alarms among the stops; what they show of the scene is the pulse's strongest sub-echo.

        Most pulses have none in the window, and go through no loop.
        """
        for alarms in comparator.false_alarms(self, sources):
            stops = self._merged(stops, alarms, number, range_m, others=bool(sources))
        return stops

    def _merged(
        self,
        stops: tuple[_Stop, ...],
        alarms: comparator.Alarms,
        number: Array,
        range_m: Lanes,
        *,
        others: bool,
    ) -> tuple[_Stop, ...]:
        """Alarms of a kind among the stops; ``others``: whether some may be of other lidars."""
        ops, tdc = self.ops, self.sensor.tdc
        zero, kind = ops.full(self.wave.origin_m, 0.0), ops.full(number, 0)

        def following(draw: Lanes, elapsed: Lanes) -> _Coming:
            elapsed, alarm = alarms(ops.uint32(draw), elapsed)
            return _Coming(
                number=draw + 1, elapsed=elapsed, time_s=alarm.time_s, amplitude=alarm.amplitude,
                status=kind + alarm_status(alarm.theirs),
            )  # fmt: skip

        def active(now: tuple[_Coming, tuple[_Stop, ...]]) -> Mask:
            return (now[0].time_s < tdc.window_s) & (now[0].number <= tdc.stops)

        def step(now: tuple[_Coming, tuple[_Stop, ...]]) -> tuple[_Coming, tuple[_Stop, ...]]:
            coming, kept = now
            width_s: Lanes = zero
            theirs = interferes(coming.status) if others else None
            if self.sensor.measures_width:
                width_s = comparator.alarm_width_s(self, coming.amplitude, theirs=theirs)
            alarm = _Stop(
                key=self.key(coming.time_s, coming.amplitude), crossing_s=coming.time_s, reported_s=coming.time_s,
                amplitude=coming.amplitude, width_s=width_s, snr=zero, probability=zero,
                source=number, true_range_m=range_m, status=coming.status,
            )  # fmt: skip
            kept = _inserted(kept, alarm)
            return following(coming.number, coming.elapsed), kept

        return ops.loop((following(kind, ops.float32(zero)), stops), active, step)[1]

    def detection(
        self, pulse_train: EchoTrain, found: _Found, stops: tuple[_Stop, ...], strongest: Array
    ) -> Detection:
        """All that is known of the pulses."""
        ops = self.ops
        returns = []
        kept = ops.full(self.wave.origin_m, False)
        for stop in stops:
            assert stop.status is not None
            used = stop.key > _EMPTY
            of_air = (stop.status == int(Status.ECHO)) & ((stop.source < 0) | (stop.source >= self.surfaces))
            status = ops.where(of_air, int(Status.WEATHER), stop.status)
            kept = kept | (used & (status == int(Status.ECHO)))
            range_m = radiometry.range_from_time_of_flight_m(time_of_flight_s=stop.reported_s)
            width_s = stop.width_s if self.sensor.measures_width else None
            returns.append(
                Returns(
                    reported=used,
                    status=status,
                    range_m=range_m,
                    amplitude=stop.amplitude,
                    intensity=intensity.reported(
                        self, pulse_train, amplitude=stop.amplitude, width_s=width_s, range_m=range_m
                    ),
                    width_s=width_s,
                    snr=stop.snr,
                    detection_probability=stop.probability,
                    source=stop.source,
                    true_range_m=stop.true_range_m,
                )
            )
        outcome = ops.where(kept, int(Outcome.KEPT), int(Outcome.HIDDEN))
        outcome = ops.where(found.in_window, outcome, int(Outcome.OUT_OF_WINDOW))
        outcome = ops.where(found.tripped, outcome, int(Outcome.BELOW_THRESHOLD))
        outcome = ops.where(pulse_train.found, outcome, int(Outcome.NO_SURFACE))
        # The power is asked for once more: no derivatives come out of the search, and none of the place is needed,
        # since the slope of the waveform is zero there.
        lit = found.highest_w > 0.0
        signal = self.point.signal(ops.where(lit, self.wave.at(found.highest)[0], 0.0))
        probability = comparator.probability(self, signal)
        return Detection(
            snr=ops.where(lit, self.snr(signal), 0.0),
            detection_probability=ops.where(lit, probability, 0.0),
            outcome=outcome,
            ambient=ambient.counts(
                pulse_train.background_power_w, self.sensor, seed=self.seed, pulse=self.pulse
            ),
            stops=tuple(returns),
            source=strongest,
        )


def _inserted(stops: tuple[_Stop, ...], new: _Stop) -> tuple[_Stop, ...]:
    """Stops in falling order of their keys with one more among them; the last one drops out."""
    kept = []
    for old in stops:
        better = new.key > old.key
        kept.append(chosen(better, new, old))
        new = chosen(better, old, new)
    return tuple(kept)


def _appended(stops: tuple[_Stop, ...], new: _Stop) -> tuple[_Stop, ...]:
    """The same if none of them has a lower key."""
    here, kept = new.key > _EMPTY, []
    for old in stops:
        used = old.key > _EMPTY
        kept.append(chosen(here & ~used, new, old))
        here = here & used
    return tuple(kept)


def _in_time(stops: tuple[_Stop, ...]) -> tuple[_Stop, ...]:
    """The same stops, first crossing first, unused ones last."""
    ops = xp(stops[0].key)
    keyed = [replace(one, key=ops.where(one.key > _EMPTY, -one.crossing_s, _EMPTY)) for one in stops]
    empty = replace(keyed[0], key=ops.full(keyed[0].key, 2.0 * _EMPTY))
    ordered = (empty,) * len(stops)
    for one in keyed:
        ordered = _inserted(ordered, one)
    return ordered
