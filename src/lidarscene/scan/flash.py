"""Flash: nothing moves; one pulse of light covers the field of view and all pixels listen at once.

Each pixel counts as a pulse of the frame, at the frame's time. A sensor that lights some rows after the others has
such a time for each group of rows. A pixel's direction follows from the lens's projection, with
h the pixel's distance from the axis over the focal length:

    rectilinear   h = tan t          equisolid     h = 2 sin(t / 2)      orthographic  h = sin t
    equidistant   h = t              stereographic h = 2 tan(t / 2)

Aperture: the pupil is fixed and perpendicular to the axis, so a beam at an angle t sees A cos t ("pupil"). A lens
also gives pixels of one size different solid angles, sin t dt / (h dh) relative to the middle. That changes the
background; it changes the echo too if the flash has the same radiant intensity everywhere, so that the pixel's part
of the pulse goes with its solid angle. "pupil_and_pixel" multiplies both: cos^4 t for a rectilinear lens, 1 for an
orthographic one.

Symbols: t angle from the axis, h image height over focal length.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field, model_validator

from ..errors import InputError
from ..files.table_model import Number
from ..maths.arrays import Lanes, xp
from ..maths.units import FileKey, Quantity, si
from ..maths.vectors import Vector
from .base import LineByLine
from .clock import PulseClock
from .scanner_file import ScannerContext, ScannerFile

LARGEST_HEIGHT = {
    "rectilinear": 50.0,
    "equidistant": 0.5 * math.pi,
    "equisolid": math.sqrt(2.0),
    "stereographic": 2.0,
    "orthographic": 1.0,
}
"""Source: the lens's projection; h at 90 degrees from the axis (for a rectilinear lens, at 88.9)."""


Count = Annotated[int, Quantity(ge=1, le=2**24, about="pixels")]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Flash(LineByLine):
    """Pixels row by row from the first row, each row from the left as seen from the sensor.

    Attributes:
        pitch: pitch of the pixels over the focal length
        projection: a key of LARGEST_HEIGHT
        frame_rate_hz: frames per second
        rows_at_once: rows that one flash lights; None: all
    """

    columns: Count
    rows: Count
    pitch: Lanes
    frame_rate_hz: float
    projection: Annotated[
        Literal["rectilinear", "equidistant", "equisolid", "stereographic", "orthographic"], FileKey()
    ] = "rectilinear"
    falloff: Annotated[
        Literal["pupil", "pupil_and_pixel"], FileKey(about='`"pupil"` or `"pupil_and_pixel"`; see docs/scanners.md')
    ] = "pupil"
    rows_at_once: Annotated[
        int | None, Quantity(ge=1, le=2**24, about="rows that light up together; all if left out")
    ] = None
    row_step_s: Annotated[
        float, Quantity("us", ge=0, le=1e7, finest=1e-2, about="from one group of rows to the next, with rows_at_once")
    ] = 0.0
    first_row: Annotated[Literal["top", "bottom"], FileKey(about="where a frame begins")] = "top"

    @property
    def frame_s(self) -> float:
        """Time from flash to flash."""
        return 1.0 / self.frame_rate_hz

    def _row_and_column(self, pulse: Lanes) -> tuple[Lanes, Lanes]:
        row, column = LineByLine._row_and_column(self, pulse)
        return row if self.first_row == "top" else self.rows - 1 - row, column

    def _mechanism(self, pulse: Lanes) -> tuple[Lanes, ...]:
        return ()

    def _optics(self, pulse: Lanes, turned: tuple[Lanes, ...]) -> tuple[Vector, Lanes]:
        ops = xp(pulse)
        row, column = self._row_and_column(pulse)
        # Twice the offset is a whole number, so the middle pixel looks exactly ahead.
        left = ops.float32(self.columns - 1 - 2 * column) * (0.5 * self.pitch)
        up = ops.float32(self.rows - 1 - 2 * row) * (0.5 * self.pitch)
        cos, ratio, pixel = _project(self.projection, left * left + up * up)
        return (cos, ratio * left, ratio * up), cos * pixel if self.falloff == "pupil_and_pixel" else cos

    @property
    def clock(self) -> PulseClock:
        """The time of the flash, for all pixels of its rows."""
        flash = self.columns * (self.rows_at_once or self.rows)
        return PulseClock(levels=((self.pulses, self.frame_s), (flash, self.row_step_s)))


def _project(projection: str, square: Lanes) -> tuple[Lanes, Lanes, Lanes]:
    """cos t, sin t / h, and the pixel's solid angle relative to the middle's, from h^2."""
    ops = xp(square)
    if projection == "rectilinear":
        cos = 1.0 / ops.sqrt(1.0 + square)
        return cos, cos, cos * cos * cos
    if projection == "orthographic":
        cos = ops.sqrt(1.0 - square)
        return cos, 1.0, 1.0 / cos
    # h = 2 sin(t / 2): cos t = 1 - h^2 / 2, and every pixel has the same solid angle.
    if projection == "equisolid":
        return 1.0 - 0.5 * square, ops.sqrt(1.0 - 0.25 * square), 1.0
    # h = 2 tan(t / 2): half-angle formulas give cos t and sin t / h without a square root.
    if projection == "stereographic":
        share = 1.0 / (1.0 + 0.25 * square)
        return (1.0 - 0.25 * square) * share, share, share * share
    # Equidistant, t = h: sin(h) / h from its series near the axis, where the quotient is 0 / 0.
    h = ops.sqrt(square)
    ratio = ops.where(h < 1e-3, 1.0 - square * (1.0 / 6.0), ops.sin(h) / ops.maximum(h, 1e-6))
    return ops.cos(h), ratio, ratio


class FlashFile(ScannerFile[Flash]):
    """[scanner] type = "flash": all pixels at once; the laser's rate is that of the flashes."""

    type: Literal["flash"]
    pixel_pitch_um: Annotated[float, Number("um", ge=0.01, le=1e4)] = Field(description="from pixel to pixel")

    @model_validator(mode="after")
    def _flashes_fit(self) -> FlashFile:
        if self.row_step_us > 0.0 and self.rows_at_once is None:
            raise ValueError("row_step_us: needs rows_at_once")
        return self

    @model_validator(mode="after")
    def _nothing_turns(self) -> FlashFile:
        if self.encoder_step_deg is not None:
            raise ValueError("encoder_step_deg: nothing turns in a flash")
        if self.columns * self.rows > 2**31 - 1:
            raise ValueError(f"must have fewer than 2^31 pixels, got {self.columns * self.rows:.3g}")
        return self

    def build(self, context: ScannerContext) -> Flash:
        """Convert to SI units, the pitch over the focal length.

        Raises:
            InputError: for pixels that the lens misses
        """
        pitch = si(self.pixel_pitch_um, "um") / context.focal_length_m
        height = 0.5 * pitch * math.hypot(self.columns - 1, self.rows - 1)
        if height >= LARGEST_HEIGHT[self.projection]:
            raise InputError(
                f"scanner: pixels must be < {LARGEST_HEIGHT[self.projection]:.3g} focal lengths off the axis of"
                f" a lens that is {self.projection}, got {height:.3g}"
            )
        groups = math.ceil(self.rows / (self.rows_at_once or self.rows))
        if (groups - 1) * si(self.row_step_us, "us") * context.rate_hz >= 1.0:
            raise InputError(
                f"scanner.row_step_us: {groups} groups of rows must fit into a frame of {1e6 / context.rate_hz:g} us,"
                f" got {self.row_step_us:g}"
            )
        return self.in_si(pitch=pitch, frame_rate_hz=context.rate_hz)
