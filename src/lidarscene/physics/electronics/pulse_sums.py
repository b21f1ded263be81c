"""The received waveform as a sum of shifted Gaussian pulses of one width: values, derivatives, peaks, crossings.

A pulse with several sub-echoes returns such a sum. It is never sampled on a grid; peaks and crossings are found as
roots of its value and slope, so their precision does not depend on a bin width.

Symbols: times t in units of the pulse's standard deviation sigma_p = FWHM / sqrt(8 ln 2), powers P in any unit;
t_k, P_k centre and height of pulse k.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ...maths.arrays import Array, Lanes, Mask, xp

SIGMAS_PER_FWHM = math.sqrt(8.0 * math.log(2.0))

Shape = tuple[Lanes, Lanes, Lanes]
"""Value, first and second derivative of the waveform at some place."""

_TOLERANCE = 1e-5
"""Accuracy bought: last step of a root search, in sigma_p: 0.03 ps for a pulse of 6 ns. Newton's steps shrink by some
hundred each."""

_MOST_STEPS = 40

_STEEPEST = 1e3
"""Accuracy bought: slope of a residual beyond which it is not followed, per sigma_p. The logarithm of a pulse has at
most its distance from the centre, 13 where single precision ends. But the slope of a tabulated course is a difference
over a step: where the course begins it may be any multiple of the value, and Newton's step would be so short that the
search seems to be over."""

_REACH = 13.0
"""Accuracy bought: farthest pulse that `comb_parts` takes, from the middle of its places, in sigma_p: 2 t_FWHM and 8
sigma_p."""

_NEAR = 5.0
"""Choice: distance of the places of `comb_parts` from their middle, in sigma_p, if no larger one is given: 2 t_FWHM."""


def raised(half: float) -> float:
    """Number added to the exponents in `comb_parts`, so that products stay within single precision, e^-87 to e^88.

    Args:
        half: largest distance of a place from the middle: an echo as far on the same side has the factor exp(half^2 /
            2)
    """
    return min(60.0, 87.0 - 0.5 * half * half)


def sum_of_pulses(*, place: Lanes, centres: Sequence[Lanes], heights: Sequence[Lanes]) -> Shape:
    """P(t) = sum_k P_k exp(-(t - t_k)^2 / 2) and its first two derivatives."""
    ops = xp(place, *centres[:1])
    value: Lanes = 0.0
    slope: Lanes = 0.0
    bend: Lanes = 0.0
    for centre, height in zip(centres, heights, strict=True):
        ahead = centre - place
        part = height * ops.exp(-0.5 * ahead * ahead)
        pull = part * ahead
        value, slope, bend = value + part, slope + pull, bend + (pull * ahead - part)
    return value, slope, bend


def comb_parts(
    *,
    start: Lanes,
    spacing: Lanes,
    middle: Lanes,
    centres: Sequence[Lanes],
    heights: Sequence[Lanes],
    half: float = _NEAR,
) -> tuple[list[Array], list[Array]]:
    """`sum_of_pulses` at evenly spaced places u: each pulse's part at the first, and its factor from one to the next.

    P(u) = exp(-(u - m)^2 / 2) sum_k P_k exp(-(t_k - m)^2 / 2) exp((t_k - m)(u - m)). The first exponential is common
    to all pulses, and the last one grows by the constant factor exp((t_k - m) du). So a place costs one
    multiplication for each pulse instead of one exponential. Pulses farther than 8 sigma_p from all places, whose
    light there is 1e-14 of their peak, are left out, and of those beyond the last place more where ``half`` is above 7:
    single precision loses their begin. Rounding accumulates: a hundred places are good to 1e-5.

    Args:
        start: first place
        spacing: distance between places
        middle: centre of the places
        half: largest distance of a place from it
    """
    ops = xp(start, middle, *centres[:1])
    parts, growths = [], []
    for centre, height in zip(centres, heights, strict=True):
        ahead = centre - middle
        near = ops.abs(ahead) < _REACH
        ahead = ops.where(near, ahead, 0.0)
        part = height * ops.exp(raised(half) + ahead * (start - middle - 0.5 * ahead))
        parts.append(ops.where(near, part, 0.0))
        growths.append(ops.exp(ahead * spacing))
    return parts, growths


def even_sum(*, place: Lanes, middle: Lanes, parts: Sequence[Lanes], half: float = _NEAR) -> Lanes:
    """P at one of the places of `comb_parts`, from the pulses' parts at that place."""
    off = place - middle
    value: Lanes = xp(off).exp(-0.5 * off * off - raised(half)) * sum(parts)
    return value


def highest_between(evaluate: Callable[[Lanes], Shape], low: Lanes, high: Lanes, *, mask: Mask) -> tuple[Lanes, Shape]:
    """Peak of the waveform between two places: its slope is positive at the first and negative at the second.

    Args:
        mask: (n,) bool, lanes to search; results of other lanes are undefined

    Returns:
        the place and the shape there
    """

    def uphill(shape: Shape) -> tuple[Lanes, Lanes]:
        # Residual -(ln P)' = -P' / P, whose slope is (P' / P)^2 - P'' / P: nearly linear for a Gaussian, on which
        # Newton's method needs one step.
        _, slope, bend = _relative_shape(shape)
        return -slope, slope * slope - bend

    return _root(evaluate, uphill, low, high, 0.5 * (low + high), mask)


def lowest_between(evaluate: Callable[[Lanes], Shape], low: Lanes, high: Lanes, *, mask: Mask) -> tuple[Lanes, Shape]:
    """Valley of the waveform between two places, as `highest_between`: slope negative, then positive."""

    def downhill(shape: Shape) -> tuple[Lanes, Lanes]:
        _, slope, bend = _relative_shape(shape)
        return slope, bend - slope * slope

    return _root(evaluate, downhill, low, high, 0.5 * (low + high), mask)


def crossing(
    evaluate: Callable[[Lanes], Shape],
    level: Lanes,
    *,
    far: Lanes,
    peak: Lanes,
    top: Shape,
    mask: Mask,
    near: Lanes | None = None,
) -> Lanes:
    """Place at which the waveform crosses a level, between a peak and a lower place on either side of it.

    Args:
        far: place below the level
        peak: place of the peak, and top the shape there
        near: a place between both that is known to be above the level; the peak if None
        mask: (n,) bool, lanes to search; results of other lanes are undefined
    """
    ops = xp(level, far, peak)
    highest, _, bend = top
    log_level = ops.log(ops.maximum(level, 1e-37))
    side = ops.where(far < peak, 1.0, -1.0)

    def above(shape: Shape) -> tuple[Lanes, Lanes]:
        # The logarithm of a Gaussian edge is a parabola, on which Newton's method converges from far away.
        value, slope, _ = _relative_shape(shape)
        return side * (ops.log(value) - log_level), side * slope

    # First guess: a Gaussian with the peak's height and curvature, which is exact for a lone pulse.
    variance = highest / ops.maximum(-bend, ops.maximum(1e-3 * highest, 1e-37))
    above_level = ops.maximum(ops.log(ops.maximum(highest, 1e-37)) - log_level, 0.0)
    guess = peak - side * ops.sqrt(2.0 * variance * above_level)
    near = peak if near is None else near
    return _root(evaluate, above, ops.minimum(far, near), ops.maximum(far, near), guess, mask)[0]


def _relative_shape(shape: Shape) -> Shape:
    """The value, kept above zero, and slope and second derivative divided by it."""
    value, slope, bend = shape
    positive = xp(value).maximum(value, 1e-37)
    return positive, slope / positive, bend / positive


@dataclass(frozen=True, slots=True, kw_only=True)
class _Bracket:
    """A root between two places.

    Attributes:
        place: the best guess, ``moved`` from the one before
        steps: number of steps so far
        shape: shape of the waveform at the guess before
    """

    low: Lanes
    high: Lanes
    place: Lanes
    moved: Lanes
    steps: Lanes
    shape: Shape


def _root(
    evaluate: Callable[[Lanes], Shape],
    residual: Callable[[Shape], tuple[Lanes, Lanes]],
    low: Lanes,
    high: Lanes,
    guess: Lanes,
    mask: Mask,
) -> tuple[Lanes, Shape]:
    """Root of a residual that rises through zero from ``low`` to ``high``: Newton's method, kept inside the bracket.

    Args:
        residual: (value, slope) from the waveform's shape
    """
    ops = xp(low, high, guess)
    guess = ops.where((guess > low) & (guess < high), guess, 0.5 * (low + high))

    def active(state: _Bracket) -> Mask:
        return (state.moved > _TOLERANCE) & (state.steps < _MOST_STEPS)

    def step(state: _Bracket) -> _Bracket:
        place = state.place
        shape = evaluate(place)
        value, slope = residual(shape)
        low, high = ops.where(value < 0.0, place, state.low), ops.where(value < 0.0, state.high, place)
        newton = place - value / ops.where(slope > 1e-30, slope, 1.0)
        # A step that leaves the bracket, or a slope without use, is replaced by bisection.
        inside = (slope > 1e-30) & (slope < _STEEPEST) & (newton >= low) & (newton <= high)
        following = ops.where(inside, newton, 0.5 * (low + high))
        moved = ops.abs(following - place)
        return _Bracket(low=low, high=high, place=following, moved=moved, steps=state.steps + 1, shape=shape)

    zero = ops.full(guess, 0.0)
    start = _Bracket(
        low=low,
        high=high,
        place=guess,
        moved=ops.where(mask, 1.0, zero),
        steps=ops.full(guess, 0),
        shape=(zero, zero, zero),
    )
    final = ops.loop(start, active, step)
    return final.place, final.shape
