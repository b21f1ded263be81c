"""Counts of background light in a window: their means and their noise."""

from __future__ import annotations

from dataclasses import dataclass

from ...maths.arrays import Array, Lanes, xp

_FEW = 10.0  # below this mean counts are drawn one by one
_TERMS = 35.0  # P(count > 35) is 1e-10 at a mean of 10


def detected_photons_hz(*, power_w: Lanes, efficiency: Lanes, photon_energy_j: Lanes) -> Lanes:
    """Photons that are detected in a second, eta P / (h nu)."""
    return efficiency * power_w / photon_energy_j


def fired_cells_hz(*, busy_share: Lanes, cells: Lanes, dead_time_s: Lanes) -> Lanes:
    """Firings of all cells in a second: each that is busy has fired once in the last dead time, N b / tau."""
    return cells * busy_share / dead_time_s


@dataclass(frozen=True, slots=True, kw_only=True)
class _Drawn:
    """How far the inversion of a Poisson distribution has come.

    left   of the uniform number, above the probabilities so far
    term   probability of this count
    """

    left: Array
    term: Array
    count: Array


def poisson_count(*, mean: Lanes, uniform: Lanes, deviate: Lanes, narrowing: Lanes) -> Lanes:
    """A whole number from a Poisson distribution: a few one by one, many by a Cornish-Fisher expansion.

    uniform    in (0, 1], for small means
    deviate    standard normal, for large ones; only one of the two is used, so that they need not be independent
    narrowing  of the standard deviation below sqrt(mean): 1 - b for cells that are dead for a share b of the time (a
               renewal process with dead time; W. Feller, Introduction to Probability Theory, vol. 2, XI.4: variance
               mean (1 - b)^2); large means only
    """
    ops = xp(mean, uniform, deviate)
    few = ops.minimum(mean, _FEW)
    term = ops.exp(-few)
    left = ops.where(mean < _FEW, uniform - term, 0.0)

    def one_more(state: _Drawn) -> _Drawn:
        count = state.count + 1.0
        term = state.term * few / count
        return _Drawn(left=state.left - term, term=term, count=count)

    # Lanes of large means end before they begin, and a loop ends with the last of its packet.
    start = _Drawn(left=left, term=term + 0.0 * left, count=0.0 * left)
    count = ops.loop(start, lambda state: (state.left > 0.0) & (state.count < _TERMS), one_more).count
    many = ops.maximum(mean, _FEW)
    skew = (deviate * deviate - 1.0) / 6.0
    drawn = many + narrowing * ops.sqrt(many) * deviate + narrowing * skew
    return ops.where(mean < _FEW, count, ops.maximum(ops.floor(drawn + 0.5), 0.0))
