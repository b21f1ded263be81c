"""The echo of a target without a surface: fog, or drops too small to be drawn one by one.

A medium with backscatter coefficient beta returns, from every slice dR, the fraction beta dR of the light that
crosses it per steradian. Slices within a pulse's length arrive together, so the echo is the lidar equation convolved
with the pulse.

Symbols: alpha extinction, beta backscatter, xi overlap, g pulse shape, V(R) response, R_s range of a surface.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ...maths.arrays import Lanes, Numbers
from ...maths.special import normal_tail
from ..constants import SPEED_OF_LIGHT_M_S
from ..electronics.pulse_sums import SIGMAS_PER_FWHM
from ..optics.pulse import gaussian_pulse

_REACH = 4.0
"""Accuracy bought: pulse lengths FWHM c / 2 to integrate over; g is 1e-19 there."""

_PANELS, _NODES = 12, 8  # of Gauss-Legendre quadrature over the pulse; panels, because overlaps have kinks


def pulse_length_m(*, fwhm_s: Lanes) -> Lanes:
    """Range interval over which a pulse spreads an echo, at half its peak: c FWHM / 2, 0.9 m for 6 ns."""
    return 0.5 * SPEED_OF_LIGHT_M_S * fwhm_s


def volume_response(
    *,
    range_m: Numbers,
    backscatter_per_m_sr: Callable[[Numbers], Numbers],
    extinction_per_m: float,
    fwhm_s: float,
    nearest_m: float,
    farthest_m: float = math.inf,
) -> Numbers:
    """Power from a medium at the time of each range: P = P_t eta A V(R), V in 1/m2.

        V(R) = int g(2 (R - r) / c) beta(r) xi(r) exp(-2 alpha r) / r^2 dr

    by Gauss-Legendre quadrature, with the Gaussian g of `physics.optics.pulse`: the lidar equation with a pulse of
    its real length (R. H. Rasshofer, M. Spies and H. Spies, Adv. Radio Sci. 9, 49 (2011), with a sin^2 pulse). Single
    scattering. Far from the ends V is close to 1.0645 (c FWHM / 2) beta xi exp(-2 alpha R) / R^2.

    Args:
        range_m: (n,) c t / 2 with t the time after the pulse
        backscatter_per_m_sr: beta(r) xi(r), with xi the overlap of beam and receiver (1 where all is seen)
        extinction_per_m: alpha, one way, of everything in the air
        nearest_m: where the medium begins, above 0
        farthest_m: where the medium ends
    """
    reach = _REACH * pulse_length_m(fwhm_s=fwhm_s)
    lower = np.clip(range_m - reach, nearest_m, farthest_m)
    upper = np.clip(range_m + reach, nearest_m, farthest_m)
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    share = ((np.arange(_PANELS)[:, None] + 0.5 * (nodes + 1.0)) / _PANELS).ravel()
    length = (upper - lower)[:, None]
    r = lower[:, None] + length * share
    shifted_s = (2.0 / SPEED_OF_LIGHT_M_S) * (range_m[:, None] - r)
    returned = gaussian_pulse(time_s=shifted_s, fwhm_s=fwhm_s) * backscatter_per_m_sr(r)
    attenuation = np.exp(-2.0 * extinction_per_m * r) / (r * r)
    return np.asarray((returned * attenuation * length) @ np.tile(0.5 * weights / _PANELS, _PANELS))


def share_before_surface(*, range_m: Lanes, surface_m: Lanes, extinction_per_m: Lanes, fwhm_s: Lanes) -> Lanes:
    """Share of V(R) that is left if a surface at R_s ends the medium.

    Q((R - R_s - kappa sigma^2) / sigma), with sigma that of g in range and kappa = 2 alpha + 2 / R_s. Exact where
    exp(-2 alpha r) / r^2 falls as exp(-kappa r) over the pulse's length and beta xi is constant there.
    """
    sigma_m = pulse_length_m(fwhm_s=fwhm_s) / SIGMAS_PER_FWHM
    falling_per_m = 2.0 * extinction_per_m + 2.0 / surface_m
    return normal_tail((range_m - surface_m) / sigma_m - falling_per_m * sigma_m)


def range_grid_m(*, farthest_m: float, fwhm_s: float) -> Numbers:
    """An even grid, fine enough for a `maths.arrays.LookupTable` of V: 1/16 of the pulse's length or finer.

    Linear interpolation is then good to 0.3 % of the highest V, also on its rise. The grid begins as far before 0 as a
    pulse reaches: air at the lens sends light back while the pulse's middle has not left yet.
    """
    length_m = pulse_length_m(fwhm_s=fwhm_s)
    nearest_m = -_REACH * length_m
    steps = math.ceil((farthest_m - nearest_m) / (length_m / 16.0))
    return np.linspace(nearest_m, farthest_m, steps + 1)
