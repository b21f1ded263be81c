"""Bins: the counts of a pulse's histogram around an echo, and the filter that looks for its peak there.

The histogram of the whole window is never made. Only the bins around an echo are drawn, one after the other in order of
time: each count is binomial, of the SPADs that are still free, so pile-up and dead time need no approximation within
them. The counts of a bin belong to (seed, pulse, bin), whichever echo needs them.

Symbols: N trials, lambda rate of detections of one free SPAD, sigma width of an echo in the histogram.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ...light.echoes import Volume
from ...light.waveform import Waveform
from ...maths import random
from ...maths.arrays import Array, Lanes, Mask, Ops, xp
from ...maths.random import Seed, Stage
from ...physics.photon_counting import dead_time, draws, matched_filter, pile_up
from ...physics.photon_counting.pile_up import BOX
from ...sensor.detectors.spad_detector import Macropixel
from .shadows import DEAD_TIMES, Shadow

BOX_SHARE = math.erf(BOX / math.sqrt(2.0))

_LEAST = 1e-3
"""Values beside the filter's peak below this share of it count as that much: their logarithm gives the peak's place."""

_BELOW_ALL = 1e9
"""Photons that no value of the filter lies below its mean."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Peak:
    """The highest value of the filter near an echo; each field (n,).

    value    value of the filter above the background, in photons
    height   the same between bins, at the top of the Gaussian through the value and its neighbours
    time_s   time of flight, with the shift by pile-up
    photons  photons of the echo: counts around the peak above those of the background
    exists   whether a searched bin is higher than its neighbours; all true where the search has no limits
    shaded   whether earlier light has changed by a percent how many SPADs are free
    expected  mean of the value there where it has; None: no light can have, or counts are corrected for it
    """

    value: Lanes
    height: Lanes
    exists: Mask
    time_s: Lanes
    photons: Lanes
    shaded: Mask
    expected: Lanes | None


_FEW = 2e-3
"""Share of the SPADs that may be left out when they come free again, or when earlier light fires them: 0.1 % of the
noise in any light."""

_NOTHING_BEFORE = 4.5
"""Widths (sigmas) behind the first bin from which on an echo has no light before it."""


_LEAD = 3.0
"""Widths (sigmas) before the first bin from which on SPADs are followed: light there is as exact as in the bins."""

_CHANGED = 0.01
"""Change of the free share from which on an echo has its own expectation: it moves P_d by some 0.005."""

_BESIDE = (-0.8, 0.0, 0.8)
"""Places in sigmas about a peak, of whose expected values a parabola gives the highest."""

_BACK = (3, 2, 1, 0)
"""Dead times before the bins at which SPADs are followed, the earliest first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Before:
    """SPADs that fired before the first bin; each (n,), or a room with an entry for each bin.

    free      share that is free at the first bin
    released  share that comes free in each bin a dead time after it has fired; None: that of even light
    due       afterpulses in each bin of those that light of its own fired, for each free SPAD; None: there are none
    shaded    whether light came before the bins: else the rooms hold nothing
    value     mean of the filter's value then, in photons; None: not followed
    changed   whether the free share is another one than in even light
    """

    free: Lanes
    released: Array | None = None
    due: Array | None = None
    shaded: Mask = False
    value: Lanes | None = None
    changed: Mask = False


@dataclass(frozen=True, slots=True, kw_only=True)
class _Course:
    """Course of the free SPADs some dead times before the drawn bins, or within them; each field (n,).

    free   share that is free when a step begins
    due    afterpulses a step that free ones are to have, above those of even light
    parts  light of each sub-echo in the step (`light.waveform.Comb`)
    """

    free: Lanes
    due: Lanes
    parts: tuple[Lanes, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Following:
    """State of following the courses; each field (n,), rooms of `_Before`.

    number   number of the next step, from the first bin: negative before it
    courses  those of `_BACK`
    free     share that is free at the first bin
    values   counts behind the filter's template so far, at some places
    """

    number: Lanes
    courses: tuple[_Course, ...]
    free: Lanes
    values: tuple[Lanes, ...]
    released: Array
    due: Array | None


@dataclass(frozen=True, slots=True, kw_only=True)
class _DrawState:
    """State of drawing the bins around an echo; each field (n,), with one entry per bin for ``firings`` and ``counts``.

    number   number of the next bin, from the first one
    free     share of the SPADs that are free for the first time since the first bin
    silent   share that has not fired in these bins
    trials   trials that have not fired in these bins, drawn
    again    trials that are free again after they have fired in these bins, drawn
    revived  trials that come free again in the next bin, drawn
    parts    light of each sub-echo in that bin (`light.waveform.Comb`)
    firings  firings of each bin
    counts   counts of each bin; None: they are the firings
    """

    number: Lanes
    free: Lanes
    silent: Lanes
    trials: Lanes
    again: Lanes
    revived: Lanes
    parts: tuple[Lanes, ...]
    firings: Array
    counts: Array | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Bins:
    """Histograms of some pulses, of which only the bins around echoes are drawn.

    pixel  SPADs under each pulse's background
    wave   light on the detector, as wide as echoes are in the histogram
    seed   32-bit frame seed
    pulse  (n,) uint32 pulse numbers
    """

    pixel: Macropixel
    wave: Waveform
    seed: Seed
    pulse: Array

    @property
    def ops(self) -> Ops:
        """Array functions of the arrays' kind, NumPy's or Dr.Jit's."""
        return xp(self.wave.origin_m)

    def draw(self, place: Lanes, time_s: Lanes, *, behind: bool = False) -> tuple[Lanes, list[Lanes], _Before]:
        """Draw the counts around a place; returns the first bin's number, the counts, (n,) each, and what was before.

        Arguments as of `highest`.
        """
        pixel, ops = self.pixel, self.ops
        bin_s = pixel.histogram.bin_s
        # Bins are drawn in pairs: a random number has two words. So the first one is even.
        middle = ops.floor(time_s / bin_s)
        first = 2.0 * ops.floor(0.5 * (middle - pixel.histogram.reach))
        start = place + (first * bin_s + 0.5 * bin_s - time_s) / pixel.sigma_s
        before = self._before(start, first * bin_s, time_s, place, behind=behind)
        return first, self._draw_counts(first, start, before, place), before

    def highest(
        self, place: Lanes, time_s: Lanes, *, behind: bool = False, limits_s: tuple[Lanes, Lanes] | None = None
    ) -> Peak:
        """Find the peak of the filter near a place of the waveform, at this time of flight.

        behind    whether there is light before these bins even where a pulse has one echo
        limits_s  times of flight between which bins count that are higher than their neighbours, other echoes being
                  near; None: the highest bin
        """
        pixel, histogram, ops = self.pixel, self.pixel.histogram, self.ops
        bin_s, reach, search = histogram.bin_s, histogram.reach, histogram.search
        first, counts, earlier = self.draw(place, time_s, behind=behind)
        background = pixel.count_rate_hz * bin_s
        values = self._filter_counts(counts, background)
        first_searched = reach - search - 1
        best, peak_bin = values[1], 0.0 * place + (first_searched + 1.0)
        before, after = values[0], values[2]
        exists = place == place
        if limits_s is not None:
            # A bin belongs to the echo on whose side of the limit its middle lies.
            low, high = (limit_s / bin_s - 0.5 - first - first_searched for limit_s in limits_s)
            best, exists = 0.0 * place - _BELOW_ALL, place != place
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

    def _before(self, start: Lanes, time_s: Lanes, echo_s: Lanes, middle: Lanes, *, behind: bool) -> _Before:
        """SPADs that background, nearer echoes and the air have fired before the first bin.

        start, time_s   place and time of flight of that bin
        echo_s, middle  time of flight and place of the echo, for which the pixel is
        behind          as of `highest`
        """
        pixel, wave = self.pixel, self.wave
        free, fires_once = pixel.free, pixel.spad.stamps == "first"
        if fires_once:
            armed = pixel.armed_s + time_s - echo_s
            free = dead_time.free_share_of_first(rate_hz=pixel.rate_hz, time_s=armed)
        if len(wave.centres) == 1 and wave.volume is None and not behind:
            # The pulse's only echo is the one in these bins.
            return _Before(free=free)
        # Places count from the nearest echo.
        shaded: Mask = start > -_NOTHING_BEFORE if behind else self._echoes_fire(start)
        if wave.volume is not None:
            shaded = shaded | self._air_fires(wave.volume, start)
        return self._follow(start, time_s, shaded, free, middle)

    def _echoes_fire(self, start: Lanes) -> Mask:
        """Whether echoes that begin before a place fire enough SPADs to be missed there, (n,)."""
        pixel, ops = self.pixel, self.ops
        power_w: Lanes = 0.0
        for centre, height in zip(self.wave.centres, self.wave.heights, strict=True):
            power_w = power_w + ops.where(centre - start < _NOTHING_BEFORE, height, 0.0)
        return power_w * (pixel.per_watt * pixel.sigma_s * math.sqrt(2.0 * math.pi)) > _FEW

    def _air_fires(self, air: Volume, start: Lanes) -> Mask:
        """Whether the air's light fires enough SPADs before a place to be missed there, (n,)."""
        pixel = self.pixel
        if pixel.spad.stamps == "first":
            return air.scale > 0.0  # none that has fired since the pulse left comes back
        # Older firings count in the light of the dead times before only.
        earliest_m = self.wave.range_m(start - (DEAD_TIMES + 1) * pixel.blind_sigmas)
        return air.highest_w(earliest_m) * pixel.per_watt * pixel.spad.dead_time_s > _FEW

    def _follow(self, start: Lanes, time_s: Lanes, shaded: Mask, even: Lanes, middle: Lanes) -> _Before:
        """Follow the SPADs through the light before the bins, three dead times to none before (T100), (T109).

        even    free share in even light
        middle  place beside which the filter's highest value is expected

        What fires a dead time before comes free in the bins, as sharply as the light that fired it came.
        """
        pixel, ops = self.pixel, self.ops
        spad, bin_s = pixel.spad, pixel.histogram.bin_s
        step, dead = bin_s / pixel.sigma_s, pixel.blind_sigmas
        zero, count = 0.0 * start, 2 * pixel.histogram.reach + 2
        # An echo that ends shortly before the bins is followed too.
        fires_once = spad.stamps == "first"
        lead = 0 if fires_once else math.ceil(_LEAD / pixel.histogram.bin_to_sigma)
        followed = (0,) if fires_once else _BACK
        begin, early = start - lead * step, lead + 0.5

        def shares() -> tuple[Lanes, ...]:
            shadow = Shadow.before(pixel, self.wave, start - early * step, time_s - early * bin_s)
            dues = [0.0] * len(followed) if spad.afterpulse is None else [shadow.due_hz(pixel, n) for n in followed]
            return tuple(zero + even * share for share in (*(shadow.free(n) for n in followed), *dues))

        of_even = (1.0,) * len(followed) + (0.0,) * len(followed)
        first = ops.where_any(shaded, shares, tuple(zero + even * share for share in of_even))
        steps = lead + count - 1
        combs = [
            self.wave.comb(
                begin - back * dead,
                step,
                begin + 0.5 * steps * step - back * dead,
                half=0.5 * steps * pixel.histogram.bin_to_sigma,
            )
            for back in followed
        ]
        fired_evenly = 0.0 if fires_once else pixel.free * pixel.rate_hz * bin_s
        scale = 1.0 / matched_filter.TEMPLATE
        state = _Following(
            number=zero - lead,
            courses=tuple(
                _Course(free=free, due=due_hz * bin_s, parts=tuple(comb.parts))
                for free, due_hz, comb in zip(first, first[len(followed) :], combs, strict=False)
            ),
            free=first[len(followed) - 1],
            values=(zero,) * len(_BESIDE),
            released=ops.room(start, count),
            due=None if spad.afterpulse is None else ops.room(start, count),
        )

        def follow_step(state: _Following) -> _Following:
            place, index = start + state.number * step, ops.int32(ops.maximum(state.number, 0.0))
            courses, released, caught = [], fired_evenly, zero
            room, due_room = state.released, state.due
            for back, comb, course in zip(followed, combs, state.courses, strict=True):
                if back == 0:
                    room = ops.put(room, index, zero + released)
                light = comb.power_w(place - back * dead, course.parts) * (pixel.per_watt * bin_s)
                of_free, of_released = dead_time.firing_parts(detections=light + pixel.rate_hz * bin_s)
                fired, due = course.free * of_free + released * of_released, course.due
                if due_room is not None and spad.afterpulse is not None and spad.afterpulse_s is not None:
                    # As in `dead_time.firing_shares`: they fire, light fires their SPADs, or they go on.
                    others = light + pixel.primary_hz * bin_s
                    gone = others + bin_s / spad.afterpulse_s
                    at_once, late = dead_time.firing_parts(detections=gone)
                    returned = ops.exp(-spad.dead_time_s / spad.afterpulse_s) * caught
                    again = (due * at_once + returned * late) / gone
                    if back == 0:
                        due_room = ops.put(due_room, index, again / ops.maximum(course.free + 0.5 * released, 1e-6))
                    fired, due = fired + again, due + returned - again * gone
                    caught = again * others + (fired - fired_evenly) * (spad.afterpulse * bin_s / spad.afterpulse_s)
                courses.append(_Course(free=course.free + released - fired, due=due, parts=comb.advance(course.parts)))
                released = fired
            in_bins = state.number > -0.5
            counted = ops.where(in_bins, pixel.coincidence_probability(released) - pixel.count_share, 0.0)
            offsets = ((place - middle - beside) * scale for beside in _BESIDE)
            return _Following(
                number=state.number + 1.0,
                courses=tuple(courses),
                free=ops.where(in_bins, state.free, courses[-1].free),
                values=tuple(
                    value + counted * ops.exp(-0.5 * offset * offset)
                    for value, offset in zip(state.values, offsets, strict=True)
                ),
                released=room,
                due=due_room,
            )

        final = ops.loop(state, lambda state: shaded & (state.number < count - 0.5), follow_step)
        value: Lanes | None = None
        if not pixel.corrected:
            low, top, high = final.values
            bend = ops.minimum(low - 2.0 * top + high, -1e-6 * ops.abs(top) - 1e-20)
            offset = ops.minimum(ops.maximum(0.5 * (low - high) / bend, -1.0), 1.0)
            value = (top - 0.5 * (low - high - bend * offset) * offset) * (matched_filter.SCALE * pixel.trials)
        return _Before(
            free=final.free,
            released=None if fires_once else final.released,
            due=final.due,
            shaded=shaded,
            value=value,
            changed=shaded & (ops.abs(final.free - even) > _CHANGED * even),
        )

    def _draw_counts(self, first: Lanes, start: Lanes, before: _Before, middle: Lanes) -> list[Lanes]:
        """Draw the counts of each bin, (n,) each; corrected for pile-up if the sensor does so.

        first   number of the first bin, even
        start   its place
        before  SPADs that fired before it
        middle  place of the echo
        """
        pixel, ops = self.pixel, self.ops
        bin_s, count = pixel.histogram.bin_s, 2 * pixel.histogram.reach + 2
        # The first bin is even, so that it may be one bin farther away.
        half = (pixel.histogram.reach + 2) * pixel.histogram.bin_to_sigma
        comb = self.wave.comb(start, bin_s / pixel.sigma_s, middle, half=half)
        all_trials = pixel.trials if pixel.spad.coincidence == 1 else 1.0
        begin = _DrawState(
            number=0.0 * start,
            free=0.0 * start + before.free,
            silent=0.0 * start + 1.0,
            trials=0.0 * start + (0.0 if pixel.corrected else all_trials),
            again=0.0 * start + (all_trials * before.free if pixel.corrected else 0.0),
            revived=0.0 * start,
            parts=tuple(comb.parts),
            firings=ops.room(start, count),
            counts=ops.room(start, count) if pixel.corrected or pixel.spad.coincidence > 1 else None,
        )

        def step(state: _DrawState) -> _DrawState:
            # A random number has two words, so two bins share one.
            pair = ops.uint32(ops.int32(0.5 * (first + state.number)))
            words = random.words(seed=self.seed, stage=Stage.HISTOGRAM, pulse=self.pulse, draw=pair)
            for word in words:
                place = start + state.number * (bin_s / pixel.sigma_s)
                light = comb.power_w(place, state.parts) * (pixel.per_watt * bin_s)
                detections = light + pixel.rate_hz * bin_s
                if before.due is not None:
                    due = ops.get(before.due, ops.int32(state.number))
                    detections = detections + ops.where(before.shaded, due, 0.0)
                state = self._draw_bin(state, before, detections, random.open_uniform(word))
                state = replace(state, parts=comb.advance(state.parts))
            return state

        final = ops.loop(begin, lambda state: state.number < count - 0.5, step)
        counts = final.firings if final.counts is None else final.counts
        return [ops.get(counts, ops.full(first, i)) for i in range(count)]

    def _draw_bin(self, state: _DrawState, before: _Before, detections: Lanes, uniform: Lanes) -> _DrawState:
        """Draw the firings of the next bin and its counts (T105).

        How many SPADs are free is not known, only how many have fired in these bins: the others fire with the share
        that the renewal course gives of them, so the counts of a dead time are multinomial.

        detections  x, detections of a free SPAD in the bin
        uniform     in (0, 1]
        """
        pixel, ops = self.pixel, self.ops
        spad = pixel.spad
        released = self._released(state.number, before)
        of_free, of_released = dead_time.firing_parts(detections=detections, branch=True)
        share = state.free * of_free + released * of_released
        revived = state.revived
        if pixel.corrected:
            # Coates' correction knows the counts before these bins too, and so how many SPADs are free.
            revived = revived + pixel.trials * released
        silent = ops.maximum(state.silent, 1e-6)
        # Of the trials that may fire the first ones have the mean trials share / silent, the second ones that of
        # free SPADs. One division gives the mean probability and the share of the second ones.
        of_again = silent * (state.again * of_free + revived * of_released)
        of_all = ops.maximum(state.trials * share + of_again, 1e-15)
        pool = ops.maximum(state.trials + state.again + revived, 1e-6)
        inverse = 1.0 / (of_all * silent * pool)
        probability, second = of_all * of_all * inverse, of_again * silent * pool * inverse
        counts, index = state.counts, ops.int32(state.number)
        if spad.coincidence == 1:
            firings = draws.binomial_count(trials=pool, probability=probability, uniform=uniform)
            if counts is not None:
                free = ops.maximum(state.again + 0.5 * revived, 1e-6 * pixel.trials)
                corrected = pixel.trials * dead_time.detections_of_share(share=firings / free)
                counts = ops.put(counts, index, corrected)
        else:
            # How many SPADs have fired is not known from the pixel's counts: their mean with so many stands for them.
            mean = pool * probability
            together = dead_time.coincidence_share(least=spad.coincidence, spads=spad.spads, share=mean)
            coincidences = draws.binomial_count(trials=pixel.trials, probability=together, uniform=uniform)
            fired = dead_time.firings_in_coincidences(least=spad.coincidence, spads=spad.spads, share=mean)
            excess = (coincidences / pixel.trials - together) / ops.maximum(together * (1.0 - together), 1e-12)
            firings = ops.maximum(mean + excess * (fired / spad.spads - mean * together), 0.0)
            assert counts is not None
            counts = ops.put(counts, index, coincidences)
        # Which of the firings are second ones is not drawn: as many as expected.
        again = firings * second
        room, number, still_silent = ops.put(state.firings, index, firings), state.number + 1.0, state.silent - share
        return replace(
            state,
            number=number,
            free=state.free + released - share,
            silent=still_silent,
            trials=ops.maximum(state.trials - (firings - again), 0.0),
            again=ops.maximum(state.again + revived - again, 0.0),
            revived=self._revived(room, number, still_silent),
            firings=room,
            counts=counts,
        )

    def _released(self, number: Lanes, before: _Before) -> Lanes:
        """Share of the SPADs, fired before the first bin, that come free in this one, (n,)."""
        pixel, ops = self.pixel, self.ops
        if pixel.spad.stamps == "first":
            return 0.0 * number
        bin_s = pixel.histogram.bin_s
        # In even light as many as fire. Beyond a dead time those come free that have fired in the bins.
        released: Lanes = pixel.free * pixel.rate_hz * bin_s
        if before.released is not None:
            released = ops.where(before.shaded, ops.get(before.released, ops.int32(number)), released)
        return released * ops.minimum(ops.maximum(pixel.spad.dead_time_s / bin_s - number, 0.0), 1.0)

    def _revived(self, firings: Array, number: Lanes, silent: Lanes) -> Lanes:
        """Firings of the drawn bins that come free in a bin, a dead time later, (n,).

        silent  share of the SPADs that has not fired before the bin
        """
        pixel, ops = self.pixel, self.ops
        zero = 0.0 * number
        if pixel.spad.stamps == "first":
            return zero
        # Firings are spread over their bin, so those of two bins come free in each.
        age = number - pixel.spad.dead_time_s / pixel.histogram.bin_s
        late = ops.floor(age)

        def earlier() -> Lanes:
            total = zero
            for index, share in ((late, 1.0 - (age - late)), (late + 1.0, age - late)):
                inside = (index >= 0.0) & (index < number)
                fired = ops.get(firings, ops.int32(ops.where(inside, index, 0.0)))
                total = total + ops.where(inside, share * fired, 0.0)
            return total

        # Most bins are nearer to the first one than a dead time, or few SPADs have fired in these.
        return ops.where_any((late >= -1.0) & (silent < 1.0 - _FEW), earlier, zero)

    def _filter_counts(self, counts: list[Lanes], background: Lanes) -> list[Lanes]:
        """Filter the counts: values above the background at the searched bins and beside them, (n,) each; (T95)."""
        pixel, ops = self.pixel, self.ops
        reach, search = pixel.histogram.reach, pixel.histogram.search
        side = reach - search - 1
        step = pixel.histogram.bin_s / (matched_filter.TEMPLATE * pixel.sigma_s)
        weights = [matched_filter.SCALE * ops.exp(-0.5 * (k * step) * (k * step)) for k in range(side + 1)]
        total = weights[0] + 2.0 * sum(weights[1:], 0.0)
        values: list[Lanes] = []
        for centre in range(reach - search - 1, reach + search + 3):
            value = weights[0] * counts[centre]
            for k in range(1, side + 1):
                value = value + weights[k] * (counts[centre - k] + counts[centre + k])
            values.append(value - total * background)
        return values

    def _peak_offset(self, before: Lanes, best: Lanes, after: Lanes) -> tuple[Lanes, Lanes]:
        """Place of the peak in bins from the highest value, of the Gaussian through it and its neighbours.

        Returns its height over that value too.
        """
        ops = self.ops
        lowest = ops.maximum(_LEAST * best, 1e-20)
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
        total, moment = 0.0 * middle, 0.0 * middle
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
        total: Lanes = 0.0 * middle
        for i, count in enumerate(counts):
            # The bins at both ends count by the part that lies inside, or the number would jump with the place.
            inside = ops.minimum(ops.maximum(half + 0.5 - ops.abs(i - middle), 0.0), 1.0)
            total = total + inside * (count - background)
        pixel = self.pixel
        if pixel.weak is not None:
            return ops.maximum(total, 0.0) * (pixel.weak.height / pile_up.shade_of_box(sun=pixel.sun))
        return ops.maximum(total, 0.0) / BOX_SHARE
