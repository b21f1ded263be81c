"""Bins: the counts of a pulse's histogram around an echo, and the filter that looks for its peak there.

The histogram of the whole window is never made. Only the bins around an echo are drawn, one after the other in order of
time: each count is binomial, of the SPADs that are still free, so pile-up and dead time need no approximation within
them. The counts of a bin belong to (seed, pulse, bin), whichever echo needs them.

Symbols: N trials, lambda rate of detections of one free SPAD, sigma width of an echo in the histogram.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ...light.waveform import Waveform
from ...maths import random
from ...maths.arrays import Array, Lanes, Mask, Ops, xp
from ...maths.random import Stage
from ...physics.photon_counting import dead_time, draws, matched_filter, pile_up
from ...sensor.detectors.spad_detector import Macropixel

BOX = 2.4
"""Half width of the bins whose counts are an echo's photons, in sigmas."""

BOX_SHARE = math.erf(BOX / math.sqrt(2.0))

_LEAST = 1e-3
"""Values beside the filter's peak below this share of it count as that much: their logarithm gives the peak's place."""

_STEPS = 12
"""Steps of the integral of the air's light before an echo."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Peak:
    """The highest value of the filter near an echo; each field (n,).

    value    value of the filter above the background, in photons
    time_s   time of flight, with the shift by pile-up
    photons  photons of the echo: counts around the peak above those of the background
    rising   whether the filter goes on rising beyond the searched bins: towards another echo's peak
    """

    value: Lanes
    rising: Mask
    time_s: Lanes
    photons: Lanes


_RELEASE = 3.0
"""Pulse widths (sigmas) until the SPADs fired by an echo have recovered."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Blind:
    """SPADs that are blind at the first bin; each field (n,).

    by_sun     share that background and dark counts have fired
    by_echoes  share that nearer echoes and the air have fired
    freed      bin in which the latter get free, on average
    """

    by_sun: Lanes
    by_echoes: Lanes
    freed: Lanes


@dataclass(frozen=True, slots=True, kw_only=True)
class _DrawState:
    """State of drawing the bins around an echo; each field (n,), with one entry per bin for ``firings`` and ``counts``.

    number   number of the next bin, from the first one
    fired    firings of the bins so far that are blind in it
    parts    light of each sub-echo in that bin (`light.waveform.Comb`)
    firings  firings of each bin
    counts   counts of each bin; None: they are the firings
    """

    number: Lanes
    fired: Lanes
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

    def highest(self, place: Lanes, time_s: Lanes) -> Peak:
        """Find the peak of the filter near a place of the waveform, at this time of flight."""
        pixel, histogram, ops = self.pixel, self.pixel.histogram, self.ops
        bin_s, reach, search = histogram.bin_s, histogram.reach, histogram.search
        # Bins are drawn in pairs: a random number has two words. So the first one is even.
        middle = ops.floor(time_s / bin_s)
        first = 2.0 * ops.floor(0.5 * (middle - reach))
        start = place + (first * bin_s + 0.5 * bin_s - time_s) / pixel.sigma_s
        counts = self._draw_counts(first, start, self._blind_shares(start, first * bin_s, time_s), place)
        background = pixel.count_rate_hz * bin_s
        values = self._filter_counts(counts, background)
        first_searched = reach - search - 1
        best, peak_bin = values[1], 0.0 * place + (first_searched + 1.0)
        before, after = values[0], values[2]
        for k in range(2, len(values) - 1):
            better = values[k] > best
            before, after = ops.where(better, values[k - 1], before), ops.where(better, values[k + 1], after)
            best, peak_bin = ops.where(better, values[k], best), ops.where(better, float(first_searched + k), peak_bin)
        rising = (before > best) | (after > best)
        if histogram.estimator == "matched_filter":
            peak_bin = peak_bin + self._peak_offset(before, best, after)
        else:
            peak_bin = peak_bin + self._centroid(counts, background, peak_bin)
        photons = self._photons(counts, background, peak_bin)
        return Peak(value=best, time_s=(first + peak_bin + 0.5) * bin_s, photons=photons, rising=rising)

    def _blind_shares(self, start: Lanes, time_s: Lanes, echo_s: Lanes) -> _Blind:
        """Shares of SPADs that are blind at the first bin, fired by the background, by nearer echoes and by the air.

        start, time_s  place and time of flight of that bin
        echo_s         time of flight of the echo, for which the pixel is
        """
        pixel, wave, ops = self.pixel, self.wave, self.ops
        free, fires_once = pixel.free, pixel.spad.stamps == "first"
        if fires_once:
            armed = pixel.armed_s + time_s - echo_s
            free = dead_time.free_share_of_first(rate_hz=pixel.rate_hz, time_s=armed)
        if len(wave.centres) == 1 and wave.volume is None:
            # The pulse's only echo is the one in these bins.
            return _Blind(by_sun=1.0 - free, by_echoes=0.0, freed=0.0)
        sigma = pixel.sigma_s
        # SPADs that fire once in a shot stay blind to its end: their dead time is infinite, here a large number.
        dead = 1e9 if fires_once else pixel.spad.dead_time_s / sigma
        energy = pixel.per_watt * sigma * math.sqrt(2.0 * math.pi)
        before, moment = 0.0 * start, 0.0 * start
        for centre, height in zip(wave.centres, wave.heights, strict=True):
            # Share of a Gaussian within the dead time before the first bin, by the logistic approximation.
            part = self._share_before(start - centre)
            if not fires_once:
                part = part - self._share_before(start - dead - centre)
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
        mean = moment / ops.maximum(before, 1e-20)
        return _Blind(
            by_sun=1.0 - free,
            by_echoes=free * dead_time.firing_share(detections=before),
            freed=(mean + dead) * (sigma / pixel.histogram.bin_s),
        )

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
        begin = _DrawState(
            number=0.0 * start,
            fired=0.0 * start,
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
                free = self._free_trials(state, blind)
                firings, counts = self._draw_bin(free, light, random.open_uniform(word))
                index = ops.int32(state.number)
                room = ops.put(state.firings, index, firings)
                state = _DrawState(
                    number=state.number + 1.0,
                    fired=self._still_blind(state, room, firings),
                    parts=comb.advance(state.parts),
                    firings=room,
                    counts=None if state.counts is None else ops.put(state.counts, index, counts),
                )
            return state

        final = ops.loop(begin, lambda state: state.number < count - 0.5, step)
        counts = final.firings if final.counts is None else final.counts
        return [ops.get(counts, ops.full(first, i)) for i in range(count)]

    def _free_trials(self, state: _DrawState, blind: _Blind) -> Lanes:
        """Number of trials that meet a free SPAD in the next bin, (n,)."""
        pixel, ops = self.pixel, self.ops
        all_trials = pixel.trials if pixel.spad.coincidence == 1 else 1.0
        share = blind.by_sun + blind.by_echoes
        if pixel.spad.stamps == "all":
            # The sun's get free evenly over one dead time; those of echoes one dead time after these; and who fired
            # in these bins, one dead time after that. The middle of a bin stands for all of it.
            step = pixel.histogram.bin_s / pixel.spad.dead_time_s
            sun_blind = ops.maximum(1.0 - (state.number + 0.5) * step, 0.0)
            width = _RELEASE * pixel.sigma_s / pixel.histogram.bin_s
            echo_blind = ops.minimum(ops.maximum((blind.freed - state.number) / width + 0.5, 0.0), 1.0)
            share = blind.by_sun * sun_blind + blind.by_echoes * echo_blind
        return ops.maximum(all_trials * (1.0 - share) - state.fired, 0.0)

    def _still_blind(self, state: _DrawState, firings: Array, latest: Lanes) -> Lanes:
        """Firings of the drawn bins, the new one included, that are still blind in the bin after it, (n,)."""
        pixel, ops = self.pixel, self.ops
        blind = state.fired + latest
        if pixel.spad.stamps == "first":
            return blind
        # Firings are spread over their bin, so half of them get free half a bin earlier or later than the others.
        age = state.number + 0.5 - pixel.spad.dead_time_s / pixel.histogram.bin_s
        late = ops.floor(age)

        def revived() -> Lanes:
            total = 0.0 * latest
            for index, share in ((late, 1.0 - (age - late)), (late + 1.0, age - late)):
                inside = (index >= 0.0) & (index <= state.number)
                earlier = ops.get(firings, ops.int32(ops.where(inside, index, 0.0)))
                total = total + ops.where(inside, share * earlier, 0.0)
            return total

        # Most bins are nearer to the first one than a dead time.
        return blind - ops.where_any(late >= -1.0, revived, 0.0 * latest)

    def _draw_bin(self, free: Lanes, light: Lanes, uniform: Lanes) -> tuple[Lanes, Lanes]:
        """Draw the firings of one bin and its counts, (n,) each.

        free     trials that meet a free SPAD
        light    detections of one free SPAD by echoes and air
        uniform  in (0, 1]
        """
        pixel, ops = self.pixel, self.ops
        spad = pixel.spad
        detections = light + pixel.rate_hz * pixel.histogram.bin_s
        share = dead_time.firing_share(detections=detections)
        if spad.coincidence == 1:
            count = draws.binomial_count(trials=free, probability=share, uniform=uniform, log_none=-detections)
            if not pixel.corrected:
                return count, count
            share_of_free = count / ops.maximum(free, 1e-6 * pixel.trials)
            return count, pixel.trials * dead_time.detections_of_share(share=share_of_free)
        # How many SPADs are free is not known from the pixel's counts: their mean stands for them.
        coincidence = dead_time.coincidence_share(least=spad.coincidence, spads=spad.spads, share=free * share)
        return free * share, draws.binomial_count(trials=pixel.trials, probability=coincidence, uniform=uniform)

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

    def _peak_offset(self, before: Lanes, best: Lanes, after: Lanes) -> Lanes:
        """Place of the peak in bins from the highest value: of the Gaussian through it and its neighbours."""
        ops = self.ops
        lowest = ops.maximum(_LEAST * best, 1e-20)
        low, top, high = (ops.log(ops.maximum(height, lowest)) for height in (before, best, after))
        bend = low - 2.0 * top + high
        flat = bend > -1e-9
        offset = 0.5 * (low - high) / ops.where(flat, -1.0, bend)
        return ops.where(flat, 0.0, ops.minimum(ops.maximum(offset, -0.5), 0.5))

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
            shade = pile_up.shade_of_box(rate_hz=pixel.rate_hz, sigma_s=pixel.sigma_s, half_width=BOX)
            total = total * (pixel.shade / shade)
        return ops.maximum(total, 0.0) / BOX_SHARE
