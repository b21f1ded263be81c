"""Light through a dirty window: grains and scratches that diffract it, and drops that stand in its way.

A grain or scratch is opaque. What passes between many of them, at random places, is a plane wave whose amplitude is
the clear share of the window; the rest of the light that gets through is diffracted (Babinet's principle; M. Born and
E. Wolf, "Principles of Optics", 7th ed., 8.3.2 and 8.6.3).

Symbols: s covered share of the window, d size of a grain, lambda wavelength, a radius of a beam on the window, b of a
drop, x distance of their centres.
"""

from __future__ import annotations

import math

import numpy as np

from ...maths.arrays import Numbers

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


def overlap_area_m2(*, beam_m: float, drop_m: float, distance_m: Numbers) -> Numbers:
    """Area that two discs share, (n,) m2 (T159): a lens of two circular segments.

    Args:
        beam_m: radius of the beam's disc
        drop_m: radius of the drop's disc
        distance_m: (n,) between their centres
    """
    distance = np.asarray(distance_m, dtype=np.float64)
    smaller = min(beam_m, drop_m)
    apart, inside = distance >= beam_m + drop_m, distance <= abs(beam_m - drop_m)
    x = np.where(apart | inside, max(beam_m, drop_m), distance)  # any place where the circles cross

    def segment(radius: float, other: float) -> Numbers:
        """Half of the sector of one disc that the chord cuts off, less its triangle."""
        along = np.clip((x * x + radius * radius - other * other) / (2.0 * x), -radius, radius)
        return np.asarray(radius**2 * np.arccos(along / radius) - along * np.sqrt(radius**2 - along**2))

    lens = segment(beam_m, drop_m) + segment(drop_m, beam_m)
    return np.asarray(np.where(apart, 0.0, np.where(inside, math.pi * smaller**2, lens)))
