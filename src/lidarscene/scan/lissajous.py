"""Resonant Lissajous scanner: both turns are sines, of one mirror or of two.

a(t) = A sin(2 pi f_a t + phi_a) in azimuth and e(t) = E sin(2 pi f_e t + phi_e) in elevation, both mechanical.
Reflection and aperture are in `scan.mirror_optics`. The pattern repeats after 1 / gcd(f_a, f_e); a frame of that
length repeats, any other one continues where the last ended.

Symbols: f frequency, phi phase, A and E amplitudes, zero to peak.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Literal, Self

from pydantic import Field

from ..files.table_model import Number
from ..maths.arrays import Lanes, xp
from ..maths.units import Quantity
from ..maths.vectors import Vector
from .base import Encoder, Jitter, SteadyPulses
from .mirror_optics import Mirrors, MirrorsFile
from .scanner_file import ScannerContext
from .turns import Turns


@dataclass(frozen=True, slots=True, kw_only=True)
class Swing:
    """One turn of a mirror: its frequency, its phase and its mechanical amplitude, zero to peak."""

    frequency_hz: float
    phase_rad: float
    turn_rad: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lissajous(SteadyPulses):
    """Pulses at a constant rate; ``pulses`` of them are a frame. Made by `create`.

    Attributes:
        azimuth_turn_rad: mechanical amplitudes, zero to peak
        elevation_turn_rad: mechanical amplitudes, zero to peak
    """

    mirrors: Mirrors
    azimuth: Turns
    elevation: Turns
    azimuth_turn_rad: Lanes
    elevation_turn_rad: Lanes

    @classmethod
    def create(
        cls,
        *,
        rate_hz: float,
        frame_hz: Annotated[float, Quantity(ge=1e-4, le=1e6, about="frames per second")],
        mirrors: Mirrors,
        azimuth: Swing,
        elevation: Swing,
        jitter_rad: Jitter = None,
        encoder_rad: Encoder = None,
    ) -> Lissajous:
        """Build from the swings on both axes."""
        # Phases as exact fractions of a turn from pulse to pulse, so that they do not drift over hours (`turns`).
        turns = [
            Turns.per_pulse(frequency_hz=swing.frequency_hz, rate_hz=rate_hz, start_rad=swing.phase_rad)
            for swing in (azimuth, elevation)
        ]
        return cls(
            pulses=max(1, round(rate_hz / frame_hz)),
            rate_hz=rate_hz,
            mirrors=mirrors,
            azimuth=turns[0],
            elevation=turns[1],
            azimuth_turn_rad=azimuth.turn_rad,
            elevation_turn_rad=elevation.turn_rad,
            jitter_rad=jitter_rad,
            encoder_rad=encoder_rad,
        )

    def _mechanism(self, pulse: Lanes) -> tuple[Lanes, Lanes]:
        ops = xp(pulse)
        return (
            self.azimuth_turn_rad * ops.sin(self.azimuth.angle_rad(pulse)),
            self.elevation_turn_rad * ops.sin(self.elevation.angle_rad(pulse)),
        )

    def _optics(self, pulse: Lanes, turned: tuple[Lanes, ...]) -> tuple[Vector, Lanes]:
        return self.mirrors.beam(turned[0], turned[1])

    def phase(self, pulse: int) -> tuple[int, ...]:
        """Those of the two turns."""
        return self.azimuth.steps(pulse), self.elevation.steps(pulse)

    def at_phase(self, phase: tuple[Lanes, ...]) -> Self:
        """The scanner with the mirrors there."""
        azimuth, elevation = phase
        return replace(self, azimuth=self.azimuth.from_start(azimuth), elevation=self.elevation.from_start(elevation))


Frequency = Annotated[float, Number(ge=1e-4, le=1e7)]
Phase = Annotated[float, Number("deg", ge=-36e3, le=36e3)]


class LissajousFile(MirrorsFile[Lissajous]):
    """[scanner] type = "lissajous": both turns are sines."""

    type: Literal["lissajous"]
    azimuth_hz: Frequency = Field(description="frequency")
    elevation_hz: Frequency = Field(description="frequency")
    azimuth_phase_deg: Phase = Field(default=0.0, description="of the sine at the start")
    elevation_phase_deg: Phase = Field(default=0.0, description="of the sine at the start")

    def build(self, context: ScannerContext) -> Lissajous:
        """Convert to SI units; the keys of the two axes give one `Swing` each."""
        return self.in_si(
            rate_hz=context.rate_hz,
            mirrors=self.mirrors_for(context),
            azimuth=self._swing("azimuth"),
            elevation=self._swing("elevation"),
        )

    def _swing(self, axis: str) -> Swing:
        hertz, phase_deg, turn_deg = (getattr(self, f"{axis}_{key}") for key in ("hz", "phase_deg", "turn_deg"))
        return Swing(frequency_hz=hertz, phase_rad=math.radians(phase_deg), turn_rad=math.radians(turn_deg))
