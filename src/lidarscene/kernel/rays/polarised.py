"""Follow the polarisation of a beam along its path, and that of light that comes back along it.

Kernels have this code only if the world has panes or mirrors. Light that is unpolarised when it leaves is not behind a
raked pane, so that of every laser is followed.

Symbols: s direction across the plane of incidence; chi angle from the last reference axis to s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...maths.arrays import Array, Lanes
from ...maths.vectors import Vector
from ...physics.optics.polarisation import LobeShares, Stokes
from ..device.backend import mitsuba
from ..device.types import DeviceVector

_LEAST_SINE = 1e-5
"""Accuracy bought: sine of the angle of incidence below which s is not defined in single precision, and both
polarisations go alike."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PolarisedBeam:
    """Polarised light at the start of the latest ray of a path; one element for each ray.

    Attributes:
        axis: reference axis of Stokes' parameters, across the ray, in the traced frame
        laser: light of the laser that has come this far
        unpolarised: what would have come this far of unpolarised light; by reciprocity, what comes back of it
    """

    axis: Any
    laser: Stokes
    unpolarised: Stokes

    @classmethod
    def start(cls, axis: Vector, share: Lanes) -> PolarisedBeam:
        """Return a beam of linear polarisation along an axis; ``share`` of its light is polarised."""
        mi = mitsuba()
        zero = mi.Float(0.0)
        return cls(
            axis=mi.Vector3f(*axis),
            laser=Stokes(zero + 1.0, zero + share, zero),
            unpolarised=Stokes(zero + 1.0, zero, zero),
        )

    def beyond(self, direction: DeviceVector, normal: DeviceVector, shares: LobeShares) -> PolarisedBeam:
        """Return the beam beyond a surface.

        Args:
            direction: of the ray that met the surface
            normal: of the surface, in the traced frame, of either sign
            shares: of the light that go on
        """
        import drjit as dr

        s = dr.cross(direction, normal)
        sine = dr.norm(s)
        s = dr.select(sine > _LEAST_SINE, s / dr.maximum(sine, _LEAST_SINE), self.axis)
        cos, sin = dr.dot(self.axis, s), dr.dot(dr.cross(direction, self.axis), s)
        double = cos * cos - sin * sin, 2.0 * cos * sin
        return PolarisedBeam(
            axis=s,
            laser=self.laser.turned(*double).passed(shares),
            unpolarised=self.unpolarised.turned(*double).passed(shares),
        )

    def outward(self, keeps: Array) -> Lanes:
        """Return the share of the laser's light at the end of the path that counts for the echo, (n,).

        Args:
            keeps: (n,) bool, whether the surface returns light polarised as it came. Of that more, or less, passes on
                the way back than of unpolarised light, for which the way back takes ``unpolarised.intensity``
        """
        import drjit as dr

        way_back = dr.maximum(self.unpolarised.intensity, 1e-12)
        return dr.select(keeps, self.laser.times(self.unpolarised) / way_back, self.laser.intensity)
