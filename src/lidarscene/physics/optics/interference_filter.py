"""The receiver's interference filter and a laser that leaves its pass band: by temperature, and by oblique light.

An edge emitter grows longer in wavelength as it warms; a filter that light passes at an angle moves to shorter ones.
Either way the echo loses light, and the sun, whose spectrum is flat over the shift, does not.

Symbols: lambda wavelength, theta angle of incidence in air, n_eff effective index of the filter's layers.
"""

from __future__ import annotations

import math

from .solar_spectrum import SpectralCurve


def oblique_factor(*, incidence_rad: float, effective_index: float) -> float:
    """Wavelength of a filter's features at an angle over that at normal incidence, sqrt(1 - (sin theta / n_eff)^2).

    Macleod, Thin-Film Optical Filters, 4th ed., 8.2.4: up to 20 degrees or so, for either polarisation.
    """
    return math.sqrt(1.0 - (math.sin(incidence_rad) / effective_index) ** 2)


def passed_share(
    transmittance: SpectralCurve, *, reference_m: float, emitted_m: float, incidence_factor: float = 1.0
) -> float:
    """Light that the filter passes of ``emitted_m`` at an angle, over that of ``reference_m`` at normal incidence.

    incidence_factor  `oblique_factor`

    Raises ValueError if nothing of ``reference_m`` passes.
    """
    reference = float(transmittance.at(reference_m))
    if reference <= 0.0:
        raise ValueError(f"the filter passes nothing at {1e9 * reference_m:g} nm")
    # A feature of the filter at lambda stands at factor x lambda for oblique light.
    return float(transmittance.at(emitted_m / incidence_factor)) / reference
