"""Rises: a Waveform in, its peaks one after the other, each with the valley before it, to whoever visits them.

No bins: the search steps over places where a peak can be, and jumps over the rest of the window.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ..light.waveform import Waveform
from ..maths.arrays import Array, Lanes, Mask, S, xp
from ..physics.electronics.pulse_sums import Shape, highest_between, lowest_between

STEP = 1.0
"""Longest step of the search, in sigma_p: a lone pulse needs two."""

_SHORTEST = 0.1
"""Shortest step. A peak with a valley or another peak nearer than this may be passed over: a dip of some 1e-4."""

_BEYOND = 1.2
"""Steps go this much farther than to where the slope's tangent is zero."""

_BEFORE = 8.0
"""How far in front of the first place that can be a peak the waveform counts as nothing, in sigma_p."""

_END = 1e29


@dataclass(frozen=True, slots=True, kw_only=True)
class Rise:
    """A peak and what comes before it, one for each pulse.

    found         whether this pulse has another one; the rest means nothing where not
    number        how many came before it, unsigned
    valley        place of the lowest point before it, and its power
    peak, top     place of the peak; power there, and its two derivatives
    """

    found: Mask
    number: Array
    valley: Lanes
    valley_w: Lanes
    peak: Lanes
    top: Shape


@dataclass(frozen=True, slots=True, kw_only=True)
class _March:
    """The search for the next peak: where it is, and what lies around it.

    left, place  two places that follow each other; once ``found`` the peak is between them
    slope, bend  derivatives of the waveform at ``place``
    ahead        start of the first interval that does not end before ``place``: no peak comes before that
    low, high    the two places around the lowest point on the way
    found        whether there is a peak at all
    """

    left: Lanes
    place: Lanes
    slope: Lanes
    bend: Lanes
    ahead: Lanes
    low: Lanes
    high: Lanes
    found: Mask


def visit_all(wave: Waveform, visit: Callable[[Rise, S], S], state: S) -> S:
    """Every rise of every pulse, in order of time.

    visit  from a rise and what is known so far to what is known after it
    state  what is known before the first: arrays of one entry for each pulse
    """
    ops = xp(wave.origin_m)
    intervals = wave.intervals()

    def following(place: Lanes) -> Array:
        """Start of the first interval that does not end before this place."""
        first = ops.full(place, 2.0 * _END)
        for start, end in intervals:
            first = ops.where(end > place, ops.minimum(first, start), first)
        return first

    def active(now: tuple[_March, Lanes, S]) -> Mask:
        return now[0].found

    def step(now: tuple[_March, Lanes, S]) -> tuple[_March, Lanes, S]:
        march, number, so_far = now
        peak, top = highest_between(wave.at, march.left, march.place, wanted=march.found)
        valley, lowest = lowest_between(
            wave.at, march.low, march.high, wanted=march.found & (march.high > march.low)
        )
        first = number == 0
        rise = Rise(
            found=march.found,
            number=ops.uint32(number),
            valley=ops.where(first, begin - _BEFORE, valley),
            valley_w=lowest[0],
            peak=peak,
            top=top,
        )
        onward = _march(wave, following, march.place, march.slope, march.bend, march.ahead)
        return onward, number + 1, visit(rise, so_far)

    # Before the first interval the waveform rises from nothing. The way to the next peak is the end of a step, not its
    # beginning: what a visit costs is not paid once more to learn that there are no more.
    start = following(ops.full(wave.origin_m, -_END))
    begin = ops.where(start < _END, start, 0.0)
    nothing, number = ops.full(begin, 0.0), ops.full(begin, 0)
    first_march = _march(wave, following, begin, nothing + 1.0, nothing, start)
    search: tuple[_March, Lanes, S] = first_march, number, state
    return ops.loop(search, active, step)[2]


def _march(
    wave: Waveform, following: Callable[[Lanes], Array], place: Lanes, slope: Lanes, bend: Lanes, ahead: Lanes
) -> _March:
    """On to the next two places with a peak between them."""
    ops = xp(place, slope)

    def active(now: _March) -> Mask:
        return ~now.found & (now.ahead < _END)

    def step(now: _March) -> _March:
        turning = now.slope * now.bend < 0.0
        level_at = ops.where(turning, ops.abs(now.slope) / ops.where(turning, ops.abs(now.bend), 1.0), STEP)
        stride = ops.minimum(ops.maximum(_BEYOND * level_at, _SHORTEST), STEP)
        right = ops.maximum(now.place + stride, now.ahead)
        _, slope_there, bend_there = wave.at(right)
        up = (now.slope <= 0.0) & (slope_there > 0.0)
        down = (now.slope > 0.0) & (slope_there <= 0.0)
        return _March(
            left=now.place,
            place=right,
            slope=slope_there,
            bend=bend_there,
            ahead=following(right),
            low=ops.where(up, now.place, now.low),
            high=ops.where(up, right, now.high),
            found=down,
        )

    nothing = ops.full(place, 0.0)
    start = _March(
        left=place, place=place, slope=slope, bend=bend, ahead=ahead, low=nothing, high=nothing,
        found=ops.full(place, False),
    )  # fmt: skip
    return ops.loop(start, active, step)
