"""Polarised light at panes: Stokes' parameters through a sheet of glass, without circular light.

A pane lets light that swings in the plane of incidence (p) through more readily than light across it (s); near
Brewster's angle it mirrors almost only the latter. Coefficients of glass are real, so linear light stays linear, and
three of Stokes' four parameters say all. Light that ran between the faces a different number of times does not
interfere, so each passage adds its own Stokes' parameters.

Reciprocity gives the way back: the share of unpolarised light that comes back along a path is the one that goes out
along it, and a surface that keeps the polarisation returns the product of what goes out and of what would go out of
unpolarised light (docs/theory_glass.md 3).

Symbols: I, Q, U Stokes' parameters, Q > 0 along the reference axis; chi angle of the axis; a, r as in `dielectrics`.
"""

from __future__ import annotations

from dataclasses import dataclass

from ...maths.arrays import Lanes
from .dielectrics import fresnel_amplitudes, pane_reflectance, pane_transmittance


@dataclass(frozen=True, slots=True)
class Stokes:
    """Stokes' parameters of light without circular part; each (n,)."""

    intensity: Lanes
    level: Lanes
    diagonal: Lanes

    def turned(self, cos_double: Lanes, sin_double: Lanes) -> Stokes:
        """The same light about an axis turned by chi, from cos(2 chi) and sin(2 chi)."""
        return Stokes(
            self.intensity,
            cos_double * self.level + sin_double * self.diagonal,
            cos_double * self.diagonal - sin_double * self.level,
        )

    def passed(self, shares: LobeShares) -> Stokes:
        """Light beyond a surface, whose s direction is the axis."""
        mean, half_difference = 0.5 * (shares.across + shares.along), 0.5 * (shares.across - shares.along)
        return Stokes(
            mean * self.intensity + half_difference * self.level,
            half_difference * self.intensity + mean * self.level,
            shares.mixed * self.diagonal,
        )

    def times(self, other: Stokes) -> Lanes:
        """I I' + Q Q' + U U'."""
        return self.intensity * other.intensity + self.level * other.level + self.diagonal * other.diagonal


@dataclass(frozen=True, slots=True)
class LobeShares:
    """Shares of the light that go into one lobe of a surface; each (n,).

    Attributes:
        across: of light polarised across the plane of incidence (s)
        along: of light polarised in it (p)
        mixed: mean product of both amplitudes, which carries U; negative where a reflection turns one of them round
    """

    across: Lanes
    along: Lanes
    mixed: Lanes


def pane_shares(*, cos_incidence: Lanes, index: Lanes, internal: Lanes, reflected: bool) -> LobeShares:
    """T or R of a pane for both polarisations, all passages between its faces summed.

    With r_s and r_p of one face: (T63) with r_s^2, with r_p^2, and for the mixed share with r_s r_p in place of r and
    (1 - r_s^2)(1 - r_p^2) in place of (1 - r)^2. Directions of s, p and light are right-handed before and after.

    Args:
        internal: a of one passage, 1 if the pane does not absorb
    """
    r_s, r_p = fresnel_amplitudes(cos_incidence=cos_incidence, index=index)
    law = pane_reflectance if reflected else pane_transmittance
    product, internal_both = r_s * r_p, internal * internal
    passing = (1.0 - r_s * r_s) * (1.0 - r_p * r_p)
    series = 1.0 / (1.0 - product * product * internal_both)
    return LobeShares(
        across=law(surface=r_s * r_s, internal=internal),
        along=law(surface=r_p * r_p, internal=internal),
        mixed=product + passing * product * internal_both * series if reflected else passing * internal * series,
    )
