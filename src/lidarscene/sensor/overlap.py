"""Overlap of the laser's spot with the receiver's field of view, as a table over the range.

The share follows from an integral over the spot, too dear for every pulse, and depends on the range alone. So it is
tabulated once, even in s / (s + R), which is fine near the sensor, where it changes.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from ..maths.arrays import Lanes, LookupTable
from ..physics.optics import receiver

_PLACES = 1025  # linear between them: 1e-5 where the share changes within a third of the range


@dataclass(frozen=True, slots=True, kw_only=True)
class Spot:
    """Width of the laser's spot.

    profile        profile of the beam: "gaussian" or "top_hat"
    exit_radius_m  radius at the exit, where the beam has its waist
    """

    profile: str
    half_divergence_rad: float
    exit_radius_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Overlap:
    """Share of the spot's light that reaches the detector, by range.

    table     the share, even in s / (s + R): from far (0) to near (1)
    scale_m   s, the range around which the share changes
    offset_m  distance from the receiver's axis to the transmitter's, at the sensor
    """

    table: LookupTable
    scale_m: Lanes
    offset_m: Lanes = 0.0

    @classmethod
    # Some 0.2 s each, and a sensor is often read more than once.
    @functools.lru_cache(maxsize=64)
    def from_optics(
        cls,
        spot: Spot,
        *,
        aperture_radius_m: float,
        field_rad: float,
        offset_m: float = 0.0,
        crossing_m: float = math.inf,
        focus_m: float = math.inf,
        scattered: float = 0.0,
    ) -> Overlap:
        """Tabulate the overlap by `physics.optics.receiver`.

        field_rad   r_PD / f
        offset_m    distance from the receiver's axis to the transmitter's, at the sensor
        crossing_m  range at which the axes meet; inf: side by side
        focus_m     range at which the receiver is in focus
        scattered   share of the light that reaches the detector by scatter, wherever the spot lies
        """
        scale = (offset_m + aperture_radius_m + spot.exit_radius_m) / (field_rad + spot.half_divergence_rad)
        place = np.linspace(0.0, 1.0, _PLACES)
        with np.errstate(divide="ignore"):
            ranges = np.maximum(scale * (1.0 / place - 1.0), 1e-9 * scale)
        share = receiver.spot_share(
            profile=spot.profile,
            spot_rad=receiver.spot_radius_rad(
                exit_radius_m=spot.exit_radius_m, half_divergence_rad=spot.half_divergence_rad, range_m=ranges
            ),
            off_axis_rad=receiver.parallax_rad(offset_m=offset_m, crossing_m=crossing_m, range_m=ranges),
            field_rad=field_rad,
            blur_rad=receiver.blur_radius_rad(aperture_radius_m=aperture_radius_m, focus_m=focus_m, range_m=ranges),
        )
        share = scattered + (1.0 - scattered) * np.asarray(share)
        return cls(table=LookupTable(share), scale_m=scale, offset_m=offset_m)

    def share(self, range_m: Lanes) -> Lanes:
        """Share of the light at these ranges, (n,)."""
        return self.table.at(self.scale_m / (self.scale_m + range_m))
