"""Silicon photomultiplier: the paper's SNR and probabilities as it writes them, (21), (26), (27), (S1) to (S3).

Nothing in a render or a study runs this: tests compare with it what does (`lidarscene.physics.reference`).
"""

from __future__ import annotations

from ...maths.arrays import Lanes, xp
from ..electronics.sipm import (
    busy_share_steady_state,
    busy_variance_steady_state,
    dark_counts,
    fired_cells_published,
    fired_share,
    fired_variance_published,
    signal_cells_published,
)


def photon_detection_efficiency(*, quantum_efficiency: Lanes, trigger_probability: Lanes, fill_factor: Lanes) -> Lanes:
    """PDE = quantum efficiency x trigger probability x fill factor, (21)."""
    return quantum_efficiency * trigger_probability * fill_factor


def snr_published(
    *,
    signal_photons: Lanes,
    background_photons: Lanes,
    pde: Lanes,
    cells: Lanes,
    dark_count_rate_hz: Lanes,
    dead_time_s: Lanes,
) -> Lanes:
    """SNR_SiPM as printed, (27): (24) over the root of (25) plus the square of (26).

    Valid while the background fires few of the cells in a dead time and the pulse is much shorter than it. In weak
    light the noise falls below one cell, and an SNR then says nothing about a comparator.
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
    """SNR_SiPM as derived: (27) with busy cells in steady state and Poisson light on each cell."""
    busy = busy_share_steady_state(
        photons=background_photons, pde=pde, cells=cells, dark_count_rate_hz=dark_count_rate_hz, dead_time_s=dead_time_s
    )
    signal = cells * (1.0 - busy) * fired_share(photons=signal_photons, pde=pde, cells=cells)
    variance = busy_variance_steady_state(busy_share=busy, cells=cells)
    return signal / xp(variance).sqrt(variance)


def photon_count_probability(*, photons: Lanes, mean_photons: Lanes) -> Lanes:
    """Probability of k photons in one cycle, (S1): Poisson."""
    from scipy.special import gammaln

    ops = xp(photons, mean_photons)
    return ops.exp(photons * ops.log(mean_photons) - mean_photons - gammaln(photons + 1.0))


def quiet_probability_published(*, photons: Lanes, pde: Lanes, cells: Lanes) -> Lanes:
    """Probability that k photons leave one cell quiet, (S2), as if each cell got k / N photons."""
    return xp(photons, pde).exp(-photons * pde / cells)


def fired_joint_probability_published(*, photons: Lanes, mean_photons: Lanes, pde: Lanes, cells: Lanes) -> Lanes:
    """Probability that k photons arrive and the cell fires, (S3). Its sum over k is (S4)."""
    arriving = photon_count_probability(photons=photons, mean_photons=mean_photons)
    return arriving * (1.0 - quiet_probability_published(photons=photons, pde=pde, cells=cells))


def dark_deviation(*, dark_counts: Lanes) -> Lanes:
    """sigma_d = sqrt(N_d), (26): Poisson."""
    return xp(dark_counts).sqrt(dark_counts)


def binomial_skewness(*, share: Lanes, cells: Lanes) -> Lanes:
    """Third standardised moment of a count of cells: (1 - 2b) / sqrt(N b (1 - b))."""
    variance = cells * share * (1.0 - share)
    return (1.0 - 2.0 * share) / xp(variance).sqrt(variance)
