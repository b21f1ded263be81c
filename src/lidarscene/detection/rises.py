"""Rises: a Waveform in, its peaks one after the other, each with the valley before it, to whoever visits them.

No bins: the search steps over places where a peak can be, and jumps over the rest of the window.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ..light.waveform import Waveform
from ..maths.arrays import Array, State, xp
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

    found: Array
    number: Array
    valley: Array
    valley_w: Array
    peak: Array
    top: Shape


Visit = Callable[[Rise, State], State]
"""What is known so far and a rise, to what is known after it."""


def visit_all(wave: Waveform, visit: Visit, state: State) -> State:
    """Every rise of every pulse, in order of time; ``state`` holds arrays of one entry for each pulse."""
    ops = xp(wave.origin_m)
    intervals = wave.intervals()

    def following(place: Array) -> Array:
        """Start of the first interval that does not end before this place."""
        first = ops.full(place, 2.0 * _END)
        for start, end in intervals:
            first = ops.where(end > place, ops.minimum(first, start), first)
        return first

    def going(*values: Array) -> Array:
        return values[len(march) - 1]

    def step(*values: Array) -> State:
        left, place, slope, bend, ahead, low, high, found, number, *rest = values
        peak, top = highest_between(wave.at, left, place, wanted=found)
        valley, lowest = lowest_between(wave.at, low, high, wanted=found & (high > low))
        first = number == 0
        rise = Rise(
            found=found,
            number=ops.uint32(number),
            valley=ops.where(first, begin - _BEFORE, valley),
            valley_w=lowest[0],
            peak=peak,
            top=top,
        )
        return (*_march(wave, following, place, slope, bend, ahead), number + 1, *visit(rise, tuple(rest)))

    # Before the first interval the waveform rises from nothing. The way to the next peak is the end of a step, not its
    # beginning: what a visit costs is not paid once more to learn that there are no more.
    start = following(ops.full(wave.origin_m, -_END))
    begin = ops.where(start < _END, start, 0.0)
    nothing, number = ops.full(begin, 0.0), ops.full(begin, 0)
    march = _march(wave, following, begin, nothing + 1.0, nothing, start)
    done: State = ops.loop((*march, number, *state), going, step)
    return done[len(march) + 1 :]


def _march(
    wave: Waveform, following: Callable[[Array], Array], place: Array, slope: Array, bend: Array, ahead: Array
) -> State:
    """On to the next two places with a peak between them.

    Returns the first of these places; the second with its slope and bend and what lies ahead of it; the two places
    around the lowest point on the way; and whether there is a peak at all.
    """
    ops = xp(place, slope)

    def going(left: Array, place: Array, slope: Array, bend: Array, ahead: Array, *rest: Array) -> Array:
        return ~rest[-1] & (ahead < _END)

    def step(left: Array, place: Array, slope: Array, bend: Array, ahead: Array, *rest: Array) -> State:
        low, high, _ = rest
        turning = slope * bend < 0.0
        level_at = ops.where(turning, ops.abs(slope) / ops.where(turning, ops.abs(bend), 1.0), STEP)
        stride = ops.minimum(ops.maximum(_BEYOND * level_at, _SHORTEST), STEP)
        right = ops.maximum(place + stride, ahead)
        _, slope_there, bend_there = wave.at(right)
        up = (slope <= 0.0) & (slope_there > 0.0)
        down = (slope > 0.0) & (slope_there <= 0.0)
        return (
            place, right, slope_there, bend_there, following(right),
            ops.where(up, place, low), ops.where(up, right, high), down,
        )  # fmt: skip

    nothing = ops.full(place, 0.0)
    state = (place, place, slope, bend, ahead, nothing, nothing, ops.full(place, False))
    done: State = ops.loop(state, going, step)
    return done
