"""Candidates: the places at which a histogram is searched for returns.

Each peak of the expected light behind the filter is one, and each echo on the flank of a peak: noise may lift it out.

Symbols: places are in widths (sigmas) of the filter's response.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from ...light.waveform import FAR
from ...maths.arrays import Array, Lanes, Mask, S
from ...maths.special import normal_tail
from ...physics.photon_counting import matched_filter, valleys
from ..rises import Rise, visit_all
from .expectation import Expected, FilteredLight
from .tuning import MERGED, NEIGHBOURS, OUTWARD


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """Place at which the histogram is searched; each field (n,).

    Attributes:
        exists: whether the pulse has it
        place: place of the filtered light
        on_flank: whether an echo lies there that is no peak of the expected light; such are visited after all peaks
        low: place from which its peak is looked for: the valley before a peak
        high: place up to which it is looked for: the valley behind
        previous: place of the peak before a peak, if there is any
        following: place of the peak behind it, if there is any
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

    Attributes:
        count: (n,) how many
        places: place of each, (n,) at a time
        valleys: place of the valley before each, (n,) at a time
        merged: (n,) for each sub-echo, whether it is part of a peak
    """

    count: Lanes
    places: Array
    valleys: Array
    merged: tuple[Mask, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Walk:
    """State of the walk to the candidates of each pulse.

    Attributes:
        number: (n,) number of the next peak
        flank: (n,) place of the last echo on a flank
        valleys: as of `_Peaks`
        places: as of `_Peaks`
    """

    number: Lanes
    flank: Lanes
    places: Array
    valleys: Array


Visit = Callable[[Candidate, Lanes, Expected, S], S]
"""``visit(candidate, power_w, expected, state) -> state``: power of the filtered light there, and its expectation."""


def visit_candidates(light: FilteredLight, visit: Visit[S], state: S) -> S:
    """Visit the peaks of each pulse in order of time, and then the echoes on their flanks; returns the last state.

    Args:
        state: state before the first: arrays of one entry for each pulse
    """
    ops, wave = light.ops, light.filtered
    peaks = _find_peaks(light)

    def next_flank(place: Lanes) -> Lanes:
        """First echo behind a place, and apart from the one there, that is not part of a peak."""
        first: Lanes = ops.full(place, FAR)
        for centre, height, merged in zip(wave.centres, wave.heights, peaks.merged, strict=True):
            new = ~merged & (height > 0.0) & (centre > place + MERGED)
            first = ops.where(new, ops.minimum(first, centre), first)
        return first

    def active(loop_state: tuple[_Walk, S]) -> Mask:
        walk = loop_state[0]
        return (walk.number < peaks.count) | (next_flank(walk.flank) < FAR)

    def step(loop_state: tuple[_Walk, S]) -> tuple[_Walk, S]:
        walk, so_far = loop_state
        number, flank = walk.number, next_flank(walk.flank)
        is_peak, last = number < peaks.count, peaks.count - 1.0

        def get(room: Array, index: Lanes) -> Lanes:
            return ops.get(room, ops.int32(ops.maximum(ops.minimum(index, last), 0.0)))

        exists = is_peak | (flank < FAR)
        place = ops.where(is_peak, get(walk.places, number), ops.where(flank < FAR, flank, 0.0))
        low = ops.where(is_peak & (number > 0.0), get(walk.valleys, number), -FAR)
        high = ops.where(is_peak & (number < last), get(walk.valleys, number + 1.0), FAR)
        candidate = Candidate(
            exists=exists,
            place=place,
            on_flank=exists & ~is_peak,
            low=low,
            high=high,
            previous=ops.where(low > -FAR, get(walk.places, number - 1.0), -FAR),
            following=ops.where(high < FAR, get(walk.places, number + 1.0), FAR),
        )
        height, slope, _ = wave.at(place)
        power_w = ops.where(exists, height, 0.0)
        # Noise lifts an echo out of a flank on the lower side.
        outward = ops.where(slope > 0.0, -OUTWARD, OUTWARD)
        expected_at = ops.where(candidate.on_flank, place + outward, place)
        expected = light.expect(expected_at, ops.where(exists, wave.at(expected_at)[0], 0.0))
        chance = _peaks_of(light, candidate, power_w)
        expected = replace(expected, peaks=chance, probability=expected.probability * chance)
        onward = replace(
            walk, number=ops.where(is_peak, number + 1.0, number), flank=ops.where(is_peak, walk.flank, flank)
        )
        return onward, visit(candidate, power_w, expected, so_far)

    first = ops.full(wave.origin_m, 0.0)
    begin = _Walk(number=first, flank=first - FAR, places=peaks.places, valleys=peaks.valleys)
    return ops.loop((begin, state), active, step)[1]


def _find_peaks(light: FilteredLight) -> _Peaks:
    """Find the peaks of the expected light behind the filter."""
    ops, wave = light.ops, light.filtered
    # As many peaks as echoes of one width at most, and those of the air: on its hump, and before its ends.
    most = len(wave.centres) + (1 + len(wave.volume.ends) if wave.volume is not None else 0)

    def note(rise: Rise, peaks: _Peaks) -> _Peaks:
        index = ops.int32(ops.minimum(peaks.count, most - 1.0))
        near = (ops.abs(centre - rise.peak) < MERGED for centre in wave.centres)
        return _Peaks(
            count=ops.minimum(peaks.count + 1.0, float(most)),
            places=ops.put(peaks.places, index, rise.peak),
            valleys=ops.put(peaks.valleys, index, rise.valley),
            merged=tuple(merged | beside for merged, beside in zip(peaks.merged, near, strict=True)),
        )

    like = wave.origin_m
    start = _Peaks(
        count=ops.full(like, 0.0),
        places=ops.room(like, most),
        valleys=ops.room(like, most),
        merged=tuple(ops.full(like, False) for _ in wave.centres),
    )
    return visit_all(wave, note, start)


def _peaks_of(light: FilteredLight, candidate: Candidate, power_w: Lanes) -> Lanes:
    """Mean number of peaks that a candidate has, whatever their height, (n,): at most 1 (T167).

    Args:
        power_w: power of the filtered light there
    """
    ops, wave, on_flank, place = light.ops, light.filtered, candidate.on_flank, candidate.place
    before, behind = place - candidate.previous < NEIGHBOURS, candidate.following - place < NEIGHBOURS
    point, noise = light.point, light.point.noise.deviation

    def count() -> Array:
        height, slope, _ = wave.at(place)
        upwards = ops.where(on_flank, ops.where(slope > 0.0, 1.0, -1.0), 0.0)
        # Of an echo on a flank: the way to the higher one.
        way: Lanes = ops.full(place, NEIGHBOURS)
        for centre, power in zip(wave.centres, wave.heights, strict=True):
            ahead = (centre - place) * upwards
            way = ops.where((ahead > MERGED) & (power >= 0.5 * height), ops.minimum(way, ahead), way)
        start = place - ops.where(upwards > 0.0, OUTWARD, way)
        end = place + ops.where(upwards > 0.0, way, OUTWARD)
        start = ops.where(on_flank, start, ops.where(before, candidate.previous, place))
        end = ops.where(on_flank, end, ops.where(behind, candidate.following, place))
        valleys_before, valleys_behind = _valleys(light, (start, place, end), upwards, power_w)
        # Without a valley between two peaks there is one: the higher, as noise has it.
        lost: Lanes = 0.0
        for near, other, number in ((before, start, valleys_before), (behind, end, valleys_behind)):
            other_w = wave.at(other)[0]
            photons, others = (light.signal(point, power) for power in (power_w, other_w))
            variance = 2.0 * noise * noise + point.noise.kappa_1 * (photons + others)
            lower = normal_tail((photons - others) / ops.sqrt(ops.maximum(variance, 1e-6)))
            lost = lost + ops.where(near, lower * ops.maximum(1.0 - number, 0.0), 0.0)
        on_way = ops.minimum(valleys_before + valleys_behind, 1.0)
        peaks: Array = ops.where(on_flank, on_way, ops.maximum(1.0 - lost, 0.0))
        return peaks

    return ops.where_any(candidate.exists & (on_flank | before | behind), count, ops.full(place, 1.0))


def _valleys(light: FilteredLight, stretches: tuple[Lanes, ...], upwards: Lanes, power_w: Lanes) -> tuple[Lanes, ...]:
    """Mean number of valleys of the drawn histogram behind the filter in neighbouring stretches, (n,) each (T166).

    Args:
        stretches: their ends, one more than stretches
        upwards: 1 or -1: only where the expected light rises or falls; 0: wherever
        power_w: power of the filtered light at the candidate, which gives the photons of all light there
    """
    ops, wave = light.ops, light.filtered
    pixel, point = light.pixel, light.point
    bin_sigmas = pixel.histogram.bin_s / pixel.sigma_s
    stride = bin_sigmas * (0.5 / matched_filter.OUTPUT_WIDTH)
    photons_per_w = light.signal(point, power_w) / ops.maximum(power_w, 1e-30)
    noise = point.noise.deviation * point.noise.deviation

    def moments_at(place: Lanes) -> tuple[Lanes, Lanes]:
        mean: Lanes = ops.full(place, 0.0)
        broadened: Lanes = ops.full(place, 0.0)
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
