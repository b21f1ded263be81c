"""The laser beam across its axis: where its power is, and its quality.

Rays that stand for a beam must carry equal shares of its power; the functions here say how far from the axis they
belong. Lengths are in units of the beam's radius w: the 1/e^2 radius of a Gaussian, the edge of a top hat. Both have
the variance w^2 / 4 on each axis, so that 2 w is the width D4sigma of ISO 11146.

Symbols: w beam radius, r distance from the axis, theta full divergence, M^2 beam quality.
"""

from __future__ import annotations

import math

from ...maths.arrays import Lanes, xp


def gaussian_ring(*, inside: Lanes, outside: Lanes) -> Lanes:
    """Mean of r^2 / w^2 over the ring of a Gaussian beam between two shares of its power, 0 <= inside < outside <= 1.

    The share within r is 1 - exp(-2 r^2 / w^2) (ISO 11146-1), so r^2 / w^2 = -ln(1 - share) / 2, and the mean over
    the ring is [F(1 - inside) - F(1 - outside)] / (2 (outside - inside)) with F(s) = s - s ln s.
    """
    ops = xp(inside, outside)

    def integral(share: Lanes) -> Lanes:
        return share * (1.0 - ops.log(ops.maximum(share, 1e-30)))

    return 0.5 * (integral(1.0 - inside) - integral(1.0 - outside)) / (outside - inside)


def top_hat_ring(*, inside: Lanes, outside: Lanes) -> Lanes:
    """Mean of r^2 / w^2 over the ring of an evenly lit disc between two shares of its power."""
    return 0.5 * (inside + outside)


def beam_quality(*, exit_diameter_m: Lanes, divergence_rad: Lanes, wavelength_m: Lanes) -> Lanes:
    """M^2 = pi w_0 (theta / 2) / lambda of a beam with its waist at the exit; a real beam has M^2 >= 1.

    Args:
        exit_diameter_m: full, at 1/e^2 (ISO 11146-1)
        divergence_rad: full, at 1/e^2 (ISO 11146-1)
    """
    return 0.25 * math.pi * exit_diameter_m * divergence_rad / wavelength_m
