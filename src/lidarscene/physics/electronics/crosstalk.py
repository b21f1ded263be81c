"""Pulses of other lidars: how strong those are that trip the comparator.

They arrive at random times of our clock, as a Poisson process. The logarithm of their peak power is normally
distributed: a beam that crosses ours by chance is a product of independent factors (place in its spot, surface,
range), and the logarithm of a product tends to a normal distribution.

Symbols: Q upper tail of the standard normal distribution, s standard deviation of ln(power).
"""

from __future__ import annotations

from ...maths.arrays import Lanes, xp
from ...maths.special import normal_tail, normal_tail_inverse
from ..constants import NEPERS_PER_DECIBEL


def tripping_probability(*, needed_power_w: Lanes, median_power_w: Lanes, spread_db: Lanes) -> Lanes:
    """Share of the pulses whose peak is ``needed_power_w`` or more, Q(ln(needed / median) / s)."""
    ops = xp(needed_power_w, median_power_w, spread_db)
    ratio = ops.maximum(needed_power_w, 1e-30) / ops.maximum(median_power_w, 1e-30)
    return normal_tail(ops.log(ratio) / (NEPERS_PER_DECIBEL * spread_db))


def tripping_power_w(*, uniform: Lanes, probability: Lanes, median_power_w: Lanes, spread_db: Lanes) -> Lanes:
    """Peak power of a pulse that trips: the inverse of its tail.

    Args:
        uniform: in (0, 1]: uniform times probability is uniform within the tail that trips
        probability: `tripping_probability`
    """
    ops = xp(uniform, probability, median_power_w)
    tail = ops.minimum(ops.maximum(uniform * probability, 1e-30), 1.0 - 1e-6)
    return median_power_w * ops.exp(NEPERS_PER_DECIBEL * spread_db * normal_tail_inverse(tail))
