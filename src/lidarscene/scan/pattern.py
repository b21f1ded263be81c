"""A user's own pattern: azimuth, elevation and time of every pulse of a frame, from a table.

Where only measured angles are known, they can be used directly. The mechanism is unknown, so A(theta_r) = A(0).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..maths.arrays import Lanes, LookupTable, Numbers, xp
from .base import Encoder, GivenAngles, Jitter, split_frame


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pattern(GivenAngles):
    """The table, in firing order; it repeats in each frame. Made by `create`."""

    pulses: int
    frame_s: float
    emission_s: Numbers
    azimuth_rad: LookupTable
    elevation_rad: LookupTable
    laser: LookupTable | None = None

    @classmethod
    def create(
        cls,
        *,
        azimuth_rad: Numbers,
        elevation_rad: Numbers,
        time_s: Numbers,
        channel: Numbers | None = None,
        frame_s: float,
        jitter_rad: Jitter = None,
        encoder_rad: Encoder = None,
    ) -> Pattern:
        """Build from columns of one length, with times rising from 0 and below ``frame_s``."""
        return cls(
            pulses=len(time_s),
            frame_s=frame_s,
            # Times stay in float64: a frame lasts 0.1 s, and float32 is good to 7 ns of that.
            emission_s=np.asarray(time_s, dtype=np.float64),
            azimuth_rad=LookupTable(np.asarray(azimuth_rad, dtype=np.float32)),
            elevation_rad=LookupTable(np.asarray(elevation_rad, dtype=np.float32)),
            laser=None if channel is None else LookupTable(np.asarray(channel, dtype=np.float32)),
            jitter_rad=jitter_rad,
            encoder_rad=encoder_rad,
        )

    def _row(self, pulse: Lanes) -> Lanes:
        ops = xp(pulse)
        return ops.divmod(ops.int32(pulse), self.pulses)[1]

    def _mechanism(self, pulse: Lanes) -> tuple[Lanes, Lanes]:
        ops, row = xp(pulse), self._row(pulse)
        return ops.take(self.azimuth_rad, row), ops.take(self.elevation_rad, row)

    def channel(self, pulse: Lanes) -> Lanes:
        """Channel from the table, or 0."""
        ops, row = xp(pulse), self._row(pulse)
        return row * 0 if self.laser is None else ops.int32(ops.take(self.laser, row))

    def time_s(self, pulse: Numbers) -> Numbers:
        """Times from the table."""
        frame, row = split_frame(pulse, self.pulses)
        return np.asarray(frame * self.frame_s + self.emission_s[row])
