"""Light through a dirty window: grains and scratches that diffract it, and drops that stand in its way.

A grain or scratch is opaque. What passes between many of them, at random places, is a plane wave whose amplitude is
the clear share of the window; the rest of the light that gets through is diffracted (Babinet's principle; M. Born and
E. Wolf, "Principles of Optics", 7th ed., 8.3.2 and 8.6.3).

Symbols: s covered share of the window, d size of a grain, lambda wavelength.
"""

from __future__ import annotations

import math

_AIRY = 2.584
"""Source: Airy's pattern; x at which (2 J_1(x) / x)^2 has fallen to 1 / e^2."""


def diffracted_share(*, covered: float) -> float:
    """Share of an echo's light that opaque grains diffract on the way out or back, 1 - (1 - s)^2 (T157).

    One way the share 1 - s passes, of which (1 - s)^2 keeps its direction: the clear share 1 - s of what passes. Both
    ways keep the square of that.
    """
    return 1.0 - (1.0 - covered) ** 2


def diffraction_angle_rad(*, wavelength_m: float, grain_m: float) -> float:
    """Full angle at 1/e^2 of the light that round grains diffract, 2 x 2.584 lambda / (pi d) (T158).

    Scratches of this width spread it as far, to 15 %: sinc^2 has fallen to 1/e^2 at 2.20 lambda / (pi d).
    """
    return 2.0 * _AIRY * wavelength_m / (math.pi * grain_m)
