"""What passes and what fails."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lidarscene.sensor.sensor_file import load_sensor
from lidarscene.studies import held
from lidarscene.studies.fit import recording_fit
from lidarscene.studies.fit.estimates import Solution
from lidarscene.studies.fit.fit_report import check_as_dict, law_rows
from lidarscene.studies.fit.recording_fit import RecordingFit
from lidarscene.studies.fit.scatter import Scatter


@pytest.mark.parametrize(
    ("law", "value", "passed"),
    [
        ("near_field", 0.149, True),
        ("near_field", 0.151, False),
        ("threshold", 0.099, True),
        ("threshold", 0.101, False),
        ("scatter", (0.81, 1.24), True),
        ("scatter", (0.79, 1.0), False),
        ("scatter", (1.0, 1.26), False),
    ],
)
def test_limits_of_each_law(monkeypatch: pytest.MonkeyPatch, law: str, value: Any, passed: bool) -> None:
    """15 % of the signal, a tenth of the shares, a quarter of the scatter, either way; the others are not recorded."""
    ratios = np.atleast_1d(value)
    monkeypatch.setattr(recording_fit, "scatter_mm", lambda *_, **__: 1e3)
    scatter = Scatter(
        solved=Solution(value=np.array([1.0, 0.0]), slope=np.eye(2), scores=np.zeros((4, 2))),
        fitted=np.zeros((0, 3)),
        held_out=np.array([(1.0, 1.0 / ratio, 1e9) for ratio in ratios]),
    )
    laws: Any = scatter if law == "scatter" else SimpleNamespace(error_of=lambda _: value, estimates=())
    checks = RecordingFit(**{law: laws}).checks(load_sensor("os1-128"))
    assert held.passed(checks) is passed
    assert {check.verdict for check in checks} >= {None, passed}
    assert [check_as_dict(check)["held"] for check in checks].count(False) == (not passed)


def test_of_a_recording_that_tells_nothing_nothing_fails() -> None:
    checks = RecordingFit().checks(load_sensor("os1-128"))
    assert held.passed(checks)
    assert held.verdict(checks, "The fit") == (
        "The fit has nothing that can be held to a limit; not measured: 'signal, mean error over the range', "
        "'kept and lost, mean difference', 'range, scatter'."
    )
    assert {check_as_dict(check)["found"] for check in checks} == {"not recorded, or too few smooth surfaces"}


def test_a_ratio_is_held_to_the_limits_of_the_table() -> None:
    """Rationale: limits that grew with the uncertainty of few pulses, to 0.65 and 1.53, hid misses."""
    for ratio, held_to in ((1.24, True), (1.26, False), (0.81, True), (0.79, False)):
        *_, row = law_rows(None, None, [(50.0, 1e-2 * ratio, 1e-2)], missing="")
        assert row.verdict is held_to
