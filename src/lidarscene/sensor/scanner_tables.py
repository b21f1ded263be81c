"""Scanner tables of a sensor file: shared types and options, and the models with mirrors.

Mechanisms differ, but all fire at the laser's rate and number their pulses in 31 bits.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Generic, Literal, Self, cast

from pydantic import Field, model_validator

from ..files.table_model import Number, Table, Target
from ..maths.units import si
from ..scan import Gimbal, Lissajous, MirrorPair, MirrorRaster, Scanner, Swing

Frequency = Annotated[float, Number(ge=1e-4, le=1e7)]
Phase = Annotated[float, Number("deg", ge=-36e3, le=36e3)]
Turn = Annotated[float, Field(ge=0, le=45)]


@dataclass(frozen=True, slots=True, kw_only=True)
class ScannerContext:
    """Numbers from the rest of the sensor file that a scanner needs."""

    rate_hz: float
    lens_radius_m: float
    focal_length_m: float
    folder: Path


def require_fewer(pulses: float) -> None:
    """Raise ValueError if a frame has more pulses than 31 bits can number."""
    if pulses > 2**31 - 1:
        raise ValueError(f"must have fewer than 2^31 pulses in a frame, got {pulses:.3g}")


class ScannerFile(Table[Target], Generic[Target]):
    """Base of all scanners."""

    def shot_period_us(self, pulse_period_us: float) -> float:
        """Time that one receiver can listen: until the next pulse, if one receiver serves all pulses."""
        return pulse_period_us

    def build(self, context: ScannerContext) -> Scanner:
        """Convert to SI units; mechanisms that need more than the pulse rate override this. Raises InputError."""
        return cast(Scanner, self.in_si(rate_hz=context.rate_hz))


class _MirrorsFile(ScannerFile[Target], Generic[Target]):
    """Mirrors: how they stand, and how far they turn."""

    mirrors: Literal["one", "two"] = "one"
    incidence_deg: Annotated[float, Field(ge=0, le=80)] | None = Field(
        default=None, description="of one mirror at rest: beam to normal; 45 if left out, as two always have"
    )
    side: Literal["left", "right", "above", "below"] | None = Field(
        default=None, description="from where the beam comes onto one mirror; below if left out"
    )
    outer: Literal["azimuth", "elevation"] = Field(
        default="elevation", description="axis that stands still, or that of the last of two mirrors"
    )
    mirror_radius_mm: Annotated[float, Number("mm", ge=0.05, le=1e4)] | None = Field(
        default=None, description="of one round mirror before the receiver's lens; the mirror is the stop if left out"
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


class MirrorFile(_MirrorsFile[MirrorRaster]):
    """[scanner] type = "mirror": galvanometers or MEMS, line by line."""

    type: Literal["mirror"]

    @model_validator(mode="after")
    def _not_too_many(self) -> MirrorFile:
        require_fewer(self.pulses_per_line * self.lines)
        return self

    def build(self, context: ScannerContext) -> MirrorRaster:
        """Convert to SI units; ``fast`` chooses which turn is the fast one."""
        turns = math.radians(self.azimuth_turn_deg), math.radians(self.elevation_turn_deg)
        fast, slow = turns if self.fast == "azimuth" else turns[::-1]
        return self.in_si(
            mirrors=self.mirrors_for(context), fast_turn_rad=fast, slow_turn_rad=slow, rate_hz=context.rate_hz
        )


class LissajousFile(_MirrorsFile[Lissajous]):
    """[scanner] type = "lissajous": both turns are sines."""

    type: Literal["lissajous"]
    azimuth_hz: Frequency
    elevation_hz: Frequency
    azimuth_phase_deg: Phase = 0.0
    elevation_phase_deg: Phase = 0.0

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
