"""Rough diffuse reflection: why a road at a flat angle is brighter than Lambert's law says.

A rough matt surface is a relief of matt facets. Seen along the beam, the facets that face the beam show and the others
hide behind them, so the light sent back hardly falls as the beam becomes flat.

Symbols: w_i, w_o unit vectors to the two sides of the light; theta their angles from the normal; sigma standard
deviation of the facets' slope angle; rho reflectivity at normal incidence; K strength of the relief.
"""

from __future__ import annotations

import math

from ...maths.arrays import Lanes, xp

_GRAZING_ALBEDO = 0.5 - 2.0 / (3.0 * math.pi)
"""Mean of s / t of (T7a) over the outgoing hemisphere, weighted by the cosine, at grazing incidence: the most."""

_LEAST_COS = 1e-6
"""Accuracy bought: least cosine by which s is divided. The two directions of a hit are never both this flat."""


def relief(slope_rad: Lanes) -> Lanes:
    r"""Strength K of (T7a) for facets of slope deviation ``slope_rad``: 0 for a flat surface, towards 0.9 for a rough.

    .. math:: K = B / A,\quad A = 1 - \frac{\sigma^2 / 2}{\sigma^2 + 0.33},\quad
              B = \frac{0.45\,\sigma^2}{\sigma^2 + 0.09}

    M. Oren, S. K. Nayar, Generalization of Lambert's reflectance model, SIGGRAPH 1994, the qualitative model.
    """
    square = slope_rad * slope_rad
    return 0.45 * square / (square + 0.09) / (1.0 - 0.5 * square / (square + 0.33))


def rough_diffuse_per_sr(
    *, reflectivity: Lanes, relief: Lanes, cos_in: Lanes, cos_out: Lanes, cos_between: Lanes
) -> Lanes:
    r"""f_r of a rough matt surface, 1/sr.

    .. math:: f_r = \frac{\rho}{\pi}\Bigl(1 + K\,\frac{s}{t}\Bigr),\quad s = \omega_i\cdot\omega_o -
              \cos\theta_i\cos\theta_o,\quad t = \max(\cos\theta_i, \cos\theta_o)\ \text{if}\ s > 0,\ \text{else}\ 1

    Oren and Nayar 1994, with the sign of s kept where it is negative (Y. Fujii, A tiny improvement of Oren-Nayar
    reflectance model, 2012): forward of the normal the integral over facets falls, and the published short form stays
    level. Divided by its value at normal incidence. Light that goes from facet to facet is left out.

    Args:
        reflectivity: reflectivity at normal incidence: the same into every direction and over the hemisphere
        relief: K, by `relief`
        cos_between: between the two directions, both away from the surface: 1 straight back
    """
    ops = xp(cos_between)
    lifted = cos_between - cos_in * cos_out
    flatter = ops.maximum(ops.maximum(cos_in, cos_out), _LEAST_COS)
    return reflectivity * (1.0 / math.pi) * (1.0 + relief * ops.where(lifted > 0.0, lifted / flatter, lifted))


def largest_reflectivity(slope_rad: float) -> float:
    """Reflectivity at which all light of grazing incidence comes back; more would break the conservation of energy."""
    return float(1.0 / (1.0 + relief(slope_rad) * _GRAZING_ALBEDO))
