"""Risley prisms: up to three wedges that rotate about the sensor's x axis, one behind the other.

Each wedge has one face perpendicular to the axis and one inclined by the wedge angle. The beam is refracted at each
face by Snell's law in vector form (`maths.vectors.refracted`), without small angles: thin wedges deviate by (n - 1)
alpha towards their thick side, real ones by some per cent more, depending on which faces look at each other.

Aperture: the lens behind the prisms is the stop. At each face the beams before and behind cover the same part of the
face, so their cross-sections are as the cosines to its normal. A(theta_r) / A(0) is the product over all faces, from
the lens outwards, of cos(theta_t) / cos(theta_i): the widening of a beam of the lens's size. Refraction between
surfaces in air keeps the product of area and solid angle, so the background of an extended source, (8), does not have
this factor, and the echo, (5), does. A(0) is the lens without wedges. The prisms are wider than every beam that the
lens takes; Fresnel losses are part of the receiver's efficiency.

With a mirror behind the wedges the axis is upright, the sensor's z: the mirror turns about it and throws the beam to
the side. A wedge that deviates by d then draws a cone of half-angle d about the mirror's direction, once in each turn
against the mirror. The fixed lasers' image turns with the mirror. The mirror is wider than every beam.

Symbols: n refractive index, alpha wedge angle, theta_i and theta_t angles before and behind a face.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from ..errors import InputError
from ..files.table_model import Table
from ..maths.arrays import Lanes, LookupTable, xp
from ..maths.units import FileKey, Quantity, si
from ..maths.vectors import FORWARD, Vector, reflected, refracted
from .base import Encoder, Jitter, SteadyPulses
from .scanner_file import ScannerContext, ScannerFile
from .turns import Turns

_PULSES_OF_MEAN = 20_000
"""Accuracy bought: pulses of which `Risley.mean_share` is the mean: to 1e-3 for the sensors of the catalogue."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wedge:
    """One rotating prism. Its phase is the direction of its thick side, from y towards z, to which it bends the beam.

    Attributes:
        tilted: inclined face: "out" (towards the scene) or "in"
    """

    angle_rad: Lanes
    index: Lanes
    turns: Turns
    tilted: str

    @classmethod
    def create(
        cls,
        *,
        rate_hz: float,
        angle_rad: Annotated[float, Quantity("deg", gt=0, le=45, about="between the faces")],
        index: Annotated[float, Quantity(ge=1, le=4, about="refractive index")],
        rotation_hz: Annotated[float, Quantity(ge=-1e6, le=1e6, about="positive from the left to the top")],
        phase_rad: Annotated[
            float, Quantity("deg", ge=-36e3, le=36e3, about="of the thick side at the start, from the left to the top")
        ] = 0.0,
        tilted: Annotated[
            Literal["in", "out"], FileKey(name="inclined_face", about='`"out"` (towards the scene) or `"in"`')
        ],
    ) -> Wedge:
        """A prism that turns at a constant rate, from y (left) to z (up) if positive; ``rate_hz`` is that of pulses."""
        turns = Turns.per_pulse(frequency_hz=rotation_hz, rate_hz=rate_hz, start_rad=phase_rad)
        return cls(angle_rad=angle_rad, index=index, turns=turns, tilted=tilted)

    def bend(self, direction: Vector, phase_rad: Lanes) -> tuple[Vector, Lanes]:
        """The beam behind the wedge, and the widening of its cross-section."""
        ops = xp(phase_rad, self.angle_rad)
        # The normal of the inclined face leans away from the thick side if that face is the outer one, else towards it.
        sine = ops.sin(self.angle_rad) * (-1.0 if self.tilted == "out" else 1.0)
        inclined = ops.cos(self.angle_rad), sine * ops.cos(phase_rad), sine * ops.sin(phase_rad)
        first, second = (FORWARD, inclined) if self.tilted == "out" else (inclined, FORWARD)
        # Into the glass and out of it. The cross-section widens with the cosine at both faces.
        inside, widened = refracted(direction, first, 1.0 / self.index)
        outside, widened_again = refracted(inside, second, self.index)
        return outside, widened * widened_again


@dataclass(frozen=True, slots=True, kw_only=True)
class TurningMirror:
    """A plane mirror behind the wedges, oblique to the axis about which it turns."""

    tilt_rad: Lanes
    turns: Turns

    @classmethod
    def create(
        cls,
        *,
        rate_hz: float,
        tilt_rad: Annotated[float, Quantity("deg", gt=0, lt=90, about="of its normal against the axis")],
        rotation_hz: Annotated[float, Quantity(ge=-1e6, le=1e6, about="positive from the front to the left")],
        phase_rad: Annotated[
            float, Quantity("deg", ge=-36e3, le=36e3, about="of its normal at the start, from the back to the right")
        ] = 0.0,
    ) -> TurningMirror:
        """A mirror that turns at a constant rate; ``rate_hz`` is that of pulses."""
        return cls(
            tilt_rad=tilt_rad, turns=Turns.per_pulse(frequency_hz=rotation_hz, rate_hz=rate_hz, start_rad=phase_rad)
        )

    def throw(self, direction: Vector, phase_rad: Lanes) -> Vector:
        """The beam behind the mirror, with the wedges' axis turned upright."""
        ops = xp(phase_rad, self.tilt_rad)
        sine = ops.sin(self.tilt_rad)
        normal = ops.cos(self.tilt_rad), sine * ops.cos(phase_rad), sine * ops.sin(phase_rad)
        along, front, left = reflected(direction, normal)
        return front, left, along


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Risley(SteadyPulses):
    """Pulses at a constant rate; ``pulses`` of them are a frame, and the prisms keep turning. Made by `create`.

    Attributes:
        beams: lasers that fire in turn
        beam_elevation_rad: elevation of each laser before the prisms, or None: one along the axis
        mean_share: mean share of the aperture behind the prisms
    """

    wedges: tuple[Wedge, ...]
    beams: int = 1
    beam_elevation_rad: LookupTable | None = None
    mirror: TurningMirror | None = None
    first_beam: Lanes = 0
    mean_share: Lanes = 1.0

    @classmethod
    def create(
        cls,
        *,
        rate_hz: float,
        frame_hz: Annotated[float, Quantity(ge=1e-4, le=1e6, about="frames per second")],
        wedges: Sequence[Wedge],
        beam_elevation_rad: Annotated[
            Sequence[float] | None,
            Quantity(
                "deg",
                ge=-45,
                le=45,
                least=1,
                about="of each laser before the prisms, in turn; one along the axis if left out",
            ),
        ] = None,
        mirror: TurningMirror | None = None,
        jitter_rad: Jitter = None,
        encoder_rad: Encoder = None,
    ) -> Risley:
        """Build from the wedges, the one next to the laser first."""
        scanner = cls(
            pulses=max(1, round(rate_hz / frame_hz)),
            rate_hz=rate_hz,
            wedges=tuple(wedges),
            mirror=mirror,
            beams=1 if beam_elevation_rad is None else len(beam_elevation_rad),
            beam_elevation_rad=(
                None if beam_elevation_rad is None else LookupTable(np.asarray(beam_elevation_rad, dtype=np.float64))
            ),
            jitter_rad=jitter_rad,
            encoder_rad=encoder_rad,
        )
        mean = np.mean(scanner.aperture_share(np.arange(_PULSES_OF_MEAN, dtype=np.uint32)))
        return replace(scanner, mean_share=float(mean))

    @property
    def _moving(self) -> list[Turns]:
        """Turns of the wedges, and of the mirror if there is one."""
        return [part.turns for part in (*self.wedges, self.mirror) if part is not None]

    def _mechanism(self, pulse: Lanes) -> tuple[Lanes, ...]:
        return tuple(turns.angle_rad(pulse) for turns in self._moving)

    def _optics(self, pulse: Lanes, turned: tuple[Lanes, ...]) -> tuple[Vector, Lanes]:
        phases, elevation_rad = turned[: len(self.wedges)], None
        if self.beam_elevation_rad is not None:
            ops = xp(pulse)
            elevation_rad = ops.float32(ops.take(self.beam_elevation_rad, self.channel(pulse)))
        direction, share = self.refract(phases, elevation_rad)
        return direction if self.mirror is None else self.mirror.throw(direction, turned[-1]), share

    def channel(self, pulse: Lanes) -> Lanes:
        """Number of the laser."""
        ops = xp(pulse)
        beam = ops.divmod(pulse, self.beams)[1] + self.first_beam
        return ops.where(beam < self.beams, beam, beam - self.beams)

    def refract(self, phases_rad: tuple[Lanes, ...], elevation_rad: Lanes | None = None) -> tuple[Vector, Lanes]:
        """Direction behind the wedges and share of the aperture, with thick sides in these directions.

        Args:
            elevation_rad: elevation of the beam before the prisms; along the axis if left out
        """
        direction: Vector = FORWARD
        if elevation_rad is not None:
            ops = xp(elevation_rad)
            direction = ops.cos(elevation_rad), 0.0 * elevation_rad, ops.sin(elevation_rad)
        # The lens is the stop. Seen from the scene it is as wide as a beam that leaves it through the wedges.
        share: Lanes = 1.0
        for wedge, phase in zip(self.wedges, phases_rad, strict=True):
            direction, widened = wedge.bend(direction, phase)
            share = share * widened
        return direction, share

    @property
    def typical_share(self) -> Lanes:
        """The mean of the pulses: few are on the axis, and none may have the aperture of the lens without wedges."""
        return self.mean_share

    def background_share(self, pulse: Lanes) -> Lanes:
        """1: refraction trades aperture for field of view, and their product stays that of the lens."""
        return 1.0

    def phase(self, pulse: int) -> tuple[int, ...]:
        """Number of the laser, and the phases of all that turns."""
        return pulse % self.beams, *(turns.steps(pulse) for turns in self._moving)

    def at_phase(self, phase: tuple[Lanes, ...]) -> Self:
        """The scanner with this laser first, and all that turns there."""
        first_beam, *starts = phase
        mirror = self.mirror
        if mirror is not None:
            mirror = replace(mirror, turns=mirror.turns.from_start(starts.pop()))
        wedges = tuple(
            replace(wedge, turns=wedge.turns.from_start(start))
            for wedge, start in zip(self.wedges, starts, strict=True)
        )
        return replace(self, first_beam=first_beam, wedges=wedges, mirror=mirror)


class WedgeFile(Table[Wedge]):
    """One prism of a Risley scanner, the first one next to the laser."""


class TurningMirrorFile(Table[TurningMirror]):
    """The mirror behind the wedges; the axis is then upright."""


class RisleyFile(ScannerFile[Risley]):
    """[scanner] type = "risley": two or three rotating wedges, or one and more with a mirror behind them."""

    type: Literal["risley"]
    wedges: Annotated[tuple[WedgeFile, ...], Field(min_length=1, max_length=3)] = Field(
        description="as below, the first next to the laser"
    )
    mirror: TurningMirrorFile | None = Field(default=None, description="as below, behind the wedges")

    @model_validator(mode="after")
    def _scans_an_area(self) -> RisleyFile:
        if self.mirror is None and len(self.wedges) < 2:
            raise ValueError("wedges: must be 2 or 3 without a mirror, got 1")
        return self

    def build(self, context: ScannerContext) -> Risley:
        """Convert to SI units.

        Raises:
            InputError: if light does not pass the wedges at every position
        """
        scanner = self.in_si(
            rate_hz=context.rate_hz,
            wedges=tuple(wedge.in_si(rate_hz=context.rate_hz) for wedge in self.wedges),
            mirror=None if self.mirror is None else self.mirror.in_si(rate_hz=context.rate_hz),
        )
        beams: tuple[float, ...] | None = si(self.beam_elevation_deg, "deg")
        if any(self._reflects(scanner, beam) for beam in beams or (None,)):
            raise InputError("scanner: light is totally reflected in these wedges; they need a smaller angle_deg")
        return scanner

    def _reflects(self, scanner: Risley, elevation_rad: float | None) -> bool:
        """True if a beam is totally reflected; on the axis only the wedges' phases relative to each other matter."""
        # All positions of the wedges to each other, in steps of 15 degrees: the losses change slowly with the angle,
        # and are largest where all thick sides are in one plane with the beam, which these steps meet.
        phases = np.radians(np.arange(0.0, 360.0, 15.0))
        first = np.zeros(1) if elevation_rad is None else phases
        turned = np.meshgrid(first, *[phases] * (len(self.wedges) - 1), indexing="ij", sparse=True)
        start = None if elevation_rad is None else np.array(elevation_rad)
        with np.errstate(divide="ignore", invalid="ignore"):  # behind a face that reflects all
            share = np.asarray(scanner.refract(tuple(turned), start)[1])
        return not bool(np.all(share > 0.0))
