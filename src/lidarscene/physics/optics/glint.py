"""The glint of a flat pane or mirror across the beam: the beam itself, reflected onto the receiver.

Such an echo does not scatter, so the lidar equation (5) does not apply. A flat mirror at R shows the receiver at 2 R.
The beam is a spot there; its centre is 2 R delta off the receiver if the mirror's normal is delta off the beam's
axis. The share of the spot on the aperture comes back.

Symbols: R range, w_1 and w_2 radii of the spot, A area of the aperture, S share of the beam on it.
"""

from __future__ import annotations

import math

import numpy as np

from ...maths.arrays import Lanes, xp
from .receiver import top_hat_in_circle

_RINGS, _SPOKES = (3, 8)  # of places on the aperture: good to 6e-3 for the narrowest spots, to 1e-6 for wide ones

_NARROWEST = 0.7
"""Accuracy bought: least ratio of spot to aperture radius. Narrower spots count as this wide, which blurs the
aperture's edge."""


def share_on_aperture(
    *, profile: str, aside_m: tuple[Lanes, Lanes], spot_radius_m: tuple[Lanes, Lanes], aperture_radius_m: Lanes
) -> Lanes:
    r"""Share of a beam on a round aperture, from 0 to 1.

    For a Gaussian, the mean density over the aperture times its area,

    .. math:: \frac{2A}{\pi w_1 w_2}\,\langle e^{-2 (x_1^2 / w_1^2 + x_2^2 / w_2^2)}\rangle

    (ISO 11146), by cubature on the disc. For a top hat, the area that the two circles share; an ellipse counts as the
    circle of its area, with distances in its own units.

    Args:
        profile: "gaussian" (radii at 1/e^2) or "top_hat" (radii of the edge, an ellipse)
        aside_m: offset from the spot's centre to the aperture's, along the two axes of the beam
        spot_radius_m: along the same axes
    """
    ops = xp(*aside_m, *spot_radius_m, aperture_radius_m)
    narrowest = _NARROWEST * aperture_radius_m
    (x, y), (w1, w2) = aside_m, (ops.maximum(radius, narrowest) for radius in spot_radius_m)
    if profile == "top_hat":
        mean_radius, offset = ops.sqrt(w1 * w2), ops.sqrt((x / w1) * (x / w1) + (y / w2) * (y / w2))
        return top_hat_in_circle(
            spot_radius=mean_radius, circle_radius=aperture_radius_m, distance=offset * mean_radius
        )
    mean: Lanes = 0.0
    for u, v, weight in _places():
        a, b = (x + u * aperture_radius_m) / w1, (y + v * aperture_radius_m) / w2
        mean = mean + weight * ops.exp(-2.0 * (a * a + b * b))
    return ops.minimum(2.0 * mean * aperture_radius_m * aperture_radius_m / (w1 * w2), 1.0)


def _places() -> list[tuple[float, float, float]]:
    """Points of a cubature on the unit disc and their weights (sum 1): Gauss-Legendre in r^2, even in angle."""
    nodes, weights = np.polynomial.legendre.leggauss(_RINGS)
    places: list[tuple[float, float, float]] = []
    for ring, (node, weight) in enumerate(zip(nodes, weights, strict=True)):
        radius = math.sqrt(0.5 * (1.0 + node))
        for spoke in range(_SPOKES):
            angle = 2.0 * math.pi * (spoke + ring / _RINGS) / _SPOKES
            share = 0.5 * float(weight) / _SPOKES
            places.append((radius * math.cos(angle), radius * math.sin(angle), share))
    return places


def apparent_backscatter_per_sr(*, share: Lanes, range_m: Lanes, aperture_m2: Lanes) -> Lanes:
    """f_r cos(theta) of the surface whose echo by (5) would be as bright as a glint: S R^2 / A.

    With it (5) gives P_t eta_r tau_a^2 S: all light of a glint that falls on the aperture comes back, at any range.
    """
    return share * range_m * range_m / aperture_m2
