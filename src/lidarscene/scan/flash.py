"""Flash: nothing moves; one pulse of light covers the field of view and every pixel listens at once.

Each pixel counts as a pulse of the frame, at the frame's time. Its direction is where the lens images it, by one of
the usual projections; h is the pixel's distance from the axis over the focal length:

    rectilinear   h = tan t          equisolid     h = 2 sin(t / 2)      orthographic  h = sin t
    equidistant   h = t              stereographic h = 2 tan(t / 2)

Aperture: the pupil stands still, square to the axis, so a beam t off the axis sees it foreshortened, A cos t
("pupil"). A lens also gives pixels of one size different solid angles, sin t dt / (h dh) of the middle's; that counts
for the background, and for the echo too where the flash has the same radiant intensity everywhere, so that the pixel's
part of the pulse goes with its solid angle. "pupil_and_pixel" multiplies both: cos^4 t for a rectilinear lens, 1 for
an orthographic one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..maths.arrays import Lanes, Numbers, xp
from ..maths.vectors import Vector
from .base import Mechanism, in_frame

LARGEST_HEIGHT = {
    "rectilinear": 50.0,
    "equidistant": 0.5 * math.pi,
    "equisolid": math.sqrt(2.0),
    "stereographic": 2.0,
    "orthographic": 1.0,
}
"""h of a beam at 90 degrees from the axis (for a rectilinear lens, at 88.9)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Flash(Mechanism):
    """Pixels row by row from the top, each row from the left as seen from the sensor.

    pitch       of the pixels over the focal length
    projection  a key of LARGEST_HEIGHT
    falloff     "pupil" or "pupil_and_pixel": what the aperture's share holds
    frame_rate_hz  flashes per second
    """

    columns: int
    rows: int
    pitch: Lanes
    frame_rate_hz: float
    projection: str = "rectilinear"
    falloff: str = "pupil"

    @property
    def pulses(self) -> int:
        """Pixels."""
        return self.columns * self.rows

    @property
    def frame_s(self) -> float:
        """From flash to flash."""
        return 1.0 / self.frame_rate_hz

    @property
    def line_pulses(self) -> int:
        """Pixels of a row."""
        return self.columns

    def _row_and_column(self, pulse: Lanes) -> tuple[Lanes, Lanes]:
        number = xp(pulse).int32(pulse)
        line = number // self.columns
        return line % self.rows, number - line * self.columns

    def _mechanism(self, pulse: Lanes) -> tuple[Lanes, ...]:
        return ()

    def _optics(self, pulse: Lanes, turned: tuple[Lanes, ...]) -> tuple[Vector, Lanes]:
        ops = xp(pulse)
        row, column = self._row_and_column(pulse)
        left = ops.float32(self.columns - 1 - 2 * column) * (0.5 * self.pitch)
        up = ops.float32(self.rows - 1 - 2 * row) * (0.5 * self.pitch)
        cos, ratio, pixel = _projected(self.projection, left * left + up * up)
        return (cos, ratio * left, ratio * up), cos * pixel if self.falloff == "pupil_and_pixel" else cos

    def channel(self, pulse: Lanes) -> Lanes:
        """Row of each pixel, 0 at the top."""
        return self._row_and_column(pulse)[0]

    def time_s(self, pulse: Numbers) -> Numbers:
        """All pixels at once."""
        return np.asarray(in_frame(pulse, self.pulses)[0] * self.frame_s)


def _projected(projection: str, square: Lanes) -> tuple[Lanes, Lanes, Lanes]:
    """cos t, sin t / h and the pixel's solid angle over the middle's, from h^2."""
    ops = xp(square)
    if projection == "rectilinear":
        cos = 1.0 / ops.sqrt(1.0 + square)
        return cos, cos, cos * cos * cos
    if projection == "orthographic":
        cos = ops.sqrt(1.0 - square)
        return cos, 1.0, 1.0 / cos
    if projection == "equisolid":
        return 1.0 - 0.5 * square, ops.sqrt(1.0 - 0.25 * square), 1.0
    if projection == "stereographic":
        share = 1.0 / (1.0 + 0.25 * square)
        return (1.0 - 0.25 * square) * share, share, share * share
    h = ops.sqrt(square)
    ratio = ops.where(h < 1e-3, 1.0 - square * (1.0 / 6.0), ops.sin(h) / ops.maximum(h, 1e-6))
    return ops.cos(h), ratio, ratio
