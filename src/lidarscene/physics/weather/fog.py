"""Fog: sizes of its droplets, and by Mie's theory its extinction and backscatter.

The ratio of backscatter to extinction decides how bright the fog looks at a given visibility. It depends on droplet
sizes and wavelength, so it is computed from them: numpy in double precision, once for a scene. Extinction from
visibility alone is in `physics.optics.air`.

Symbols: n(r) droplets per volume and radius, r_c mode radius, alpha extinction, beta backscatter, Q efficiencies.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from ...maths.arrays import Numbers
from ..constants import KOSCHMIEDER
from . import mie

VISIBLE_M = 550e-9
"""Source: Koschmieder; wavelength at which visibility is defined."""

_RADII = 4000  # steps of 0.03 um or less average the ripple of Q_back to 3 % at 532 nm, to 2 % from 850 nm on


@dataclass(frozen=True, slots=True, kw_only=True)
class Droplets:
    """Droplet sizes by a modified gamma distribution, n(r) = a r^alpha exp(-b r^gamma), b = (alpha / gamma) /
    r_c^gamma.

    D. Deirmendjian, Electromagnetic Scattering on Spherical Polydispersions (1969).

    Attributes:
        number_per_m3: number of all droplets; it fixes a
        mode_m: r_c, the most frequent radius
    """

    number_per_m3: float
    alpha: float
    gamma: float
    mode_m: float

    def per_m4(self, radius_m: Numbers) -> Numbers:
        """n(r): droplets per cubic metre and metre of radius."""
        ratio = radius_m / self.mode_m
        b = self.alpha / self.gamma
        order = (self.alpha + 1.0) / self.gamma
        scale = self.number_per_m3 / self.mode_m * self.gamma * math.exp(order * math.log(b) - math.lgamma(order))
        return np.asarray(scale * ratio**self.alpha * np.exp(-b * ratio**self.gamma))

    @property
    def largest_m(self) -> float:
        """Radius beyond which less than 1e-9 of the cross-section lies."""
        b = self.alpha / self.gamma
        return self.mode_m * math.pow((2.0 * (self.alpha + 3.0) / self.gamma + 25.0) / b, 1.0 / self.gamma)


TYPES = {
    "strong_advection": Droplets(number_per_m3=20e6, alpha=3.0, gamma=1.0, mode_m=10e-6),
    "moderate_advection": Droplets(number_per_m3=20e6, alpha=3.0, gamma=1.0, mode_m=8e-6),
    "radiation": Droplets(number_per_m3=200e6, alpha=6.0, gamma=1.0, mode_m=2e-6),
    "strong_spray": Droplets(number_per_m3=100e6, alpha=6.0, gamma=1.0, mode_m=4e-6),
    "moderate_spray": Droplets(number_per_m3=100e6, alpha=6.0, gamma=1.0, mode_m=2e-6),
    "chu_hogg": Droplets(number_per_m3=20e6, alpha=2.0, gamma=0.5, mode_m=1e-6),
}
"""Source: R. H. Rasshofer, M. Spies and H. Spies, Adv. Radio Sci. 9, 49 (2011), table of particle distributions; kinds
of fog by name, each with its published density. The two of radiation and advection fog are also fogs of E. P. Shettle
and R. W. Fenn, AFGL-TR-79-0214 (1979)."""


@functools.lru_cache(maxsize=64)
def scattering(droplets: Droplets, wavelength_m: float) -> tuple[float, float]:
    """Extinction (per metre) and backscatter coefficient (per metre and steradian) of these droplets.

    alpha = int pi r^2 Q_ext n dr and beta = int r^2 Q_back n dr / 4, with `physics.weather.mie.efficiencies`.
    """
    radius = np.linspace(0.0, droplets.largest_m, _RADII + 1)[1:]
    extinction, backscatter = mie.efficiencies(
        size_parameter=2.0 * math.pi * radius / wavelength_m, index=mie.water_index(wavelength_m=wavelength_m)
    )
    weight = droplets.per_m4(radius) * radius**2 * (radius[1] - radius[0])
    return math.pi * float(weight @ extinction), 0.25 * float(weight @ backscatter)


def visibility_m(droplets: Droplets) -> float:
    """Meteorological visibility in these droplets, 3.912 over their extinction at 550 nm (Koschmieder)."""
    return KOSCHMIEDER / scattering(droplets, VISIBLE_M)[0]
