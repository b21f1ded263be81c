"""Bins: the counts of a pulse's histogram around an echo, and the filter that looks for its peak there.

The histogram of the whole window is never made. Only the bins around an echo are drawn, one after the other in order of
time: each count is binomial, of the SPADs that are still free, so pile-up and dead time need no approximation within
them. The counts of a bin belong to (seed, pulse, bin), whichever echo needs them.

Symbols: N trials, lambda rate of detections of one free SPAD, sigma width of an echo in the histogram.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from ...light.waveform import Waveform
from ...maths import random
from ...maths.arrays import Array, Lanes, Mask, Ops, xp
from ...maths.random import Seed, Stage
from ...physics.photon_counting import dead_time, matched_filter
from ...physics.photon_counting.pile_up import BOX
from ...sensor.detectors.macropixel import Macropixel
from .courses import Courses, EarlierFirings
from .tuning import FEW, LEAST_LEVEL

_BELOW_ALL = 1e9
"""Choice: photons that no value of the filter lies below its mean."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Peak:
    """The highest value of the filter near an echo; each field (n,).

    Attributes:
        value: value of the filter above the background, in photons
        height: the same between bins, at the top of the Gaussian through the value and its neighbours
        time_s: time of flight, with the shift by pile-up
        photons: photons of the echo: counts around the peak above those of the background
        exists: whether a searched bin is higher than its neighbours; all true where the search has no limits
        shaded: whether earlier light has changed by a percent how many SPADs are free
        expected: mean of the value there where it has; None: no light can have, or counts are corrected for it
    """

    value: Lanes
    height: Lanes
    exists: Mask
    time_s: Lanes
    photons: Lanes
    shaded: Mask
    expected: Lanes | None


@dataclass(frozen=True, slots=True, kw_only=True)
class _DrawState:
    """State of drawing the bins around an echo; each field (n,), with one entry per bin for ``firings`` and ``counts``.

    Attributes:
        number: number of the next bin, from the first one
        free: share of the SPADs that are free for the first time since the first bin
        silent: share that has not fired in these bins
        first_silent: share that has not fired in the first of them, whose SPADs come free within the bins
        trials: trials that have not fired in these bins, drawn
        again: trials that are free again after they have fired in these bins, drawn
        parts: light of each sub-echo in that bin (`light.waveform.Comb`)
        firings: firings of each bin
        counts: counts of each bin; None: they are the firings
    """

    number: Lanes
    free: Lanes
    silent: Lanes
    first_silent: Lanes
    trials: Lanes
    again: Lanes
    parts: tuple[Lanes, ...]
    firings: Array
    counts: Array | None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rates:
    """Numbers of one bin, computed once: what a loop computes it computes at each pass. Each a number or (n,).

    Attributes:
        of_watt: detections of a free SPAD for each watt
        background: those of the background
        released: share of the SPADs that comes free in even light, as many as fire
        dead_bins: dead time, in bins; 0 of SPADs that fire once
    """

    of_watt: Lanes
    background: Lanes
    released: Lanes
    dead_bins: Lanes


@dataclass(frozen=True, slots=True, kw_only=True)
class Bins:
    """Histograms of some pulses, of which only the bins around echoes are drawn.

    Attributes:
        pixel: SPADs under each pulse's background
        wave: light on the detector, as wide as echoes are in the histogram
        seed: 32-bit frame seed
        pulse: (n,) uint32 pulse numbers
    """

    pixel: Macropixel
    wave: Waveform
    seed: Seed
    pulse: Array

    @property
    def ops(self) -> Ops:
        """Array functions of the arrays' kind, NumPy's or Dr.Jit's."""
        return xp(self.wave.origin_m)

    def draw(self, place: Lanes, time_s: Lanes, *, behind: bool = False) -> tuple[Lanes, list[Lanes], EarlierFirings]:
        """Draw the counts around a place; returns the first bin's number, the counts, (n,) each, and what was before.

        Arguments as of `highest`.
        """
        pixel, ops = self.pixel, self.ops
        bin_s = pixel.histogram.bin_s
        # Bins are drawn in pairs: a random number has two words. So the first one is even.
        middle = ops.floor(time_s / bin_s)
        first = 2.0 * ops.floor(0.5 * (middle - pixel.histogram.reach))
        start = place + (first * bin_s + 0.5 * bin_s - time_s) / pixel.sigma_s
        before = Courses(pixel=pixel, wave=self.wave).earlier_firings(
            start, first * bin_s, time_s, place, behind=behind
        )
        return first, self._draw_counts(first, start, before, place), before

    def highest(
        self, place: Lanes, time_s: Lanes, *, behind: bool = False, limits_s: tuple[Lanes, Lanes] | None = None
    ) -> Peak:
        """Find the peak of the filter near a place of the waveform, at this time of flight.

        Args:
            behind: whether there is light before these bins even where a pulse has one echo
            limits_s: times of flight between which bins count that are higher than their neighbours, other echoes being
                near; None: the highest bin
        """
        pixel, histogram, ops = self.pixel, self.pixel.histogram, self.ops
        bin_s, reach, search = histogram.bin_s, histogram.reach, histogram.search
        first, counts, earlier = self.draw(place, time_s, behind=behind)
        background = pixel.count_rate_hz * bin_s
        values = self._filter_counts(counts, background)
        first_searched = reach - search - 1
        best, peak_bin = values[1], ops.full(place, first_searched + 1.0)
        before, after = values[0], values[2]
        exists = ops.full(place, limits_s is None)
        if limits_s is not None:
            # A bin belongs to the echo on whose side of the limit its middle lies.
            low, high = (limit_s / bin_s - 0.5 - first - first_searched for limit_s in limits_s)
            best = ops.full(place, -_BELOW_ALL)
        for k in range(1 if limits_s is not None else 2, len(values) - 1):
            better = values[k] > best
            if limits_s is not None:
                better = better & (values[k] > values[k - 1]) & (values[k] >= values[k + 1]) & (low <= k) & (k < high)
                exists = exists | better
            before, after = ops.where(better, values[k - 1], before), ops.where(better, values[k + 1], after)
            best, peak_bin = ops.where(better, values[k], best), ops.where(better, float(first_searched + k), peak_bin)
        offset, over_best = self._peak_offset(before, best, after)
        if histogram.estimator == "matched_filter":
            peak_bin = peak_bin + offset
        else:
            peak_bin = peak_bin + self._centroid(counts, background, peak_bin)
        photons = self._photons(counts, background, peak_bin)
        time_s = (first + peak_bin + 0.5) * bin_s
        return Peak(
            value=best,
            height=over_best * best,
            time_s=time_s,
            photons=photons,
            exists=exists,
            shaded=earlier.changed,
            expected=earlier.value,
        )

    def _draw_counts(self, first: Lanes, start: Lanes, before: EarlierFirings, middle: Lanes) -> list[Lanes]:
        """Draw the counts of each bin, (n,) each; corrected for pile-up if the sensor does so.

        Args:
            first: number of the first bin, even
            start: its place
            before: SPADs that fired before it
            middle: place of the echo
        """
        pixel, ops = self.pixel, self.ops
        bin_s, count, zero = pixel.histogram.bin_s, 2 * pixel.histogram.reach + 2, ops.full(start, 0.0)
        # The first bin is even, so that it may be one bin farther away.
        half = (pixel.histogram.reach + 2) * pixel.histogram.bin_to_sigma
        spacing = bin_s / pixel.sigma_s
        comb = self.wave.comb(start, spacing, middle, half=half, recurrent=True)
        background = pixel.rate_hz * bin_s
        rates = _Rates(
            of_watt=pixel.per_watt * bin_s,
            background=background,
            released=pixel.free * background,
            dead_bins=0.0 if pixel.spad.fires_once else pixel.spad.dead_time_s / bin_s,
        )
        trials, again = pixel.first_trials(before.free)
        begin = _DrawState(
            number=zero,
            free=zero + before.free,
            silent=ops.full(start, 1.0),
            first_silent=ops.full(start, 1.0),
            trials=zero + trials,
            again=zero + again,
            parts=tuple(comb.parts),
            firings=ops.room(start, count),
            counts=None if pixel.counts_firings else ops.room(start, count),
        )

        def step(state: _DrawState) -> _DrawState:
            # A random number has two words, so two bins share one.
            pair = ops.uint32(ops.int32(0.5 * (first + state.number)))
            words = random.words(seed=self.seed, stage=Stage.HISTOGRAM, pulse=self.pulse, draw=pair)
            for word in words:
                power_w = comb.power_w(start + state.number * spacing, state.parts)
                detections = ops.fma(power_w, rates.of_watt, rates.background)
                if before.due is not None:
                    due = ops.get(before.due, ops.int32(state.number))
                    detections = detections + ops.where(before.shaded, due, 0.0)
                state = self._draw_bin(state, before, rates, detections, random.open_uniform(word))
                state = replace(state, parts=comb.advance(state.parts))
            return state

        final = ops.loop(begin, lambda state: state.number < count - 0.5, step)
        counts = final.firings if final.counts is None else final.counts
        return [ops.get(counts, ops.full(first, i)) for i in range(count)]

    def _draw_bin(
        self, state: _DrawState, before: EarlierFirings, rates: _Rates, detections: Lanes, uniform: Lanes
    ) -> _DrawState:
        """Draw the firings of the next bin and its counts (T105).

        How many SPADs are free is not known, only how many have fired in these bins: the others fire with the share
        that the renewal course gives of them, so the counts of a dead time are multinomial.

        Args:
            detections: x, detections of a free SPAD in the bin
            uniform: in (0, 1]
        """
        pixel, ops = self.pixel, self.ops
        released = self._released(state.number, before, rates)
        of_free, of_released = dead_time.firing_parts(detections=detections, branch=True)
        share = ops.fma(state.free, of_free, released * of_released)
        silent, zero = ops.maximum(state.silent, 1e-6), ops.full(state.number, 0.0)

        def with_second() -> tuple[Lanes, ...]:
            revived = self._revived(state, rates)
            if pixel.knows_free:
                # The counts before these bins are known too.
                revived = revived + pixel.trials * released
            # Of the trials that may fire the first ones have the mean trials share / silent, the second ones that of
            # free SPADs. One division gives the mean probability and the share of the second ones.
            of_again = silent * (state.again * of_free + revived * of_released)
            of_all = ops.maximum(state.trials * share + of_again, 1e-15)
            pool = ops.maximum(state.trials + state.again + revived, 1e-6)
            inverse = 1.0 / (of_all * silent * pool)
            return pool, of_all * of_all * inverse, of_again * silent * pool * inverse, revived

        drawn: tuple[Lanes, ...] = state.trials, share / silent, zero, zero
        if pixel.knows_free:
            drawn = with_second()
        elif not pixel.spad.fires_once:
            # Most bins are nearer to the first one than a dead time, or few SPADs have fired in the first ones.
            returning = (state.number > rates.dead_bins - 1.0) & (state.first_silent < 1.0 - FEW)
            drawn = ops.where_any(returning, with_second, drawn)
        pool, probability, second, revived = drawn
        known_free, index = state.again + 0.5 * revived, ops.int32(state.number)
        firings, counted = pixel.draw(pool=pool, probability=probability, known_free=known_free, uniform=uniform)
        counts = None if state.counts is None else ops.put(state.counts, index, counted)
        # Which of the firings are second ones is not drawn: as many as expected.
        again = firings * second
        still_silent, count = state.silent - share, 2.0 * pixel.histogram.reach + 2.0
        return replace(
            state,
            number=state.number + 1.0,
            free=state.free + released - share,
            silent=still_silent,
            first_silent=ops.where(state.number < count - rates.dead_bins, still_silent, state.first_silent),
            trials=ops.maximum(state.trials - (firings - again), 0.0),
            again=ops.maximum(state.again + revived - again, 0.0),
            firings=ops.put(state.firings, index, firings),
            counts=counts,
        )

    def _released(self, number: Lanes, before: EarlierFirings, rates: _Rates) -> Lanes:
        """Share of the SPADs, fired before the first bin, that come free in this one, (n,)."""
        pixel, ops = self.pixel, self.ops
        if pixel.spad.fires_once:
            return ops.full(number, 0.0)
        # Beyond a dead time those come free that have fired in the bins.
        released = rates.released
        if before.released is not None:
            released = ops.where(before.shaded, ops.get(before.released, ops.int32(number)), released)
        return released * ops.minimum(ops.maximum(rates.dead_bins - number, 0.0), 1.0)

    def _revived(self, state: _DrawState, rates: _Rates) -> Lanes:
        """Firings of the drawn bins that come free in the next one, a dead time later, (n,)."""
        ops, total = self.ops, self.ops.full(state.number, 0.0)
        if self.pixel.spad.fires_once:
            return total
        # Firings are spread over their bin, so those of two bins come free in each.
        age = state.number - rates.dead_bins
        late = ops.floor(age)
        for index, share in ((late, 1.0 - (age - late)), (late + 1.0, age - late)):
            inside = (index >= 0.0) & (index < state.number)
            fired = ops.get(state.firings, ops.int32(ops.where(inside, index, 0.0)))
            total = total + ops.where(inside, share * fired, 0.0)
        return total

    def _filter_counts(self, counts: list[Lanes], background: Lanes) -> list[Lanes]:
        """Filter the counts: values above the background at the searched bins and beside them, (n,) each; (T95)."""
        pixel, ops = self.pixel, self.ops
        reach, search = pixel.histogram.reach, pixel.histogram.search
        side = reach - search - 1
        step = pixel.histogram.bin_s / (matched_filter.TEMPLATE * pixel.sigma_s)
        # Of a Gaussian at even distances the factor from one weight to the next shrinks by a constant factor.
        falls, shrinks = ops.exp(-0.5 * step * step), ops.exp(-step * step)
        weights: list[Lanes] = [matched_filter.SCALE]
        for _ in range(side):
            weights.append(weights[-1] * falls)
            falls = falls * shrinks
        total = weights[0] + 2.0 * sum(weights[1:], 0.0)
        values: list[Lanes] = []
        for centre in range(reach - search - 1, reach + search + 3):
            value = weights[0] * counts[centre]
            for k in range(1, side + 1):
                value = ops.fma(weights[k], counts[centre - k] + counts[centre + k], value)
            values.append(value - total * background)
        return values

    def _peak_offset(self, before: Lanes, best: Lanes, after: Lanes) -> tuple[Lanes, Lanes]:
        """Place of the peak in bins from the highest value, of the Gaussian through it and its neighbours.

        Returns its height over that value too.
        """
        ops = self.ops
        lowest = ops.maximum(LEAST_LEVEL * best, 1e-20)
        low, top, high = (ops.log(ops.maximum(height, lowest)) for height in (before, best, after))
        bend = low - 2.0 * top + high
        flat = bend > -1e-9
        offset = 0.5 * (low - high) / ops.where(flat, -1.0, bend)
        offset = ops.where(flat, 0.0, ops.minimum(ops.maximum(offset, -0.5), 0.5))
        return offset, ops.exp(0.25 * (high - low) * offset)

    def _centroid(self, counts: list[Lanes], background: Lanes, middle: Lanes) -> Lanes:
        """Centroid of the counts above the background within 2.4 sigmas of a bin, in bins from it."""
        ops = self.ops
        half = BOX * self.pixel.sigma_s / self.pixel.histogram.bin_s
        total, moment = ops.full(middle, 0.0), ops.full(middle, 0.0)
        for i, count in enumerate(counts):
            offset = i - middle
            # The bins at both ends count by the part that lies inside.
            share = ops.minimum(ops.maximum(half + 0.5 - ops.abs(offset), 0.0), 1.0)
            inside = share * (count - background)
            total, moment = total + inside, moment + offset * inside
        return ops.minimum(ops.maximum(moment / ops.maximum(total, 1.0), -half), half)

    def _photons(self, counts: list[Lanes], background: Lanes, middle: Lanes) -> Lanes:
        """Counts above the background within 2.4 sigmas of a place, which is in bins from the first one's centre."""
        ops = self.ops
        half = BOX * self.pixel.sigma_s / self.pixel.histogram.bin_s
        total: Lanes = ops.full(middle, 0.0)
        for i, count in enumerate(counts):
            # The bins at both ends count by the part that lies inside, or the number would jump with the place.
            inside = ops.minimum(ops.maximum(half + 0.5 - ops.abs(i - middle), 0.0), 1.0)
            total = total + inside * (count - background)
        return self.pixel.photons_of_box(ops.maximum(total, 0.0))
