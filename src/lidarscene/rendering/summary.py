"""Summary: what happened in a frame, counted while it is rendered.

Counts come chunk by chunk, so that no array of all pulses is needed for them.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..detection.outcomes import Outcome, Status
from ..maths.arrays import Numbers


@dataclass(slots=True)
class Summary:
    """What happened in a frame: pulses by outcome, points, and seconds by stage."""

    beams: int = 0
    outcomes: Numbers = field(default_factory=lambda: np.zeros(len(Outcome), dtype=np.int64))
    points: int = 0
    statuses: Numbers = field(default_factory=lambda: np.zeros(len(Status), dtype=np.int64))
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def false_alarms(self) -> int:
        """Points of noise and of other lidars."""
        return int(self.statuses[Status.FALSE_ALARM] + self.statuses[Status.INTERFERENCE])

    @property
    def weather(self) -> int:
        """Points of fog, rain and snow."""
        return int(self.statuses[Status.WEATHER])

    @property
    def hits(self) -> int:
        """Pulses that met a surface."""
        return self.beams - int(self.outcomes[Outcome.NO_SURFACE])

    @classmethod
    def total(cls, parts: Sequence[Summary]) -> Summary:
        """Of several frames."""
        whole = cls()
        for part in parts:
            whole.beams += part.beams
            whole.outcomes += part.outcomes
            whole.points += part.points
            whole.statuses += part.statuses
            for stage, seconds in part.seconds.items():
                whole.seconds[stage] = whole.seconds.get(stage, 0.0) + seconds
        return whole

    def count(self, outcome: Numbers, status: Numbers | None) -> None:
        """Add some pulses, and the points of them if there are any."""
        self.beams += len(outcome)
        self.outcomes += _counts(outcome, len(Outcome))
        if status is not None:
            self.points += len(status)
            self.statuses += _counts(status, len(Status))

    def spent(self, stage: str, since: float) -> float:
        """Add the time since ``since`` to a stage; returns now."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - since
        return now


def _counts(values: Numbers, kinds: int) -> Numbers:
    """How often each of 0 .. kinds - 1 is there; for a few kinds of many values five times as fast as a histogram."""
    others = [np.count_nonzero(values == kind) for kind in range(1, kinds)]
    return np.array([len(values) - sum(others), *others])
