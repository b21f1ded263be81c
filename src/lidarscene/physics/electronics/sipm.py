"""Silicon photomultiplier: N cells that each fire once and are then dead for tau. (21)-(28), (S4)-(S6).

The response saturates because a dead cell cannot fire, and background light keeps some cells dead. Counts are fired
cells within one dead time. There are two models of the background:

``published``     (23)-(27) as printed: every dead time starts with all cells alive.
``steady_state``  derived: a cell that is dead for tau after each firing, under a rate r, is busy x / (1 + x) of the
                  time, x = r tau; the number of busy cells is binomial (docs/theory.md, section 6).

At Table 1 they give 125.7 and 109.6 busy cells; the scene simulation uses the derived model.

Symbols: N cells, pde detection efficiency, n photons, x firings per cell and dead time, b busy share.
"""

from __future__ import annotations

import math

from ...maths.arrays import Lanes, xp
from ...maths.special import expm1, log1p


def background_photons(*, power_w: Lanes, dead_time_s: Lanes, photon_energy_j: Lanes) -> Lanes:
    """Background photons in one dead time, N_b-photon, P tau / (h nu), under (23)."""
    return power_w * dead_time_s / photon_energy_j


def signal_photons(*, peak_power_w: Lanes, pulse_fwhm_s: Lanes, photon_energy_j: Lanes) -> Lanes:
    """Signal photons that count towards the peak, N_s-photon under (24): half of P_r FWHM / (h nu).

    When the pulse is at its peak, half of its energy has arrived. The energy is taken as P_r FWHM (a Gaussian has 6 %
    more).
    """
    return 0.5 * peak_power_w * pulse_fwhm_s / photon_energy_j


def fired_share_published(*, photons: Lanes, pde: Lanes, cells: Lanes) -> Lanes:
    """Share of cells that fire, 1 - exp(n (exp(-pde / N) - 1)): (22) divided by N, and (S4)."""
    return -expm1(photons * expm1(-pde / cells))


def fired_cells_published(*, photons: Lanes, pde: Lanes, cells: Lanes) -> Lanes:
    """Mean number of fired cells: (22) for a flash, (23) for background photons, and (S5)."""
    return cells * fired_share_published(photons=photons, pde=pde, cells=cells)


def signal_cells_published(
    *, background_cells: Lanes, dark_counts: Lanes, photons: Lanes, pde: Lanes, cells: Lanes
) -> Lanes:
    """N_s, (24): share (22) of the cells that background and dark counts left alive."""
    free = cells - background_cells - dark_counts
    return free * fired_share_published(photons=photons, pde=pde, cells=cells)


def fired_share(*, photons: Lanes, pde: Lanes, cells: Lanes) -> Lanes:
    """Share of cells that fire when Poisson light falls on them independently: 1 - exp(-n pde / N).

    Exact, because thinning a Poisson stream gives a Poisson stream. (S2) splits k photons evenly instead, which is
    0.03 % lower at Table 1 (pde / 2N).
    """
    return -expm1(-photons * pde / cells)


def photons_for_share(*, share: Lanes, pde: Lanes, cells: Lanes) -> Lanes:
    """`fired_share` solved for the photons. Shares above 1 - 1e-6 are taken as 1 - 1e-6."""
    return -log1p(-xp(share).minimum(share, 1.0 - 1e-6)) * cells / pde


MOST_TELLING_SHARE = 1.0 - math.exp(-1.5936)
"""Share of the free cells, 0.797, at which their count gives the light most precisely.

With x avalanches per cell, if cells could fire twice, the deviation of ln(x) by the count's binomial noise is
sqrt((e^x - 1) / N) / x, least at x = 2 (1 - e^-x) = 1.5936. Beyond it each photon adds less information.
"""


def photons_for_share_published(*, share: Lanes, pde: Lanes, cells: Lanes) -> Lanes:
    """`fired_share_published` solved for the photons, with the same limit."""
    return log1p(-xp(share).minimum(share, 1.0 - 1e-6)) / expm1(-pde / cells)


def dark_counts(*, cells: Lanes, dark_count_rate_hz: Lanes, dead_time_s: Lanes) -> Lanes:
    """Dark counts of all cells in one dead time, N_d under (23). The rate is that of one cell."""
    return cells * dark_count_rate_hz * dead_time_s


def fired_variance_published(*, fired: Lanes, cells: Lanes) -> Lanes:
    """Variance of the fired cells, N_fired (1 - N_fired / N): (25) and (S6) (which calls it a deviation)."""
    return fired * (1.0 - fired / cells)


def busy_share_steady_state(
    *, photons: Lanes, pde: Lanes, cells: Lanes, dark_count_rate_hz: Lanes, dead_time_s: Lanes
) -> Lanes:
    """Share of time that a cell is dead, b = x / (1 + x), with x = (light and dark count rate) tau."""
    x = photons * pde / cells + dark_count_rate_hz * dead_time_s
    return x / (1.0 + x)


def busy_variance_steady_state(*, busy_share: Lanes, cells: Lanes) -> Lanes:
    """Variance of the number of busy cells, binomial: N b (1 - b) = N x / (1 + x)^2."""
    return cells * busy_share * (1.0 - busy_share)


def busy_share_correlated(
    *, firings: Lanes, crosstalk: Lanes, afterpulse: Lanes, afterpulse_to_dead_time: Lanes
) -> Lanes:
    """Share of time that a cell is dead where avalanches cause others, theory (T20a).

    A ready cell is fired x + p b times in a dead time, since each of the b avalanches of a cell tries another; and an
    afterpulse succeeds if its cell is ready by then, with the probability K: not in the dead time, as left by the
    background until 2 tau, as any cell after that. The fixed point is found in `_TURNS` turns.

    Args:
        firings: firings by light and dark counts of a cell that never dies, in a dead time, x
        crosstalk: probability p that an avalanche fires another cell at once, any alike
        afterpulse: probability a that it fires its own cell again, after an exponential delay
        afterpulse_to_dead_time: mean delay over the dead time
    """
    ops = xp(firings, crosstalk, afterpulse)
    delay = 1.0 / afterpulse_to_dead_time
    beyond_dead_time = ops.exp(-delay)
    early = (1.0 - ops.exp(-firings - delay)) / (1.0 + firings * afterpulse_to_dead_time)
    busy = firings / (1.0 + firings)
    for _ in range(_TURNS):
        ready = 1.0 - busy
        refires = afterpulse * beyond_dead_time * (early + beyond_dead_time * ready)
        total = firings + crosstalk * busy + refires * busy / ready
        busy = total / (1.0 + total)
    return busy


_TURNS = 12
"""Each turn leaves p (1 - b)^2 or so of the error: 1e-6 of the share at p = 0.3."""


def crosstalk_variance(*, busy_share: Lanes, crosstalk: Lanes) -> Lanes:
    """Variance of the number of busy cells over the binomial, (1 + q) / (1 - q (1 - b)), q = p (1 - b), theory (T20b).

    Avalanches come in clusters of mean 1 / (1 - q), of which the mean square is (1 + q) times the mean over 1 - q; and
    more busy cells fire fewer. 1 where all cells are busy.
    """
    succeeds = crosstalk * (1.0 - busy_share)
    return (1.0 + succeeds) / (1.0 - succeeds * (1.0 - busy_share))


def firing_deviation(*, busy_share: Lanes, crosstalk: Lanes) -> Lanes:
    """Deviation of the number of firings in a long time over a Poisson number's, theory (T20d).

    (1 - b) sqrt(1 - q^2) / (1 - q (1 - b)), q = p (1 - b): clusters of avalanches vary (1 + q) / (1 - q) times as much,
    and of a slow change, which leaves fewer cells ready, 1 / (1 + b / ((1 - b) (1 - q))) stays. 1 - b if p is 0.
    """
    ready = 1.0 - busy_share
    succeeds = crosstalk * ready
    return ready * xp(succeeds).sqrt(1.0 - succeeds * succeeds) / (1.0 - succeeds * ready)


def add_crosstalk(*, photons: Lanes, pde: Lanes, cells: Lanes, ready_share: Lanes, crosstalk: Lanes) -> Lanes:
    """Photons of a flash that would fire without crosstalk as many cells as these do with it, theory (T20c).

    Each of Y photons in a cell fires it if ready, and the avalanche fires a ready cell with p f, f the share of ready
    ones: d ln f = -dY / (1 - p f). The root of ln f - p f = ln f_0 - p f_0 - Y by Newton's method from below.

    Args:
        ready_share: ready share of all cells before the flash
    """
    ops = xp(photons, ready_share)
    start = ops.log(ready_share)
    constant = start - crosstalk * ready_share - photons * pde / cells
    logarithm = constant
    for _ in range(4):
        cross_firing = crosstalk * ops.exp(logarithm)
        logarithm = logarithm - (logarithm - cross_firing - constant) / (1.0 - cross_firing)
    return (start - logarithm) * cells / pde


def remove_crosstalk(*, photons: Lanes, pde: Lanes, cells: Lanes, ready_share: Lanes, crosstalk: Lanes) -> Lanes:
    """`add_crosstalk` solved for the photons: Y = Y' - p f_0 (1 - exp(-Y'))."""
    return photons - crosstalk * ready_share * fired_share(photons=photons, pde=pde, cells=cells) * cells / pde


def snr_approximate(*, signal_photons: Lanes, background_photons: Lanes, pde: Lanes) -> Lanes:
    """(28): the SNR if signal and background are far from saturating the cells, without dark counts.

    In powers, by (14) of the theory page: P_r B_pulse / 2 sqrt(PDE / (h nu P_rs tau)).
    """
    return signal_photons * xp(background_photons, pde).sqrt(pde / background_photons)
