"""Receiver that sums many shots into a histogram and reports its peaks.

The expected histogram after the filter is a sum of broadened echoes. Each of its peaks is a candidate, and each echo
on the flank of a peak: noise may lift it out. The counts around a candidate are drawn (`bins`), filtered and compared
with the threshold. The rest of the window holds noise alone, of which only the peaks above the threshold matter: a
Poisson process, as for a comparator (docs/photon_counting.md).

A "pulse" is one point here: all of its shots together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ...light.echoes import EchoTrain, Interference
from ...light.waveform import Waveform, waveform
from ...maths import random
from ...maths.arrays import Array, Lanes, Mask, Ops, select_state, xp
from ...maths.random import Seed
from ...maths.special import normal_tail
from ...physics.electronics import tdc
from ...physics.electronics.pulse_sums import SIGMAS_PER_FWHM
from ...physics.optics import radiometry, scintillation
from ...physics.photon_counting import dead_time, matched_filter, pile_up, valleys
from ...sensor.detectors import WorkingPoint
from ...sensor.detectors.spad_detector import PLACES, Macropixel
from ...sensor.sensor_model import Sensor
from .. import ambient, comparator
from ..outcomes import Outcome, Status
from ..reported_intensity import reported_intensity
from ..returns import Detection, Returns, alarm_status
from ..rises import Rise, visit_all
from ..shots import Shots
from .bins import BOX_SHARE, Bins, Peak
from .folding import fold

_EMPTY = -1e30
"""Key of an unused stop: below every other key."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Stop:
    """A return, or room for one; each field (n,).

    key           sort key: returns with larger keys are kept first; `_EMPTY` if the stop is unused
    time_s        time of flight that the receiver reports
    photons       photons of the return
    snr           expected value of the filter over the noise without an echo
    probability   P_d
    source        number of the sub-echo with the most light there, -1 for the even light of the air
    true_range_m  mean range of the light there
    status        a `Status`
    """

    key: Lanes
    time_s: Lanes
    photons: Lanes
    snr: Lanes
    probability: Lanes
    source: Lanes
    true_range_m: Lanes
    status: Lanes


_SURE = 5.3
"""Deviations of the filter's value by which an echo exceeds its highest threshold: the rest of P_d is below 6e-8, which
single precision does not tell from none."""

_LOWEST_HUMP = 0.1
"""Expected height, in thresholds, below which no hump of SPADs that come back is looked for: noise is as high."""

_ASIDE = 2.5
"""Distance in sigmas at which light of its own takes a hump's place."""

_MERGED = 0.9
"""Distance in widths of the filter's response at which an echo is part of a peak: noise splits none off nearer ones."""

_NEIGHBOURS = 4.2
"""Distance, in these widths, of two peaks between which noise may fill the valley."""

_OUTWARD = 0.3
"""Distance, in these widths, from an echo on a flank to the end of the valleys that lift it out."""

_FAR = 1e30
"""Place that no pulse has."""

_NEVER = 1e-7
"""P_d below which the bins around a peak are not drawn: less than a point in forty frames of 262,144 pulses."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Expected:
    """Expectation of a peak; each field (n,).

    snr          its value over the noise without an echo
    probability  P_d
    level        median of its threshold, in photons
    lone         how far its neighbours lack it (`sensor.detectors.working_point.ThresholdLaw`)
    peaks        mean number of peaks there, a factor of the probability
    """

    snr: Lanes
    probability: Lanes
    level: Lanes
    lone: Lanes
    peaks: Lanes = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Candidate:
    """Place at which the histogram is searched; each field (n,).

    exists       whether the pulse has it
    place        place of the filtered light
    on_flank     whether an echo lies there that is no peak of the expected light; such are visited after all peaks
    low, high    places between which its peak is looked for: the valleys beside a peak
    previous, following  places of the peaks beside a peak, if there are any
    """

    exists: Mask
    place: Lanes
    on_flank: Mask
    low: Lanes
    high: Lanes
    previous: Lanes
    following: Lanes


@dataclass(frozen=True, slots=True, kw_only=True)
class _Peaks:
    """Peaks of the expected light behind the filter, in order of time.

    count    (n,) how many
    places   place of each, (n,) at a time
    valleys  place of the valley before each, (n,) at a time
    merged   (n,) for each sub-echo, whether it is part of a peak
    """

    count: Lanes
    places: Array
    valleys: Array
    merged: tuple[Mask, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Visits:
    """State of the visits to the candidates of each pulse.

    number   (n,) number of the next peak
    flank    (n,) place of the last echo on a flank
    valleys  as of `_Peaks`
    places   as of `_Peaks`
    search   returns so far
    """

    number: Lanes
    flank: Lanes
    places: Array
    valleys: Array
    search: _PeakSearch


@dataclass(frozen=True, slots=True, kw_only=True)
class _PeakSearch:
    """State of the search over the peaks of each pulse; each field (n,).

    tripped    whether the filter exceeded the threshold at any peak
    in_window  whether it did within the window
    last_s     time of the last return
    revived_s  time of the last return of SPADs that come back
    highest    place of the highest peak of the light
    highest_w  power there
    stops      returns so far, best first
    """

    tripped: Mask
    in_window: Mask
    last_s: Lanes
    revived_s: Lanes
    highest: Lanes
    highest_w: Lanes
    stops: tuple[_Stop, ...]


def detect(pulse_train: EchoTrain, sensor: Sensor, *, seed: Seed, pulse: Array) -> Detection:
    """Detect every pulse: one `Returns` for each stop, in order of time (docs/photon_counting.md).

    seed   32-bit frame seed; every random number is keyed by (seed, stage, pulse)
    pulse  (n,) uint32 pulse numbers
    """
    histogram = sensor.histogram
    assert histogram is not None
    light = fold(pulse_train, histogram)
    background = pulse_train.background_power_w
    point, pixel = sensor.working_point(background), sensor.pixel(background)
    level, deviate = sensor.threshold(point), _draw_deviate(seed, pulse)
    receiver = _Receiver(
        sensor=sensor,
        point=point,
        seed=seed,
        pulse=pulse,
        threshold=histogram.threshold_of_noise(level, deviate),
        pixel=pixel,
        level=level,
        deviate=deviate,
        train=light.train,
        folds_m=light.folds_m,
        light=waveform(*broaden(light.train, sensor, pixel.sigma_s)),
        filtered=waveform(*broaden(light.train, sensor, matched_filter.OUTPUT_WIDTH * pixel.sigma_s)),
        fluctuation=pulse_train.fluctuation,
    )
    alone = receiver.alone()
    state = receiver.search(alone)
    number, range_m = receiver.strongest()
    stops = receiver.add_alarms(state.stops, number, range_m)
    return receiver.detection(state, stops if len(stops) == 1 else _sort_by_time(stops), number, alone)


def _draw_deviate(seed: Seed, pulse: Array) -> Lanes:
    """Draw the standard normal number of each point, (n,), that sets its threshold for all of its peaks (T111)."""
    return random.normal_pair(random.words(seed=seed, stage=random.Stage.THRESHOLD, pulse=pulse))[0]


def broaden(train: EchoTrain, sensor: Sensor, sigma_s: Lanes) -> tuple[EchoTrain, Sensor]:
    """Widen the echoes to ``sigma_s`` at constant energy; returns the light and a sensor with a pulse of that width."""
    ratio = sensor.laser.pulse_fwhm_s / (SIGMAS_PER_FWHM * sigma_s)
    parts = tuple(replace(part, peak_power_w=part.peak_power_w * ratio) for part in train.parts)
    laser = replace(sensor.laser, pulse_fwhm_s=SIGMAS_PER_FWHM * sigma_s)
    return replace(train, parts=parts), replace(sensor, laser=laser)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Receiver(Shots):
    """Receiver applied to n pulses.

    train     their light, folded into the unambiguous range
    folds_m   range by which each sub-echo of a surface was folded, (n,) each; None: nothing folds
    light     expected light as wide as in the histogram
    filtered  expected light as wide as behind the filter
    pixel     SPADs under the background, as they are where their number does not depend on the range
    level     (n,) median threshold of `point`, which is that of `pixel`
    deviate   (n,) standard normal number of the point, which scatters its thresholds
    """

    train: EchoTrain
    folds_m: Sequence[Lanes] | None
    light: Waveform
    filtered: Waveform
    pixel: Macropixel
    level: Lanes
    deviate: Lanes

    @property
    def ops(self) -> Ops:
        """Array functions of the arrays' kind, NumPy's or Dr.Jit's."""
        return xp(self.light.origin_m)

    def _pixel_at(self, range_m: Lanes) -> Macropixel:
        """SPADs at this range, (n,): those that fire once in a shot become fewer."""
        if self.pixel.spad.stamps == "all":
            return self.pixel
        return self.sensor.pixel(self.train.background_power_w, range_m=range_m)

    def _point_at(self, range_m: Lanes) -> tuple[WorkingPoint, Lanes]:
        """Working point at this range and its median threshold, (n,)."""
        if self.pixel.spad.stamps == "all":
            return self.point, self.level
        point = self.sensor.working_point(self.train.background_power_w, range_m=range_m)
        return point, self.sensor.threshold(point)

    @property
    def _multi_peak(self) -> bool:
        """True if the light may have more than one peak."""
        return len(self.filtered.centres) > 1 or self.filtered.volume is not None

    def alone(self) -> _Expected | None:
        """Expectation of the only peak of each pulse; None if the light may have several."""
        if self._multi_peak:
            return None
        return self._expect(self.ops.full(self.light.origin_m, 0.0), self.filtered.heights[0])

    def search(self, alone: _Expected | None) -> _PeakSearch:
        """Visit all peaks of the expected histogram and keep the best returns of each pulse; ``alone`` of `alone`."""
        ops, like = self.ops, self.light.origin_m
        zero, never, number = ops.full(like, 0.0), ops.full(like, False), ops.full(like, 0)
        empty = _Stop(
            key=ops.full(like, _EMPTY),
            time_s=zero,
            photons=zero,
            snr=zero,
            probability=zero,
            source=number,
            true_range_m=zero,
            status=number,
        )
        start = _PeakSearch(
            tripped=never,
            in_window=never,
            last_s=zero - 1.0,
            revived_s=zero - 1.0,
            highest=zero,
            highest_w=zero,
            stops=(empty,) * self.sensor.tdc.stops,
        )
        if alone is None:
            return self._visit_candidates(start)
        # The only echo is the only peak.
        power = self.filtered.heights[0]
        only = _Candidate(
            exists=power > 0.0, place=zero, on_flank=never, low=zero, high=zero, previous=zero, following=zero
        )
        return self._add_peak(only, power, alone, start)

    def _find_peaks(self) -> _Peaks:
        """Find the peaks of the expected light behind the filter."""
        ops, wave = self.ops, self.filtered
        # As many peaks as echoes of one width at most, and those of the air: on its hump, and before its end.
        most = len(wave.centres) + (2 if wave.volume is not None else 0)

        def note(rise: Rise, peaks: _Peaks) -> _Peaks:
            index = ops.int32(ops.minimum(peaks.count, most - 1.0))
            near = (ops.abs(centre - rise.peak) < _MERGED for centre in wave.centres)
            return _Peaks(
                count=ops.minimum(peaks.count + 1.0, float(most)),
                places=ops.put(peaks.places, index, rise.peak),
                valleys=ops.put(peaks.valleys, index, rise.valley),
                merged=tuple(merged | beside for merged, beside in zip(peaks.merged, near, strict=True)),
            )

        like = self.light.origin_m
        start = _Peaks(
            count=ops.full(like, 0.0),
            places=ops.room(like, most),
            valleys=ops.room(like, most),
            merged=tuple(ops.full(like, False) for _ in wave.centres),
        )
        return visit_all(wave, note, start)

    def _visit_candidates(self, start: _PeakSearch) -> _PeakSearch:
        """Visit the peaks of each pulse in order of time, and then the echoes on their flanks."""
        ops, wave = self.ops, self.filtered
        peaks = self._find_peaks()

        def next_flank(place: Lanes) -> Lanes:
            """First echo behind a place, and apart from the one there, that is not part of a peak."""
            first: Lanes = ops.full(place, _FAR)
            for centre, height, merged in zip(wave.centres, wave.heights, peaks.merged, strict=True):
                new = ~merged & (height > 0.0) & (centre > place + _MERGED)
                first = ops.where(new, ops.minimum(first, centre), first)
            return first

        def active(visits: _Visits) -> Mask:
            return (visits.number < peaks.count) | (next_flank(visits.flank) < _FAR)

        def step(visits: _Visits) -> _Visits:
            number, flank = visits.number, next_flank(visits.flank)
            is_peak, last = number < peaks.count, peaks.count - 1.0

            def get(room: Array, index: Lanes) -> Lanes:
                return ops.get(room, ops.int32(ops.maximum(ops.minimum(index, last), 0.0)))

            exists = is_peak | (flank < _FAR)
            place = ops.where(is_peak, get(visits.places, number), ops.where(flank < _FAR, flank, 0.0))
            low = ops.where(is_peak & (number > 0.0), get(visits.valleys, number), -_FAR)
            high = ops.where(is_peak & (number < last), get(visits.valleys, number + 1.0), _FAR)
            candidate = _Candidate(
                exists=exists,
                place=place,
                on_flank=exists & ~is_peak,
                low=low,
                high=high,
                previous=ops.where(low > -_FAR, get(visits.places, number - 1.0), -_FAR),
                following=ops.where(high < _FAR, get(visits.places, number + 1.0), _FAR),
            )
            height, slope, _ = wave.at(place)
            power_w = ops.where(exists, height, 0.0)
            # Noise lifts an echo out of a flank on the lower side.
            outward = ops.where(slope > 0.0, -_OUTWARD, _OUTWARD)
            expected_at = ops.where(candidate.on_flank, place + outward, place)
            expected = self._expect(expected_at, ops.where(exists, wave.at(expected_at)[0], 0.0))
            chance = self._peaks_of(candidate, power_w)
            expected = replace(expected, peaks=chance, probability=expected.probability * chance)
            return replace(
                visits,
                number=ops.where(is_peak, number + 1.0, number),
                flank=ops.where(is_peak, visits.flank, flank),
                search=self._add_peak(candidate, power_w, expected, visits.search),
            )

        first = ops.full(self.light.origin_m, 0.0)
        begin = _Visits(number=first, flank=first - _FAR, places=peaks.places, valleys=peaks.valleys, search=start)
        return ops.loop(begin, active, step).search

    def _peaks_of(self, candidate: _Candidate, power_w: Lanes) -> Lanes:
        """Mean number of peaks that a candidate has, whatever their height, (n,): at most 1 (T167).

        power_w  power of the filtered light there
        """
        ops, wave, on_flank, place = self.ops, self.filtered, candidate.on_flank, candidate.place
        before, behind = place - candidate.previous < _NEIGHBOURS, candidate.following - place < _NEIGHBOURS
        point, noise = self.point, self.point.noise.deviation

        def count() -> Array:
            height, slope, _ = wave.at(place)
            upwards = ops.where(on_flank, ops.where(slope > 0.0, 1.0, -1.0), 0.0)
            # Of an echo on a flank: the way to the higher one.
            way: Lanes = ops.full(place, _NEIGHBOURS)
            for centre, power in zip(wave.centres, wave.heights, strict=True):
                ahead = (centre - place) * upwards
                way = ops.where((ahead > _MERGED) & (power >= 0.5 * height), ops.minimum(way, ahead), way)
            start = place - ops.where(upwards > 0.0, _OUTWARD, way)
            end = place + ops.where(upwards > 0.0, way, _OUTWARD)
            start = ops.where(on_flank, start, ops.where(before, candidate.previous, place))
            end = ops.where(on_flank, end, ops.where(behind, candidate.following, place))
            valleys_before, valleys_behind = self._valleys((start, place, end), upwards, power_w)
            # Without a valley between two peaks there is one: the higher, as noise has it.
            lost: Lanes = 0.0
            for near, other, number in ((before, start, valleys_before), (behind, end, valleys_behind)):
                other_w = wave.at(other)[0]
                photons, others = (self._signal(point, power) for power in (power_w, other_w))
                variance = 2.0 * noise * noise + point.noise.kappa_1 * (photons + others)
                lower = normal_tail((photons - others) / ops.sqrt(ops.maximum(variance, 1e-6)))
                lost = lost + ops.where(near, lower * ops.maximum(1.0 - number, 0.0), 0.0)
            on_way = ops.minimum(valleys_before + valleys_behind, 1.0)
            peaks: Array = ops.where(on_flank, on_way, ops.maximum(1.0 - lost, 0.0))
            return peaks

        return ops.where_any(candidate.exists & (on_flank | before | behind), count, ops.full(place, 1.0))

    def _valleys(self, stretches: tuple[Lanes, ...], upwards: Lanes, power_w: Lanes) -> tuple[Lanes, ...]:
        """Mean number of valleys of the drawn histogram behind the filter in neighbouring stretches, (n,) each (T166).

        stretches  their ends, one more than stretches
        upwards    1 or -1: only where the expected light rises or falls; 0: wherever
        power_w    power of the filtered light at the candidate, which gives the photons of all light there
        """
        ops, wave = self.ops, self.filtered
        pixel, point = self.pixel, self.point
        bin_sigmas = pixel.histogram.bin_s / pixel.sigma_s
        stride = bin_sigmas * (0.5 / matched_filter.OUTPUT_WIDTH)
        photons_per_w = self._signal(point, power_w) / ops.maximum(power_w, 1e-30)
        noise = point.noise.deviation * point.noise.deviation

        def moments_at(place: Lanes) -> tuple[Lanes, Lanes]:
            mean: Lanes = 0.0 * place
            broadened: Lanes = 0.0 * place
            for centre, height in zip(wave.centres, wave.heights, strict=True):
                square = (centre - place) * (centre - place)
                mean = mean + height * ops.exp(-0.5 * square)
                broadened = broadened + height * ops.exp((-0.5 / valleys.SIGNAL_WIDTH**2) * square)
            even = wave.air_w(place)
            variance = valleys.SIGNAL_HEIGHT * broadened + valleys.EVEN_HEIGHT * even
            return photons_per_w * (mean + even), noise + photons_per_w * variance

        def inside(place: Lanes, first: Lanes, last: Lanes) -> Lanes:
            """Share of the half bin around a place that lies in a stretch."""
            start, end = ops.maximum(first, place - 0.5 * stride), ops.minimum(last, place + 0.5 * stride)
            return ops.maximum(end - start, 0.0) / stride

        Moments = tuple[tuple[Lanes, Lanes], ...]
        State = tuple[Lanes, Moments, tuple[Lanes, ...]]

        def add(state: State) -> State:
            place, moments, totals = state
            moments = (*moments, moments_at(place + 2.0 * stride))
            means, variances = zip(*moments, strict=True)
            share = valleys.probability(means=means[::2], variances=variances, bin_sigmas=bin_sigmas)
            share = ops.where((means[4] - means[0]) * upwards >= 0.0, 0.5 * share, 0.0)
            sums = (
                total + share * inside(place, first, last)
                for total, first, last in zip(totals, stretches[:-1], stretches[1:], strict=True)
            )
            return place + stride, moments[1:], tuple(sums)

        # Half bins, whose neighbours a bin away are other ones: each needs the light at one new place.
        begin = 1.0 * stretches[0]
        ahead = tuple(moments_at(begin + k * stride) for k in (-2.0, -1.0, 0.0, 1.0))
        start: State = begin, ahead, (ops.full(begin, 0.0),) * (len(stretches) - 1)
        return ops.loop(start, lambda state: state[0] < stretches[-1] + 0.5 * stride, add)[2]

    def _add_peak(self, candidate: _Candidate, power_w: Lanes, expected: _Expected, state: _PeakSearch) -> _PeakSearch:
        """Add a candidate and its return to the search, which chance must be able to make.

        power_w  (n,) power of the filtered light there
        """
        ops, exists, place = self.ops, candidate.exists, candidate.place
        higher = exists & (power_w > state.highest_w)
        state = replace(
            state,
            highest=ops.where(higher, place, state.highest),
            highest_w=ops.where(higher, power_w, state.highest_w),
        )
        likely = exists & (expected.probability > _NEVER)
        drawn = replace(candidate, exists=likely)
        state = ops.where_any(likely, lambda: self._add_return(drawn, power_w, expected, state), state)
        if not self._sees_humps:
            return state
        pixel = self.pixel
        detections = pixel.detections(self._lone_w(power_w))
        by_echo, by_sun = (dead_time.firing_share(detections=x) for x in (detections, pixel.sun * pixel.blind_sigmas))
        peaks = likely & ~candidate.on_flank if self._multi_peak else likely
        high = peaks & (pixel.height_of_free(by_echo * by_sun) > _LOWEST_HUMP * expected.level)
        return ops.where_any(high, lambda: self._add_revived(high, place, detections, expected, state), state)

    @property
    def _sees_humps(self) -> bool:
        """True if SPADs that come back a dead time behind an echo can make a return.

        They are fewer than those that the echo fired, so the strongest return is never theirs. Coates' correction knows
        how many SPADs are free.
        """
        sensor, pixel = self.sensor, self.pixel
        only_strongest = sensor.tdc.stops == 1 and sensor.tdc.keep == "strongest"
        return pixel.spad.stamps == "all" and not pixel.corrected and not only_strongest

    def _lone_w(self, power_w: Lanes) -> Lanes:
        """Peak power of the lone laser pulse that gives this filtered power: the argument of the working point."""
        return power_w * (self.filtered.fwhm_s / self.sensor.laser.pulse_fwhm_s)

    def _add_return(
        self, candidate: _Candidate, power_w: Lanes, expected: _Expected, state: _PeakSearch
    ) -> _PeakSearch:
        """Draw the bins around a candidate and add its return to the search; arguments as of `_add_peak`."""
        ops, sensor, converter, place = self.ops, self.sensor, self.sensor.tdc, candidate.place
        range_m = self.filtered.range_m(place)
        arrival_s = radiometry.time_of_flight_s(range_m=range_m)
        pixel = self._pixel_at(range_m)
        detections = pixel.detections(self._lone_w(power_w))
        early = pixel.sigma_s * pile_up.shift(detections=detections, sun=pixel.sun, dead=pixel.blind_sigmas)
        bins = Bins(pixel=pixel, wave=self.light, seed=self.seed, pulse=self.pulse)
        limits_s = None
        if self._multi_peak:
            limits_s = (
                radiometry.time_of_flight_s(range_m=self.filtered.range_m(candidate.low)) + early,
                radiometry.time_of_flight_s(range_m=self.filtered.range_m(candidate.high)) + early,
            )
        at = place * matched_filter.OUTPUT_WIDTH + early / pixel.sigma_s
        peak = bins.highest(at, arrival_s + early, limits_s=limits_s)
        expected = self._expect_shaded(candidate, power_w, expected, peak)
        threshold = pixel.histogram.threshold_of_point(expected.level, self.deviate, expected.lone)
        tripped = candidate.exists & peak.exists & (peak.value >= threshold)
        time_s = self._reported_s(pixel, peak)
        accepted = tripped & comparator.accepts_crossing(sensor, arrival_s) & comparator.is_range(time_s)
        apart: Mask = time_s - state.last_s >= converter.dead_time_s
        stops = state.stops
        if self._multi_peak:
            accepted, stops = self._keep_first(
                accepted & (candidate.on_flank | apart), candidate.on_flank, time_s, stops
            )
            last_s = ops.where(accepted & ~candidate.on_flank, time_s, state.last_s)
        else:
            accepted = accepted & apart
            last_s = ops.where(accepted, time_s, state.last_s)
        source, true_range, status = self._source(place)
        stop = _Stop(
            key=ops.where(accepted, self._key(time_s, peak.value), _EMPTY),
            time_s=time_s,
            photons=peak.photons,
            snr=expected.snr,
            probability=expected.probability,
            source=source,
            true_range_m=true_range,
            status=status,
        )
        return replace(
            state,
            tripped=state.tripped | tripped,
            in_window=state.in_window | accepted,
            last_s=last_s,
            stops=_insert(stops, stop),
        )

    def _keep_first(
        self, accepted: Mask, on_flank: Mask, time_s: Lanes, stops: tuple[_Stop, ...]
    ) -> tuple[Mask, tuple[_Stop, ...]]:
        """Hold the return of an echo on a flank, which is visited after all peaks, to the distance from the others.

        Returns whether it is accepted, and the stops without those that lie less than that distance behind it. A peak
        of the histogram that is a return already is no second one: two are two bins apart at least.
        """
        ops, separation_s = self.ops, self.sensor.tdc.dead_time_s
        assert self.sensor.histogram is not None
        for stop in stops:
            behind_s, occupied = time_s - stop.time_s, stop.key > _EMPTY
            same = ops.abs(behind_s) < self.sensor.histogram.bin_s
            near = (behind_s >= 0.0) & (behind_s < separation_s)
            accepted = accepted & ~(occupied & (same | (on_flank & near)))
        shortened = []
        for stop in stops:
            ahead_s = stop.time_s - time_s
            loses = accepted & on_flank & (ahead_s > 0.0) & (ahead_s < separation_s)
            shortened.append(replace(stop, key=ops.where(loses, _EMPTY, stop.key)))
        return accepted, _sort_by_key(shortened)

    def _add_revived(
        self, exists: Mask, place: Lanes, detections: Lanes, expected: _Expected, state: _PeakSearch
    ) -> _PeakSearch:
        """Search where the SPADs that a peak has fired come back together; adds a return of them to the search.

        place       (n,) place of the peak whose SPADs they are
        detections  (n,) Lambda of that peak
        expected    expectation of that peak

        A later echo is held to the distance from the last echo, not from these: nothing is known of them when the peaks
        are visited.
        """
        ops, sensor = self.ops, self.sensor
        pixel, point = self.pixel, self.point
        assert point.law is not None
        echo = pile_up.firings(detections=detections, sun=pixel.sun)
        hump = pile_up.hump(echo, sun=pixel.sun, dead=pixel.blind_sigmas)
        height, behind = pixel.height_of_free(hump.excess), echo.mean + pixel.blind_sigmas + hump.place
        echo_s = radiometry.time_of_flight_s(range_m=self.filtered.range_m(place))
        arrival_s, at = echo_s + behind * pixel.sigma_s, place * matched_filter.OUTPUT_WIDTH + behind
        # Another echo there has its own peak, and its counts are with these SPADs.
        light_w = self.light.at(at)[0]
        for aside in (-_ASIDE, _ASIDE):
            light_w = ops.maximum(light_w, self.light.at(at + aside)[0])
        exists = exists & (4.0 * pixel.trials * pixel.detections(light_w) < height)
        peak = Bins(pixel=pixel, wave=self.light, seed=self.seed, pulse=self.pulse).highest(at, arrival_s, behind=True)
        if peak.expected is not None:
            height = ops.where(peak.shaded, peak.expected, height)
        level, signal = expected.level, pixel.signal_of_height(height)
        lone = point.law.lone(level, signal)
        threshold = pixel.histogram.threshold_of_point(level, self.deviate, lone)
        time_s, apart_s = self._reported_s(pixel, peak), sensor.tdc.dead_time_s
        accepted = exists & (peak.value >= threshold) & comparator.accepts_crossing(sensor, arrival_s)
        accepted = accepted & (time_s - state.last_s >= apart_s) & comparator.is_range(time_s)
        # Echoes that merge have one hump.
        accepted = accepted & (time_s - state.revived_s >= ops.maximum(2.0 * _ASIDE * pixel.sigma_s, apart_s))
        source, true_range, _ = self._source(place)
        stop = _Stop(
            key=ops.where(accepted, self._key(time_s, peak.value), _EMPTY),
            time_s=time_s,
            photons=peak.photons,
            snr=height / point.noise.deviation,
            probability=point.detection_probability(level, signal, 0.0),
            source=source,
            true_range_m=true_range,
            status=ops.full(source, int(Status.REVIVED)),
        )
        return replace(state, revived_s=ops.where(accepted, time_s, state.revived_s), stops=_insert(state.stops, stop))

    def _reported_s(self, pixel: Macropixel, peak: Peak) -> Lanes:
        """Time of flight that the receiver reports of a peak, (n,) s."""
        return tdc.quantise(
            time_s=self.ops.maximum(peak.time_s - self._walk_s(pixel, peak), 0.0),
            least_significant_bit_s=self.sensor.tdc.least_significant_bit_s,
        )

    def _shadow(self, place: Lanes, signal: Lanes) -> Lanes:
        """Photons of a peak and its background that SPADs fired by nearer echoes miss, (n,) (T168)."""
        pixel = self.pixel
        if not self._multi_peak or pixel.corrected or pixel.spad.coincidence > 1:
            return 0.0
        ops, wave = self.ops, self.filtered
        before: Lanes = 0.0
        for centre, height in zip(wave.centres, wave.heights, strict=True):
            since = (place - centre) * matched_filter.OUTPUT_WIDTH
            # The shadow that an echo casts on itself is in its own height.
            blind = (since > _MERGED * matched_filter.OUTPUT_WIDTH) & (since < pixel.blind_sigmas)
            before = before + ops.where(blind, height * ops.exp(-pixel.sun * ops.maximum(since, 0.0)), 0.0)
        fired = dead_time.firing_share(detections=pixel.detections(self._lone_w(before)))
        background = pixel.count_rate_hz * pixel.sigma_s * (matched_filter.SCALE * valleys.TEMPLATE_AREA)
        return fired * (signal + background)

    def _expect_shaded(self, candidate: _Candidate, power_w: Lanes, expected: _Expected, peak: Peak) -> _Expected:
        """Expectation of a peak whose SPADs earlier light has fired, or that are back; of others ``expected``.

        Before the bins are drawn it is known to first order only (`_shadow`).
        """
        ops, value = self.ops, peak.expected
        if value is None:
            return expected
        place = candidate.place
        shaded = candidate.exists & peak.shaded & ~candidate.on_flank

        def expect() -> _Expected:
            range_m = self.filtered.range_m(place)
            alone = self._signal(self._point_at(range_m)[0], power_w)
            height = self._pixel_at(range_m).peak(alone).height
            part = ops.maximum(value, 0.0) / ops.maximum(height, 1e-6)
            dimmed = self._expect(place, power_w, part=part)
            return replace(
                dimmed,
                probability=dimmed.probability * expected.peaks,
                level=dimmed.level + 0.0 * place,
                peaks=expected.peaks + 0.0 * place,
            )

        same = replace(expected, level=expected.level + 0.0 * place, peaks=expected.peaks + 0.0 * place)
        return ops.where_any(shaded, expect, same)

    def _expect(self, place: Lanes, power_w: Lanes, *, part: Lanes | None = None) -> _Expected:
        """Expectation of a peak of the light behind the filter, (n,).

        part  its height over that of an echo of this power alone; None: by the light before it, to first order
        """
        point, level = self._point_at(self.filtered.range_m(place))
        assert point.law is not None
        signal = self._signal(point, power_w)
        shadow: Lanes = self._shadow(place, signal) if part is None else 0.0
        share: Lanes = 1.0 if part is None else part
        signal = share * signal
        broad = level - self._gain_of_breadth(point, place, power_w) + shadow
        if self.fluctuation is None:
            probability, lone = self._chances(point, broad, signal)
        else:
            lone = point.law.lone(broad, signal)
            # The threshold is that of the light that comes, P_d is the mean over all light that may come.
            mean_w = power_w / self.fluctuation.relative_power
            signal = share * self._signal(point, mean_w)
            mean_level = level - self._gain_of_breadth(point, place, mean_w) + shadow

            def probability_of(relative_power: Lanes) -> Lanes:
                return point.detection_probability(
                    mean_level, share * self._signal(point, mean_w * relative_power), 0.0
                )

            probability = scintillation.mean(probability_of, self.fluctuation.variance)
        return _Expected(snr=signal / point.noise.deviation, probability=probability, level=level, lone=lone)

    def _chances(self, point: WorkingPoint, threshold: Lanes, signal: Lanes) -> tuple[Lanes, Lanes]:
        """P_d of an echo, and how far its neighbours lack it, (n,) each."""
        assert point.law is not None
        ops, law, noise, histogram = self.ops, point.law, point.noise, self.sensor.histogram
        assert histogram is not None

        def compute() -> tuple[Array, Array]:
            zero = ops.full(signal, 0.0)
            return zero + point.detection_probability(threshold, signal, 0.0), zero + law.lone(threshold, signal)

        if self._multi_peak:  # in a loop over the peaks
            return compute()
        # Most echoes are sure, or there is none: packets of such lanes skip half a dozen tails.
        highest = threshold
        if histogram.threshold_spread is not None:
            highest = threshold * xp(histogram.threshold_spread).exp(PLACES[-1][0] * histogram.threshold_spread)
        deviation = ops.sqrt(noise.deviation * noise.deviation + noise.kappa_1 * signal)
        sure = signal - highest > _SURE * deviation
        certain = ops.where(sure, 1.0, 0.0)
        return ops.where_any(~sure & (signal > 0.0), compute, (certain, 1.0 - certain))

    def _signal(self, point: WorkingPoint, power_w: Lanes) -> Lanes:
        """Photons of a peak of the light behind the filter, (n,)."""
        return point.response.signal(self._lone_w(power_w))

    def _gain_of_breadth(self, point: WorkingPoint, place: Lanes, power_w: Lanes) -> Lanes:
        """Photons that noise gains on the broad peak of echoes that merge behind the filter, (n,) (T98a)."""
        if not self._multi_peak:
            return 0.0
        ops, signal = self.ops, self._signal(point, power_w)
        return matched_filter.gain_of_breadth(
            signal=signal,
            background=point.noise.deviation * point.noise.deviation,
            signal_variance=ops.maximum(point.noise.kappa_1 * signal + point.noise.kappa_2 * signal * signal, 0.0),
            bend=self.filtered.at(place)[2] / ops.maximum(power_w, 1e-30),
        )

    def _walk_s(self, pixel: Macropixel, peak: Peak) -> Lanes:
        """Pile-up shift that the receiver corrects, (n,) s: mostly negative."""
        calibrated = pixel.histogram.calibrated
        if calibrated is None:
            return 0.0
        trials = pixel.trials * (pixel.free if pixel.spad.coincidence == 1 else 1.0)
        shift = calibrated.at(
            height=peak.height / trials,
            narrowing=peak.height / self.ops.maximum(peak.photons * BOX_SHARE, 1e-6),
            sun=pixel.rate_hz * pixel.sigma_s,
        )
        return pixel.sigma_s * shift

    def _key(self, time_s: Lanes, value: Lanes) -> Lanes:
        """Sort key, (n,): returns with larger keys are kept first."""
        return {"first": -time_s, "last": time_s, "strongest": value}[self.sensor.tdc.keep]

    def _source(self, place: Lanes) -> tuple[Lanes, Lanes, Lanes]:
        """Number of the sub-echo with the most light at a peak, -1 for the air's even light, true range and status."""
        ops, wave = self.ops, self.filtered
        surfaces, end = self.train.surfaces, len(wave.centres) - self.train.stray
        strongest, number = ops.full(place, -1.0), ops.full(place, 0)
        surfaces_w, air_w, weighted, fold = (ops.full(place, 0.0) for _ in range(4))
        for k, (centre, height) in enumerate(zip(wave.centres[:end], wave.heights, strict=False)):
            ahead = centre - place
            part = height * ops.exp(-0.5 * ahead * ahead)
            if k < surfaces:
                surfaces_w, weighted = surfaces_w + part, weighted + part * ahead
                if self.folds_m is not None:
                    fold = ops.where(part > strongest, self.folds_m[k], fold)
            else:
                air_w = air_w + part
            number = ops.where(part > strongest, k, number)
            strongest = ops.maximum(part, strongest)
        lit = surfaces_w > 0.0
        mean = place + ops.where(lit, weighted / ops.where(lit, surfaces_w, 1.0), 0.0)
        range_m = wave.range_m(mean) + fold
        status = ops.where(fold > 0.0, int(Status.ALIASED), int(Status.ECHO))
        even: Lanes = 0.0
        if wave.volume is not None or end > surfaces:
            even = wave.air_w(place)
            weather = air_w + even > surfaces_w
            number = ops.where(weather & (even > strongest), -1, number)
            range_m = ops.where(weather, ops.maximum(wave.range_m(place), 0.0), range_m)
            status = ops.where(weather, int(Status.WEATHER), status)
        if not self.train.stray:
            return number, range_m, status
        # Stray light is no surface of this pulse: the return is of it where it is more than half of the light.
        ahead = wave.centres[end] - place
        is_stray = wave.heights[end] * ops.exp(-0.5 * ahead * ahead) > surfaces_w + air_w + even
        return (
            ops.where(is_stray, end, number),
            ops.where(is_stray, wave.range_m(wave.centres[end]), range_m),
            ops.where(is_stray, int(Status.STRAY), status),
        )

    def strongest(self) -> tuple[Array, Lanes]:
        """Number and range [m] of each pulse's strongest sub-echo of a surface, both (n,)."""
        ops, wave = self.ops, self.filtered
        number, highest = ops.full(wave.origin_m, 0), ops.full(wave.origin_m, 0.0)
        range_m = ops.full(wave.origin_m, 0.0)
        for k in range(self.train.surfaces):
            brighter = wave.heights[k] > highest
            echo_range_m = wave.range_m(wave.centres[k]) + (0.0 if self.folds_m is None else self.folds_m[k])
            number, range_m = ops.where(brighter, k, number), ops.where(brighter, echo_range_m, range_m)
            highest = ops.maximum(wave.heights[k], highest)
        return number, range_m

    def add_alarms(self, stops: tuple[_Stop, ...], number: Array, range_m: Lanes) -> tuple[_Stop, ...]:
        """Add the false alarms to the stops.

        number, range_m  (n,) source and true range that an alarm gets: those of the pulse's strongest sub-echo
        """
        ops, converter = self.ops, self.sensor.tdc
        sources: tuple[Interference, ...] = self.train.interference
        zero = ops.full(range_m, 0.0)
        for alarms in comparator.false_alarms(self, sources):
            for alarm in comparator.first_alarms(alarms, converter.stops):
                in_window = alarm.time_s < converter.window_s
                stop = _Stop(
                    key=ops.where(in_window, self._key(alarm.time_s, alarm.amplitude), _EMPTY),
                    time_s=alarm.time_s,
                    photons=alarm.amplitude,
                    snr=zero,
                    probability=zero,
                    source=number,
                    true_range_m=range_m,
                    status=ops.full(number, 0) + alarm_status(alarm.interfering),
                )
                stops = _insert(stops, stop)
        return stops

    def detection(
        self, state: _PeakSearch, stops: tuple[_Stop, ...], number: Array, alone: _Expected | None
    ) -> Detection:
        """Convert the stops to `Returns`, and find the outcome of each pulse; ``alone`` of `alone`."""
        ops = self.ops
        lit = state.highest_w > 0.0
        # The search passes no derivatives on, so the light of the highest peak is evaluated once more.
        highest = alone or self._expect(state.highest, ops.where(lit, self.filtered.at(state.highest)[0], 0.0))
        snr, probability = ops.where(lit, highest.snr, 0.0), ops.where(lit, highest.probability, 0.0)
        reported, has_echo = [], ops.full(self.light.origin_m, False)
        for stop in stops:
            occupied = stop.key > _EMPTY
            is_echo = occupied & ((stop.status == int(Status.ECHO)) | (stop.status == int(Status.ALIASED)))
            has_echo = has_echo | is_echo
            range_m = radiometry.range_from_time_of_flight_m(time_of_flight_s=stop.time_s)
            amplitude = ops.maximum(stop.photons, 0.0)
            value = reported_intensity(self, self.train, amplitude=amplitude, width_s=None, range_m=range_m)
            reported.append(
                Returns(
                    reported=occupied,
                    status=stop.status,
                    range_m=range_m,
                    amplitude=amplitude,
                    intensity=value,
                    snr=stop.snr if self._multi_peak else ops.where(is_echo, snr, stop.snr),
                    detection_probability=stop.probability
                    if self._multi_peak
                    else ops.where(is_echo, probability, stop.probability),
                    source=stop.source,
                    true_range_m=stop.true_range_m,
                    photons=amplitude,
                )
            )
        # Later lines overrule earlier ones: the first stage at which the pulse's echo was lost names the outcome.
        outcome = ops.where(has_echo, int(Outcome.KEPT), int(Outcome.HIDDEN))
        outcome = ops.where(state.in_window, outcome, int(Outcome.OUT_OF_WINDOW))
        outcome = ops.where(state.tripped, outcome, int(Outcome.BELOW_THRESHOLD))
        outcome = ops.where(self.train.has_surface, outcome, int(Outcome.NO_SURFACE))
        return Detection(
            snr=snr,
            detection_probability=probability,
            outcome=outcome,
            ambient=ambient.counts(self.train.background_power_w, self.sensor, seed=self.seed, pulse=self.pulse),
            stops=tuple(reported),
            source=number,
        )


def _insert(stops: tuple[_Stop, ...], new: _Stop) -> tuple[_Stop, ...]:
    """Insert a stop into a list in falling order of keys; the last one drops out."""
    ordered = []
    for old in stops:
        better = new.key > old.key
        ordered.append(select_state(better, new, old))
        new = select_state(better, old, new)
    return tuple(ordered)


def _sort_by_time(stops: tuple[_Stop, ...]) -> tuple[_Stop, ...]:
    """Sort the stops by time; unused ones come last."""
    ops = xp(stops[0].key)
    return _sort_by_key([replace(stop, key=ops.where(stop.key > _EMPTY, -stop.time_s, _EMPTY)) for stop in stops])


def _sort_by_key(stops: Sequence[_Stop]) -> tuple[_Stop, ...]:
    """Sort the stops by falling keys."""
    empty = replace(stops[0], key=xp(stops[0].key).full(stops[0].key, 2.0 * _EMPTY))
    ordered = (empty,) * len(stops)
    for stop in stops:
        ordered = _insert(ordered, stop)
    return ordered
