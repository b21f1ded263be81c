"""Reflectivity at the laser's wavelength from a visible colour.

Pigments that look alike may differ in the infrared, so a colour predicts a surface's reflectivity poorly. It
predicts better how one kind of surface varies from place to place: soiled and clean, stone and mortar. So the level is
the material's, and the colour scales it.
"""

from __future__ import annotations

import numpy as np

from ..maths.arrays import Numbers

WAVELENGTHS_M = (850e-9, 905e-9, 940e-9, 1064e-9, 1550e-9)
"""Choice: wavelengths of the table: the lasers of automotive lidars."""

EXPONENTS = (0.940, 0.930, 0.929, 0.919, 0.849)
"""Source: ECOSTRESS Spectral Library 1.0; slope of log reflectivity on log red (600 to 700 nm) over 85 spectra: the 45
man-made surfaces (concrete, roads, roofs, construction materials; no reflectance targets) and the 40 soils that reach
from 0.46 to 1.56 um, copy named in docs/materials.md."""

SPREADS = (0.36, 0.37, 0.39, 0.44, 0.50)
"""Source: the same spectra; standard deviation of what is left of log reflectivity: a factor of 1.4 at 905 nm, 1.6 at
1550 nm, between surfaces. Within the ten concretes and roads it is 0.11 at 905 nm, and the slope 0.99."""


def reflectivity_by_colour(*, red: Numbers, mean_red: float, reflectivity: float, wavelength_m: float) -> Numbers:
    """Reflectivity where the colour is ``red`` (linear light), of a material whose mean red is ``mean_red``.

    rho (red / mean red)^gamma, gamma by linear interpolation in `EXPONENTS`. At most 1.
    """
    exponent = float(np.interp(wavelength_m, WAVELENGTHS_M, EXPONENTS))
    return np.minimum(reflectivity * (np.asarray(red) / mean_red) ** exponent, 1.0)
