"""The summary for machines: every point is an echo, a false alarm or of the weather."""

import numpy as np
import pytest

from lidarscene.detection.outcomes import Outcome, Status
from lidarscene.outputs.run_report import as_dict
from lidarscene.rendering.frame_summary import Summary


def test_points_by_what_they_are_and_beams_by_their_time() -> None:
    """Start-up and files do not count for the beams of a second: 600 in 1 + 2 + 4 + 8 s are 40."""
    summary = Summary(
        beams=600,
        points=100,
        seconds={"load": 50.0, "record": 1.0, "trace": 2.0, "collect": 4.0, "assemble": 8.0, "write": 99.0},
    )
    summary.outcomes[Outcome.NO_SURFACE] = 200
    for status, count in enumerate((60, 5, 7, 14, 0, 10, 4)):
        summary.statuses[status] = count
    content = as_dict(summary)
    assert (content["beams"], content["hits"], content["points"]) == (600, 400, 100)
    kinds = [content[name] for name in ("echoes", "false_alarms", "weather", "stray", "revived")]
    assert kinds == [60, 12, 14, 10, 4]
    assert len(Status) == 7
    assert content["beams_per_second"] == 40
    assert content["seconds"]["load"] == pytest.approx(50.0)
    assert sum(content["missed"].values()) == int(np.sum(summary.outcomes))
