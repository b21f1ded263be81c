"""Cells in Geiger mode: fill factor, and what overvoltage and temperature make of efficiency and dark counts.

Symbols: N cells on the area A, g width of the border between active areas, V overvoltage, V_0 its scale, T temperature.
"""

from __future__ import annotations

import math

from ...maths.arrays import Lanes, xp
from ...maths.special import expm1


def fill_factor(*, area_m2: Lanes, cells: Lanes, gap_m: Lanes) -> Lanes:
    """Share of square cells that is active, (1 - g sqrt(N / A))^2 (T224); 0 where the border is the whole cell.

    Source: geometry. Data sheets of Hamamatsu's S13360 state 0.47, 0.74 and 0.82 at a pitch of 25, 50 and 75 um, where
    borders of 7 um make 0.52, 0.74 and 0.82.
    """
    side = 1.0 - gap_m * xp(area_m2, cells).sqrt(cells / area_m2)
    side = xp(side).maximum(side, 0.0)
    return side * side


def trigger_probability(*, overvoltage_v: Lanes, scale_v: Lanes) -> Lanes:
    """Chance that a carrier starts an avalanche, 1 - exp(-V / V_0) (T225); 0 below breakdown.

    Source: Otte et al., Nucl. Instrum. Methods A 846, 106, 2017, who find this law for the efficiency of three makers'
    devices.
    """
    above = xp(overvoltage_v).maximum(overvoltage_v, 0.0)
    return -expm1(-above / scale_v)


def overvoltage_v(*, rated_v: Lanes, drift_v_k: Lanes, warming_k: Lanes) -> Lanes:
    """Overvoltage under a bias that stays while the breakdown rises, V - beta (T - T_r) (T226)."""
    return rated_v - drift_v_k * warming_k


def dark_growth(*, warming_k: Lanes, doubling_k: Lanes) -> Lanes:
    """Factor of the dark counts, 2^((T - T_r) / d) (T227).

    Assumed: twice for each 10 degrees, as makers of SiPMs use to say; a unit's own data sheet decides.
    """
    exponent = math.log(2.0) * warming_k / doubling_k
    return xp(exponent).exp(exponent)
