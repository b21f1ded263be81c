"""Base of the scanner tables of a sensor file, in the units that people write.

Mechanisms differ, but all fire at the laser's rate and number their pulses in 31 bits. What can be wrong about one
depends on others of its numbers (a facet that turns away from the beam, a laser that fires after its cycle). Each table
refuses such mistakes by key, before anything is traced.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Generic, cast

from ..files.table_model import Table, Target
from .base import Scanner


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

    @property
    def firing_rate_hz(self) -> float | None:
        """Pulse rate that follows from the table; None: the laser's."""
        return None

    @property
    def files(self) -> tuple[str, ...]:
        """Files that the table names, beside the sensor's."""
        return ()

    @property
    def turn_rate_rad_s(self) -> float:
        """Rate at which lasers and receivers turn together while a point's shots are summed; 0: they stand still."""
        return 0.0

    def shot_period_us(self, pulse_period_us: float) -> float:
        """Time that one receiver can listen: until the next pulse, if one receiver serves all pulses."""
        return pulse_period_us

    def build(self, context: ScannerContext) -> Scanner:
        """Convert to SI units; mechanisms that need more than the pulse rate override this.

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        return cast(Scanner, self.in_si(rate_hz=context.rate_hz))
