"""Histograms of single photons: Coates' correction and the bound of Cramer and Rao.

Nothing in a render or a study runs this: tests compare with it what does (`lidarscene.physics.reference`).
"""

from __future__ import annotations

import math

import numpy as np

from ...maths.arrays import Lanes, Numbers, xp
from ..photon_counting.dead_time import LARGEST_SHARE


def coates(counts: Numbers, *, trials: float, dead_bins: float | None = None) -> Numbers:
    """(n,) detections of each bin, per SPAD and shot, from a histogram with pile-up: Coates' correction (T94); NumPy.

    Lambda_i = -ln(1 - n_i / (N - sum n_j)), with the sum over the bins in which those fired that are still blind
    (P. B. Coates, "The correction for photon pile-up in the measurement of radiative lifetimes", J. Phys. E 1, 878,
    1968).

    Args:
        counts: (n,) counts of the histogram, from the moment when all SPADs were free
        trials: N, number of SPADs times shots
        dead_bins: dead time in bins, whole or not; None: the rest of the shot. Firings are spread over their bin, so
            half of them are free again in the bin that lies a whole dead time behind it
    """
    values = np.asarray(counts, dtype=np.float64)
    count = len(values)
    behind = np.arange(1.0, count + 1.0)
    blind = np.ones(count) if dead_bins is None else np.clip(dead_bins + 0.5 - behind, 0.0, 1.0)
    free = trials - np.concatenate([[0.0], np.convolve(values, blind)[: count - 1]])
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(-np.log1p(-np.minimum(values / free, LARGEST_SHARE)))


def bound_s(*, signal: Lanes, rate_hz: Lanes, sigma_s: float, bin_s: float) -> Lanes:
    """Cramer and Rao's bound on the time of an echo, from counts in bins (T99).

    1 / sqrt(sum (S g_i')^2 / (S g_i + r bin_s)), with g_i the share of the pulse in each bin and g_i' its derivative.
    """
    ops = xp(signal, rate_hz)
    information: Lanes = 0.0
    steps = math.ceil(6.0 * sigma_s / bin_s)
    for k in range(-steps, steps + 1):
        # Bins that lie symmetrically about the echo; another place changes the sum by less than 1e-3 for fine bins.
        low, high = (k - 0.5) * bin_s / sigma_s, (k + 0.5) * bin_s / sigma_s
        share = 0.5 * (math.erf(high * math.sqrt(0.5)) - math.erf(low * math.sqrt(0.5)))
        slope = (math.exp(-0.5 * low * low) - math.exp(-0.5 * high * high)) / math.sqrt(2.0 * math.pi) / sigma_s
        expected = signal * share + rate_hz * bin_s
        information = information + (signal * slope) ** 2 / ops.maximum(expected, 1e-30)
    return 1.0 / ops.sqrt(information)
