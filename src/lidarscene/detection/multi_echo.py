"""Multi-echo: an EchoTrain in, what the comparator and the TDC report of its waveform out.

Every rise of the waveform has its own deviate, as `returns` has one for its single echo. The waveform is nowhere
sampled: rises are visited one after the other (`rises`), crossings are roots.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..light.echoes import EchoTrain, Interference
from ..light.waveform import waveform
from ..maths.arrays import Array, State, xp
from ..physics.electronics.pulse_sums import crossing
from ..physics.optics import radiometry
from ..sensor.model import Sensor
from . import ambient, comparator, intensity
from .returns import Detection, Outcome, Returns, Status, alarm_status, interferes
from .rises import Rise, visit_all
from .samplers import Shots, read

_EMPTY = -1e30
"""Key of a stop that nothing uses yet."""

# Of a stop: key, time of the crossing, reported time, amplitude, width, SNR, P_d, source, true range; later its status.
_FIELDS = 9


def detect(train: EchoTrain, sensor: Sensor, *, seed: Array, pulse: Array) -> Detection:
    """Crossings of every pulse's waveform, and false alarms: those that the converter keeps, in order of time.

    seed   32-bit frame seed
    pulse  (n,) uint32 pulse numbers
    """
    point = sensor.working_point(train.background_power_w)
    converter = _Converter(
        sensor=sensor, point=point, threshold=sensor.threshold(point), wave=waveform(train, sensor),
        seed=seed, pulse=pulse, surfaces=train.surfaces,
    )  # fmt: skip
    found = converter.search()
    strongest = converter.strongest()
    stops = converter.with_alarms(found.stops, train.interference, *strongest)
    if sensor.tdc.keep != "first":
        stops = _in_time(stops)
    return converter.detection(train, found, stops, strongest[0])


@dataclass(frozen=True, slots=True, kw_only=True)
class _Found:
    """What the search knows in the end: what the pulse had at all, and the crossings that the converter keeps.

    highest    place of the highest peak, and its power
    """

    tripped: Array
    in_window: Array
    highest: Array
    highest_w: Array
    stops: list[State]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Brightest:
    """Of some sub-echoes at a place.

    number  of the brightest
    slope   how steeply the light of all of them rises
    mean    their mean place by light
    """

    number: Array
    slope: Array
    mean: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class _Converter(Shots):
    """Comparator and TDC over the waveforms of some pulses.

    surfaces  how many sub-echoes, the first ones, are of surfaces
    """

    surfaces: int

    def key(self, time_s: Array, amplitude: Array) -> Array:
        """The larger, the rather a crossing is kept."""
        return {"first": -time_s, "last": time_s, "strongest": amplitude}[self.sensor.tdc.keep]

    def search(self) -> _Found:
        """All rises, and the best crossings of each pulse."""
        ops, like = self.ops, self.wave.origin_m
        nothing, never, number = ops.full(like, 0.0), ops.full(like, False), ops.full(like, 0)
        empty = (ops.full(like, _EMPTY), *([nothing] * 6), number, nothing)
        start = (
            never,
            never,
            never,
            ops.full(like, _EMPTY),
            *([nothing] * 2),
            *(empty * self.sensor.tdc.stops),
        )
        _, tripped, in_window, _, highest, highest_w, *values = visit_all(self.wave, self._visit, start)
        status = ops.full(like, int(Status.ECHO))
        stops = [(*stop, status) for stop in _grouped(values)]
        return _Found(tripped=tripped, in_window=in_window, highest=highest, highest_w=highest_w, stops=stops)

    def _visit(self, rise: Rise, state: State) -> State:
        """One rise: does it trip, is the comparator ready for it, is it worth a stop?"""
        ops, tdc = self.ops, self.sensor.tdc
        high, tripped, in_window, last, highest, highest_w, *values = state
        peak_w = ops.where(rise.found, rise.top[0], 0.0)
        trip = comparator.trip(
            self.point, self.threshold, peak_w, seed=self.seed, pulse=self.pulse, draw=rise.number
        )
        # The comparator falls in the valley if that lies below the level, which has the rise's own noise.
        in_valley = self.point.signal(rise.valley_w) >= trip.level
        edge = rise.found & trip.tripped & ~(high & in_valley)
        place = self._crossing(rise, trip, edge, in_valley)
        crossing_s = self.time_s(place)
        ready = (place - last) * self.sigma_s >= tdc.dead_time_s
        taken = edge & comparator.listening(self.sensor, crossing_s) & ready
        stops = _grouped(values)
        new = self._stop(rise, trip, taken & self._may_keep(crossing_s, stops), place, in_valley, crossing_s)
        return (
            ops.where(rise.found, trip.tripped, high),
            tripped | edge,
            in_window | taken,
            ops.where(taken, place, last),
            ops.where(peak_w > highest_w, rise.peak, highest),
            ops.maximum(highest_w, peak_w),
            *(value for stop in self._with(stops, new) for value in stop),
        )

    def _may_keep(self, crossing_s: Array, stops: list[State]) -> Array:
        """Whether a crossing at this time can be among the best: what is measured of others is not asked for."""
        if self.sensor.tdc.keep == "strongest":
            return True
        return self.key(crossing_s, 0.0) > stops[-1][0]

    def _with(self, stops: list[State], new: State) -> list[State]:
        """The best crossings so far and one behind them in time."""
        return _appended(stops, new) if self.sensor.tdc.keep == "first" else _inserted(stops, new)

    def _crossing(self, rise: Rise, trip: comparator.Trip, edge: Array, in_valley: Array) -> Array:
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
        taken: Array,
        place: Array,
        in_valley: Array,
        crossing_s: Array,
    ) -> State:
        """What the converter would report of a crossing; not taken, it has the lowest key."""
        ops = self.ops
        reading = read(self, rise, trip, place, wanted=taken)
        key = ops.where(taken, self.key(crossing_s, reading.amplitude), _EMPTY)
        source, true_range = self._source(rise, place, in_valley)
        return (
            key, crossing_s, reading.reported_s, reading.amplitude, reading.width_s,
            self.snr(trip.signal), trip.probability, source, true_range,
        )  # fmt: skip

    def snr(self, signal: Array) -> Array:
        """(19) or (27)."""
        return signal / self.ops.where(self.point.noise <= 0.0, 1e-30, self.point.noise)

    def _source(self, rise: Rise, place: Array, in_valley: Array) -> tuple[Array, Array]:
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
        return number, ops.maximum(
            range_m, 0.0
        )  # air right before the lens trips it while the pulse still leaves

    def _brightest(self, place: Array, first: int, end: int) -> _Brightest:
        """Of some sub-echoes, at a place."""
        ops, wave = self.ops, self.wave
        strongest, number, total, slope = ops.full(place, -1.0), ops.full(place, 0), ops.full(place, 0.0), 0.0
        for k in range(first, end):
            ahead = wave.centres[k] - place
            part = wave.heights[k] * ops.exp(-0.5 * ahead * ahead)
            number = ops.where(part > strongest, k, number)
            strongest = ops.maximum(part, strongest)
            total, slope = total + part, slope + part * ahead
        lit = total > 0.0
        mean = place + ops.where(lit, slope / ops.where(lit, total, 1.0), 0.0)
        return _Brightest(number=number, slope=slope, mean=mean)

    def strongest(self) -> tuple[Array, Array]:
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
        self, stops: list[State], sources: tuple[Interference, ...], number: Array, range_m: Array
    ) -> list[State]:
        """False alarms among the stops; what they show of the scene is the pulse's strongest sub-echo.

        Most pulses have none in the window, and go through no loop.
        """
        for alarms in comparator.false_alarms(
            self.sensor, self.point, self.threshold, sources, seed=self.seed, pulse=self.pulse
        ):
            stops = self._merged(stops, alarms, number, range_m, others=bool(sources))
        return stops

    def _merged(
        self, stops: list[State], alarms: comparator.Alarms, number: Array, range_m: Array, *, others: bool
    ) -> list[State]:
        """Alarms of a kind among the stops; ``others``: whether some may be of other lidars."""
        ops, tdc = self.ops, self.sensor.tdc
        zero, kind = ops.full(self.wave.origin_m, 0.0), ops.full(number, 0)

        def following(draw: Array, come: Array) -> State:
            come, (time_s, amplitude, theirs) = alarms(ops.uint32(draw), come)
            return draw + 1, come, time_s, amplitude, kind + alarm_status(theirs)

        def going(draw: Array, come: Array, time_s: Array, *rest: Array) -> Array:
            return (time_s < tdc.window_s) & (draw <= tdc.stops)

        def step(
            draw: Array, come: Array, time_s: Array, amplitude: Array, status: Array, *values: Array
        ) -> State:
            theirs = interferes(status) if others else False
            width_s = self.alarm_width_s(amplitude, theirs) if self.sensor.measures_width else zero
            alarm = (
                self.key(time_s, amplitude), time_s, time_s, amplitude,
                width_s, zero, zero, number, range_m, status,
            )  # fmt: skip
            kept = _inserted(_grouped(values, len(alarm)), alarm)
            return *following(draw, come), *(value for stop in kept for value in stop)

        start = following(kind, ops.float32(zero))
        done: State = ops.loop((*start, *(value for stop in stops for value in stop)), going, step)
        return _grouped(done[len(start) :], len(stops[0]))

    def alarm_width_s(self, amplitude: Array, theirs: Array) -> Array:
        """Time over the threshold of false alarms."""
        return comparator.alarm_width_s(self.sensor, self.point, self.threshold, amplitude, theirs=theirs)

    def detection(self, train: EchoTrain, found: _Found, stops: list[State], strongest: Array) -> Detection:
        """All that is known of the pulses."""
        ops = self.ops
        returns = []
        kept = ops.full(self.wave.origin_m, False)
        for key, _, reported_s, amplitude, width_s, snr, probability, source, true_range, status in stops:
            used = key > _EMPTY
            of_air = (status == int(Status.ECHO)) & ((source < 0) | (source >= self.surfaces))
            status = ops.where(of_air, int(Status.WEATHER), status)
            kept = kept | (used & (status == int(Status.ECHO)))
            range_m = radiometry.range_from_time_of_flight_m(time_of_flight_s=reported_s)
            known = width_s if self.sensor.measures_width else None
            returns.append(
                Returns(
                    reported=used,
                    status=status,
                    range_m=range_m,
                    amplitude=amplitude,
                    intensity=intensity.reported(
                        train,
                        self.sensor,
                        self.point,
                        self.threshold,
                        amplitude=amplitude,
                        width_s=known,
                        range_m=range_m,
                    ),
                    width_s=known,
                    snr=snr,
                    detection_probability=probability,
                    source=source,
                    true_range_m=true_range,
                )
            )
        outcome = ops.where(kept, int(Outcome.KEPT), int(Outcome.HIDDEN))
        outcome = ops.where(found.in_window, outcome, int(Outcome.OUT_OF_WINDOW))
        outcome = ops.where(found.tripped, outcome, int(Outcome.BELOW_THRESHOLD))
        outcome = ops.where(train.found, outcome, int(Outcome.NO_SURFACE))
        # The power is asked for once more: no derivatives come out of the search, and none of the place is needed,
        # since the slope of the waveform is zero there.
        lit = found.highest_w > 0.0
        signal = self.point.signal(ops.where(lit, self.wave.at(found.highest)[0], 0.0))
        probability = comparator.probability(self.point, self.threshold, signal)
        return Detection(
            snr=ops.where(lit, self.snr(signal), 0.0),
            detection_probability=ops.where(lit, probability, 0.0),
            outcome=outcome,
            ambient=ambient.counts(train.background_power_w, self.sensor, seed=self.seed, pulse=self.pulse),
            stops=tuple(returns),
            source=strongest,
        )


def _grouped(values: Sequence[Array], fields: int = _FIELDS) -> list[State]:
    """The stops of a loop's state."""
    return [tuple(values[first : first + fields]) for first in range(0, len(values), fields)]


def _inserted(stops: list[State], new: State) -> list[State]:
    """Stops in falling order of their keys with one more among them; the last one drops out."""
    ops = xp(new[0])
    kept = []
    for old in stops:
        better = new[0] > old[0]
        kept.append(tuple(ops.where(better, a, b) for a, b in zip(new, old, strict=True)))
        new = tuple(ops.where(better, b, a) for a, b in zip(new, old, strict=True))
    return kept


def _appended(stops: list[State], new: State) -> list[State]:
    """The same if none of them has a lower key."""
    ops = xp(new[0])
    here, kept = new[0] > _EMPTY, []
    for old in stops:
        used = old[0] > _EMPTY
        kept.append(tuple(ops.where(here & ~used, a, b) for a, b in zip(new, old, strict=True)))
        here = here & used
    return kept


def _in_time(stops: list[State]) -> list[State]:
    """The same stops, first crossing first, unused ones last."""
    ops = xp(stops[0][0])
    keyed = [(ops.where(one[0] > _EMPTY, -one[1], _EMPTY), *one) for one in stops]
    empty = (ops.full(keyed[0][0], 2.0 * _EMPTY), *keyed[0][1:])
    ordered = [empty] * len(stops)
    for one in keyed:
        ordered = _inserted(ordered, one)
    return [one[1:] for one in ordered]
