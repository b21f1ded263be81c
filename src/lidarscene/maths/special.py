"""Special functions for numpy and Dr.Jit, with relative (not absolute) precision in the tails.

False-alarm probabilities of 1e-9 and below decide how many false points a frame has. Library functions lose them in
single precision, or do not exist on the device.

Symbols: Q(x) upper tail of the standard normal distribution.
"""

from __future__ import annotations

import math

import numpy as np

from .arrays import Lanes, is_drjit, xp

SIGMA_PER_MAD = 1.4826
"""Source: normal distribution, 1 / 0.6745; standard deviation over its median absolute deviation."""

_G = (
    -0.574876301783,
    0.585602105065,
    0.0193236598742,
    -0.0319074323358,
    -0.00176507555013,
    0.00431992303771,
    -0.00020373366824,
    -0.000704773165933,
    0.000160267917169,
    0.000100904262117,
    -4.78213909494e-05,
    -8.71241465059e-06,
    6.99029317878e-06,
)
"""Accuracy bought: coefficients of g, a polynomial in t: erfc(z) = t exp(-z^2 + g), t = 2 / (2 + z), fitted to
scipy.special.erfcx by Chebyshev interpolation on 0 <= z <= 12: 1.8e-10 relative in float64, a few 1e-7 in float32."""

_Z_MAX = 12.0
"""Accuracy bought: end of the polynomial's interval: erfc is below 1e-62 there, beyond single precision."""

_T_MIN = 2.0 / (2.0 + _Z_MAX)
_T_MIDDLE, _T_HALF = 0.5 * (1.0 + _T_MIN), 0.5 * (1.0 - _T_MIN)


def normal_tail(x: Lanes) -> Lanes:
    """Q(x): probability that a standard normal deviate exceeds ``x``.

    Relative error below 2e-10 in float64 and about 5e-7 (1 + x^2 / 2) in float32, for x up to 17. Beyond that it
    keeps falling to zero.
    """
    ops = xp(x)
    t, g = _erfcx(ops.minimum(ops.abs(x) * math.sqrt(0.5), _Z_MAX))
    half = 0.5 * t * ops.exp(g - 0.5 * x * x)
    return ops.where(x > 0.0, half, 1.0 - half)


def _erfcx(z: Lanes) -> tuple[Lanes, Lanes]:
    """The t and g with erfc(z) exp(z^2) = t exp(g)."""
    t = 2.0 / (2.0 + z)
    u = (t - _T_MIDDLE) / _T_HALF
    g = _G[-1] + 0.0 * u
    for coefficient in _G[-2::-1]:
        g = g * u + coefficient
    return t, g


def log1p(x: Lanes) -> Lanes:
    """log(1 + x), precise for small ``x`` in float32 too."""
    if not is_drjit(x):
        return np.log1p(x)
    ops = xp(x)
    series = x * (1.0 - x * (0.5 - x * (1.0 / 3.0 - 0.25 * x)))
    return ops.where(ops.abs(x) < 2.0**-7, series, ops.log(1.0 + x))


def expm1(x: Lanes) -> Lanes:
    """exp(x) - 1, precise for small ``x`` in float32 too."""
    if not is_drjit(x):
        return np.expm1(x)
    ops = xp(x)
    series = x * (1.0 + x * (0.5 + x * (1.0 / 6.0 + x * (1.0 / 24.0))))
    return ops.where(ops.abs(x) < 2.0**-6, series, ops.exp(x) - 1.0)


def polynomial(x: Lanes, *coefficients: float) -> Lanes:
    """Polynomial by Horner's rule, an operation for each power; ``coefficients`` from the highest power down."""
    ops, value = xp(x), coefficients[0] + 0.0 * x
    for coefficient in coefficients[1:]:
        value = ops.fma(value, x, coefficient)
    return value


_STIELTJES = 1 / 12, 1 / 30, 53 / 210, 195 / 371, 22999 / 22737, 29944523 / 19733142
"""Source: NIST Digital Library of Mathematical Functions, 5.10; continued fraction of what Stirling's formula lacks."""


def _beyond_stirling(x: Lanes) -> Lanes:
    """log Gamma(x) less (x - 1/2) log x - x + log(2 pi) / 2: Stieltjes' fraction at x + 2, and the recurrence to x."""
    lacking: Lanes = 0.0
    for coefficient in reversed(_STIELTJES):
        lacking = coefficient / (x + 2.0 + lacking)
    for y in (x + 1.0, x):
        lacking = lacking + ((y + 0.5) * log1p(1.0 / y) - 1.0)
    return lacking


def beta_power(x: Lanes, a: Lanes, b: Lanes) -> Lanes:
    """x^a (1 - x)^b / B(a, b), for a and b >= 1 and 0 < x < 1.

    As C. Loader computes binomial probabilities (Fast and Accurate Computation of Binomial Probabilities, 2000): by how
    far a is from its share of a + b. Logarithms of factorials would lose all digits of single precision.
    """
    ops, trials = xp(x, a, b), a + b
    exponent = _beyond_stirling(trials) - _beyond_stirling(a) - _beyond_stirling(b)
    # The nearer to 0 of x and 1 - x has more digits.
    beyond = ops.where(x < 0.5, a - trials * x, trials * (1.0 - x) - b)
    for count, expected, off in ((a, trials * x, beyond), (b, trials * (1.0 - x), -beyond)):
        # off - count log(count / expected), which near the expected one is a difference of nearly equal numbers.
        near = ops.abs(off) < 0.05 * expected
        share = ops.where(near, off / expected, 0.0)
        series = polynomial(share, -1 / 56, 1 / 42, -1 / 30, 1 / 20, -1 / 12, 1 / 6, -1 / 2)
        exponent = exponent + ops.where(near, off * share * series, off - count * ops.log(count / expected))
    return ops.exp(exponent) * ops.sqrt(a * (b / trials) / (2.0 * math.pi))


_MANY = 1000.0
"""Accuracy bought: variance of a count from which on Edgeworth's series is better near the mean: both are good to 4e-5
there."""


def binomial_tail(*, least: Lanes, trials: Lanes, probability: Lanes) -> Lanes:
    """Probability that a binomial count is at least ``least``: the regularised incomplete beta I_p(k, n - k + 1).

    By a continued fraction, on the side of the mean where it converges within 60 terms for up to about 3000 trials. Of
    many more it does not near the mean, where Edgeworth's series takes its place. Relative error up to 3000 trials 1e-8
    in float64, and of any number of them 4e-5; in float32 7e-5 up to 3000 trials, some 1e-3 up to 1e6 and 2e-2 up to
    1e9, if one in 1000 of them does not count.
    """
    ops = xp(least, trials, probability)
    k = ops.maximum(ops.minimum(least, trials), 1.0)
    p = ops.minimum(ops.maximum(probability, 1e-30), 1.0 - 1e-7)
    a, b = k, trials - k + 1.0
    # The fraction converges fast on one side of the mean only; on the other, I_p(a, b) = 1 - I_(1-p)(b, a).
    upper = p < (a + 1.0) / (a + b + 2.0)
    sides = ops.where(upper, a, b), ops.where(upper, b, a), ops.where(upper, p, 1.0 - p), ops.where(upper, 1.0 - p, p)
    tail = beta_power(p, a, b) * _incomplete_beta_fraction(*sides)
    tail = ops.where(upper, tail, 1.0 - tail)
    variance = trials * p * (1.0 - p)
    deviation = ops.sqrt(variance)
    off = (k - trials * p - 0.5) / deviation
    density = ops.exp(-0.5 * off * off) / math.sqrt(2.0 * math.pi)
    broad = normal_tail(off) + density * (off * off - 1.0) * (1.0 - 2.0 * p) / (6.0 * deviation)
    tail = ops.where((variance > _MANY) & (ops.abs(off) < 1.0), broad, tail)
    tail = ops.where(least <= 0.0, 1.0, ops.where(least > trials, 0.0, tail))
    return ops.minimum(ops.maximum(tail, 0.0), 1.0)


def _incomplete_beta_fraction(a: Lanes, b: Lanes, x: Lanes, y: Lanes) -> Lanes:
    """I_x(a, b) B(a, b) / (x^a y^b), y = 1 - x: 60 terms of A. DiDonato and A. Morris' (9), ACM TOMS 18 (1992), 3.

    By Lentz's method. Where y is small, it has no difference of nearly equal numbers.
    """
    ops = xp(a, b, x)

    def guarded(value: Lanes) -> Lanes:
        return ops.where(ops.abs(value) < 1e-30, 1e-30, value)

    beyond = a * y - b * x + 1.0
    c = fraction = guarded(a * beyond / (a + 1.0))
    d = 0.0 * x
    for m in range(1, 61):
        share = x / (a + (2.0 * m - 1.0))
        above = (a + (m - 1.0)) * share * ((a + b + (m - 1.0)) * share) * (m * (b - m))
        below = m + m * (b - m) * share + (a + m) * (beyond + m * (1.0 + y)) / (a + (2.0 * m + 1.0))
        d = 1.0 / guarded(below + above * d)
        c = guarded(below + above / c)
        fraction = fraction * (c * d)
    return 1.0 / fraction


def scaled_normal_tail(x: Lanes) -> Lanes:
    """Q(x) exp(x^2 / 2) for x >= 0, which does not underflow; relative error below 1e-9 in float64."""
    ops = xp(x)
    near = ops.minimum(ops.abs(x), _Z_MAX * math.sqrt(2.0))
    far = 1.0 / ops.maximum(ops.abs(x), 1.0)
    square = far * far
    series = far * (1.0 - square * (1.0 - square * (3.0 - square * (15.0 - square * 105.0))))
    t, g = _erfcx(near * math.sqrt(0.5))
    return ops.where(near < ops.abs(x), series / math.sqrt(2.0 * math.pi), 0.5 * t * ops.exp(g))


def normal_tail_inverse(probability: Lanes) -> Lanes:
    """The x with Q(x) = ``probability``, 1e-60 < probability < 1, by Newton's method on log Q."""
    ops = xp(probability)
    p = ops.minimum(ops.maximum(probability, 1e-60), 1.0 - 1e-16)
    small = ops.minimum(p, 1.0 - p)
    t = ops.sqrt(-2.0 * ops.log(small))
    # Start: Abramowitz and Stegun 26.2.23, good to 4.5e-4. Then Newton's method on log Q(x) = log p, with the slope
    # -phi / Q; log Q is nearly a parabola, so four steps suffice.
    x = t - (2.515517 + t * (0.802853 + t * 0.010328)) / (1.0 + t * (1.432788 + t * (0.189269 + t * 0.001308)))
    for _ in range(4):
        tail = normal_tail(x)
        density = ops.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)
        x = x + (ops.log(tail) - ops.log(small)) * tail / density
    return ops.where(p <= 0.5, x, -x)
