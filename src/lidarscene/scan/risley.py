"""Risley prisms: two or three wedges that rotate about the sensor's x axis, one behind the other.

Each wedge has one face square to the axis and one inclined by the wedge angle. The beam is refracted at each face by
Snell's law in vector form (`vectors.refracted`), no angle is taken to be small: thin wedges deviate by (n - 1) alpha
towards their thick side, real ones by some per cent more, which depends on the faces that look at each other.

Aperture: the lens behind the prisms is the stop. At each face the beams before and behind cover the same part of the
face, so their cross-sections are as the cosines to its normal, and A(theta_r) / A(0) is the product over all faces,
from the lens outwards, of cos(theta_t) / cos(theta_i): by how much a beam of the lens's size is wider in the scene.
What is lost in area is gained in solid angle: refraction between surfaces in air keeps their product. So the background
of an extended source, (8), does not have this factor, and the echo, (5), does.
A(0) is the lens itself, wedges out of the way. The prisms are taken to be wider than every beam that the lens takes;
what Fresnel reflection costs is part of the receiver's efficiency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..maths.arrays import Lanes, Numbers, Table, xp
from ..maths.vectors import Vector, refracted
from .base import Mechanism
from .turns import Turns

_X: Vector = (1.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Wedge:
    """One rotating prism. Its phase is the direction of its thick side, from y towards z; that is where it bends to.

    tilted  which face is inclined: "out" (towards the scene) or "in"
    """

    angle_rad: Lanes
    index: Lanes
    turns: Turns
    tilted: str

    @classmethod
    def of(
        cls,
        *,
        rate_hz: float,
        angle_rad: float,
        index: float,
        rotation_hz: float,
        phase_rad: float,
        tilted: str,
    ) -> Wedge:
        """Seen ``rate_hz`` times a second. Positive rotation goes from y (left) to z (up)."""
        turns = Turns.per_pulse(frequency_hz=rotation_hz, rate_hz=rate_hz, start_rad=phase_rad)
        return cls(angle_rad=angle_rad, index=index, turns=turns, tilted=tilted)

    def bend(self, direction: Vector, phase_rad: Lanes) -> tuple[Vector, Lanes]:
        """The beam behind the wedge, and by how much its cross-section has grown."""
        ops = xp(phase_rad, self.angle_rad)
        # The inclined face recedes from its thick side: forward on the way out, backward on the way in.
        sine = ops.sin(self.angle_rad) * (-1.0 if self.tilted == "out" else 1.0)
        inclined = ops.cos(self.angle_rad), sine * ops.cos(phase_rad), sine * ops.sin(phase_rad)
        first, second = (_X, inclined) if self.tilted == "out" else (inclined, _X)
        inside, widened = refracted(direction, first, 1.0 / self.index)
        outside, again = refracted(inside, second, self.index)
        return outside, widened * again


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Risley(Mechanism):
    """Pulses at an even rate; ``pulses`` of them are a frame, and the prisms go on turning. Made by `of`.

    beams             lasers that take turns
    beam_elevation_rad  of each before the prisms, or None: the one along the axis
    """

    pulses: int
    rate_hz: float
    wedges: tuple[Wedge, ...]
    beams: int = 1
    beam_elevation_rad: Table | None = None

    @classmethod
    def of(
        cls,
        *,
        rate_hz: float,
        frame_hz: float,
        wedges: Sequence[Wedge],
        beam_elevation_rad: Sequence[float] | None = None,
    ) -> Risley:
        """From the wedges, the first one next to the laser, turned at the same rate of pulses."""
        return cls(
            pulses=max(1, round(rate_hz / frame_hz)), rate_hz=rate_hz, wedges=tuple(wedges),
            beams=1 if beam_elevation_rad is None else len(beam_elevation_rad),
            beam_elevation_rad=(
                None if beam_elevation_rad is None else Table(np.asarray(beam_elevation_rad, dtype=np.float64))
            ),
        )  # fmt: skip

    @property
    def frame_s(self) -> float:
        """Length of a frame."""
        return self.pulses / self.rate_hz

    def _mechanism(self, pulse: Lanes) -> tuple[Lanes, ...]:
        return tuple(wedge.turns.angle_rad(pulse) for wedge in self.wedges)

    def _optics(self, pulse: Lanes, turned: tuple[Lanes, ...]) -> tuple[Vector, Lanes]:
        if self.beam_elevation_rad is None:
            return self.through(turned)
        ops = xp(pulse)
        return self.through(turned, ops.float32(ops.take(self.beam_elevation_rad, self.channel(pulse))))

    def channel(self, pulse: Lanes) -> Lanes:
        """Number of the laser."""
        number = xp(pulse).int32(pulse)
        return number - number // self.beams * self.beams

    def through(
        self, phases_rad: tuple[Lanes, ...], elevation_rad: Lanes | None = None
    ) -> tuple[Vector, Lanes]:
        """Direction and share of the aperture with the wedges' thick sides in these directions.

        elevation_rad  of the beam before the prisms; along the axis if left out
        """
        direction: Vector = _X
        if elevation_rad is not None:
            ops = xp(elevation_rad)
            direction = ops.cos(elevation_rad), 0.0 * elevation_rad, ops.sin(elevation_rad)
        share: Lanes = 1.0
        for wedge, phase in zip(self.wedges, phases_rad, strict=True):
            direction, widened = wedge.bend(direction, phase)
            share = share * widened
        return direction, share

    def background_share(self, pulse: Lanes) -> Lanes:
        """Refraction trades aperture for field of view: their product is that of the lens alone."""
        return 1.0

    def time_s(self, pulse: Numbers) -> Numbers:
        """One pulse after the other, without a pause."""
        return np.asarray(pulse, dtype=np.float64) / float(self.rate_hz)
