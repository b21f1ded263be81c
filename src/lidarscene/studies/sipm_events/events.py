"""Avalanches of a SiPM's cells, one by one: cells and light in, times of firing out.

Every cell takes photons and dark counts as a Poisson process, fires, and is dead for tau (non-paralysable: what
comes meanwhile is lost and prolongs nothing). Two engines, which agree where both apply:

independent   no crosstalk, no afterpulses. Cells are then alike and unconnected, so that only those that fire
              are touched, all cells of many shots at once: the k-th pass finds the k-th firing of each.
coupled       anything. Shots run abreast, each avalanche in its turn; costs a pass for every photon.

`sipm_waveform` adds the avalanches up, `sipm_working_point` makes numbers of them. docs/sipm.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...maths.arrays import Numbers
from .cells import CellArray, Light, Rates, recovered
from .coupled import fire_coupled

_EVENTS_AT_A_TIME = 2e6


@dataclass(frozen=True, slots=True, kw_only=True)
class Avalanches:
    """Firings of some shots, in no order.

    shot    (n,) int, from 0
    time_s  (n,) from the pulse's peak
    gain    (n,) charge, 1 for a recovered cell
    """

    shot: Numbers
    time_s: Numbers
    gain: Numbers


def simulate(
    array: CellArray, light: Light, *, start_s: float, end_s: float, shots: int, seed: int
) -> Iterator[tuple[int, Avalanches]]:
    """Avalanches in a window, some shots at a time: (number of shots, what they hold).

    Those of cells that were busy at the window's start come along, with their times before it. The same seed gives
    the same avalanches.
    """
    rates = Rates(array, light, start_s=start_s - array.warm_up_s, end_s=end_s)
    each = array.cells * (rates.busy_share + min(rates.total, (end_s - start_s) / array.dead_time_s + 2.0))
    at_a_time = max(1, min(shots, int(_EVENTS_AT_A_TIME / max(each, 1.0))))
    engine = fire_coupled if array.crosstalk > 0.0 or array.afterpulse > 0.0 else fire_independent
    for number, first in enumerate(range(0, shots, at_a_time)):
        count = min(at_a_time, shots - first)
        random = np.random.Generator(np.random.SFC64([seed, number]))
        shot, time_s, gain = engine(array, rates, count, random)
        yield count, Avalanches(shot=shot, time_s=time_s, gain=gain)


def fire_independent(
    array: CellArray, rates: Rates, shots: int, random: np.random.Generator
) -> tuple[Numbers, Numbers, Numbers]:
    """Shot, time and gain of every avalanche of cells that know nothing of each other.

    The state at the start is stationary: busy with probability x / (1 + x), for how long still even in (0, tau).
    Firings come where the integral of the rate has grown by an exponential deviate since the cell was ready.
    """
    busy = random.binomial(array.cells, rates.busy_share, shots)
    once = random.binomial(array.cells - busy, -math.expm1(-rates.total))
    busy_shot = np.repeat(np.arange(shots), busy)
    busy_time = rates.time_s[0] - array.dead_time_s * random.random(len(busy_shot))
    shot = np.repeat(np.arange(shots), once)
    waited = -np.log1p(random.random(len(shot)) * math.expm1(-rates.total))
    time_s = rates.when(np.minimum(waited, rates.total))
    shot, time_s = np.concatenate([busy_shot, shot]), np.concatenate([busy_time, time_s])
    found = [(shot, time_s, np.ones(len(shot)))]
    ready = time_s + array.dead_time_s
    since = ready
    while len(shot):
        firings = rates.by(since) + random.standard_exponential(len(shot))
        kept = np.flatnonzero((firings < rates.total) & (ready < rates.time_s[-1]))
        shot, ready, time_s = shot[kept], ready[kept], rates.when(firings[kept])
        age = time_s - ready
        fires = np.ones(len(shot), dtype=bool)
        if array.trigger_recovery_s > 0.0:
            fires = random.random(len(shot)) < recovered(age, array.trigger_recovery_s)
        found.append((shot[fires], time_s[fires], recovered(age[fires], array.recovery_s)))
        ready = np.where(fires, time_s + array.dead_time_s, ready)
        since = np.where(fires, ready, time_s)
    columns = [np.concatenate(column) for column in zip(*found, strict=True)]
    return columns[0], columns[1], columns[2]
