"""Rises: the peaks of a waveform in order of time, each with the valley before it.

A sum of Gaussian pulses has fewer peaks than pulses, and their places are not known in closed form. Sampling the whole
window would cost thousands of evaluations for each pulse. The search evaluates the waveform only where it can have a
peak, jumps over the rest, and finds peaks and valleys as roots (docs/theory_light.md 5).

Symbols: P power over time, sigma_p standard deviation of the laser pulse and unit of all places.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ..light.waveform import Waveform
from ..maths.arrays import Array, Lanes, Mask, S, xp
from ..physics.electronics.pulse_sums import Shape, highest_between, lowest_between

STEP = 1.0
"""Accuracy bought: longest step of the search, in sigma_p: a single pulse takes two.

A step may pass over a valley and the peak behind it, if both are nearer than this to the peak before: of two equal
pulses, 2.1 sigma_p apart, that is a dip of 0.7 %."""

_SHORTEST = 0.1
"""Accuracy bought: shortest step of the search, in sigma_p: it passes a peak that the slope's tangent puts nearer."""

_BEYOND = 1.2
"""Accuracy bought: factor by which steps are longer than the way to where the slope's tangent is zero, so that they
pass the peak."""

_END = 1e29
"""Choice: places beyond this are behind the last interval."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rise:
    """One peak of each pulse and the valley before it; each field (n,). Between the two the power only rises.

    Attributes:
        exists: whether the pulse has this peak; if not, the other fields are undefined
        number: number of peaks before it, unsigned
        valley: place of the lowest point before the peak
        valley_w: power there
        peak: place of the peak
        top: power at the peak, and its first and second derivative
    """

    exists: Mask
    number: Array
    valley: Lanes
    valley_w: Lanes
    peak: Lanes
    top: Shape


@dataclass(frozen=True, slots=True, kw_only=True)
class _March:
    """State of the search for the next peak of each pulse; each field (n,).

    Attributes:
        previous: place of the search before ``place``; once ``bracketed``, the peak is between them
        place: place of the search
        slope: first derivative of the waveform at ``place``
        bend: second derivative there
        ahead: start of the first interval that does not end before ``place``: there is no peak before it
        low: the first of two consecutive places with the valley between them
        high: the second
        bracketed: whether a peak lies between the last two places
    """

    previous: Lanes
    place: Lanes
    slope: Lanes
    bend: Lanes
    ahead: Lanes
    low: Lanes
    high: Lanes
    bracketed: Mask


def visit_all(wave: Waveform, visit: Callable[[Rise, S], S], state: S) -> S:
    """Visit every rise of every pulse in order of time; returns the last state.

    Args:
        visit: ``visit(rise, state) -> state``, called once for each rise
        state: state before the first rise: arrays of one entry for each pulse
    """
    if wave.lone:
        return _visit_lone(wave, visit, state)
    ops = xp(wave.origin_m)
    intervals = wave.intervals()

    def next_start(place: Lanes) -> Array:
        """Start of the first interval that ends behind this place; beyond `_END` if there is none."""
        first = ops.full(place, 2.0 * _END)
        for start, end in intervals:
            first = ops.where(end > place, ops.minimum(first, start), first)
        return first

    def active(loop_state: tuple[_March, Lanes, S]) -> Mask:
        return loop_state[0].bracketed

    def step(loop_state: tuple[_March, Lanes, S]) -> tuple[_March, Lanes, S]:
        march, number, so_far = loop_state
        # The march has bracketed the peak and the valley before it; Newton's method finds both. All lanes go through
        # the loop together, so each visit handles the j-th rise of every pulse that has one.
        peak, top = highest_between(wave.at, march.previous, march.place, mask=march.bracketed)
        valley, lowest = lowest_between(wave.at, march.low, march.high, mask=march.bracketed & (march.high > march.low))
        # A rise begins in the valley because that is where the comparator may fall, and because the power only rises
        # from there to the peak: a level between them is crossed exactly once.
        first = number == 0
        rise = Rise(
            exists=march.bracketed,
            number=ops.uint32(number),
            valley=ops.where(first, dark, valley),
            valley_w=lowest[0],
            peak=peak,
            top=top,
        )
        onward = _march(wave, next_start, march.place, march.slope, march.bend, march.ahead)
        return onward, number + 1, visit(rise, so_far)

    # The waveform rises from zero before the first interval: its slope is positive there and its valley is dark. Each
    # step ends with the march to the next peak instead of beginning with it. So the loop ends before a visit of
    # lanes that have no further peak.
    start = next_start(ops.full(wave.origin_m, -_END))
    begin = ops.where(start < _END, start, 0.0)
    dark = wave.start(begin)
    zero, number = ops.full(begin, 0.0), ops.full(begin, 0)
    first_march = _march(wave, next_start, begin, zero + 1.0, zero, start)
    search: tuple[_March, Lanes, S] = first_march, number, state
    return ops.loop(search, active, step)[2]


def _visit_lone(wave: Waveform, visit: Callable[[Rise, S], S], state: S) -> S:
    """Visit the only rise of pulses with one echo at most: it is the echo, and needs no search."""
    ops = xp(wave.origin_m)
    (height,), zero = wave.heights, ops.full(wave.origin_m, 0.0)
    exists = height > 0.0
    # Places count from the first echo.
    rise = Rise(
        exists=exists,
        number=ops.uint32(ops.full(zero, 0)),
        valley=wave.start(zero - 1.0),
        valley_w=zero,
        peak=zero,
        top=(height, zero, -height),
    )

    def step(loop_state: tuple[Lanes, S]) -> tuple[Lanes, S]:
        return loop_state[0] + 1, visit(rise, loop_state[1])

    # A loop of one step: packets without an echo skip it, and no derivatives pass.
    start: tuple[Lanes, S] = ops.full(zero, 0), state
    return ops.loop(start, lambda loop_state: exists & (loop_state[0] < 1), step)[1]


def _march(
    wave: Waveform, next_start: Callable[[Lanes], Array], place: Lanes, slope: Lanes, bend: Lanes, ahead: Lanes
) -> _March:
    """Walk on to the next pair of places with a peak between them.

    Args:
        next_start: gives the start of the first interval that ends behind a place
        place: (n,) start of the walk
        slope: (n,) first derivative of the waveform there
        bend: (n,) second derivative there
        ahead: (n,) ``next_start(place)``
    """
    ops = xp(place, slope)

    def active(march: _March) -> Mask:
        return ~march.bracketed & (march.ahead < _END)

    def step(march: _March) -> _March:
        # A peak needs P' = 0 and P'' < 0. Where the slope runs towards zero its tangent says how far that is; the step
        # goes a little farther, so that a peak falls between its ends, and never farther than sigma_p.
        turning = march.slope * march.bend < 0.0
        level_at = ops.where(turning, ops.abs(march.slope) / ops.where(turning, ops.abs(march.bend), 1.0), STEP)
        stride = ops.minimum(ops.maximum(_BEYOND * level_at, _SHORTEST), STEP)
        # Outside the intervals the waveform is convex: it may have one valley there, but no peak. The step may jump
        # over all of it, and its two ends still enclose that valley.
        right = ops.maximum(march.place + stride, march.ahead)
        _, slope_there, bend_there = wave.at(right)
        up = (march.slope <= 0.0) & (slope_there > 0.0)
        down = (march.slope > 0.0) & (slope_there <= 0.0)
        return _March(
            previous=march.place,
            place=right,
            slope=slope_there,
            bend=bend_there,
            ahead=next_start(right),
            low=ops.where(up, march.place, march.low),
            high=ops.where(up, right, march.high),
            bracketed=down,
        )

    zero = ops.full(place, 0.0)
    start = _March(
        previous=place,
        place=place,
        slope=slope,
        bend=bend,
        ahead=ahead,
        low=zero,
        high=zero,
        bracketed=ops.full(place, False),
    )
    return ops.loop(start, active, step)
