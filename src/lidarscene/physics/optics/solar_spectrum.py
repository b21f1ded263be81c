"""Sunlight by wavelength: from a spectrum and a filter to the irradiance that passes at a given illuminance.

Scenes give sunlight in klux, detectors see it through a narrow filter in the infrared. Illuminance is photopic: E_v =
683 lm/W times the integral of V(lambda) E(lambda), with V the CIE curve of 1924. The spectrum keeps its shape and is
scaled until its E_v is the given one. Spectra and filters are straight lines between their points and zero outside;
their products are integrated exactly.

Symbols: E spectral irradiance [W/m3], V luminous efficiency, E_v illuminance [lux].
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...maths.arrays import Numbers, frozen
from ..constants import REFERENCE_ILLUMINANCE_KLUX

LUMINOUS_EFFICACY_LM_W = 683.0
"""Source: the SI's definition of the candela; K_m: lumens per watt at 555 nm, where V = 1 (defined is 683 lm/W at 540
THz, 0.0004 % less)."""

_TAIL = 1e-6
"""Accuracy bought: transmittance at which a smooth filter is cut off."""

_POINTS = 801  # of a smooth filter


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SpectralCurve:
    """A quantity over wavelength: straight lines between the points, zero outside.

    Attributes:
        wavelength_m: (n,) float64, rising
        value: (n,) float64; W/m3 (W/m2 per metre of wavelength) for a spectrum, 0 to 1 for a filter
    """

    wavelength_m: Numbers
    value: Numbers

    def __post_init__(self) -> None:
        """Check shapes and order, and freeze the arrays."""
        object.__setattr__(self, "wavelength_m", frozen(self.wavelength_m, np.float64, (None,)))
        object.__setattr__(self, "value", frozen(self.value, np.float64, (len(self.wavelength_m),)))
        if len(self.wavelength_m) < 2 or not (np.diff(self.wavelength_m) > 0.0).all():
            raise ValueError("wavelengths must be two or more, each longer than the one before")

    def at(self, wavelength_m: Numbers | float) -> Numbers:
        """The value at these wavelengths."""
        return np.asarray(np.interp(wavelength_m, self.wavelength_m, self.value, left=0.0, right=0.0))


def photopic_efficiency(*, wavelength_m: Numbers | float) -> Numbers:
    """V(lambda) of CIE 1924 (y-bar of CIE 1931), by the two-lobe fit of Wyman, Sloan and Shirley (2013).

    J. Comput. Graph. Tech. 2(2). It differs from the table by at most 0.0071 (at 620 nm), and the illuminance of
    daylight by less than 0.1 % (the tests have the table).
    """
    nm = 1e9 * np.asarray(wavelength_m, dtype=np.float64)

    def lobe(peak: float, below: float, above: float) -> Numbers:
        return np.asarray(np.exp(-0.5 * ((nm - peak) / np.where(nm < peak, below, above)) ** 2))

    return 0.821 * lobe(568.8, 46.9, 40.5) + 0.286 * lobe(530.9, 16.3, 31.1)


def integral(curve: SpectralCurve, weight: Callable[[Numbers], Numbers], *, nodes_m: Numbers | None = None) -> float:
    """Integral of curve times weight over wavelength, where both are defined.

    Simpson's rule between neighbouring points of the curve and of ``nodes_m``, the points of the weight: exact for a
    weight of straight lines.
    """
    points = curve.wavelength_m
    if nodes_m is not None:
        low, high = max(points[0], nodes_m[0]), min(points[-1], nodes_m[-1])
        points = np.union1d(points, nodes_m)
        points = points[(points >= low) & (points <= high)]
    if len(points) < 2:
        return 0.0
    middle = 0.5 * (points[1:] + points[:-1])
    ends, centres = curve.at(points) * weight(points), curve.at(middle) * weight(middle)
    return float(np.sum(np.diff(points) * (ends[1:] + ends[:-1] + 4.0 * centres)) / 6.0)


def illuminance_lux(spectrum: SpectralCurve) -> float:
    """E_v = 683 lm/W times the integral of V(lambda) E(lambda)."""
    return LUMINOUS_EFFICACY_LM_W * integral(spectrum, lambda x: photopic_efficiency(wavelength_m=x))


def box_filter(*, centre_m: float, width_m: float) -> SpectralCurve:
    """Transmittance one within half a width of the centre, zero outside."""
    edges = np.array([centre_m - 0.5 * width_m, centre_m + 0.5 * width_m])
    return SpectralCurve(wavelength_m=edges, value=np.ones(2))


def gaussian_filter(*, centre_m: float, width_m: float) -> SpectralCurve:
    """Transmittance exp(-ln2 (2 (lambda - centre) / width)^2): ``width_m`` wide at half its peak of one."""
    reach = math.sqrt(-math.log2(_TAIL))
    u = np.linspace(-reach, reach, _POINTS)
    return SpectralCurve(wavelength_m=centre_m + 0.5 * width_m * u, value=np.exp(-math.log(2.0) * u**2))


def passed_share(transmittance: SpectralCurve, *, wavelength_m: float, drift_m: float) -> float:
    """Light that the filter passes of a laser that has drifted, over that at its wavelength: theory (T128)."""
    return float(transmittance.at(wavelength_m + drift_m)) / float(transmittance.at(wavelength_m))


def in_band_irradiance_w_m2(spectrum: SpectralCurve, transmittance: SpectralCurve) -> float:
    """Irradiance behind the filter, without scaling the spectrum."""
    return integral(spectrum, transmittance.at, nodes_m=transmittance.wavelength_m)


def irradiance_at_100_klux_w_m2(spectrum: SpectralCurve, transmittance: SpectralCurve) -> float:
    """Irradiance behind the filter with the spectrum scaled to 100 klux: the value in a sensor file."""
    scale = 1e3 * REFERENCE_ILLUMINANCE_KLUX / illuminance_lux(spectrum)
    return scale * in_band_irradiance_w_m2(spectrum, transmittance)
