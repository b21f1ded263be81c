"""The air in between: one-way transmittance, and extinction from visibility.

A scene gives the transmittance directly, as the paper's Table 1 does (98 % one way), or an extinction coefficient, or
a visibility, from which Kruse's and Kim's models make an extinction at the laser's wavelength.

Symbols: tau_a = exp(-alpha R) one-way transmittance, alpha extinction coefficient [1/m], V visibility, q exponent.
"""

from __future__ import annotations

import math

from ...maths.arrays import Lanes, xp
from ..constants import KOSCHMIEDER

_REFERENCE_WAVELENGTH_UM = 0.55
"""Source: Kruse, McGlauchlin and McQuistan, 1962; wavelength at which visibility is defined."""


def transmittance(*, fixed: Lanes, extinction_per_m: Lanes, range_m: Lanes) -> Lanes:
    """One-way transmittance, ``fixed`` times exp(-alpha R) (Beer and Lambert). Use alpha = 0 or fixed = 1."""
    return fixed * xp(range_m, extinction_per_m).exp(-extinction_per_m * range_m)


def kruse_exponent(visibility_km: float) -> float:
    """Exponent q of Kruse, McGlauchlin and McQuistan, Elements of Infrared Technology (1962).

    1.6 above 50 km, 1.3 from 6 to 50 km, 0.585 V^(1/3) below (V in km). Made for haze; doubtful in fog.
    """
    if visibility_km > 50.0:
        return 1.6
    if visibility_km > 6.0:
        return 1.3
    return 0.585 * math.cbrt(visibility_km)


def kim_exponent(visibility_km: float) -> float:
    """Exponent q of Kim, McArthur and Korevaar, Proc. SPIE 4214, 26 (2001), revised for fog below 6 km.

    0.16 V + 0.34 from 1 to 6 km, V - 0.5 from 0.5 to 1 km, 0 below: dense fog is grey.
    """
    if visibility_km > 50.0:
        return 1.6
    if visibility_km > 6.0:
        return 1.3
    if visibility_km > 1.0:
        return 0.16 * visibility_km + 0.34
    if visibility_km > 0.5:
        return visibility_km - 0.5
    return 0.0


def extinction_from_visibility_per_m(*, visibility_m: float, wavelength_m: float, model: str = "kim") -> float:
    """Extinction coefficient alpha = (3.912 / V) (lambda / 550 nm)^-q, per metre.

    8.9e-5 per metre at 905 nm and 23 km.

    Args:
        model: exponent q: "kruse" or "kim" (equal above 6 km)
    """
    exponent = {"kruse": kruse_exponent, "kim": kim_exponent}[model](visibility_m / 1000.0)
    ratio = wavelength_m * 1e6 / _REFERENCE_WAVELENGTH_UM
    return KOSCHMIEDER / visibility_m * math.pow(ratio, -exponent)
