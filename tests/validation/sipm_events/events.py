"""Avalanches of a SiPM's cells, one by one: cells and light in, times of firing out.

Every cell receives photons and dark counts as a Poisson process, fires, and is dead for tau (non-paralysable: what
arrives meanwhile is lost and prolongs nothing). There are two engines, which agree where both apply:

independent   no crosstalk, no afterpulses. Cells are then alike and independent, so only those that fire are
              simulated, all cells of many shots at once: pass k finds the k-th firing of each.
coupled       everything. All shots advance together, one avalanche after the other; one pass for every photon.

`output` adds the avalanches up, `working_point` evaluates them: docs/sipm.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lidarscene.maths.arrays import Numbers

from .cells import Rates, recovered_share
from .coupled import fire_coupled

_EVENTS_AT_A_TIME = 2e6


@dataclass(frozen=True, slots=True, kw_only=True)
class Avalanches:
    """Firings of some shots, unordered.

    Attributes:
        shot: (n,) int, from 0
        time_s: (n,) from the pulse's peak
        gain: (n,) charge, 1 for a recovered cell
    """

    shot: Numbers
    time_s: Numbers
    gain: Numbers


def simulate(array, light, *, start_s, end_s, shots, seed):
    """Avalanches in a window, some shots at a time: yields (number of shots, their avalanches).

    Includes avalanches of cells that are busy at the window's start, with earlier times. Equal seeds give equal
    avalanches.
    """
    rates = Rates(array, light, start_s=start_s - array.warm_up_s, end_s=end_s)
    events_per_shot = array.cells * (rates.busy_share + min(rates.total, (end_s - start_s) / array.dead_time_s + 2.0))
    at_a_time = max(1, min(shots, int(_EVENTS_AT_A_TIME / max(events_per_shot, 1.0))))
    engine = fire_coupled if array.crosstalk > 0.0 or array.afterpulse > 0.0 else fire_independent
    for number, first in enumerate(range(0, shots, at_a_time)):
        count = min(at_a_time, shots - first)
        random = np.random.Generator(np.random.SFC64([seed, number]))
        shot, time_s, gain = engine(array, rates, count, random)
        yield count, Avalanches(shot=shot, time_s=time_s, gain=gain)


def fire_independent(array, rates, shots, random):
    """Shot, time and gain of every avalanche of independent cells.

    The start is stationary: busy with probability x / (1 + x), and for a rest of the dead time that is uniform in (0,
    tau). A ready cell fires when the integral of its rate has grown by an exponential deviate.
    """
    # First firings: cells are alike, so their numbers are binomial and only the cells that fire are drawn.
    busy = random.binomial(array.cells, rates.busy_share, shots)
    once = random.binomial(array.cells - busy, -math.expm1(-rates.total))
    busy_shot = np.repeat(np.arange(shots), busy)
    busy_time = rates.time_s[0] - array.dead_time_s * random.random(len(busy_shot))
    shot = np.repeat(np.arange(shots), once)
    waited = -np.log1p(random.random(len(shot)) * math.expm1(-rates.total))
    time_s = rates.when(np.minimum(waited, rates.total))
    shot, time_s = np.concatenate([busy_shot, shot]), np.concatenate([busy_time, time_s])
    passes = [(shot, time_s, np.ones(len(shot)))]
    # Further firings, pass by pass, until no cell fires again in the window.
    ready = time_s + array.dead_time_s
    since = ready
    while len(shot):
        firings = rates.firings_until(since) + random.standard_exponential(len(shot))
        firing_again = np.flatnonzero((firings < rates.total) & (ready < rates.time_s[-1]))
        shot, ready, time_s = shot[firing_again], ready[firing_again], rates.when(firings[firing_again])
        age = time_s - ready
        fires = np.ones(len(shot), dtype=bool)
        if array.trigger_recovery_s > 0.0:
            fires = random.random(len(shot)) < recovered_share(age, array.trigger_recovery_s)
        passes.append((shot[fires], time_s[fires], recovered_share(age[fires], array.recovery_s)))
        ready = np.where(fires, time_s + array.dead_time_s, ready)
        since = np.where(fires, ready, time_s)
    columns = [np.concatenate(column) for column in zip(*passes, strict=True)]
    return columns[0], columns[1], columns[2]
