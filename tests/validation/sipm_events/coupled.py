"""Avalanches of cells that influence each other: photons, dark counts, crosstalk and afterpulses in order of time.

All shots advance together: one pass handles one event of each shot. It is the slow and simple engine, which keeps the
time of every cell's last avalanche and assumes nothing else; the fast one is checked against it.
"""

from __future__ import annotations

import numpy as np

from lidarscene.maths.arrays import Numbers

from .cells import CellArray, Rates, recovered_share

_SPARE_SLOTS = 32
"""Room for pending afterpulses of a shot above the mean of an array that is always busy. Beyond that a further one
replaces the one that is due last."""


class _State:
    """State of each shot: last avalanche of every cell, pending afterpulses, avalanches so far."""

    def __init__(self, array: CellArray, rates: Rates, shots: int, random: np.random.Generator) -> None:
        """Stationary for cells without memory; `CellArray.warm_up_s` covers the rest."""
        self.array, self.random = array, random
        shape = (shots, array.cells)
        ago = array.dead_time_s * random.random(shape)
        busy = random.random(shape) < rates.busy_share
        self.last = np.where(busy, rates.time_s[0] - ago, -np.inf)
        shot, cell = np.nonzero(busy)
        self.avalanches = [(shot, self.last[shot, cell], np.ones(len(shot)))]
        pending = array.afterpulse * array.cells * array.afterpulse_s / array.dead_time_s
        slots = _SPARE_SLOTS + int(pending)
        self.due = np.full((shots, slots), np.inf)
        self.due_cell = np.zeros((shots, slots), dtype=np.int64)

    def strike(self, shot: Numbers, cell: Numbers, time_s: Numbers) -> None:
        """A photon, dark count or afterpulse in one cell of each of these shots, and its consequences.

        Each turn of the loop is one generation of crosstalk.
        """
        array, random = self.array, self.random
        while len(shot):
            age = time_s - self.last[shot, cell] - array.dead_time_s
            ready = age >= 0.0
            if array.trigger_recovery_s > 0.0:
                ready &= random.random(len(shot)) < recovered_share(age, array.trigger_recovery_s)
            fires = np.flatnonzero(ready)
            shot, cell, time_s, age = shot[fires], cell[fires], time_s[fires], age[fires]
            self.avalanches.append((shot, time_s, recovered_share(age, array.recovery_s)))
            self.last[shot, cell] = time_s
            if array.afterpulse > 0.0:
                self._store_afterpulses(shot, cell, time_s)
            spreads = np.flatnonzero(random.random(len(shot)) < array.crosstalk)
            shot, time_s = shot[spreads], time_s[spreads]
            # Any other cell with equal probability: a step of 1 .. cells - 1 from this one.
            step = random.integers(1, max(array.cells, 2), len(spreads))
            cell = (cell[spreads] + step) % array.cells

    def _store_afterpulses(self, shot: Numbers, cell: Numbers, time_s: Numbers) -> None:
        comes = np.flatnonzero(self.random.random(len(shot)) < self.array.afterpulse)
        shot, cell, time_s = shot[comes], cell[comes], time_s[comes]
        slot = np.argmax(self.due[shot], axis=1)
        self.due[shot, slot] = time_s + self.array.afterpulse_s * self.random.standard_exponential(len(shot))
        self.due_cell[shot, slot] = cell


def fire_coupled(array, rates, shots, random):
    """Shot, time and gain of every avalanche, with crosstalk and afterpulses."""
    state = _State(array, rates, shots, random)
    firings = random.standard_exponential(shots) / array.cells  # of one cell; the array has as many times more
    arrival = rates.when(firings)
    shot = np.arange(shots)
    while len(shot):
        time_s, cell = arrival[shot], random.integers(0, array.cells, len(shot))
        if array.afterpulse > 0.0:
            slot = np.argmin(state.due[shot], axis=1)
            due = state.due[shot, slot]
            after = due < time_s
            time_s = np.where(after, due, time_s)
            cell = np.where(after, state.due_cell[shot, slot], cell)
            state.due[shot[after], slot[after]] = np.inf
            drawn = shot[~after]
        else:
            drawn = shot
        inside = time_s < rates.time_s[-1]
        state.strike(shot[inside], cell[inside], time_s[inside])
        firings[drawn] += random.standard_exponential(len(drawn)) / array.cells
        arrival[drawn] = rates.when(firings[drawn])
        shot = shot[inside]
    columns = [np.concatenate(column) for column in zip(*state.avalanches, strict=True)]
    return columns[0], columns[1], columns[2]
