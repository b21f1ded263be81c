"""A user's own pattern: azimuth, elevation and time of every pulse of a frame, from a table.

Where only measured angles are known, they can be used directly. The mechanism is unknown, so A(theta_r) = A(0).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..maths.arrays import Array, Table, xp
from .base import Encoder, GivenAngles, Jitter, Matrix, in_frame


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pattern(GivenAngles):
    """The table, in firing order; it repeats in each frame. Made by `of`."""

    pulses: int
    frame_s: float
    emission_s: Matrix
    azimuth_rad: Table
    elevation_rad: Table
    laser: Table | None = None

    @classmethod
    def of(
        cls,
        *,
        azimuth_rad: Matrix,
        elevation_rad: Matrix,
        time_s: Matrix,
        channel: Matrix | None = None,
        frame_s: float,
        jitter_rad: Jitter = None,
        encoder_rad: Encoder = None,
    ) -> Pattern:
        """From columns of one length, with times rising from 0 and below ``frame_s``."""
        return cls(
            pulses=len(time_s),
            frame_s=frame_s,
            emission_s=np.asarray(time_s, dtype=np.float64),
            azimuth_rad=Table(np.asarray(azimuth_rad, dtype=np.float32)),
            elevation_rad=Table(np.asarray(elevation_rad, dtype=np.float32)),
            laser=None if channel is None else Table(np.asarray(channel, dtype=np.float32)),
            jitter_rad=jitter_rad,
            encoder_rad=encoder_rad,
        )

    def _row(self, pulse: Array) -> Array:
        return xp(pulse).int32(pulse) % self.pulses

    def _mechanism(self, pulse: Array) -> tuple[Array, Array]:
        ops, row = xp(pulse), self._row(pulse)
        return ops.take(self.azimuth_rad, row), ops.take(self.elevation_rad, row)

    def channel(self, pulse: Array) -> Array:
        """Channel from the table, or 0."""
        ops, row = xp(pulse), self._row(pulse)
        return row * 0 if self.laser is None else ops.int32(ops.take(self.laser, row))

    def time_s(self, pulse: Matrix) -> Matrix:
        """Times from the table."""
        frame, row = in_frame(pulse, self.pulses)
        return np.asarray(frame * self.frame_s + self.emission_s[row])
