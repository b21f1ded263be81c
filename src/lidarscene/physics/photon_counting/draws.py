"""Draws: binomial counts from uniform numbers.

A histogram receiver draws some twenty counts for each pulse, most of them small. Lanes go through a kernel in packets,
and a packet leaves out what none of its lanes needs.
"""

from __future__ import annotations

import math

from ...maths.arrays import Array, Lanes, xp
from ...maths.special import log1p, polynomial

_FEW = 4.0
"""Accuracy bought: below this mean the distribution is inverted term by term."""

_RARE = 0.03
"""Accuracy bought: below this probability of a trial the logarithm of its complement is a series."""

_TERMS = 14
"""Terms that are inverted: P(count > 14) is 1e-5 at a mean of 4."""

_FIRST_TERMS = 5
"""Terms that are inverted where a count is not 0: P(count >= 5) is 4e-3 at a mean of 1."""

_MARGIN = 5e-5
"""Accuracy bought: distance of a uniform number from the bounds between which its count is 1: farther than the series
of `_small_count` and single precision are off."""

_TAIL = 5.0
"""Accuracy bought: beyond this -ln(1 - x^2), which 0.3 % of the numbers exceed, the normal deviate has a polynomial of
its own."""

_CENTRE = (
    2.81022636e-08,
    3.43273939e-07,
    -3.5233877e-06,
    -4.39150654e-06,
    0.00021858087,
    -0.00125372503,
    -0.00417768164,
    0.246640727,
    1.50140941,
)
"""Source: Giles (`_deviate`), coefficients of erfinv up to there, the highest power first."""

_BEYOND = (
    -0.000200214257,
    0.000100950558,
    0.00134934322,
    -0.00367342844,
    0.00573950773,
    -0.0076224613,
    0.00943887047,
    1.00167406,
    2.83297682,
)
"""Source: Giles (`_deviate`), coefficients of erfinv beyond."""


def binomial_count(*, trials: Lanes, probability: Lanes, uniform: Lanes) -> Lanes:
    """A whole number from a binomial distribution, (n,): by inversion if its mean is small, else by Cornish and Fisher.

    Args:
        trials: number of trials, whole or not
        probability: probability of each, from 0 to 1
        uniform: in (0, 1]
    """
    ops = xp(trials, probability, uniform)
    p = ops.minimum(ops.maximum(probability, 0.0), 1.0 - 1e-6)
    few = trials * p < _FEW
    # (1 - p)^N >= 1 - N p for N >= 1, and up to that the count is 0. It is at most (N p)^2 / 2 above that. So large is
    # the probability of two counts at most, for N >= 2: between both bounds there is one. Many packets in the dark need
    # no more.
    mean = ops.maximum(trials, 1.0) * p
    counts, several = few & (uniform > 1.0 - mean), 0.5 * mean * mean + _MARGIN
    one = (uniform > 1.0 - mean + several) & (uniform <= 1.0 - several) & (trials >= 2.0)
    known = ops.where(counts & one, 1.0, 0.0)
    small = ops.where_any(counts & ~one, lambda: _small_count(trials, p, uniform), known)
    return ops.where_any(~few, lambda: _large_count(trials, p, uniform), small)


def _small_count(trials: Lanes, p: Lanes, uniform: Lanes) -> Array:
    """The count if its mean is small, (n,): how many terms of the distribution lie below the uniform number."""
    ops = xp(trials, p, uniform)
    # Few of many trials: three terms of ln(1 - p), off by p^3 / 4 of a count.
    series: Lanes = -p * polynomial(p, 1.0 / 3.0, 0.5, 1.0)
    log_none: Lanes = ops.where_any(p > _RARE, lambda: 0.0 * p + log1p(-p), series)
    none = ops.exp(trials * log_none)
    # P(k) / P(k - 1) = (N + 1) odds / k - odds: written so that each term waits for one product of the term before.
    odds = p / (1.0 - p)
    all_odds = (trials + 1.0) * odds

    def add_terms(state: tuple[Lanes, Lanes, Lanes], first: int, end: int) -> tuple[Lanes, Lanes, Lanes]:
        """Count, term and sum of the terms after more terms."""
        count, term, below = state
        for k in range(first, end):
            term = term * ops.maximum(ops.fma(all_odds, 1.0 / k, -odds), 0.0)
            below = below + term
            count = count + ops.where(uniform > below, 1.0, 0.0)
        return count, term, below

    first_count: Lanes = ops.where(uniform > none, 1.0, 0.0)
    state = add_terms((first_count, none, none), 1, _FIRST_TERMS)
    count, _, _ = ops.where_any(uniform > state[2], lambda: add_terms(state, _FIRST_TERMS, _TERMS), state)
    return ops.minimum(count, trials)


def _large_count(trials: Lanes, p: Lanes, uniform: Lanes) -> Array:
    """The count if its mean is not small, (n,): Cornish and Fisher to the kurtosis, rounded to a whole number."""
    # Rounding adds 1 / 12 to the variance, so it is taken off before (Sheppard).
    ops = xp(trials, p, uniform)
    mean = trials * p
    root = ops.sqrt(ops.maximum(mean * (1.0 - p) - 1.0 / 12.0, 1e-6))
    z = _deviate(uniform)
    square, tilt = z * z, 1.0 - 2.0 * p
    skew = tilt * ops.fma(square, 1.0 / 6.0, -1.0 / 6.0)
    # 1 - 6 p (1 - p) is (3 tilt^2 - 1) / 2.
    tilt_square = tilt * tilt
    spread = ops.fma(tilt_square, 1.5, -0.5)
    curved = spread * ops.fma(square, 1.0 / 24.0, -3.0 / 24.0) - tilt_square * ops.fma(square, 2.0 / 36.0, -5.0 / 36.0)
    many = ops.floor(ops.fma(root, z, mean) + skew + curved * z / root + 0.5)
    return ops.minimum(ops.maximum(many, 0.0), trials)


def _deviate(uniform: Lanes) -> Lanes:
    """The z below which a standard normal deviate lies with this probability, to 1e-4 or better.

    Giles, "Approximating the erfinv function", GPU Computing Gems Jade Edition, 2011.
    """
    ops = xp(uniform)
    # x = 2 u - 1 in (-1, 1); 1 - x^2 = 4 u (1 - u) keeps its precision near 0. Near 1 float32 has no more than 24 bits.
    x = 2.0 * uniform - 1.0
    w = -ops.log(ops.maximum(4.0 * uniform * (1.0 - uniform), 1e-12))
    low = polynomial(w - 2.5, *_CENTRE)

    def tail() -> Lanes:
        return polynomial(ops.sqrt(ops.maximum(w, _TAIL)) - 3.0, *_BEYOND)

    return math.sqrt(2.0) * x * ops.where_any(w >= _TAIL, tail, low)
