"""Summary: pulses by outcome, points by status and seconds by stage of a frame, counted while it is rendered.

Counts come chunk by chunk, so that no array of all pulses is needed for them.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..detection.outcomes import Outcome, Status
from ..maths.arrays import Numbers
from ..maths.attributes import HintedAttributes


@dataclass(slots=True)
class Summary(HintedAttributes):
    """Counts and times of one frame or several.

    Attributes:
        beams: pulses fired
        outcomes: pulses by `Outcome`
        points: points in the cloud
        statuses: points by `Status`
        seconds: name of a stage -> wall time [s]
    """

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
    def stray(self) -> int:
        """Points of stray light of other channels."""
        return int(self.statuses[Status.STRAY])

    @property
    def revived(self) -> int:
        """Points of the sun on SPADs that come back together."""
        return int(self.statuses[Status.REVIVED])

    @property
    def hits(self) -> int:
        """Pulses that met a surface."""
        return self.beams - int(self.outcomes[Outcome.NO_SURFACE])

    @classmethod
    def total(cls, parts: Sequence[Summary]) -> Summary:
        """Sum of the summaries of several frames."""
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
        """Add pulses by their `Outcome`, and their points by `Status` if there are any."""
        self.beams += len(outcome)
        self.outcomes += _counts(outcome, len(Outcome))
        if status is not None:
            self.points += len(status)
            self.statuses += _counts(status, len(Status))

    def add_time(self, stage: str, since: float) -> float:
        """Add the time since ``since`` to a stage, and return the present time (`time.perf_counter`)."""
        end = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + end - since
        return end


def _counts(values: Numbers, kinds: int) -> Numbers:
    """Count each of 0 .. kinds - 1 among the values; for a few kinds five times as fast as a histogram."""
    flags = np.zeros(len(values), dtype=bool)  # of all kinds: new memory takes longer than to compare
    counts = [np.count_nonzero(np.equal(values, kind, out=flags)) for kind in range(1, kinds)]
    return np.array([len(values) - sum(counts), *counts])
