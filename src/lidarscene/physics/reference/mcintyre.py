"""Electrons out of an avalanche photodiode: McIntyre's distribution, its exact tail, and Webb's approximation.

Nothing in a render or a study runs this: tests compare with it what does (`lidarscene.physics.reference`). Symbols and
sources as in `physics.electronics.mcintyre`.
"""

from __future__ import annotations

import math

import numpy as np

from ...maths.arrays import Lanes, xp
from ...maths.special import normal_tail, scaled_normal_tail


def log_probability(*, primary: Lanes, total: Lanes, gain: Lanes, ionisation_ratio: Lanes) -> Lanes:
    """Log of the probability that ``primary`` electrons leave as ``total``; -inf for total < primary. numpy.

    For n in and m out (McIntyre, 1972):
    n Gamma(m / (1 - k) + 1) / (m (m - n)! Gamma(k m / (1 - k) + n + 1))
    ((1 + k (M - 1)) / M)^(n + k m / (1 - k)) ((1 - k)(M - 1) / M)^(m - n).
    """
    from scipy.special import gammaln

    n, m = np.broadcast_arrays(np.asarray(primary, dtype=float), np.asarray(total, dtype=float))
    k = ionisation_ratio
    possible = m >= n
    m = np.where(possible, m, n)
    through = k * m / (1.0 - k)
    log_beta = math.log((1.0 - k) * (gain - 1.0) / gain) if gain > 1.0 else -math.inf
    created = np.where(m > n, (m - n) * log_beta, 0.0) if gain > 1.0 else np.where(m > n, log_beta, 0.0)
    value = (
        np.log(n)
        - np.log(m)
        + gammaln(m + through + 1.0)
        - gammaln(m - n + 1.0)
        - gammaln(through + n + 1.0)
        + (n + through) * math.log((1.0 + k * (gain - 1.0)) / gain)
        + created
    )
    return np.where(possible, value, -np.inf)


def webb_tail(*, excess: Lanes, primaries: Lanes, gain: Lanes, excess_noise: Lanes) -> Lanes:
    """Probability of an output more than ``excess`` above its mean, by Webb's approximation; no amplifier.

    In closed form, because 1 + x / lambda is an inverse Gaussian variable (K. R. Baker, IEEE Trans. Commun. 44, 15,
    1996). Needs F > 1; ``excess`` may be negative.
    """
    ops = xp(excess, primaries, gain, excess_noise)
    shape = ops.sqrt(primaries * excess_noise) / (excess_noise - 1.0)
    y = 1.0 + excess / (gain * ops.sqrt(primaries * excess_noise)) / shape
    inside = ops.maximum(y, 1e-12)
    below, above = shape * (inside - 1.0) / ops.sqrt(inside), shape * (inside + 1.0) / ops.sqrt(inside)
    tail = normal_tail(below) - ops.exp(-0.5 * below * below) * scaled_normal_tail(above)
    return ops.where(y > 0.0, ops.maximum(tail, 0.0), 1.0)


def tail_probability_exact(
    *, excess: float, primaries: float, gain: float, ionisation_ratio: float, amplifier: float
) -> float:
    """`tail_probability` by summing McIntyre's probabilities: slow, and without approximation. numpy.

    The distribution of one electron's output is tabulated, compounded over Poisson primaries and convolved with the
    amplifier's noise by Fourier transform. It is first tilted by exp(s m), with s near the saddle point, so that the
    tail keeps its relative precision however small it is.
    """
    deviation = math.hypot(amplifier, gain * math.sqrt(primaries * _second_moment(gain, ionisation_ratio)))
    mean = primaries * gain
    tilt = 0.9 * excess / deviation**2
    tilt = min(tilt, 0.5 * _steepest(gain, ionisation_ratio))
    length = 2 ** math.ceil(math.log2(mean + 4.0 * excess + 24.0 * deviation + 64.0 * gain))
    electrons = np.arange(length, dtype=float)
    single = np.zeros(length)
    single[1:] = np.exp(
        log_probability(primary=1.0, total=electrons[1:], gain=gain, ionisation_ratio=ionisation_ratio)
        + tilt * (electrons[1:] - gain)
    )
    weight = single.sum()
    # Both factors are centred on their means, so that the exponentials stay within the floating range.
    frequency = 2.0 * math.pi * np.fft.rfftfreq(length)
    growth = math.exp(tilt * gain)
    transform = np.exp(
        primaries * growth * (np.fft.rfft(single) - weight)
        - 0.5 * (amplifier * frequency) ** 2
        - 1j * frequency * amplifier**2 * tilt
    )
    tilted = np.fft.irfft(transform, length)
    log_scale = primaries * (growth * weight - 1.0 - tilt * gain) + 0.5 * (amplifier * tilt) ** 2
    # Untilt, and sum what lies above; half of the count at the limit, as a continuous variable has it.
    above = electrons - mean - excess
    share = np.clip(above + 0.5, 0.0, 1.0)
    with np.errstate(over="ignore"):
        untilted = np.where(share > 0.0, tilted * share * np.exp(np.minimum(-tilt * above, 50.0)), 0.0)
    return float(untilted.sum() * math.exp(log_scale - tilt * excess))


def _second_moment(gain: float, k: float) -> float:
    """F: second moment of one electron's output over the square of its mean."""
    return k * gain + (1.0 - k) * (2.0 - 1.0 / gain)


def _steepest(gain: float, k: float) -> float:
    """The s beyond which the mean of exp(s m) over one electron's output diverges."""
    if gain <= 1.0:
        return math.inf
    b = (1.0 - k) * (gain - 1.0) / gain
    if k <= 0.0:
        return -math.log(b)
    d = 1.0 / (k * (gain - 1.0))
    return math.log1p(d) - math.log1p(b * d) / (1.0 - k)
