"""Bins: the counts of a pulse's histogram around an echo, and the filter that looks for its peak there.

The histogram of the whole window is never made. Only the bins around an echo are drawn, one after the other in order of
time: each count is binomial, of the SPADs that are still free, so pile-up and dead time need no approximation within
them. The counts of a bin belong to (seed, pulse, bin), whichever echo needs them.

Symbols: N trials, lambda rate of detections of one free SPAD, sigma width of an echo in the histogram.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ...light.waveform import Waveform
from ...maths import random
from ...maths.arrays import Array, Lanes, Mask, Ops, xp
from ...maths.random import Stage
from ...physics.photon_counting import dead_time, draws, matched_filter, pile_up
from ...physics.photon_counting.pile_up import BOX
from ...sensor.detectors.spad_detector import Macropixel

BOX_SHARE = math.erf(BOX / math.sqrt(2.0))

_LEAST = 1e-3
"""Values beside the filter's peak below this share of it count as that much: their logarithm gives the peak's place."""

_BELOW_ALL = 1e9
"""Photons that no value of the filter lies below its mean."""

_STEPS = 12
"""Steps of the integral of the air's light before an echo."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Peak:
    """The highest value of the filter near an echo; each field (n,).

    value    value of the filter above the background, in photons
    height   the same between bins, at the top of the Gaussian through the value and its neighbours
    time_s   time of flight, with the shift by pile-up
    photons  photons of the echo: counts around the peak above those of the background
    exists   whether a searched bin is higher than its neighbours; all true where the search has no limits
    """

    value: Lanes
    height: Lanes
    exists: Mask
    time_s: Lanes
    photons: Lanes


_FEW = 2e-3
"""Share of the SPADs that may be left out when they come free again: 0.1 % of the noise in any light."""

_RELEASE = 3.0
"""Pulse widths (sigmas) until the SPADs fired by an echo have recovered."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Blind:
    """SPADs that are blind at the first bin; each field (n,).

    by_sun     share that background and dark counts have fired
    by_echoes  share that nearer echoes and the air have fired
    freed      bin in which the latter get free, on average
    missed     share of the SPADs that the sun fires before the echoes, and does not fire behind them
    recent     how much of that shadow is left at the first bin: the sun's SPADs come back in it
    revived    share of the SPADs by which more are free than in even light: those of echoes that are back together
    older      shadow of these echoes a dead time before the first bin
    again      share of the free SPADs that nearer echoes have fired and that is still blind: afterpulses are to come
    due        afterpulses in the first bin for each SPAD that is free in even light, of echoes whose SPADs are back
    release    pulse widths (sigmas) over which the SPADs of echoes recover
    """

    by_sun: Lanes
    by_echoes: Lanes
    freed: Lanes
    missed: Lanes
    recent: Lanes
    revived: Lanes = 0.0
    older: Lanes = 0.0
    again: Lanes = 0.0
    due: Lanes = 0.0
    release: Lanes = _RELEASE


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
    seed: Lanes
    pulse: Array

    @property
    def ops(self) -> Ops:
        """Array functions of the arrays' kind, NumPy's or Dr.Jit's."""
        return xp(self.wave.origin_m)

    def highest(
        self,
        place: Lanes,
        time_s: Lanes,
        *,
        echo: pile_up.Firings | None = None,
        limits_s: tuple[Lanes, Lanes] | None = None,
    ) -> Peak:
        """Find the peak of the filter near a place of the waveform, at this time of flight.

        echo      firings of an echo a dead time before, whose SPADs come back here; None: the place is that of an echo
        limits_s  times of flight between which bins count that are higher than their neighbours, other echoes being
                  near; None: the highest bin
        """
        pixel, histogram, ops = self.pixel, self.pixel.histogram, self.ops
        bin_s, reach, search = histogram.bin_s, histogram.reach, histogram.search
        # Bins are drawn in pairs: a random number has two words. So the first one is even.
        middle = ops.floor(time_s / bin_s)
        first = 2.0 * ops.floor(0.5 * (middle - reach))
        start = place + (first * bin_s + 0.5 * bin_s - time_s) / pixel.sigma_s
        counts = self._draw_counts(first, start, self._blind_shares(start, first * bin_s, time_s, echo), place)
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
        return Peak(value=best, height=over_best * best, time_s=time_s, photons=photons, exists=exists)

    def _blind_shares(self, start: Lanes, time_s: Lanes, echo_s: Lanes, echo: pile_up.Firings | None = None) -> _Blind:
        """Shares of SPADs that are blind at the first bin, fired by the background, by nearer echoes and by the air.

        start, time_s  place and time of flight of that bin
        echo_s         time of flight of the echo, for which the pixel is
        echo           as of `highest`
        """
        pixel, wave, ops = self.pixel, self.wave, self.ops
        free, fires_once = pixel.free, pixel.spad.stamps == "first"
        if fires_once:
            armed = pixel.armed_s + time_s - echo_s
            free = dead_time.free_share_of_first(rate_hz=pixel.rate_hz, time_s=armed)
        lone = len(wave.centres) == 1 and wave.volume is None and pixel.spad.afterpulse is None
        if echo is None and lone:
            # The pulse's only echo is the one in these bins.
            return _Blind(by_sun=1.0 - free, by_echoes=0.0, freed=0.0, missed=0.0, recent=1.0)
        sigma = pixel.sigma_s
        # SPADs that fire once in a shot stay blind to its end: their dead time is infinite, here a large number.
        dead = 1e9 if fires_once else pixel.spad.dead_time_s / sigma
        energy = pixel.per_watt * sigma * math.sqrt(2.0 * math.pi)
        before, moment, older, older_moment = (0.0 * start for _ in range(4))
        for centre, height in zip(wave.centres, wave.heights, strict=True):
            # Share of a Gaussian within the dead time before the first bin, by the logistic approximation.
            part = self._share_before(start - centre)
            if not fires_once:
                back = self._share_before(start - dead - centre)
                part = part - back
                back = (back - self._share_before(start - 2.0 * dead - centre)) * height * energy
                older, older_moment = older + back, older_moment + back * ops.minimum(centre + dead - start, 0.0)
            part = part * height * energy
            before, moment = before + part, moment + part * ops.minimum(centre - start, 0.0)
        if wave.volume is not None:
            since = ops.maximum(time_s, 0.0)
            if not fires_once:
                since = ops.minimum(since, pixel.spad.dead_time_s)
            step = since / (sigma * _STEPS)
            for k in range(_STEPS):
                part = wave.air_w(start - (k + 0.5) * step) * step * sigma * pixel.per_watt
                before, moment = before + part, moment - part * (k + 0.5) * step
        mean = moment / ops.maximum(before, 1e-20) + (0.0 if echo is None else echo.mean)
        fired = dead_time.firing_share(detections=before) if echo is None else echo.share
        revived: Lanes = 0.0
        shadow: Lanes = 0.0
        if not fires_once:
            # Linear response of the free share: 1 - exp(-lambda tau) - lambda u of what fired is free too much a time u
            # after it has come back, times exp(-lambda u).
            since = -pixel.sun * older_moment / ops.maximum(older, 1e-20)
            left = dead_time.firing_share(detections=older) * ops.exp(-since)
            revived = free * left * (1.0 - ops.exp(-pixel.sun * dead) - since)
            shadow = left
        again, due = (0.0, 0.0) if pixel.spad.afterpulse is None else self._due_shares(start, dead)
        return _Blind(
            by_sun=1.0 - free,
            by_echoes=free * fired,
            freed=(mean + dead) * (sigma / pixel.histogram.bin_s),
            missed=fired if echo is None else ops.minimum(fired, 1.0),
            recent=1.0 if fires_once else ops.exp(mean * pixel.sun),
            revived=revived,
            older=shadow,
            again=again,
            due=due,
            release=_RELEASE if echo is None else echo.deviation * math.sqrt(12.0),
        )

    def _due_shares(self, start: Lanes, dead: Lanes) -> tuple[Lanes, Lanes]:
        """`_Blind.again` and `_Blind.due`.

        dead  dead time in sigmas
        """
        ops = self.ops
        energy = self.pixel.per_watt * self.pixel.sigma_s * math.sqrt(2.0 * math.pi)
        # A dead time, the one before, and all that is older: a SPAD fires once in each, and an echo is in one of them.
        lights, places = [0.0 * start for _ in range(3)], [0.0 * start for _ in range(3)]
        for centre, height in zip(self.wave.centres, self.wave.heights, strict=True):
            since = start - centre
            light = self._share_before(since) * height * energy
            inside = (since < dead, (since >= dead) & (since < 2.0 * dead), since >= 2.0 * dead)
            for i, within in enumerate(inside):
                lights[i] = lights[i] + ops.where(within, light, 0.0)
                places[i] = places[i] + ops.where(within, light * (since - dead), 0.0)
        due: Lanes = 0.0
        for light, place in zip(lights[1:], places[1:], strict=True):
            since_s = place / ops.maximum(light, 1e-20) * self.pixel.sigma_s
            due = due + dead_time.firing_share(detections=light) * self._afterpulses(since_s)
        return dead_time.firing_share(detections=lights[0]), due

    def _afterpulses(self, since_s: Lanes) -> Lanes:
        """Afterpulses in a bin for each SPAD that came free so long before (T109)."""
        pixel, ops = self.pixel, self.ops
        spad = pixel.spad
        assert spad.afterpulse is not None
        assert spad.afterpulse_s is not None
        # The sun may have fired it by then; two dead times on it has its share of free SPADs again.
        free = ops.maximum(ops.exp(-pixel.rate_hz * since_s), pixel.free)
        rate = spad.afterpulse / spad.afterpulse_s * ops.exp(-(since_s + spad.dead_time_s) / spad.afterpulse_s)
        return rate * free * pixel.histogram.bin_s

    def _due(self, state: _DrawState, blind: _Blind) -> Lanes:
        """Afterpulses of earlier echoes in the next bin, for each free SPAD (T109)."""
        pixel, ops, bin_s = self.pixel, self.ops, self.pixel.histogram.bin_s
        assert pixel.spad.afterpulse_s is not None
        due = blind.due * ops.exp(-state.number * (bin_s / pixel.spad.afterpulse_s))
        back = 1.0 - 0.5 * (self._still_blind(state.number, blind) + self._still_blind(state.number + 1.0, blind))
        since = ops.maximum(state.number + 0.5 - blind.freed, 0.0) * bin_s
        due = due + blind.again * back * self._afterpulses(since)
        # Where echoes have come back together more SPADs are free than in even light, but none more has afterpulses.
        return due * pixel.free / ops.maximum(state.free, pixel.free)

    def _share_before(self, ahead: Lanes) -> Lanes:
        """Share of a Gaussian that lies before a place so many sigmas behind its centre, to 1 %."""
        ops = self.ops
        return 1.0 / (1.0 + ops.exp(-1.702 * ops.maximum(ahead, -40.0)))

    def _draw_counts(self, first: Lanes, start: Lanes, blind: _Blind, middle: Lanes) -> list[Lanes]:
        """Draw the counts of each bin, (n,) each; corrected for pile-up if the sensor does so.

        first   number of the first bin, even
        start   its place
        blind   SPADs that are blind then
        middle  place of the echo
        """
        pixel, ops = self.pixel, self.ops
        bin_s, count = pixel.histogram.bin_s, 2 * pixel.histogram.reach + 2
        comb = self.wave.comb(start, bin_s / pixel.sigma_s, middle)
        first_free = 1.0 - blind.by_sun - blind.by_echoes * blind.recent + blind.revived
        all_trials = pixel.trials if pixel.spad.coincidence == 1 else 1.0
        begin = _DrawState(
            number=0.0 * start,
            free=0.0 * start + first_free,
            silent=0.0 * start + 1.0,
            trials=0.0 * start + (0.0 if pixel.corrected else all_trials),
            again=0.0 * start + (all_trials * first_free if pixel.corrected else 0.0),
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
                if pixel.spad.afterpulse is not None:
                    detections = detections + self._due(state, blind)
                state = self._draw_bin(state, blind, detections, random.open_uniform(word))
                state = replace(state, parts=comb.advance(state.parts))
            return state

        final = ops.loop(begin, lambda state: state.number < count - 0.5, step)
        counts = final.firings if final.counts is None else final.counts
        return [ops.get(counts, ops.full(first, i)) for i in range(count)]

    def _draw_bin(self, state: _DrawState, blind: _Blind, detections: Lanes, uniform: Lanes) -> _DrawState:
        """Draw the firings of the next bin and its counts (T105).

        How many SPADs are free is not known, only how many have fired in these bins: the others fire with the share
        that the renewal course gives of them, so the counts of a dead time are multinomial.

        detections  x, detections of a free SPAD in the bin
        uniform     in (0, 1]
        """
        pixel, ops = self.pixel, self.ops
        spad = pixel.spad
        released = self._released(state.number, blind)
        of_free, of_released = dead_time.firing_parts(detections=detections, branch=True)
        share = state.free * of_free + released * of_released
        revived = state.revived
        if pixel.corrected:
            # Coates' correction knows the counts before these bins too, and so how many SPADs are free.
            revived = revived + pixel.trials * released
        # Of the trials that may fire the first ones have the mean trials share / silent, the second ones that of free
        # SPADs. One division gives the mean probability and the share of the second ones.
        silent = ops.maximum(state.silent, 1e-6)
        of_again = silent * (state.again * of_free + revived * of_released)
        of_all = ops.maximum(state.trials * share + of_again, 1e-15)
        pool = ops.maximum(state.trials + state.again + revived, 1e-6)
        inverse = 1.0 / (of_all * silent * pool)
        probability = of_all * of_all * inverse
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
        again = firings * of_again * silent * pool * inverse
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

    def _released(self, number: Lanes, blind: _Blind) -> Lanes:
        """Share of the SPADs, fired before the first bin, that come free in this one, (n,)."""
        pixel, ops = self.pixel, self.ops
        if pixel.spad.stamps == "first":
            return 0.0 * number
        # The sun's get free evenly over one dead time, those of echoes one dead time after these.
        step = pixel.histogram.bin_s / pixel.spad.dead_time_s
        of_sun = blind.by_sun * ops.minimum(ops.maximum(1.0 - number * step, 0.0), step)
        if isinstance(blind.by_echoes, float):
            return of_sun
        # A dead time behind the echoes the sun's are those that it fired in their shadow.
        before, after = self._still_blind(number, blind), self._still_blind(number + 1.0, blind)
        since = ops.maximum(number + 0.5 - blind.freed, 0.0) * (pixel.rate_hz * pixel.histogram.bin_s)
        shadow = blind.missed * (1.0 - 0.5 * (before + after)) * ops.exp(-since)
        shadow = shadow + blind.older * ops.exp(-(number + 0.5) * (pixel.rate_hz * pixel.histogram.bin_s))
        return of_sun * (1.0 - shadow) + blind.by_echoes * (before - after)

    def _still_blind(self, edge: Lanes, blind: _Blind) -> Lanes:
        """Share of the SPADs fired by echoes that is blind at the edge of a bin; they come back over some widths."""
        ops, slope = self.ops, self.pixel.histogram.bin_s / (blind.release * self.pixel.sigma_s)
        return ops.minimum(ops.maximum((blind.freed - edge) * slope + 0.5, 0.0), 1.0)

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
        if not (pixel.corrected or pixel.spad.coincidence > 1):
            weak = pixel.weak_top
            return ops.maximum(total, 0.0) * (weak.height / pile_up.shade_of_box(sun=pixel.sun))
        return ops.maximum(total, 0.0) / BOX_SHARE
