"""Mirrors that turn about two axes: from two mechanical angles to the reflected beam and the aperture.

Each beam is reflected by a plane mirror, r = d - 2 (d . n) n, with the normal n given by the mechanical angles. So an
even grid of mechanical angles is not even in azimuth and elevation; only near the axis is the optical angle twice the
mechanical one. At rest the beam leaves along the sensor's x axis; positive turns move it to the left and up.

Symbols: d incoming and r outgoing direction, n normal, t turn.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Annotated, Generic, Literal, Self

from pydantic import Field, model_validator

from ..files.table_model import Number, Target
from ..maths.arrays import Lanes, xp
from ..maths.units import si
from ..maths.vectors import FORWARD, LEFT, UP, Vector, dot, reflected, weighted_sum
from .aperture import mirror_share, round_mirror_share
from .scanner_file import ScannerContext, ScannerFile

_SIDES: dict[str, Vector] = {"left": LEFT, "right": (0.0, -1.0, 0.0), "above": UP, "below": (0.0, 0.0, -1.0)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Gimbal:
    """One mirror on two axes (MEMS, gimballed galvanometer).

    One axis is perpendicular to the plane of incidence: a turn about it moves the beam by twice as much. The other
    lies in the mirror and in that plane: a turn t moves the beam out of it by asin(cos(incidence) sin(2 t)).

    Aperture: the mirror is the stop, so A goes with its projected area (`aperture.mirror_share`). With a round mirror
    of given size, the lens is the stop while the mirror's projection covers it (`aperture.round_mirror_share`; share
    of the lens's whole area, below 1 at rest if the mirror is smaller).

    Attributes:
        incidence_rad: angle between the incoming beam and the normal at rest; the beam is folded by pi minus twice that
        side: side from which the beam comes: "left", "right", "above" or "below" the x axis
        outer: turn whose axis is fixed: "azimuth" or "elevation"; it carries the axis of the other turn
        mirror_radius_m: radius of a round mirror in front of the lens, or None: the mirror is the stop
        lens_radius_m: radius of the receiver's lens; used only with a mirror radius
    """

    incidence_rad: Lanes
    side: str
    outer: str
    mirror_radius_m: Lanes | None = None
    lens_radius_m: Lanes | None = None

    def beam(self, azimuth_turn_rad: Lanes, elevation_turn_rad: Lanes) -> tuple[Vector, Lanes]:
        """Direction and share of the aperture for these turns about the two axes."""
        side = _SIDES[self.side]
        folds_upright = self.side in ("above", "below")
        in_plane, out_of_plane = (
            (elevation_turn_rad, azimuth_turn_rad) if folds_upright else (azimuth_turn_rad, elevation_turn_rad)
        )
        across = LEFT if folds_upright else UP
        # The sign makes a positive turn move the beam left or up, from whichever side it comes.
        towards_side = in_plane * sum(side)
        ops = xp(in_plane, out_of_plane, self.incidence_rad)
        cos_rest, sin_rest = ops.cos(self.incidence_rad), ops.sin(self.incidence_rad)
        # The normal at rest, and the direction in the mirror within the plane of incidence.
        normal_at_rest, along = (
            weighted_sum(cos_rest, FORWARD, sin_rest, side),
            weighted_sum(-sin_rest, FORWARD, cos_rest, side),
        )
        cos_in, sin_in = ops.cos(towards_side), ops.sin(towards_side)
        cos_out, sin_out = ops.cos(out_of_plane), ops.sin(out_of_plane)
        if folds_upright == (self.outer == "elevation"):  # the in-plane turn is the outer one
            normal = weighted_sum(cos_out, weighted_sum(cos_in, normal_at_rest, sin_in, along), sin_out, across)
        else:
            normal = weighted_sum(cos_in, weighted_sum(cos_out, normal_at_rest, sin_out, across), sin_in, along)
        incoming = weighted_sum(1.0, FORWARD, -2.0 * cos_rest, normal_at_rest)
        cos_incidence = -dot(incoming, normal)
        return reflected(incoming, normal), self._share(cos_incidence, cos_rest)

    def _share(self, cos_incidence: Lanes, cos_rest: Lanes) -> Lanes:
        if self.mirror_radius_m is None or self.lens_radius_m is None:
            return mirror_share(cos_incidence=cos_incidence, cos_at_rest=cos_rest)
        return round_mirror_share(
            cos_incidence=cos_incidence, mirror_radius_m=self.mirror_radius_m, lens_radius_m=self.lens_radius_m
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class MirrorPair:
    """Two mirrors on one axis each, at 45 degrees to the beam at rest (the usual pair of galvanometers).

    The first mirror moves the beam by exactly twice its turn; the last mirror turns all of it by twice its own. So
    lines of equal first turn are cones about the last mirror's axis.

    Aperture: both mirrors are rectangles that just hold the beam at rest. Each narrows the beam in its own plane of
    incidence, and the planes are perpendicular, so the shares multiply. The walk of the beam over the second mirror
    is left out: the mirrors are close together.

    Attributes:
        last: turn of the mirror that the beam leaves from: "azimuth" or "elevation"
    """

    last: str

    def beam(self, azimuth_turn_rad: Lanes, elevation_turn_rad: Lanes) -> tuple[Vector, Lanes]:
        """Direction and share of the aperture for these turns of the two mirrors."""
        upright = self.last == "elevation"
        first, last = (azimuth_turn_rad, elevation_turn_rad) if upright else (elevation_turn_rad, azimuth_turn_rad)
        # Where the first mirror moves the beam, and from where the last one gets it.
        moved, side = (LEFT, UP) if upright else (UP, LEFT)
        ops = xp(first, last)
        angle, last_angle = 0.25 * math.pi + first, 0.25 * math.pi + last
        normal = weighted_sum(-ops.cos(angle), moved, -ops.sin(angle), side)
        between = reflected(moved, normal)
        last_normal = weighted_sum(ops.cos(last_angle), FORWARD, ops.sin(last_angle), side)
        cos_rest = math.sqrt(0.5)
        shares = (
            mirror_share(cos_incidence=-dot(incoming, mirror_normal), cos_at_rest=cos_rest)
            for incoming, mirror_normal in ((moved, normal), (between, last_normal))
        )
        first_share, last_share = shares
        return reflected(between, last_normal), first_share * last_share


Mirrors = Gimbal | MirrorPair


Turn = Annotated[float, Field(ge=0, le=45)]


class MirrorsFile(ScannerFile[Target], Generic[Target]):
    """Mirrors: how they stand, and how far they turn."""

    mirrors: Literal["one", "two"] = Field(default="one", description='`"one"` on two axes, or `"two"` on one each')
    incidence_deg: Annotated[float, Field(ge=0, le=80)] | None = Field(
        default=None, description="of one mirror at rest; 45 if left out"
    )
    side: Literal["left", "right", "above", "below"] | None = Field(
        default=None, description='from where the beam meets one mirror; `"below"` if left out'
    )
    outer: Literal["azimuth", "elevation"] = Field(
        default="elevation", description="the axis that stands still, or that of the last of two mirrors"
    )
    mirror_radius_mm: Annotated[float, Number("mm", ge=0.05, le=1e4)] | None = Field(
        default=None, description="of one round mirror before the lens; if left out the mirror is the stop"
    )
    azimuth_turn_deg: Turn = Field(description="mechanical amplitude, zero to peak")
    elevation_turn_deg: Turn = Field(description="mechanical amplitude, zero to peak")

    @model_validator(mode="after")
    def _faces_the_beam(self) -> Self:
        if self.mirrors == "two":
            for key in ("incidence_deg", "side", "mirror_radius_mm"):
                if getattr(self, key) is not None:
                    raise ValueError(f'{key}: must go with mirrors = "one", got "two"')
        turns = math.radians(self.azimuth_turn_deg), math.radians(self.elevation_turn_deg)
        stop = self._mirrors(None, 0.0)
        # The cosine of incidence is least in a corner of the field.
        for a, e in itertools.product((-1, 1), repeat=2):
            if stop.beam(a * turns[0], e * turns[1])[1] <= 1e-6:
                raise ValueError("a mirror must face the beam at every turn, got one that turns too far")
        return self

    def _mirrors(self, mirror_radius_m: float | None, lens_radius_m: float) -> Gimbal | MirrorPair:
        if self.mirrors == "two":
            return MirrorPair(last=self.outer)
        return Gimbal(
            incidence_rad=math.radians(45.0 if self.incidence_deg is None else self.incidence_deg),
            side=self.side or "below",
            outer=self.outer,
            mirror_radius_m=mirror_radius_m,
            lens_radius_m=None if mirror_radius_m is None else lens_radius_m,
        )

    def mirrors_for(self, context: ScannerContext) -> Gimbal | MirrorPair:
        """Build the mirrors in SI units."""
        return self._mirrors(si(self.mirror_radius_mm, "mm"), context.lens_radius_m)
