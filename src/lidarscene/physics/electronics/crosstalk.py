"""Pulses of other lidars: how strong those are that trip the comparator.

They come at random to our clock, as a Poisson process, with peaks whose logarithm is normally distributed: a beam
that crosses ours by chance is met at some place in its spot, off some surface, through a product of such factors.
"""

from __future__ import annotations

import math

from ...maths.arrays import Lanes, xp
from ...maths.special import normal_tail, normal_tail_inverse

_NEPERS = math.log(10.0) / 10.0  # in a decibel of power


def tripping_probability(*, needed_power_w: Lanes, median_power_w: Lanes, spread_db: Lanes) -> Lanes:
    """Share of the pulses with a peak of ``needed_power_w`` or more, Q(ln(needed / median) / s)."""
    ops = xp(needed_power_w, median_power_w, spread_db)
    ratio = ops.maximum(needed_power_w, 1e-30) / ops.maximum(median_power_w, 1e-30)
    return normal_tail(ops.log(ratio) / (_NEPERS * spread_db))


def tripping_power_w(*, uniform: Lanes, probability: Lanes, median_power_w: Lanes, spread_db: Lanes) -> Lanes:
    """Peak of a pulse that trips, from a number in (0, 1] and `tripping_probability`: the inverse of its tail."""
    ops = xp(uniform, probability, median_power_w)
    tail = ops.minimum(ops.maximum(uniform * probability, 1e-30), 1.0 - 1e-6)
    return median_power_w * ops.exp(_NEPERS * spread_db * normal_tail_inverse(tail))
