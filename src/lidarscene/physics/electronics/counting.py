"""Counts of background light in a window: their means and their noise."""

from __future__ import annotations

from ...maths.arrays import Array, xp

_FEW = 10.0  # below this mean counts are drawn one by one
_TERMS = 35.0  # P(count > 35) is 1e-10 at a mean of 10


def detected_photons_hz(*, power_w: Array, efficiency: Array, photon_energy_j: Array) -> Array:
    """Photons that are detected in a second, eta P / (h nu)."""
    return efficiency * power_w / photon_energy_j


def fired_cells_hz(*, busy_share: Array, cells: Array, dead_time_s: Array) -> Array:
    """Firings of all cells in a second: each that is busy has fired once in the last dead time, N b / tau."""
    return cells * busy_share / dead_time_s


def poisson_count(*, mean: Array, uniform: Array, deviate: Array, narrowing: Array) -> Array:
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

    def going(left: Array, term: Array, count: Array) -> Array:
        return (left > 0.0) & (count < _TERMS)

    def one_more(left: Array, term: Array, count: Array) -> tuple[Array, ...]:
        count = count + 1.0
        term = term * few / count
        return left - term, term, count

    # Lanes of large means end before they begin, and a loop ends with the last of its packet.
    count = ops.loop((left, term + 0.0 * left, 0.0 * left), going, one_more)[2]
    many = ops.maximum(mean, _FEW)
    skew = (deviate * deviate - 1.0) / 6.0
    drawn = many + narrowing * ops.sqrt(many) * deviate + narrowing * skew
    return ops.where(mean < _FEW, count, ops.maximum(ops.floor(drawn + 0.5), 0.0))
