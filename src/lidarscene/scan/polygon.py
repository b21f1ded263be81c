"""Rotating polygon: each facet sweeps one line, and a facet tilted against the axis sweeps it at another elevation.

The polygon turns about a vertical axis. The beam comes from the side, horizontally. It meets the middle of a facet
that is perpendicular to the bisector with its own middle: that beam leaves along the x axis. If the polygon is turned
by w from there, the facet's normal is (cos b cos(i + w), +-cos b sin(i + w), sin b), and the beam, reflected by r = d
- 2 (d . n) n, moves by 2 w and by about 2 b cos(i + w) up.

Aperture: the facet is the stop. The received beam is a fixed disc of the lens's radius while the facet moves across
it; light on the next facet looks elsewhere. With the inradius R the facet's edges are R tan(pi / N) to both sides of
its middle, the beam's axis meets the facet's plane at u from the middle, and lengths along the facet project on the
beam with the cosine of incidence. So the share is a disc between two straight edges (`aperture.slit_share`). The
facet is taken as high enough, and its tilt is left out of the edges.

Symbols: w turn, i angle of incidence, b tilt of the facet, N facets, R inradius.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import model_validator

from ..errors import InputError
from ..maths.arrays import Lanes, LookupTable, xp
from ..maths.units import FileKey, Quantity, SameTable
from ..maths.vectors import Vector, dot, reflected, weighted_sum
from .aperture import slit_share
from .base import Encoder, Jitter, LineByLine, Rotation
from .clock import PulseClock
from .scanner_file import ScannerContext, ScannerFile


@dataclass(frozen=True, slots=True, kw_only=True)
class Facets:
    """The facets of a polygon, and how the beam meets them; as in `Polygon`."""

    tilt_rad: Annotated[
        Sequence[float],
        Quantity(
            "deg",
            name="facet_tilt_deg",
            ge=-40,
            le=40,
            least=3,
            about="of each facet against the axis, in the order in which they pass; positive looks up",
        ),
    ]
    duty: Annotated[float, Quantity(gt=0, le=1, about="part of a facet's time in which pulses leave")] = 1.0
    incidence_rad: Annotated[float, Quantity("deg", ge=0, le=80, about="on the facet that sends the beam along x")] = (
        math.radians(45.0)
    )
    side: Annotated[Literal["left", "right"], FileKey(about="from where the beam comes")] = "left"
    inradius_m: Annotated[
        float | None,
        Quantity(
            "mm",
            ge=0.1,
            le=1e4,
            about="from the axis to the facets; without it the facets cut nothing off the aperture",
        ),
    ] = None
    lens_radius_m: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Polygon(LineByLine):
    """One frame is one turn: a row of ``columns`` pulses for each facet, in its middle. Made by `create`.

    Attributes:
        turn_rad: turn from pulse to pulse; positive is counter-clockwise seen from above
        incidence_rad: incidence of the beam on the facet, in the middle of its line
        side: 1 if the beam comes from the left, -1 from the right
        tilt_rad: tilt of each facet; positive looks up
        inradius_m: distance from the axis to the facets, or None: the facets never cut the beam
        lens_radius_m: lens radius of the receiver; used only with an inradius
    """

    columns: int
    rows: int
    rate_hz: float
    rotation_hz: float
    turn_rad: Lanes
    incidence_rad: Lanes
    side: Lanes
    tilt_rad: LookupTable
    half_facet: Lanes
    inradius_m: Lanes | None = None
    lens_radius_m: Lanes | None = None

    @classmethod
    def create(
        cls,
        *,
        rate_hz: float,
        rotation_hz: Rotation,
        facets: Annotated[Facets, SameTable()],
        jitter_rad: Jitter = None,
        encoder_rad: Encoder = None,
    ) -> Polygon:
        """Build from the facets, one for each tilt; pulses leave during ``duty`` of a facet's time."""
        count = len(facets.tilt_rad)
        return cls(
            rows=count,
            columns=max(1, int(rate_hz * facets.duty / (abs(rotation_hz) * count) + 1e-6)),
            rate_hz=rate_hz,
            rotation_hz=rotation_hz,
            turn_rad=2.0 * math.pi * rotation_hz / rate_hz,
            incidence_rad=facets.incidence_rad,
            side=1.0 if facets.side == "left" else -1.0,
            tilt_rad=LookupTable(np.asarray(facets.tilt_rad, dtype=np.float64)),
            half_facet=math.tan(math.pi / count),
            inradius_m=facets.inradius_m,
            lens_radius_m=facets.lens_radius_m,
            jitter_rad=jitter_rad,
            encoder_rad=encoder_rad,
        )

    @property
    def frame_s(self) -> float:
        """One turn of the polygon."""
        return 1.0 / abs(self.rotation_hz)

    def _mechanism(self, pulse: Lanes) -> tuple[Lanes]:
        column = self._row_and_column(pulse)[1]
        # The turn counts from each facet's own middle: facets differ in tilt only.
        return (xp(pulse).float32(2 * column + 1 - self.columns) * (0.5 * self.turn_rad),)

    def _optics(self, pulse: Lanes, turned: tuple[Lanes, ...]) -> tuple[Vector, Lanes]:
        ops = xp(pulse)
        (turn,) = turned
        tilt = ops.float32(ops.take(self.tilt_rad, self._row_and_column(pulse)[0]))
        # `rest_normal` is that of an upright facet in mid-line; mirrored at it, the incoming beam leaves along x.
        rest_normal = ops.cos(self.incidence_rad), self.side * ops.sin(self.incidence_rad), 0.0
        incoming = weighted_sum(1.0, (1.0, 0.0, 0.0), -2.0 * rest_normal[0], rest_normal)
        # The facet has turned on, and leans by its tilt.
        angle = self.side * self.incidence_rad + turn
        level = ops.cos(angle), ops.sin(angle), 0.0
        normal = weighted_sum(ops.cos(tilt), level, ops.sin(tilt), (0.0, 0.0, 1.0))
        cos_incidence = -dot(incoming, normal)
        direction = reflected(incoming, normal)
        if self.inradius_m is None or self.lens_radius_m is None:
            return direction, 1.0
        # In units of the inradius: the beam's axis passes through the point `rest_normal`, and the facet's middle is
        # `level`. Follow the beam to the facet's plane; `offset` is the distance from there to the facet's middle,
        # along the facet.
        along = (1.0 - dot(level, rest_normal)) / dot(level, incoming)
        facet_point = weighted_sum(1.0, rest_normal, along, incoming)
        offset = dot(facet_point, (-level[1], level[0], 0.0))
        scale = cos_incidence * self.inradius_m / self.lens_radius_m
        share = slit_share(left=(self.half_facet + offset) * scale, right=(self.half_facet - offset) * scale)
        return direction, share

    @property
    def clock(self) -> PulseClock:
        """Pulses of a line at the pulse rate; each line starts when its facet arrives."""
        return PulseClock(levels=((self.columns, self.frame_s / self.rows),), rate_hz=self.rate_hz)


class PolygonFile(ScannerFile[Polygon]):
    """[scanner] type = "polygon": one line for each facet."""

    type: Literal["polygon"]

    @model_validator(mode="after")
    def _faces_the_beam(self) -> PolygonFile:
        if self.rotation_hz == 0.0:
            raise ValueError("rotation_hz: must not be 0")
        # The last pulse of a facet finds it turned by half of the duty's part of a facet.
        swing = self.incidence_deg + self.duty * 180.0 / len(self.facet_tilt_deg)
        if swing >= 90.0:
            raise ValueError(
                f"facets must turn by < 90 degrees from the beam, got {swing:g} with"
                f" incidence_deg = {self.incidence_deg:g} and duty = {self.duty:g}"
            )
        return self

    def build(self, context: ScannerContext) -> Polygon:
        """Convert to SI units; only a facet of known size needs the lens.

        Raises:
            InputError: if a facet has no pulse
        """
        facets = len(self.facet_tilt_deg)
        on_facet = context.rate_hz * self.duty / (facets * abs(self.rotation_hz))
        # float32 counts columns exactly up to 2^24.
        if not 1.0 - 1e-6 <= on_facet < 2**24:
            raise InputError(f"scanner: must have 1 to 2^24 pulses on each facet, got {on_facet:.3g}")
        lens_radius_m = None if self.inradius_mm is None else context.lens_radius_m
        return self.in_si(rate_hz=context.rate_hz, lens_radius_m=lens_radius_m)
