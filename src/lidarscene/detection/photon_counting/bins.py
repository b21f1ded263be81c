"""Bins: the counts of a pulse's histogram around an echo, and the filter that looks for its peak there.

The histogram of the whole window is never made. Only the bins around an echo are drawn, one after the other in order of
time: each count is binomial, of the SPADs that are still free, so pile-up and dead time need no approximation within
them. The counts of a bin belong to (seed, pulse, bin), whichever echo asks for them.

Symbols: N trials, lambda rate of detections of one free SPAD, sigma width of an echo in the histogram.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ...light.waveform import Waveform
from ...maths import random
from ...maths.arrays import Array, Lanes, Ops, xp
from ...maths.random import Stage
from ...physics.photon_counting import dead_time, draws, matched_filter
from ...sensor.photon_counting.model import Macropixel

_BOX = 2.4
"""Half width of the bins whose counts are an echo's photons, in sigmas."""

_BOX_SHARE = math.erf(_BOX / math.sqrt(2.0))

_LEAST = 1e-3
"""Values beside the filter's peak below this share of it count as that much: their logarithm gives the peak's place."""

_STEPS = 12
"""Steps of the integral of the air's light before an echo."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Peak:
    """The highest value of the filter near an echo; each field (n,).

    value    of the filter above the background, in photons
    time_s   of flight, with the shift by pile-up
    photons  of the echo: counts around the peak above those of the background
    """

    value: Lanes
    time_s: Lanes
    photons: Lanes


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
        """The array functions for these arrays."""
        return xp(self.wave.origin_m)

    def highest(self, place: Lanes, time_s: Lanes) -> Peak:
        """The peak of the filter near a place of the waveform, at this time of flight."""
        pixel, histogram, ops = self.pixel, self.pixel.histogram, self.ops
        bin_s, reach, search = histogram.bin_s, histogram.reach, histogram.search
        # Bins are drawn in pairs: a random number has two words. So the first one is even.
        middle = ops.floor(time_s / bin_s)
        first = 2.0 * ops.floor(0.5 * (middle - reach))
        start = place + (first * bin_s + 0.5 * bin_s - time_s) / pixel.sigma_s
        light = self._light(start, place, 2 * reach + 2)
        counts = self._drawn(first, self._blind(start, first * bin_s, time_s), light)
        background = pixel.count_rate_hz * bin_s
        values = self._filtered(counts, background)
        least = reach - search - 1
        best, at = values[1], 0.0 * place + (least + 1.0)
        before, after = values[0], values[2]
        for k in range(2, len(values) - 1):
            better = values[k] > best
            before, after = ops.where(better, values[k - 1], before), ops.where(better, values[k + 1], after)
            best, at = ops.where(better, values[k], best), ops.where(better, float(least + k), at)
        if histogram.estimator == "matched_filter":
            at = at + self._between(before, best, after)
        else:
            at = at + self._centroid(counts, background, at)
        return Peak(
            value=best, time_s=(first + at + 0.5) * bin_s, photons=self._photons(counts, background, at)
        )

    def _light(self, start: Lanes, middle: Lanes, count: int) -> list[Lanes]:
        """Detections of one free SPAD in each bin by echoes and air, (n,) each."""
        bin_s, sigma = self.pixel.histogram.bin_s, self.pixel.sigma_s
        comb = self.wave.evenly(start, bin_s / sigma, middle)
        place, parts, found = start, comb.parts, []
        for _ in range(count):
            found.append(comb.power_w(place, parts) * (self.pixel.per_watt * bin_s))
            place, parts = place + bin_s / sigma, comb.following(parts)
        return found

    def _blind(self, start: Lanes, time_s: Lanes, echo_s: Lanes) -> Lanes:
        """Share of the SPADs that are blind at the first bin: fired by the background, by nearer echoes and by the air.

        start, time_s  place and time of flight of that bin
        echo_s         time of flight of the echo, for which the pixel is
        """
        pixel, wave, ops = self.pixel, self.wave, self.ops
        free = pixel.free
        if pixel.spad.stamps == "first":
            armed = pixel.armed_s + time_s - echo_s
            free = dead_time.free_share_of_first(rate_hz=pixel.rate_hz, time_s=armed)
        if len(wave.centres) == 1 and wave.volume is None:
            return 1.0 - free  # the pulse's only echo is the one in these bins
        sigma, once = pixel.sigma_s, pixel.spad.stamps == "first"
        dead = 1e9 if once else pixel.spad.dead_time_s / sigma
        energy = pixel.per_watt * sigma * math.sqrt(2.0 * math.pi)
        before: Lanes = 0.0 * start
        for centre, height in zip(wave.centres, wave.heights, strict=True):
            before = before + ops.where((centre < start) & (centre > start - dead), height * energy, 0.0)
        if wave.volume is not None:
            since = ops.maximum(time_s, 0.0) if once else ops.minimum(pixel.spad.dead_time_s, ops.maximum(time_s, 0.0))
            step = since / (sigma * _STEPS)
            of_air = sum(wave.air_w(start - (k + 0.5) * step) for k in range(_STEPS))
            before = before + of_air * step * sigma * pixel.per_watt
        return 1.0 - free * ops.exp(-before)

    def _drawn(self, first: Lanes, blind: Lanes, light: list[Lanes]) -> list[Lanes]:
        """Counts of each bin, (n,); corrected for pile-up if the sensor does so.

        first  number of the first bin, even
        blind  share of the SPADs that are blind then
        """
        pixel, ops = self.pixel, self.ops
        spad, bin_s, trials = pixel.spad, pixel.histogram.bin_s, pixel.trials
        alone, once = spad.coincidence == 1, spad.stamps == "first"
        whole = trials if alone else 1.0
        dead = 0.0 if once else spad.dead_time_s / bin_s
        fired: list[Lanes] = []
        counts: list[Lanes] = []
        even: tuple[Array, Array] | None = None
        for i, one in enumerate(light):
            if i % 2 == 0:
                pair = ops.int32(0.5 * first) + i // 2
                even = random.words(seed=self.seed, stage=Stage.HISTOGRAM, pulse=self.pulse, draw=ops.uint32(pair))
            assert even is not None
            uniform = random.open_uniform(even[i % 2])
            # Who was blind at the first bin gets free evenly over one dead time; who fired since, after one.
            if once:
                free = whole * (1.0 - blind) - sum(fired, 0.0)
            else:
                free = whole * (1.0 - blind * ops.maximum(1.0 - i / dead, 0.0))
                for lag in range(1, i + 1):
                    free = free - fired[i - lag] * ops.minimum(ops.maximum(dead - lag + 0.5, 0.0), 1.0)
            free = ops.maximum(free, 0.0)
            share = dead_time.firing_share(detections=one + pixel.rate_hz * bin_s)
            if alone:
                count = draws.binomial_count(trials=free, probability=share, uniform=uniform)
                fired.append(count)
                if pixel.corrected:
                    of_free = count / ops.maximum(free, 1e-6 * whole)
                    count = trials * dead_time.detections_of_share(share=of_free)
            else:
                # How many SPADs are free is not known from the pixel's counts: their mean stands for them.
                fired.append(free * share)
                both = dead_time.coincidence_share(
                    least=spad.coincidence, spads=spad.spads, share=free * share
                )
                count = draws.binomial_count(trials=trials, probability=both, uniform=uniform)
            counts.append(count)
        return counts

    def _filtered(self, counts: list[Lanes], background: Lanes) -> list[Lanes]:
        """Values of the filter above the background at the searched bins and beside them, (n,) each; (T95)."""
        pixel, ops = self.pixel, self.ops
        reach, search = pixel.histogram.reach, pixel.histogram.search
        side = reach - search - 1
        step = pixel.histogram.bin_s / (matched_filter.TEMPLATE * pixel.sigma_s)
        weights = [matched_filter.SCALE * ops.exp(-0.5 * (k * step) * (k * step)) for k in range(side + 1)]
        total = weights[0] + 2.0 * sum(weights[1:], 0.0)
        found = []
        for centre in range(reach - search - 1, reach + search + 3):
            value = weights[0] * counts[centre]
            for k in range(1, side + 1):
                value = value + weights[k] * (counts[centre - k] + counts[centre + k])
            found.append(value - total * background)
        return found

    def _between(self, before: Lanes, best: Lanes, after: Lanes) -> Lanes:
        """Place of the peak in bins from the highest value: of the Gaussian through it and its neighbours."""
        ops = self.ops
        least = ops.maximum(_LEAST * best, 1e-20)
        low, top, high = (ops.log(ops.maximum(one, least)) for one in (before, best, after))
        bend = low - 2.0 * top + high
        flat = bend > -1e-9
        offset = 0.5 * (low - high) / ops.where(flat, -1.0, bend)
        return ops.where(flat, 0.0, ops.minimum(ops.maximum(offset, -0.5), 0.5))

    def _centroid(self, counts: list[Lanes], background: Lanes, middle: Lanes) -> Lanes:
        """Centroid of the counts above the background within 2.4 sigmas of a bin, in bins from it."""
        ops = self.ops
        half = _BOX * self.pixel.sigma_s / self.pixel.histogram.bin_s
        total, moment = 0.0 * middle, 0.0 * middle
        for i, count in enumerate(counts):
            off = i - middle
            # The bins at both ends count by the part that lies inside.
            share = ops.minimum(ops.maximum(half + 0.5 - ops.abs(off), 0.0), 1.0)
            inside = share * (count - background)
            total, moment = total + inside, moment + off * inside
        return ops.minimum(ops.maximum(moment / ops.maximum(total, 1.0), -half), half)

    def _photons(self, counts: list[Lanes], background: Lanes, middle: Lanes) -> Lanes:
        """Counts above the background within 2.4 sigmas of a place, which is in bins from the first one's centre."""
        ops = self.ops
        half = _BOX * self.pixel.sigma_s / self.pixel.histogram.bin_s
        total: Lanes = 0.0 * middle
        for i, count in enumerate(counts):
            # The bins at both ends count by the part that lies inside, or the number would jump with the place.
            inside = ops.minimum(ops.maximum(half + 0.5 - ops.abs(i - middle), 0.0), 1.0)
            total = total + inside * (count - background)
        return ops.maximum(total, 0.0) / _BOX_SHARE
