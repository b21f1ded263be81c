"""What every scanner can do."""

from __future__ import annotations

from typing import Protocol

from ..arrays import Array


class Scanner(Protocol):
    """Pulse numbers 0 .. pulses - 1 of one frame, in firing order, to directions in the sensor's frame."""

    @property
    def pulses(self) -> int:
        """Pulses in one frame."""

    def angles(self, pulse: Array) -> tuple[Array, Array]:
        """Azimuth and elevation [rad] of each pulse; numpy or Dr.Jit, like ``pulse`` (32-bit unsigned)."""

    def channel(self, pulse: Array) -> Array:
        """Channel (row, laser, ring) of each pulse."""
