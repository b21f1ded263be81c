"""Panes and water films: reflectance and transmittance of a layer with two Fresnel surfaces.

A car's window, a wet road: light is reflected at both faces of the layer, to and fro, and partly absorbed in between.
Interference is left out.

Symbols: n refractive index, k absorption index, r reflectance of one face, a transmittance of one passage.
"""

from __future__ import annotations

import math

from ...maths.arrays import Lanes, xp


def fresnel_reflectance(*, cos_incidence: Lanes, index: Lanes) -> Lanes:
    """Reflectance of a smooth lossless surface for unpolarised light: (R_s + R_p) / 2.

    Args:
        index: n of the body over that of the medium, > 1
    """
    across, along = fresnel_amplitudes(cos_incidence=cos_incidence, index=index)
    return 0.5 * (across * across + along * along)


def fresnel_amplitudes(*, cos_incidence: Lanes, index: Lanes) -> tuple[Lanes, Lanes]:
    """r_s and r_p: amplitudes that a smooth lossless surface reflects, across the plane of incidence and in it.

    Born and Wolf, Principles of Optics, 7th ed., 1.5.2: s, p and the direction of light are right-handed before and
    after, so that at normal incidence r_p = -r_s.

    Args:
        index: n of the body over that of the medium, > 1
    """
    ops = xp(cos_incidence)
    inside = ops.sqrt(1.0 - (1.0 - cos_incidence * cos_incidence) / (index * index))
    across = (cos_incidence - index * inside) / (cos_incidence + index * inside)
    along = (index * cos_incidence - inside) / (index * cos_incidence + inside)
    return across, along


def optical_depth(*, index_k: float, thickness_m: float, wavelength_m: float) -> float:
    """Optical depth of a layer at normal incidence, 4 pi k d / lambda."""
    return 4.0 * math.pi * index_k * thickness_m / wavelength_m


def internal_transmittance(*, depth: Lanes, cos_incidence: Lanes, index: Lanes) -> Lanes:
    """a: transmittance of one passage of a pane, exp(-depth / cos(angle inside)) (Beer, Lambert, Snell).

    Args:
        depth: `optical_depth`
    """
    ops = xp(cos_incidence)
    inside = ops.sqrt(1.0 - (1.0 - cos_incidence * cos_incidence) / (index * index))
    return ops.exp(-depth / inside)


def pane_reflectance(*, surface: Lanes, internal: Lanes) -> Lanes:
    """R of a pane, all passages between its faces summed: r + (1 - r)^2 r a^2 / (1 - r^2 a^2).

    No interference: the pulse's coherence length is shorter than the pane is thick, or the faces are not parallel to
    a wavelength. Rubin, Sol. Energy Mater. 12, 275 (1985).

    Args:
        surface: r of one face
        internal: a of one passage; with a = 1 the pane has 2 r / (1 + r)
    """
    round_trip = internal * internal
    return surface + (1.0 - surface) * (1.0 - surface) * surface * round_trip / (1.0 - surface * surface * round_trip)


def pane_transmittance(*, surface: Lanes, internal: Lanes) -> Lanes:
    """T of a pane, with `pane_reflectance`'s arguments: (1 - r)^2 a / (1 - r^2 a^2)."""
    return (1.0 - surface) * (1.0 - surface) * internal / (1.0 - surface * surface * internal * internal)
