"""Peaks: finder for receivers that sum many shots into a histogram and report its peaks.

The expected histogram after the filter is a sum of broadened echoes. Each of its peaks is a candidate, and each echo
on the flank of a peak: noise may lift it out (`candidates`). The counts around a candidate are drawn (`bins`), filtered
and compared with the threshold. The rest of the window holds noise alone, of which only the peaks above the threshold
matter: a Poisson process, as for a comparator (docs/photon_counting.md).

A "pulse" is one point here: all of its shots together.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from ...light.echoes import EchoTrain
from ...light.waveform import waveform
from ...maths import random
from ...maths.arrays import Array, Lanes, Mask
from ...maths.random import Seed
from ...physics.optics import radiometry
from ...physics.photon_counting import dead_time, matched_filter, pile_up
from ...sensor.detectors.macropixel import Macropixel
from ...sensor.sensor_model import Sensor
from .. import comparator
from .. import stops as stop_list
from ..outcomes import Status
from ..sources import brightest, of_number, strongest
from ..stops import EMPTY, Found, Stop, Stops
from .bins import Bins, Peak
from .candidates import Candidate, visit_candidates
from .expectation import Expected, FilteredLight, broaden
from .folding import fold
from .tuning import ASIDE, LOWEST_HUMP, NEVER


@dataclass(frozen=True, slots=True, kw_only=True)
class _PeakSearch:
    """State of the search over the peaks of each pulse; each field (n,).

    Attributes:
        tripped: whether the filter exceeded the threshold at any peak
        in_window: whether it did within the window
        last_s: time of the last return
        revived_s: time of the last return of SPADs that come back
        highest: place of the highest peak of the light
        highest_w: power there
        stops: returns so far, best first
    """

    tripped: Mask
    in_window: Mask
    last_s: Lanes
    revived_s: Lanes
    highest: Lanes
    highest_w: Lanes
    stops: Stops


@dataclass(frozen=True, slots=True, kw_only=True)
class Peaks(FilteredLight):
    """Search of the histograms of some pulses for their peaks."""

    @classmethod
    def of(cls, train: EchoTrain, sensor: Sensor, *, seed: Seed, pulse: Array) -> Peaks:
        """Prepare the search; arguments as of `receiver.detect`."""
        histogram, background = sensor.histogram, train.background_power_w
        assert histogram is not None
        light = fold(train, histogram)
        point, pixel = sensor.working_point(background), sensor.pixel(background)
        # One number for each point sets the threshold for all of its peaks (T111).
        words = random.words(seed=seed, stage=random.Stage.THRESHOLD, pulse=pulse)
        level, deviate = sensor.threshold(point), random.normal_pair(words)[0]
        return cls(
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
            fluctuation=train.fluctuation,
        )

    def search(self) -> Found:
        """Visit all peaks of the expected histogram and keep the best returns of each pulse."""
        ops, like, wave, converter = self.ops, self.light.origin_m, self.filtered, self.sensor.tdc
        zero, never, number = ops.full(like, 0.0), ops.full(like, False), ops.full(like, 0)
        empty = Stop(
            key=ops.full(like, EMPTY),
            reported_s=zero,
            amplitude=zero,
            snr=zero,
            detection_probability=zero,
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
            stops=stop_list.empty_stops(converter, empty),
        )
        if self.has_several:
            state = visit_candidates(self, self._add_peak, start)
            # The search passes no derivatives on, so the light of the highest peak is evaluated once more.
            lit = state.highest_w > 0.0
            highest = self.expect(state.highest, ops.where(lit, wave.at(state.highest)[0], 0.0))
        else:
            # The only echo is the only peak.
            highest, power_w = self.expect(zero, wave.heights[0]), wave.heights[0]
            only = Candidate(
                exists=power_w > 0.0, place=zero, on_flank=never, low=zero, high=zero, previous=zero, following=zero
            )
            state = self._add_peak(only, power_w, highest, start)
            lit = state.highest_w > 0.0
        source, range_m = strongest(wave, self.train.surfaces, self.folds_m)
        return Found(
            stops=stop_list.best_first(converter, state.stops),
            tripped=state.tripped,
            in_window=state.in_window,
            snr=ops.where(lit, highest.snr, 0.0),
            detection_probability=ops.where(lit, highest.probability, 0.0),
            source=source,
            true_range_m=range_m,
        )

    def _add_peak(self, candidate: Candidate, power_w: Lanes, expected: Expected, state: _PeakSearch) -> _PeakSearch:
        """Add a candidate and its return to the search, which chance must be able to make.

        Args:
            power_w: (n,) power of the filtered light there
        """
        ops, exists, place = self.ops, candidate.exists, candidate.place
        higher = exists & (power_w > state.highest_w)
        state = replace(
            state,
            highest=ops.where(higher, place, state.highest),
            highest_w=ops.where(higher, power_w, state.highest_w),
        )
        likely = exists & (expected.probability > NEVER)
        drawn = replace(candidate, exists=likely)
        state = ops.where_any(likely, lambda: self._add_return(drawn, power_w, expected, state), state)
        if not self._sees_humps:
            return state
        pixel = self.pixel
        detections = pixel.detections(self.lone_w(power_w))
        by_echo, by_sun = (dead_time.firing_share(detections=x) for x in (detections, pixel.sun * pixel.blind_sigmas))
        peaks = likely & ~candidate.on_flank if self.has_several else likely
        high = peaks & (pixel.height_of_free(by_echo * by_sun) > LOWEST_HUMP * expected.level)
        return ops.where_any(high, lambda: self._add_revived(high, place, detections, expected, state), state)

    @property
    def _sees_humps(self) -> bool:
        """True if SPADs that come back a dead time behind an echo can make a return.

        They are fewer than those that the echo fired, so the strongest return is never theirs. Coates' correction knows
        how many SPADs are free.
        """
        sensor, pixel = self.sensor, self.pixel
        only_strongest = sensor.tdc.stops == 1 and sensor.tdc.keep == "strongest"
        return pixel.has_humps and not only_strongest

    def _add_return(self, candidate: Candidate, power_w: Lanes, expected: Expected, state: _PeakSearch) -> _PeakSearch:
        """Draw the bins around a candidate and add its return to the search; arguments as of `_add_peak`."""
        ops, sensor, converter, place = self.ops, self.sensor, self.sensor.tdc, candidate.place
        range_m = self.filtered.range_m(place)
        arrival_s = radiometry.time_of_flight_s(range_m=range_m)
        pixel = self.pixel_at(range_m)
        detections = pixel.detections(self.lone_w(power_w))
        early = pixel.sigma_s * pile_up.shift(detections=detections, sun=pixel.sun, dead=pixel.blind_sigmas)
        bins = Bins(pixel=pixel, wave=self.light, seed=self.seed, pulse=self.pulse)
        limits_s = None
        if self.has_several:
            limits_s = (
                radiometry.time_of_flight_s(range_m=self.filtered.range_m(candidate.low)) + early,
                radiometry.time_of_flight_s(range_m=self.filtered.range_m(candidate.high)) + early,
            )
        at = place * matched_filter.OUTPUT_WIDTH + early / pixel.sigma_s
        peak = bins.highest(at, arrival_s + early, limits_s=limits_s)
        if peak.expected is not None:
            shaded = candidate.exists & peak.shaded & ~candidate.on_flank
            expected = self.expect_shaded(place, power_w, expected, value=peak.expected, shaded=shaded)
        threshold = pixel.histogram.threshold_of_point(expected.level, self.deviate, expected.lone)
        tripped = candidate.exists & peak.exists & (peak.value >= threshold)
        time_s = self._reported_s(pixel, peak)
        # The peak that is found for an echo on a flank may be that beside it, which is blanked.
        found_s = ops.where(candidate.on_flank, time_s, arrival_s)
        accepted = tripped & comparator.accepts_crossing(sensor, found_s) & comparator.is_range(time_s)
        apart: Mask = time_s - state.last_s >= converter.dead_time_s
        stops = state.stops
        if self.has_several:
            accepted, stops = self._keep_first(
                accepted & (candidate.on_flank | apart), candidate.on_flank, time_s, stops
            )
            last_s = ops.where(accepted & ~candidate.on_flank, time_s, state.last_s)
        else:
            accepted = accepted & apart
            last_s = ops.where(accepted, time_s, state.last_s)
        source, true_range, status = self._source(place)
        key = stop_list.sort_key(sensor.tdc, time_s, peak.value)
        stop = Stop(
            key=ops.where(accepted, key, EMPTY),
            reported_s=time_s,
            amplitude=peak.photons,
            snr=expected.snr,
            detection_probability=expected.probability,
            source=source,
            true_range_m=true_range,
            status=status,
        )
        return replace(
            state,
            tripped=state.tripped | tripped,
            in_window=state.in_window | accepted,
            last_s=last_s,
            stops=stop_list.insert_stop(converter, stops, stop),
        )

    def _keep_first(self, accepted: Mask, on_flank: Mask, time_s: Lanes, stops: Stops) -> tuple[Mask, Stops]:
        """Hold the return of an echo on a flank, which is visited after all peaks, to the distance from the others.

        Returns:
            whether it is accepted, and the stops without those that lie less than that distance behind it. A peak of
            the histogram that is a return already is no second one: two are two bins apart at least.
        """
        ops, separation_s = self.ops, self.sensor.tdc.dead_time_s
        assert self.sensor.histogram is not None
        for stop in stops:
            behind_s, occupied = time_s - stop.time_s, stop.occupied
            same = ops.abs(behind_s) < self.sensor.histogram.bin_s
            near = (behind_s >= 0.0) & (behind_s < separation_s)
            accepted = accepted & ~(occupied & (same | (on_flank & near)))
        kept = []
        for stop in stops:
            ahead_s = stop.time_s - time_s
            loses = accepted & on_flank & (ahead_s > 0.0) & (ahead_s < separation_s)
            kept.append(stop.only_where(~loses))
        return accepted, tuple(kept)

    def _add_revived(
        self, exists: Mask, place: Lanes, detections: Lanes, expected: Expected, state: _PeakSearch
    ) -> _PeakSearch:
        """Search where the SPADs that a peak has fired come back together; adds a return of them to the search.

        A later echo is held to the distance from the last echo, not from these: nothing is known of them when the peaks
        are visited.

        Args:
            place: (n,) place of the peak whose SPADs they are
            detections: (n,) Lambda of that peak
            expected: expectation of that peak
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
        for aside in (-ASIDE, ASIDE):
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
        accepted = accepted & (time_s - state.revived_s >= ops.maximum(2.0 * ASIDE * pixel.sigma_s, apart_s))
        source, true_range, _ = self._source(place)
        key = stop_list.sort_key(sensor.tdc, time_s, peak.value)
        stop = Stop(
            key=ops.where(accepted, key, EMPTY),
            reported_s=time_s,
            amplitude=peak.photons,
            snr=point.snr(height),
            detection_probability=point.detection_probability(level, signal, 0.0),
            source=source,
            true_range_m=true_range,
            status=ops.full(source, int(Status.REVIVED)),
        )
        return replace(
            state,
            revived_s=ops.where(accepted, time_s, state.revived_s),
            stops=stop_list.insert_stop(sensor.tdc, state.stops, stop),
        )

    def _reported_s(self, pixel: Macropixel, peak: Peak) -> Lanes:
        """Time of flight that the receiver reports of a peak, (n,) s."""
        return comparator.converted_time_s(self, peak.time_s - self._walk_s(pixel, peak))

    def _walk_s(self, pixel: Macropixel, peak: Peak) -> Lanes:
        """Pile-up shift that the receiver corrects, (n,) s: mostly negative."""
        calibrated = pixel.histogram.calibrated
        if calibrated is None:
            return 0.0
        shift = calibrated.at(
            height=peak.height / pixel.free_trials,
            narrowing=peak.height / self.ops.maximum(peak.photons * pile_up.BOX_SHARE, 1e-6),
            sun=pixel.rate_hz * pixel.sigma_s,
        )
        return pixel.sigma_s * shift

    def _source(self, place: Lanes) -> tuple[Lanes, Lanes, Lanes]:
        """Number of the sub-echo with the most light at a peak, -1 for the air's even light, true range and status."""
        ops, wave = self.ops, self.filtered
        surfaces, end = self.train.surfaces, len(wave.centres) - self.train.stray
        surface, air = brightest(wave, place, 0, surfaces), brightest(wave, place, surfaces, end)
        number = ops.where(air.highest > surface.highest, air.number, surface.number)
        fold = ops.full(place, 0.0) if self.folds_m is None else of_number(self.folds_m, surface.number)
        range_m = wave.range_m(surface.mean) + fold
        status = ops.where(fold > 0.0, int(Status.ALIASED), int(Status.ECHO))
        even: Lanes = 0.0
        if wave.volume is not None or end > surfaces:
            even = wave.air_w(place)
            weather = air.total + even > surface.total
            number = ops.where(weather & (even > ops.maximum(air.highest, surface.highest)), -1, number)
            range_m = ops.where(weather, ops.maximum(wave.range_m(place), 0.0), range_m)
            status = ops.where(weather, int(Status.WEATHER), status)
        if not self.train.stray:
            return number, range_m, status
        # Stray light is no surface of this pulse: the return is of it where it is more than half of the light.
        ahead = wave.centres[end] - place
        is_stray = wave.heights[end] * ops.exp(-0.5 * ahead * ahead) > surface.total + air.total + even
        return (
            ops.where(is_stray, end, number),
            ops.where(is_stray, wave.range_m(wave.centres[end]), range_m),
            ops.where(is_stray, int(Status.STRAY), status),
        )
