"""Overlap of the laser's spot with the receiver's field of view, as a table over the range.

The share follows from an integral over the spot, too dear for every pulse, and depends on the range alone. So it is
tabulated once, even in s / (s + R), which is fine near the sensor, where it changes. How it changes with the numbers
behind it is known to first order: derivatives of a maximum range need no more.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from ..maths.arrays import Lanes, LookupTable, Numbers, is_drjit
from ..physics.optics import receiver

_PLACES = 1025  # linear between them: 1e-5 where the share changes within a third of the range

SIXTH_ORDER = ((1.0, 0.75), (2.0, -0.15), (3.0, 1.0 / 60.0))
"""Sixth-order central difference: sum of w_k (f(x + k h) - f(x - k h)) / h (Fornberg, Math. Comp. 51, 1988, 699)."""

_STEP = 1e-3
"""Accuracy bought: h over x: the slopes of the share are off by 1e-9."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Spot:
    """Width of the laser's spot.

    Attributes:
        profile: profile of the beam: "gaussian" or "top_hat"
        exit_radius_m: radius at the exit, where the beam has its waist
    """

    profile: str
    half_divergence_rad: Lanes
    exit_radius_m: Lanes


@dataclass(frozen=True, slots=True, kw_only=True)
class Alignment:
    """Place of the transmitter beside the receiver, and the receiver's focus.

    Attributes:
        offset_m: distance from the receiver's axis to the transmitter's, at the sensor
        crossing_m: range at which the axes meet; inf: side by side
        focus_m: range at which the receiver is in focus
        scattered: share of the light that reaches the detector by scatter, wherever the spot lies
    """

    offset_m: Lanes = 0.0
    crossing_m: Lanes = math.inf
    focus_m: Lanes = math.inf
    scattered: Lanes = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class OverlapGeometry:
    """All that decides the overlap.

    Attributes:
        field_rad: r_PD / f
    """

    spot: Spot
    aperture_radius_m: Lanes
    field_rad: Lanes
    alignment: Alignment = Alignment()

    @property
    def lengths(self) -> dict[str, Lanes]:
        """Lengths and angles that the share of the spot in the field of view depends on, by name."""
        return {
            "half_divergence_rad": self.spot.half_divergence_rad,
            "exit_radius_m": self.spot.exit_radius_m,
            "aperture_radius_m": self.aperture_radius_m,
            "field_rad": self.field_rad,
            "offset_m": self.alignment.offset_m,
            "crossing_m": self.alignment.crossing_m,
            "focus_m": self.alignment.focus_m,
        }

    @property
    def scale_m(self) -> Lanes:
        """Range around which the share changes."""
        width_m = self.alignment.offset_m + self.aperture_radius_m + self.spot.exit_radius_m
        return width_m / (self.field_rad + self.spot.half_divergence_rad)

    def with_scatter(self, spot_share: Lanes) -> Lanes:
        """Share of the light on the detector, from that of the spot in the field of view."""
        return self.alignment.scattered + (1.0 - self.alignment.scattered) * spot_share

    def share(self, range_m: Numbers) -> Numbers:
        """Share of the light on the detector at these ranges, (n,), by the integral itself; NumPy."""
        return np.asarray(self.with_scatter(_spot_share(self.spot.profile, {**self.lengths, "range_m": range_m})))


@dataclass(frozen=True, slots=True, kw_only=True)
class Overlap:
    """Share of the spot's light that reaches the detector, by range.

    Attributes:
        table: the share, even in s / (s + R): from far (0) to near (1)
        scale_m: s, the range around which the share changes
        geometry: for which the table is
        moved: geometry near that one, for which the share is computed to first order; None: that of the table
    """

    table: LookupTable
    scale_m: Lanes
    geometry: OverlapGeometry
    moved: OverlapGeometry | None = None

    @classmethod
    # Some 0.2 s each, and a sensor is often read more than once.
    @functools.lru_cache(maxsize=64)
    def from_geometry(cls, geometry: OverlapGeometry) -> Overlap:
        """Tabulate the overlap by `physics.optics.receiver`."""
        scale = geometry.scale_m
        place = np.linspace(0.0, 1.0, _PLACES)
        with np.errstate(divide="ignore"):
            ranges = np.maximum(scale * (1.0 / place - 1.0), 1e-9 * scale)
        return cls(table=LookupTable(geometry.share(ranges)), scale_m=scale, geometry=geometry)

    @property
    def offset_m(self) -> Lanes:
        """Distance from the receiver's axis to the transmitter's, at the sensor."""
        return self.geometry.alignment.offset_m

    def move(self, geometry: OverlapGeometry) -> Overlap:
        """Return the overlap of a geometry whose numbers are close to this one's, or record derivatives."""
        return replace(self, moved=geometry)

    def share(self, range_m: Lanes) -> Lanes:
        """Share of the light at these ranges, (n,); of one range where the geometry is `moved`."""
        if self.moved is None:
            return self.table.at(self.scale_m / (self.scale_m + range_m))
        # The integral has 4,096 terms: as a kernel with derivatives it would compile for minutes.
        centre_m = float(np.ravel(cast(Any, range_m).numpy() if is_drjit(range_m) else range_m)[0])
        spot_share, slopes = _spot_share_and_slopes(self.geometry, centre_m)
        values = {**self.moved.lengths, "range_m": range_m}
        centres = {**self.geometry.lengths, "range_m": centre_m}
        shift = sum((slope * (values[name] - centres[name]) for name, slope in slopes.items()), 0.0)
        return self.moved.with_scatter(spot_share + shift)


def _spot_share(profile: str, lengths: Mapping[str, Lanes]) -> Numbers:
    """Share of the spot in the field of view for `OverlapGeometry.lengths` and ``range_m``, NumPy."""
    range_m = lengths["range_m"]
    return np.asarray(
        receiver.spot_share(
            profile=profile,
            spot_rad=receiver.spot_radius_rad(
                exit_radius_m=lengths["exit_radius_m"],
                half_divergence_rad=lengths["half_divergence_rad"],
                range_m=range_m,
            ),
            off_axis_rad=receiver.parallax_rad(
                offset_m=lengths["offset_m"], crossing_m=lengths["crossing_m"], range_m=range_m
            ),
            field_rad=lengths["field_rad"],
            blur_rad=receiver.blur_radius_rad(
                aperture_radius_m=lengths["aperture_radius_m"], focus_m=lengths["focus_m"], range_m=range_m
            ),
        )
    )


@functools.lru_cache(maxsize=64)
def _spot_share_and_slopes(geometry: OverlapGeometry, range_m: float) -> tuple[float, dict[str, float]]:
    """Share of the spot in the field of view at a range, and its derivatives with respect to all finite lengths.

    A length of 0 is left out: the share is even in each of them.
    """
    lengths = {**geometry.lengths, "range_m": range_m}
    varied = [name for name, value in lengths.items() if value and math.isfinite(value)]
    factors = np.array([1.0 + sign * multiple * _STEP for multiple, _ in SIXTH_ORDER for sign in (1.0, -1.0)])
    # All in one call, for a call takes nearly the same time for 1 geometry and for 50: the last one is the centre.
    columns = {name: np.full(len(varied) * len(factors) + 1, value) for name, value in lengths.items()}
    for number, name in enumerate(varied):
        columns[name][number * len(factors) : (number + 1) * len(factors)] *= factors
    spot_share = _spot_share(geometry.spot.profile, columns)
    weights = np.array([sign * weight for _, weight in SIXTH_ORDER for sign in (1.0, -1.0)])
    rises = spot_share[:-1].reshape(len(varied), len(factors)) @ weights
    return float(spot_share[-1]), {
        name: float(rise / (_STEP * lengths[name])) for name, rise in zip(varied, rises, strict=True)
    }
