"""Emission times of pulses: a number is split into frames, lines and pulses of a line, and the times of these add up.

Times need double precision, which holds 0.1 s to 1e-17 s, and single precision to 7 ns. The same lines run on NumPy and
on the device, with the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..maths.arrays import Lanes, xp


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PulseClock:
    """Emission times of a scanner. On the device its numbers are in double precision.

    Attributes:
        levels: pulses of each frame or line, the longest first, and the time from one to the next [s]; those of the
            first level are counted on without end
        rate_hz: rate of the pulses within the last level; None: as ``times_s`` says
        times_s: time of each pulse within the last level [s]; None: as ``rate_hz`` says, all at once without either
    """

    levels: tuple[tuple[Any, Any], ...] = ()
    rate_hz: Lanes | None = None
    times_s: Lanes | None = None

    def time_s(self, pulse: Lanes, *, earlier: Lanes | None = None) -> Lanes:
        """(n,) float64 times of pulses [s], a new array.

        Args:
            pulse: (n,) whole numbers
            earlier: what `before` says of pulse 0; None: it is the first of all
        """
        ops = xp(pulse)
        number, before = pulse, earlier
        time_s: Lanes = 0.0
        for pulses, step_s in self.levels:
            whole, number = ops.divmod(number, pulses)
            count = ops.float64(whole) if before is None else ops.float64(whole) + before
            time_s, before = time_s + ops.product(count, step_s), None
        if self.times_s is not None:
            return time_s + ops.take(self.times_s, number)
        if self.rate_hz is None:
            return time_s
        count = ops.float64(number) if before is None else ops.float64(number) + before
        return time_s + count / self.rate_hz

    def before(self, pulse: int) -> float:
        """Frames or lines of the first level before this pulse, the first of a frame; without levels, pulses."""
        return float(pulse // int(self.levels[0][0]) if self.levels else pulse)
