"""Mirror raster (galvanometers, MEMS): lines by a fast turn, one below the other by a slow one.

The grid is even in the mirror's own angles; reflection and aperture are in `scan.mirror_optics`. Lines are fired at a
constant rate; between them the mirror flies back or turns round, and no pulse leaves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import model_validator

from ..maths.arrays import Lanes, Numbers, xp
from ..maths.units import FileKey, Quantity
from ..maths.vectors import Vector
from .base import LineByLine
from .clock import PulseClock
from .mirror_optics import Mirrors, MirrorsFile
from .scanner_file import ScannerContext, require_fewer


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MirrorRaster(LineByLine):
    """A frame of ``rows`` lines of ``columns`` pulses, from the top, the first from the left.

    Attributes:
        fast_turn_rad: mechanical amplitudes, zero to peak
        slow_turn_rad: mechanical amplitudes, zero to peak
        fast: "azimuth" or "elevation": the turn that scans a line; with "elevation" lines are vertical, from the left
        waveform: course of the fast turn: "sawtooth" (every line in one direction) or "triangle" (to and fro), both
            with even steps and both ends included; "sine" (to and fro, resonant), with pulses at even times
        slow: "step" (at rest during a line) or "ramp" (moves on during a line)
        line_duty: part of the time in which pulses leave, in a line; a sine's pulses are those around its middle, so a
            smaller duty uses less of its amplitude
        frame_duty: the same in a frame
    """

    columns: Annotated[int, Quantity(name="pulses_per_line", ge=1, le=2**24, about="columns")]
    rows: Annotated[int, Quantity(name="lines", ge=1, le=2**24, about="rows")]
    mirrors: Mirrors
    fast_turn_rad: Lanes
    slow_turn_rad: Lanes
    rate_hz: float
    fast: Annotated[Literal["azimuth", "elevation"], FileKey(about="the turn that scans a line")] = "azimuth"
    waveform: Annotated[Literal["sawtooth", "triangle", "sine"], FileKey(about="of the fast turn")] = "sawtooth"
    slow: Annotated[Literal["step", "ramp"], FileKey(about="the other turn, from line to line")] = "step"
    line_duty: Annotated[Lanes, Quantity(gt=0, le=1, about="part of a line's time in which pulses leave")] = 1.0
    frame_duty: Annotated[Lanes, Quantity(gt=0, le=1, about="part of a frame's time in which lines are scanned")] = 1.0

    @property
    def line_s(self) -> float:
        """Time from line to line."""
        return float(self.columns / (self.rate_hz * self.line_duty))

    @property
    def frame_s(self) -> float:
        """Length of a frame, fly-back included."""
        return float(self.rows * self.line_s / self.frame_duty)

    def _mechanism(self, pulse: Lanes) -> tuple[Lanes, Lanes]:
        ops = xp(pulse)
        row, column = self._row_and_column(pulse)
        if self.waveform == "sine":
            # Pulses at even times around the middle of the swing: a duty below 1 leaves the ends of the sine dark.
            middle = (ops.float32(2 * column + 1) / ops.float32(2 * self.columns) - 0.5) * self.line_duty
            fast: Lanes = -ops.sin(math.pi * middle)
        else:
            fast = _even_steps(column, self.columns)
        # To and fro: every second line runs backwards.
        if self.waveform != "sawtooth":
            fast = ops.where(row % 2 == 0, fast, -fast)
        if self.slow == "ramp":
            # The slow mirror moves on during a line, so lines are slanted by one line's step.
            within = ops.float32(column) / ops.float32(self.columns) * self.line_duty
            slow: Lanes = 1.0 - 2.0 * (ops.float32(row) + within) / ops.float32(self.rows)
        else:
            slow = _even_steps(row, self.rows)
        fast, slow = fast * self.fast_turn_rad, slow * self.slow_turn_rad
        return (fast, slow) if self.fast == "azimuth" else (slow, fast)

    def _optics(self, pulse: Lanes, turned: tuple[Lanes, ...]) -> tuple[Vector, Lanes]:
        return self.mirrors.beam(turned[0], turned[1])

    @property
    def channel_elevation_rad(self) -> Numbers | None:
        """Elevation of each line in its middle; None of upright lines."""
        return self._row_elevations() if self.fast == "azimuth" else None

    @property
    def clock(self) -> PulseClock:
        """Pulses of a line at the pulse rate; lines and frames after their pauses."""
        return PulseClock(levels=((self.pulses, self.frame_s), (self.columns, self.line_s)), rate_hz=self.rate_hz)


def _even_steps(number: Lanes, count: Lanes) -> Lanes:
    """1 to -1 in even steps, 0 for a single one. Twice the offset is a whole number, so the middle is exactly 0."""
    ops = xp(number, count)
    steps = ops.float32(count) - 1.0
    return ops.float32(count - 1 - 2 * number) / ops.maximum(steps, 1.0)


class MirrorFile(MirrorsFile[MirrorRaster]):
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
