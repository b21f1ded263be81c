"""Dead time: what SPADs count of a light that changes in time, shot after shot.

A SPAD fires once and is then blind for its dead time, or for the rest of the shot. Photons of an echo are lost behind
those of the sun, of nearer echoes and of the same echo: pile-up. Counts of a histogram bin are therefore not in
proportion to the light.

Symbols: lambda rate of detected photons of one free SPAD, tau its dead time, a share of the SPADs that are free, Lambda
detections of an echo that one SPAD would make in a shot without dead time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ...maths.arrays import Lanes, Numbers, xp
from ...maths.special import expm1, log1p, polynomial

_TERMS = 14
"""Terms of a binomial tail: what is left is below 1e-6 of it where the mean is below the least count."""

_LITTLE, _FIFTH = 0.2, 1.0 / 120.0
"""Accuracy bought: detections in a step up to which the share that fires is a series, and the last factor of that: off
by 1e-6."""

LARGEST_SHARE = 1.0 - 1e-6
"""Accuracy bought: largest share of SPADs that single precision distinguishes from all of them."""


def free_share(*, rate_hz: Lanes, dead_time_s: Lanes) -> Lanes:
    """Share of time in which a SPAD is free under even light, a = 1 / (1 + lambda tau) (T90)."""
    return 1.0 / (1.0 + rate_hz * dead_time_s)


def free_share_of_first(*, rate_hz: Lanes, time_s: Lanes) -> Lanes:
    """Share of SPADs that have not fired so long after they were armed, exp(-lambda t) (T91)."""
    ops = xp(rate_hz, time_s)
    return ops.exp(-rate_hz * ops.maximum(time_s, 0.0))


def afterpulse_factor(*, rate_hz: Lanes, dead_time_s: Lanes, afterpulse: Lanes, afterpulse_s: Lanes) -> Lanes:
    """Growth of the rate of a free SPAD by afterpulses under even light, 1 / (1 - p G), to first order in p (T109).

    G is the share of afterpulses that find their SPAD free: they outlast the dead time, and no other photon has fired
    it by then.

    Args:
        rate_hz: lambda, of light and dark counts alone
        afterpulse: p, afterpulses of each firing
        afterpulse_s: their mean delay
    """
    ops = xp(rate_hz, afterpulse_s)
    lasting = ops.exp(-dead_time_s / afterpulse_s)
    return 1.0 / (1.0 - afterpulse * lasting / (1.0 + rate_hz * afterpulse_s * (1.0 - lasting)))


def firing_share(*, detections: Lanes) -> Lanes:
    """Share of the free SPADs that fire, 1 - exp(-Lambda), for this mean number of detections (T92)."""
    return -expm1(-detections)


def detections_of_share(*, share: Lanes) -> Lanes:
    """Lambda from the share of the free SPADs that fire: Coates' correction of one bin, -ln(1 - share) (T94)."""
    return -log1p(-xp(share).minimum(share, LARGEST_SHARE))


def coincidence_share(*, least: int, spads: Lanes, share: Lanes) -> Lanes:
    """Probability that at least ``least`` of so many SPADs fire in one bin, each with this probability (T93).

    The binomial tail, with relative precision: summed upwards where it is small, else one minus the terms below.
    """
    ops = xp(spads, share)
    odds_of = ops.minimum(share, LARGEST_SHARE)
    odds = odds_of / (1.0 - odds_of)
    none_fires = ops.exp(spads * log1p(-odds_of))
    term, below = none_fires, none_fires
    for k in range(1, least):
        term = term * ops.maximum(spads - (k - 1.0), 0.0) / k * odds
        below = below + term
    term = term * ops.maximum(spads - (least - 1.0), 0.0) / least * odds
    above = term
    for k in range(least + 1, least + _TERMS):
        term = term * ops.maximum(spads - (k - 1.0), 0.0) / k * odds
        above = above + term
    return ops.where(spads * odds_of < 0.5 * least, above, ops.maximum(1.0 - below, 0.0))


def coincidence_slope(*, least: int, spads: Lanes, share: Lanes) -> Lanes:
    """Growth of `coincidence_share` with the mean number of firings: P(K = m - 1) of all SPADs but one."""
    others = spads - 1.0
    enough = 1.0 if least == 1 else coincidence_share(least=least - 1, spads=others, share=share)
    return enough - coincidence_share(least=least, spads=others, share=share)


def firings_in_coincidences(*, least: int, spads: Lanes, share: Lanes) -> Lanes:
    """Mean number of firings in bins with a coincidence, E[K; K >= m], for each bin."""
    enough = 1.0 if least == 1 else coincidence_share(least=least - 1, spads=spads - 1.0, share=share)
    return spads * share * enough


def firing_parts(*, detections: Lanes, branch: bool = False) -> tuple[Lanes, Lanes]:
    """Shares of the SPADs that fire in one step of even light (T100).

    Of those that are free when the step begins 1 - exp(-x) fire, with x the detections of a free SPAD in the step.
    Those that come free evenly over the step meet half of its light on average: 1 - (1 - exp(-x)) / x of them fire.

    Args:
        branch: whether packets of lanes with little light skip the exponential; derivatives do not pass a branch
    """
    # Where x is small both are differences of near equals, and a series takes their place; most bins have little light.
    ops = xp(detections)
    series: Lanes = detections * polynomial(detections, -_FIFTH, 1.0 / 24.0, -1.0 / 6.0, 0.5)
    many = detections > _LITTLE

    def exact() -> Lanes:
        return 1.0 - (1.0 - ops.exp(-detections)) / ops.where(many, detections, 1.0)

    late: Lanes = ops.where_any(many, exact, series) if branch else ops.where(many, exact(), series)
    return detections - detections * late, late


def firing_shares(
    rate_hz: Numbers,
    *,
    bin_s: float,
    dead_time_s: float,
    steady: bool = True,
    afterpulse: float = 0.0,
    afterpulse_s: float = 1.0,
) -> Numbers:
    """(..., n) probability that a SPAD fires in each bin of a shot, for a light that is even within a bin; NumPy.

    The share of free SPADs is one minus the share that fired in the dead time before: a renewal process,
    a_(i+1) = a_i - f_i + f_(i - tau / bin_s), with the firings f_i of `firing_parts` spread over their bin (T100).
    So do the afterpulses that free SPADs still have before them, to first order in their number (T109).

    Args:
        rate_hz: (..., n) lambda in each bin, of light and dark counts alone
        dead_time_s: inf: a SPAD fires once in a shot
        steady: whether SPADs are in balance with the light of the first bin when the shot begins; else all are free
        afterpulse: p, afterpulses of each firing; of a SPAD that fires once in a shot there are none
        afterpulse_s: their mean delay
    """
    detections = np.asarray(rate_hz, dtype=np.float64) * bin_s
    count = detections.shape[-1]
    fires_once = math.isinf(dead_time_s)
    steady = steady and not fires_once
    # Firings of a bin come free over two bins, unless the dead time is a whole number of them.
    blind_bins = 0 if fires_once else math.floor(dead_time_s / bin_s)
    late_share = 0.0 if fires_once else dead_time_s / bin_s - blind_bins
    of_free, of_released = (np.asarray(part) for part in firing_parts(detections=detections))
    free = np.ones(detections.shape[:-1])
    fired = np.zeros((*detections.shape[:-1], blind_bins + 1 + count))
    # Rate of afterpulses that free SPADs are to have, and that of those that fire in a step when they do.
    afterpulses = bool(afterpulse) and not fires_once
    due, caught = np.zeros_like(free), np.zeros_like(fired if afterpulses else free)
    lasting = math.exp(-dead_time_s / afterpulse_s)
    if steady:
        rate = detections[..., 0]
        if afterpulses:
            rate = rate * afterpulse_factor(
                rate_hz=rate / bin_s, dead_time_s=dead_time_s, afterpulse=afterpulse, afterpulse_s=afterpulse_s
            )
        free = free / (1.0 + rate * (dead_time_s / bin_s))
        fired[..., : blind_bins + 1] = (free * rate)[..., None]
        if afterpulses:
            due = free * (rate - detections[..., 0])
            renewed = fired[..., 0] * (afterpulse * bin_s / afterpulse_s)
            caught[..., : blind_bins + 1] = (due * detections[..., 0] + renewed)[..., None]
    for i in range(count):
        released = 0.0 if fires_once else late_share * fired[..., i] + (1.0 - late_share) * fired[..., i + 1]
        firings = free * of_free[..., i] + released * of_released[..., i]
        if afterpulses:
            returned = lasting * (late_share * caught[..., i] + (1.0 - late_share) * caught[..., i + 1])
            # In a step they fire, their SPADs are fired by light, or they go on.
            gone = detections[..., i] + bin_s / afterpulse_s
            at_once, late = (np.asarray(part) for part in firing_parts(detections=gone))
            over_step = (due * at_once + returned * late) / gone
            firings = firings + over_step
            lost = over_step * detections[..., i]
            caught[..., blind_bins + 1 + i] = lost + firings * afterpulse * bin_s / afterpulse_s
            due = due + returned - over_step * gone
        fired[..., blind_bins + 1 + i] = firings
        free = free + released - firings
    return fired[..., blind_bins + 1 :]


def missing_share(*, firings_s: Lanes, rate_hz: Lanes, dead_time_s: Lanes, back: Sequence[Lanes]) -> Lanes:
    """Share of free SPADs that is missing, in even light, a time after one SPAD of light of its own fired (T106).

    G(t) = exp(-lambda t) - sum_n H(t - n tau) exp(-lambda t_n) (lambda t_n)^(n - 1) / (n - 1)! (1 - lambda t_n / n),
    with t_n = t - n tau: the solution of G' = -lambda G(t) + lambda G(t - tau) for a firing that is back at tau.

    Args:
        firings_s: t, since the firing
        rate_hz: lambda
        back: H of n = 1, 2, ...: whether so many dead times have passed, or which part of many firings has
    """
    ops = xp(firings_s, rate_hz, dead_time_s)
    missing: Lanes = ops.exp(-rate_hz * firings_s)
    for number, passed in enumerate(back, 1):
        since = rate_hz * ops.maximum(firings_s - number * dead_time_s, 0.0)
        term = passed * ops.exp(-since) * (1.0 - since * (1.0 / number))
        for factor in range(1, number):
            term = term * since * (1.0 / factor)
        missing = missing - term
    return missing
