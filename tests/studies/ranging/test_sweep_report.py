"""Sentences about curves, on curves made by hand."""

import numpy as np
import pytest

from lidarscene import load_sensor
from lidarscene.studies.ranging.curves import CurveCrossing, Curves, Question, SweepCurve
from lidarscene.studies.ranging.plane import RangeStatus, Target
from lidarscene.studies.ranging.sweep_axes import condition_axis
from lidarscene.studies.ranging.sweep_report import air_text, as_dict, chart_of, notes, table_text, window_note

SENSOR = load_sensor("table1-apd")


def curves(key: str, quantity: str, **changed: object) -> Curves:
    axis = condition_axis(key, start=1.0, stop=100.0, count=3, log=True)
    names = {"curves": tuple(SweepCurve(name=name, values=np.array([3.0, 2.0, 1.0])) for name in ("a", "b"))}
    return Curves(
        **{"question": Question(quantity=quantity, axis=axis), "crossings": (), "detection_limits": ()}
        | names
        | changed
    )


@pytest.mark.parametrize(("falls", "verb"), [(True, "falls below"), (False, "rises above")])
def test_who_passes_whom(falls: bool, verb: str) -> None:
    swept = curves(
        "illuminance_klux", "snr", crossings=(CurveCrossing(first="a", second="b", place=7.0, value=2.5, falls=falls),)
    )
    (line, *_) = notes(swept, {"a": SENSOR, "b": SENSOR})
    assert line == f"crossing at 7 klux: a {verb} b, SNR 2.5"


@pytest.mark.parametrize(("falls", "verb"), [(True, "falls to"), (False, "rises to")])
def test_where_a_sensor_passes_its_threshold(falls: bool, verb: str) -> None:
    limit = CurveCrossing(first="a", second="", place=7.0, value=5.0, falls=falls)
    swept = curves("illuminance_klux", "snr", detection_limits=(limit,))
    (line, *_) = notes(swept, {"a": SENSOR, "b": SENSOR})
    assert line == f"a: {verb} P_d 0.9 at 7 klux, where SNR 5"
    found = {name: entry["detection_limits"] for name, entry in as_dict(swept)["sensors"].items()}
    assert found == {"a": [{"at": 7.0, "value": 5.0, "falls": falls}], "b": []}
    (line, *_) = notes(curves("distance", "snr", detection_limits=(limit,)), {"a": SENSOR, "b": SENSOR})
    assert line.startswith("a: range 7 m at P_d 0.9, where SNR 5") is falls


def test_a_window_that_ends_before_what_is_seen() -> None:
    """4 us are 599.58 m. An Ouster's next shot leaves a period later: light from beyond half of c times it folds."""
    assert window_note("a", SENSOR, farthest_m=599.5, limit_text="it") is None
    assert window_note("a", SENSOR, farthest_m=599.7, limit_text="it") == "a: its window ends at 599.6 m, before it"
    ouster = load_sensor("os1-128")
    assert ouster.histogram is not None
    folds_m = 0.5 * 299_792_458.0 * float(ouster.histogram.period_s)
    line = window_note("o", ouster, farthest_m=1e4, limit_text="it")
    assert line is not None
    assert line.endswith(f"; echoes from beyond {folds_m:.1f} m are reported too near by that range")


def test_the_air_in_words_and_ranges_that_are_none() -> None:
    assert air_text(Target(transmittance=1.0), 1500.0) == "visibility 1.5 km"
    assert air_text(Target(extinction_per_m=0.002), None) == "extinction 0.002 per metre"
    status = np.array([RangeStatus.NO_LIMIT, RangeStatus.FOUND, RangeStatus.NEVER_DETECTED])
    swept = curves(
        "illuminance_klux", "range", curves=(SweepCurve(name="a", values=np.array([np.inf, 70.0, 0.0]), status=status),)
    )
    assert [line.split("  ")[-1].strip() for line in table_text(swept).splitlines()] == ["a", "no limit", "70", "never"]


def test_what_is_nothing_is_not_drawn_on_a_logarithm() -> None:
    chart = chart_of(
        curves("illuminance_klux", "snr", curves=(SweepCurve(name="a", values=np.array([3.0, 0.0, 2.0])),)),
        "t",
        "words",
        thresholds={"a": 5.0},
    )
    np.testing.assert_array_equal(chart.lines[0].y, [3.0, np.nan, 2.0])
    assert chart.y_log
    assert [level.y for level in chart.levels] == [5.0]
