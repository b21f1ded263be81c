"""Rain and snow: particle sizes, extinction, and the backscatter of one drop or flake.

Sizes are exponential, n(D) = N_0 exp(-Lambda D). Drops and flakes are a thousand wavelengths wide, so their
extinction is twice their shadow (Q_ext = 2) at any lidar wavelength.

Symbols: D diameter, N_0 intercept, Lambda slope, R rate [mm/h], alpha extinction, beta backscatter, Q_back
efficiency.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...maths.arrays import Lanes, xp
from ..constants import NEPERS_PER_DECIBEL
from . import mie

DB_PER_KM = NEPERS_PER_DECIBEL / 1000.0  # one decibel per kilometre, in 1/m

FLAKE_DENSITY = {"dry": 0.1, "wet": 0.2}
"""Source: C. Magono and T. Nakamura, J. Meteorol. Soc. Japan 43, 139 (1965), the order of magnitude; density of flakes
over that of water. Flakes are then 2.2 or 1.7 times as wide as the drops they melt to."""

_FLAKE_LIDAR_RATIO_SR = 25.0
"""Choice: lidar ratio of ice without absorption; ice clouds have 20 to 35."""

_FLAKE_PATH_M = 0.3e-3
"""Choice: path in ice of the light that comes back: an estimate, a few crystals."""

_ICE = np.array(
    [
        (0.30, 2.0e-11),
        (0.39, 2.0e-11),
        (0.43, 4.14e-11),
        (0.50, 5.89e-10),
        (0.60, 5.73e-9),
        (0.70, 2.90e-8),
        (0.80, 1.34e-7),
        (0.84, 1.51e-7),
        (0.88, 3.35e-7),
        (0.90, 4.20e-7),
        (0.95, 6.02e-7),
        (1.00, 1.62e-6),
        (1.03, 2.33e-6),
        (1.07, 1.81e-6),
        (1.10, 1.70e-6),
        (1.15, 2.29e-6),
        (1.20, 6.71e-6),
        (1.25, 1.29e-5),
        (1.35, 1.39e-5),
        (1.40, 1.98e-5),
        (1.43, 1.028e-4),
        (1.46, 2.942e-4),
        (1.493, 5.532e-4),
        (1.538, 4.594e-4),
        (1.563, 3.858e-4),
        (1.613, 2.659e-4),
        (1.70, 1.875e-4),
        (1.80, 1.411e-4),
        (1.86, 1.432e-4),
        (1.905, 4.081e-4),
        (1.961, 1.442e-3),
        (2.00, 1.640e-3),
        (2.083, 1.023e-3),
        (2.15, 4.025e-4),
        (2.245, 2.026e-4),
        (2.35, 4.591e-4),
        (2.50, 7.530e-4),
    ]
)
"""Source: S. G. Warren and R. E. Brandt, J. Geophys. Res. 113, D14220 (2008), as in the refractiveindex.info database;
wavelength in micrometres and absorption index of ice."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sizes:
    """Diameters of drops or flakes: intercept_per_m4 exp(-slope_per_m D) per m3 and metre of diameter."""

    intercept_per_m4: float
    slope_per_m: float

    @property
    def extinction_per_m(self) -> float:
        """int 2 (pi / 4) D^2 n dD = pi N_0 / Lambda^3, since int D^2 exp(-Lambda D) dD = 2 / Lambda^3."""
        return math.pi * self.intercept_per_m4 / self.slope_per_m**3


def marshall_palmer(*, rate_mm_h: float) -> Sizes:
    """Raindrops: N_0 = 8000 / m3 / mm, Lambda = 4.1 R^-0.21 / mm, R > 0 in mm/h.

    J. S. Marshall and W. McK. Palmer, J. Meteorol. 5, 165 (1948). It overestimates drops below 1 mm.
    """
    return Sizes(intercept_per_m4=8e6, slope_per_m=4100.0 * rate_mm_h**-0.21)


def gunn_marshall(*, rate_mm_h: float, kind: str) -> Sizes:
    """Snowflakes "dry" or "wet", R in mm/h of water.

    K. L. S. Gunn and J. S. Marshall, J. Meteorol. 15, 452 (1958): N_0 = 3800 R^-0.87 / m3 / mm and Lambda = 2.55
    R^-0.48 / mm for the diameters of the melted drops. Here they are widened to flakes by `FLAKE_DENSITY`.
    """
    widened = FLAKE_DENSITY[kind] ** (-1.0 / 3.0)
    return Sizes(intercept_per_m4=3.8e6 * rate_mm_h**-0.87 / widened, slope_per_m=2550.0 * rate_mm_h**-0.48 / widened)


def rain_extinction_per_m(*, rate_mm_h: float) -> float:
    """alpha of Marshall and Palmer's drops: 3.65e-4 R^0.63 per metre, or 1.58 R^0.63 dB/km."""
    return marshall_palmer(rate_mm_h=rate_mm_h).extinction_per_m if rate_mm_h > 0.0 else 0.0


def snow_extinction_per_m(*, rate_mm_h: float, wavelength_m: float, kind: str) -> float:
    """alpha of snow, "dry" or "wet", for R mm/h of water: a R^b dB/km, Recommendation ITU-R P.1814.

    Wet: a = 1.023e-4 lambda + 3.7855466, b = 0.72. Dry: a = 5.42e-5 lambda + 5.4958776, b = 1.38. lambda in nm.
    """
    slope, constant, power = {"wet": (1.023e-4, 3.7855466, 0.72), "dry": (5.42e-5, 5.4958776, 1.38)}[kind]
    return float((slope * wavelength_m * 1e9 + constant) * rate_mm_h**power * DB_PER_KM)


def drop_backscatter_m2_sr(*, diameter_m: Lanes, wavelength_m: float) -> Lanes:
    """Backscatter of one raindrop, D^2 Q_back / 16 in W/sr per W/m2, from the two rays along its axis.

    The front face reflects r = ((n - 1) / (n + 1))^2, the back face (1 - r)^2 r (n / (2 - n))^2 exp(-2 a D): the
    square is the focusing by the front face, and a = 4 pi k / lambda the water's absorption. Q_back is their sum.
    Geometrical optics (H. C. van de Hulst, Light Scattering by Small Particles (1957), chapter 12).

    A perfect sphere adds a glory, tens of times as bright, within about lambda / D of straight back: of drops below a
    millimetre `physics.weather.glory` adds it.
    """
    front_face, back_face, absorption_per_m = _drop_rays(wavelength_m)
    fading = xp(diameter_m).exp(-2.0 * absorption_per_m * diameter_m)
    return diameter_m * diameter_m * (front_face + back_face * fading) / 16.0


def rain_backscatter_per_m_sr(*, rate_mm_h: float, wavelength_m: float) -> float:
    """beta of Marshall and Palmer's drops: int n D^2 Q_back / 16 dD, in closed form."""
    if rate_mm_h <= 0.0:
        return 0.0
    sizes = marshall_palmer(rate_mm_h=rate_mm_h)
    front_face, back_face, absorption_per_m = _drop_rays(wavelength_m)
    faded = sizes.slope_per_m + 2.0 * absorption_per_m
    return sizes.intercept_per_m4 / 8.0 * (front_face / sizes.slope_per_m**3 + back_face / faded**3)


def _drop_rays(wavelength_m: float) -> tuple[float, float, float]:
    """Q_back of the front and of the back face of a clear drop, and the absorption of water per metre."""
    index = mie.water_index(wavelength_m=wavelength_m)
    n = index.real
    reflected = ((n - 1.0) / (n + 1.0)) ** 2
    focused = (n / (2.0 - n)) ** 2
    return reflected, (1.0 - reflected) ** 2 * reflected * focused, 4.0 * math.pi * index.imag / wavelength_m


def snow_lidar_ratio_sr(*, wavelength_m: float) -> float:
    """alpha / beta of snow: 25 sr for clear ice, more where ice absorbs along 0.3 mm. Both are estimates.

    25 sr is the middle of the values of ice clouds; a flake as a white Lambertian ball would have 3 pi sr.
    """
    absorption_index = math.exp(np.interp(wavelength_m * 1e6, _ICE[:, 0], np.log(_ICE[:, 1])))
    return _FLAKE_LIDAR_RATIO_SR * math.exp(4.0 * math.pi * absorption_index / wavelength_m * _FLAKE_PATH_M)


def flake_backscatter_m2_sr(*, diameter_m: Lanes, wavelength_m: float) -> Lanes:
    """Backscatter of one flake, W/sr per W/m2: its extinction, twice its disc, over `snow_lidar_ratio_sr`."""
    return 0.5 * math.pi * diameter_m * diameter_m / snow_lidar_ratio_sr(wavelength_m=wavelength_m)
