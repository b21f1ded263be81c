"""Silicon photomultiplier: N cells that each fire once and are then dead for tau. (21)-(28), (S4)-(S6).

Counts are fired cells within one dead time. Two models of the background stand side by side:

``published``     (23)-(27) as printed: every dead time starts with all cells alive.
``steady_state``  derived: a cell that is dead for tau after each firing, under a rate r, is busy
                  x / (1 + x) of the time, x = r tau; busy cells are binomial. PHYSICS.md, section 3.

At Table 1 the two give 125.7 and 109.6 busy cells; the scene simulation uses the derived one.
"""

from __future__ import annotations

import math

from ...maths.arrays import Lanes, xp
from ...maths.special import expm1, log1p, log_gamma


def photon_detection_efficiency(
    *, quantum_efficiency: Lanes, trigger_probability: Lanes, fill_factor: Lanes
) -> Lanes:
    """PDE as the product (21)."""
    return quantum_efficiency * trigger_probability * fill_factor


def background_photons(*, power_w: Lanes, dead_time_s: Lanes, photon_energy_j: Lanes) -> Lanes:
    """Background photons in one dead time, N_b-photon under (23)."""
    return power_w * dead_time_s / photon_energy_j


def signal_photons(*, peak_power_w: Lanes, pulse_fwhm_s: Lanes, photon_energy_j: Lanes) -> Lanes:
    """Signal photons that count towards the peak, N_s-photon under (24): half of P_r FWHM / (h nu).

    Half of the energy has arrived when the pulse is at its peak, with P_r FWHM taken as the energy (a
    Gaussian has 6 % more).
    """
    return 0.5 * peak_power_w * pulse_fwhm_s / photon_energy_j


def fired_share_published(*, photons: Lanes, pde: Lanes, cells: Lanes) -> Lanes:
    """Share of cells that fire, 1 - exp(n (exp(-pde / N) - 1)): (22) over N, and (S4)."""
    return -expm1(photons * expm1(-pde / cells))


def fired_cells_published(*, photons: Lanes, pde: Lanes, cells: Lanes) -> Lanes:
    """Mean number of fired cells: (22) for a flash, (23) for the background's photons, and (S5)."""
    return cells * fired_share_published(photons=photons, pde=pde, cells=cells)


def signal_cells_published(
    *, background_cells: Lanes, dark_counts: Lanes, photons: Lanes, pde: Lanes, cells: Lanes
) -> Lanes:
    """N_s, (24): the share (22) of the cells that background and dark counts have left."""
    free = cells - background_cells - dark_counts
    return free * fired_share_published(photons=photons, pde=pde, cells=cells)


def snr_published(
    *,
    signal_photons: Lanes,
    background_photons: Lanes,
    pde: Lanes,
    cells: Lanes,
    dark_count_rate_hz: Lanes,
    dead_time_s: Lanes,
) -> Lanes:
    """SNR_SiPM as printed, (27): (24) over the root of (25) and the square of (26).

    Holds while the background fires few of the cells in a dead time and the pulse is much shorter than it;
    in weak light the noise falls below one cell, and an SNR then says nothing about a comparator.
    """
    dark = dark_counts(cells=cells, dark_count_rate_hz=dark_count_rate_hz, dead_time_s=dead_time_s)
    busy = fired_cells_published(photons=background_photons, pde=pde, cells=cells)
    signal = signal_cells_published(
        background_cells=busy, dark_counts=dark, photons=signal_photons, pde=pde, cells=cells
    )
    variance = fired_variance_published(fired=busy, cells=cells) + dark
    return signal / xp(variance).sqrt(variance)


def snr_steady_state(
    *,
    signal_photons: Lanes,
    background_photons: Lanes,
    pde: Lanes,
    cells: Lanes,
    dark_count_rate_hz: Lanes,
    dead_time_s: Lanes,
) -> Lanes:
    """SNR_SiPM as derived: what (27) becomes with busy cells in steady state and light thinned over the cells."""
    busy = busy_share_steady_state(
        photons=background_photons, pde=pde, cells=cells,
        dark_count_rate_hz=dark_count_rate_hz, dead_time_s=dead_time_s,
    )  # fmt: skip
    signal = cells * (1.0 - busy) * fired_share(photons=signal_photons, pde=pde, cells=cells)
    variance = busy_variance_steady_state(busy_share=busy, cells=cells)
    return signal / xp(variance).sqrt(variance)


def photon_count_probability(*, photons: Lanes, mean_photons: Lanes) -> Lanes:
    """Probability of k photons in one cycle, (S1): Poisson."""
    ops = xp(photons, mean_photons)
    return ops.exp(photons * ops.log(mean_photons) - mean_photons - log_gamma(photons + 1.0))


def quiet_probability_published(*, photons: Lanes, pde: Lanes, cells: Lanes) -> Lanes:
    """Probability that k photons leave one cell quiet, (S2): as if each cell got k / N of them."""
    return xp(photons, pde).exp(-photons * pde / cells)


def fired_joint_probability_published(
    *, photons: Lanes, mean_photons: Lanes, pde: Lanes, cells: Lanes
) -> Lanes:
    """Probability that k photons come and the cell fires, (S3); its sum over k is (S4)."""
    coming = photon_count_probability(photons=photons, mean_photons=mean_photons)
    return coming * (1.0 - quiet_probability_published(photons=photons, pde=pde, cells=cells))


def fired_share(*, photons: Lanes, pde: Lanes, cells: Lanes) -> Lanes:
    """Share of cells that fire when Poisson light falls on them independently: 1 - exp(-n pde / N).

    Thinning a Poisson stream leaves a Poisson stream, so this is exact; (S2) splits k photons evenly
    instead, which is 0.03 % lower at Table 1 (pde / 2N).
    """
    return -expm1(-photons * pde / cells)


def photons_for_share(*, share: Lanes, pde: Lanes, cells: Lanes) -> Lanes:
    """`fired_share` solved for the photons; shares at or above one count as one part in 1e6 below it."""
    return -log1p(-xp(share).minimum(share, 1.0 - 1e-6)) * cells / pde


MOST_TELLING_SHARE = 1.0 - math.exp(-1.5936)
"""Share of the free cells, 0.797, at which their count tells the light most precisely.

With x avalanches per cell, if cells could fire twice, the deviation of ln(x) by the count's binomial noise is
sqrt((e^x - 1) / N) / x, least at x = 2 (1 - e^-x) = 1.5936. From there on each photon tells less than the one before.
"""


def photons_for_share_published(*, share: Lanes, pde: Lanes, cells: Lanes) -> Lanes:
    """`fired_share_published` solved for the photons."""
    return log1p(-xp(share).minimum(share, 1.0 - 1e-6)) / expm1(-pde / cells)


def dark_counts(*, cells: Lanes, dark_count_rate_hz: Lanes, dead_time_s: Lanes) -> Lanes:
    """Dark counts of all cells in one dead time, N_d under (23); the rate is for each cell."""
    return cells * dark_count_rate_hz * dead_time_s


def dark_deviation(*, dark_counts: Lanes) -> Lanes:
    """sigma_d = sqrt(N_d), (26): Poisson."""
    return xp(dark_counts).sqrt(dark_counts)


def fired_variance_published(*, fired: Lanes, cells: Lanes) -> Lanes:
    """Variance of the fired cells, N_fired (1 - N_fired / N): (25) and (S6) (which calls it a deviation)."""
    return fired * (1.0 - fired / cells)


def busy_share_steady_state(
    *, photons: Lanes, pde: Lanes, cells: Lanes, dark_count_rate_hz: Lanes, dead_time_s: Lanes
) -> Lanes:
    """Share of time that a cell is dead, x / (1 + x), with light and dark counts in x = r tau."""
    x = photons * pde / cells + dark_count_rate_hz * dead_time_s
    return x / (1.0 + x)


def busy_variance_steady_state(*, busy_share: Lanes, cells: Lanes) -> Lanes:
    """Variance of the busy cells, binomial: N x / (1 + x)^2."""
    return cells * busy_share * (1.0 - busy_share)


def snr_approximate(*, signal_photons: Lanes, background_photons: Lanes, pde: Lanes) -> Lanes:
    """(28): the SNR where both the signal and the background are far from saturating the cells, no dark counts.

    In powers, by (14) of the theory page: P_r B_pulse / 2 sqrt(PDE / (h nu P_rs tau)).
    """
    return signal_photons * xp(background_photons, pde).sqrt(pde / background_photons)
