"""Counts of frames: what adds up to what."""

import numpy as np

from lidarscene.detection.outcomes import Outcome, Status
from lidarscene.rendering.frame_summary import Summary


def test_counts_of_points_and_pulses() -> None:
    """Noise and other lidars are false alarms; what met no surface is no hit; frames add up."""
    outcome = np.repeat(
        [Outcome.NO_SURFACE, *(outcome_code for outcome_code in Outcome if outcome_code != Outcome.NO_SURFACE)], 2
    ).astype(np.uint8)
    status = np.repeat(np.array(list(Status), np.uint8), 1 + np.arange(len(Status)))
    single, two = Summary(), Summary(seconds={"trace": 1.5, "write": 1.0})
    single.count(outcome, status)
    two.count(outcome[:5], None)
    two.seconds["trace"] += 0.5
    assert (single.beams, single.hits, single.points) == (len(outcome), len(outcome) - 2, len(status))
    assert single.false_alarms == (1 + Status.FALSE_ALARM) + (1 + Status.INTERFERENCE)
    assert single.weather == 1 + Status.WEATHER
    total = Summary.total([single, two, single])
    assert (total.beams, total.hits, total.points) == (2 * len(outcome) + 5, 2 * len(outcome) - 1, 2 * len(status))
    assert total.seconds == {"trace": 2.0, "write": 1.0}
