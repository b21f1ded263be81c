"""Rotating polygon: each facet sweeps one line, and a facet tilted against the axis sweeps it at another elevation.

The polygon turns about an upright axis; the beam comes from the side, level, and meets the middle of a facet that
stands square to the bisector with its own middle: that beam leaves along the x axis. The polygon turned by w from
there has the facet's normal at (cos b cos(i + w), +-cos b sin(i + w), sin b), with i the angle of incidence and b
the facet's tilt, and the beam is reflected by r = d - 2 (d . n) n: it moves by 2 w, and by about 2 b cos(i + w) up.

Aperture: the facet is the stop. The received beam is a disc of the lens's radius that stands still, while the facet
turns out from under it; what falls on the next facet looks elsewhere. With the inradius R the facet's edges are
R tan(pi / N) to both sides of its middle, the beam's axis meets the facet's plane at u from the middle, and a distance
along the facet projects on the beam with the cosine of incidence: the share is a disc between two straight edges
(`aperture.slit_share`). The facet's height is taken to be enough, and its tilt is left out of the edges.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..maths.arrays import Lanes, Numbers, Table, xp
from ..maths.vectors import Vector, dot, mixed, reflected
from .aperture import slit_share
from .base import Mechanism, in_frame


@dataclass(frozen=True, slots=True, kw_only=True)
class FacetSize:
    """What decides how much of the receiver's beam a facet takes.

    inradius_m     from the axis to the facets
    lens_radius_m  of the receiver
    """

    inradius_m: Lanes
    lens_radius_m: Lanes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Polygon(Mechanism):
    """One frame is one turn: ``facets`` lines of ``columns`` pulses, in the middle of each facet. Made by `of`.

    turn_rad       of the polygon from pulse to pulse; positive is counter-clockwise seen from above
    incidence_rad  of the beam on the facet in the middle of its line
    side           1 if the beam comes from the left, -1 from the right
    tilt_rad       of each facet; positive looks up
    size           of the facets, or None: they are wider than the beam at every turn
    """

    facets: int
    columns: int
    rate_hz: float
    rotation_hz: float
    turn_rad: Lanes
    incidence_rad: Lanes
    side: Lanes
    tilt_rad: Table
    half_facet: Lanes
    size: FacetSize | None = None

    @classmethod
    def of(
        cls,
        *,
        rate_hz: float,
        rotation_hz: float,
        tilt_rad: Sequence[float],
        duty: float,
        incidence_rad: float,
        side: str,
        size: FacetSize | None = None,
    ) -> Polygon:
        """As many facets as tilts; pulses leave during ``duty`` of the time that a facet has."""
        facets = len(tilt_rad)
        return cls(
            facets=facets,
            columns=max(1, int(rate_hz * duty / (abs(rotation_hz) * facets) + 1e-6)),
            rate_hz=rate_hz,
            rotation_hz=rotation_hz,
            turn_rad=2.0 * math.pi * rotation_hz / rate_hz,
            incidence_rad=incidence_rad,
            side=1.0 if side == "left" else -1.0,
            tilt_rad=Table(np.asarray(tilt_rad, dtype=np.float64)),
            half_facet=math.tan(math.pi / facets),
            size=size,
        )

    @property
    def pulses(self) -> int:
        """Pulses in one frame."""
        return self.facets * self.columns

    @property
    def frame_s(self) -> float:
        """One turn of the polygon."""
        return 1.0 / abs(self.rotation_hz)

    @property
    def line_pulses(self) -> int:
        """Pulses of a facet."""
        return self.columns

    def _facet_and_column(self, pulse: Lanes) -> tuple[Lanes, Lanes]:
        number = xp(pulse).int32(pulse)
        line = number // self.columns
        return line % self.facets, number - line * self.columns

    def _mechanism(self, pulse: Lanes) -> tuple[Lanes]:
        column = self._facet_and_column(pulse)[1]
        return (xp(pulse).float32(2 * column + 1 - self.columns) * (0.5 * self.turn_rad),)

    def _optics(self, pulse: Lanes, turned: tuple[Lanes, ...]) -> tuple[Vector, Lanes]:
        ops = xp(pulse)
        (turn,) = turned
        tilt = ops.float32(ops.take(self.tilt_rad, self._facet_and_column(pulse)[0]))
        rest = ops.cos(self.incidence_rad), self.side * ops.sin(self.incidence_rad), 0.0
        incoming = mixed(1.0, (1.0, 0.0, 0.0), -2.0 * rest[0], rest)
        angle = self.side * self.incidence_rad + turn
        level = ops.cos(angle), ops.sin(angle), 0.0
        normal = mixed(ops.cos(tilt), level, ops.sin(tilt), (0.0, 0.0, 1.0))
        cos_incidence = -dot(incoming, normal)
        direction = reflected(incoming, normal)
        if self.size is None:
            return direction, 1.0
        # In inradii: the beam's axis passes `rest`, the facet's middle is `level`. From there along the beam to the
        # facet's plane, and then how far along the facet that is from its middle.
        along = (1.0 - dot(level, rest)) / dot(level, incoming)
        met = mixed(1.0, rest, along, incoming)
        aside = dot(met, (-level[1], level[0], 0.0))
        scale = cos_incidence * self.size.inradius_m / self.size.lens_radius_m
        share = slit_share(left=(self.half_facet + aside) * scale, right=(self.half_facet - aside) * scale)
        return direction, share

    def channel(self, pulse: Lanes) -> Lanes:
        """Facet of each pulse."""
        return self._facet_and_column(pulse)[0]

    def time_s(self, pulse: Numbers) -> Numbers:
        """Pulses of a line at the rate; lines start when their facets come round."""
        line, column = in_frame(pulse, self.columns)
        return np.asarray(line * (self.frame_s / self.facets) + column / self.rate_hz)
