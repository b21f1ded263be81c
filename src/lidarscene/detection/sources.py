"""Sources: the sub-echo of a pulse with the most light, of all or at a place of the waveform.

Symbols: p_k and u_k light and centre of sub-echo k.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..light.waveform import Waveform
from ..maths.arrays import Array, Lanes, xp


@dataclass(frozen=True, slots=True, kw_only=True)
class Brightest:
    """Brightest of some sub-echoes at a place of the waveform, and sums over them; each field (n,).

    Attributes:
        number: number of the sub-echo with the most light there
        highest: its light there; -1 without any sub-echo
        total: sum of their light
        slope: derivative of the sum of their light
        mean: mean of their centres, weighted by their light there
    """

    number: Lanes
    highest: Lanes
    total: Lanes
    slope: Lanes
    mean: Lanes


def brightest(wave: Waveform, place: Lanes, first: int, end: int) -> Brightest:
    """Find the brightest of the sub-echoes ``first`` to ``end`` - 1 at a place, and sum over them."""
    ops = xp(wave.origin_m)
    highest, number = ops.full(place, -1.0), ops.full(place, 0)
    total: Lanes = ops.full(place, 0.0)
    slope: Lanes = 0.0
    for k in range(first, end):
        ahead = wave.centres[k] - place
        part = wave.heights[k] * ops.exp(-0.5 * ahead * ahead)
        number = ops.where(part > highest, k, number)
        highest = ops.maximum(part, highest)
        total, slope = total + part, slope + part * ahead
    # slope = sum_k p_k (u_k - u), so u + slope / total = sum_k p_k u_k / sum_k p_k: the mean weighted by light.
    lit = total > 0.0
    mean = place + ops.where(lit, slope / ops.where(lit, total, 1.0), 0.0)
    return Brightest(number=number, highest=highest, total=total, slope=slope, mean=mean)


def strongest(wave: Waveform, surfaces: int, folds_m: Sequence[Lanes] | None = None) -> tuple[Array, Lanes]:
    """Number and range [m] of each pulse's strongest sub-echo of a surface, both (n,).

    Args:
        surfaces: number of sub-echoes that are of surfaces; they come before those of the air
        folds_m: (n,) for each, by how much it appears too near; None: not at all
    """
    ops = xp(wave.origin_m)
    number, highest = ops.full(wave.origin_m, 0), ops.full(wave.origin_m, 0.0)
    place = ops.full(wave.origin_m, 0.0)
    for k, (centre, height) in enumerate(zip(wave.centres[:surfaces], wave.heights, strict=False)):
        number = ops.where(height > highest, k, number)
        place = ops.where(height > highest, centre, place)
        highest = ops.maximum(height, highest)
    range_m = wave.range_m(place)
    return number, range_m if folds_m is None else range_m + of_number(folds_m, number)


def of_number(values: Sequence[Lanes], number: Lanes) -> Lanes:
    """Value of this sub-echo among those of all, (n,)."""
    chosen: Lanes = values[0]
    for k, value in enumerate(values[1:], start=1):
        chosen = xp(number).where(number == k, value, chosen)
    return chosen
