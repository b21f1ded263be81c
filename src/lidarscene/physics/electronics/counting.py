"""Counts of background light in a time window: their mean and their noise.

Some sensors report how many photons a pixel counted besides its echo. Means reach from far below one to many
thousands, so a count is drawn by one of two methods: term by term where the mean is small, from a normal deviate
where it is large.

Symbols: eta detection efficiency, N cells, b busy share, tau dead time.
"""

from __future__ import annotations

from dataclasses import dataclass

from ...maths.arrays import Array, Lanes, xp
from ...maths.special import beta_power

_FEW = 10.0
"""Accuracy bought: mean below which the distribution is inverted term by term; above it, Cornish and Fisher's expansion
draws it."""

_TERMS = 35.0
"""Accuracy bought: terms that are inverted: P(count > 35) is 1e-10 at a mean of 10."""


def detected_photons_hz(*, power_w: Lanes, efficiency: Lanes, photon_energy_j: Lanes) -> Lanes:
    """Detected photons per second, eta P / (h nu)."""
    return efficiency * power_w / photon_energy_j


def fired_cells_hz(*, busy_share: Lanes, cells: Lanes, dead_time_s: Lanes) -> Lanes:
    """Firings of all cells per second, N b / tau: each busy cell has fired once in the last dead time."""
    return cells * busy_share / dead_time_s


def upcrossings_hz(*, least: Lanes, cells: Lanes, busy_share: Lanes, dead_time_s: Lanes) -> Lanes:
    """Rate at which the number of busy cells rises to ``least``, Hz: least P(least) / tau (docs/theory.md, T28c).

    Exact for independent cells, each dead for tau after it fires: the number rises to k as often as it falls from k,
    and each of k busy cells recovers 1 / tau times a second. P is binomial, N cells of which each is busy for a share
    b of the time.
    """
    ops = xp(least, cells, busy_share)
    k = ops.minimum(ops.maximum(least, 1.0), cells)
    share = ops.minimum(ops.maximum(busy_share, 1e-30), 1.0 - 1e-7)
    # k P(k), with k N! / (k! (N - k)!) = 1 / B(k, N - k + 1).
    rate = beta_power(share, k, cells - k + 1.0) / (1.0 - share) / dead_time_s
    return ops.where(least > cells, 0.0, rate)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Inversion:
    """State of the inversion of a Poisson distribution.

    Attributes:
        remainder: part of the uniform number above the probabilities so far
        term: probability of this count
    """

    remainder: Array
    term: Array
    count: Array


def poisson_count(*, mean: Lanes, uniform: Lanes, deviate: Lanes, narrowing: Lanes) -> Lanes:
    """A whole number from a Poisson distribution: by inversion if the mean is below 10, else by Cornish and Fisher.

    Args:
        uniform: in (0, 1], for small means
        deviate: standard normal, for large means; only one of the two is used, so they need not be independent
        narrowing: factor of the standard deviation sqrt(mean), for large means only: 1 - b for cells that are dead for
            a share b of the time. Their firings are a renewal process with dead time, whose variance is mean (1 - b)^2
            (W. Feller, Introduction to Probability Theory, vol. 2, XI.4)
    """
    ops = xp(mean, uniform, deviate)
    few = ops.minimum(mean, _FEW)
    term = ops.exp(-few)
    # What is left of the uniform number after P(0); lanes of large means start with nothing left and never loop.
    remainder = ops.where(mean < _FEW, uniform - term, 0.0)

    def add_term(state: _Inversion) -> _Inversion:
        count = state.count + 1.0
        term = state.term * few / count
        return _Inversion(remainder=state.remainder - term, term=term, count=count)

    # Inversion: subtract P(1), P(2), ... until the uniform number is used up; the number of terms is the count.
    # Lanes of large means end before they begin, and a loop ends with the last of its packet.
    start = _Inversion(remainder=remainder, term=term + 0.0 * remainder, count=0.0 * remainder)
    count = ops.loop(start, lambda state: (state.remainder > 0.0) & (state.count < _TERMS), add_term).count
    # Cornish and Fisher to the skewness 1 / sqrt(mean): mean + sigma z + (z^2 - 1) / 6, rounded to a whole number.
    many = ops.maximum(mean, _FEW)
    skew = (deviate * deviate - 1.0) / 6.0
    drawn = many + narrowing * ops.sqrt(many) * deviate + narrowing * skew
    return ops.where(mean < _FEW, count, ops.maximum(ops.floor(drawn + 0.5), 0.0))
