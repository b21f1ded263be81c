"""Limits, the verdict on what is held to them, and the sentence and the table that say so."""

import math

import pytest

from lidarscene.studies.held import LIMITS, Held, Limits, held_table, passed, verdict


@pytest.mark.parametrize(
    ("limits", "value", "expected"),
    [
        (Limits(0.4, None), 0.5, True),
        (Limits(None, 0.4), 0.5, False),
        (Limits(-10.0, 10.0), -11.0, False),
        (Limits(-10.0, 10.0), -10.0, True),
        (Limits(-10.0, 10.0), 10.0, True),
        (Limits(None, 10.0), math.nextafter(10.0, math.inf), False),
        (Limits(1.0, None), math.inf, True),
        (Limits(None, 0.0), 0, True),
        (Limits(None, 1.0), math.nan, False),
        (Limits(None, 1.0), None, None),
        (Limits(), 1.0, None),
        (Limits(), math.nan, None),
    ],
)
def test_verdict(limits: Limits, value: float | None, expected: bool | None) -> None:
    """Ends are included, one side may be open, NaN never passes, and without value or limits there is no verdict."""
    row = Held(quantity="", value=value, limits=limits)
    assert row.verdict is expected
    assert passed([row]) is (expected is not False)


def test_limits_of_two_sided_ratios_are_inverses_and_all_have_a_source() -> None:
    for name, limits in LIMITS.items():
        assert limits.source
        assert limits.low is not None or limits.high is not None
        if " ratio" in name:
            assert limits.low is not None
            assert limits.high == pytest.approx(1.0 / limits.low)


def test_limits_move() -> None:
    assert Limits(None, 0.5).shifted(0.25) == Limits(None, 0.75)
    assert [str(limits) for limits in (Limits(0.8, 1.25), Limits(None, 0.15), Limits(0.95), Limits())] == [
        "0.8 to 1.25",
        "at most 0.15",
        "at least 0.95",
        "",
    ]


def test_the_verdict_names_the_limits_that_are_missed() -> None:
    met_limit = Held(quantity="points", value=0.01, limits=LIMITS["points"])
    unlimited = Held(quantity="signal, mean", condition="3 to 5 m", reference=3.0, simulated=4.0, value=0.3)
    missed = [
        Held(quantity="range, bias", condition="smooth surfaces", value=14.0, limits=LIMITS["range bias"], unit="mm"),
        Held(quantity="real returns kept", value=0.9, limits=LIMITS["returns kept"]),
        Held(quantity="signal", value=0.5, limits=LIMITS["signal error"]),
        Held(quantity="ground", value=0.5, limits=LIMITS["signal error"]),
    ]
    assert verdict([met_limit, met_limit, unlimited], "The twin") == "The twin meets all 2 limits."
    assert verdict([met_limit], "The fit") == "The fit meets the one limit."
    assert verdict([unlimited], "The twin") == "The twin has nothing that can be held to a limit."
    assert verdict([met_limit, unlimited, missed[0]], "The twin") == (
        "The twin meets 1 of 2 limits; it misses 'range, bias (smooth surfaces)', 14 where -10 to 10 is allowed."
    )
    sentence = verdict([met_limit, *missed], "The twin")
    assert sentence.startswith("The twin meets 1 of 5 limits; it misses 'range, bias (")
    assert sentence.endswith("; 'signal', 0.5 where at most 0.15 is allowed; 1 more.")


def test_limits_that_nothing_is_held_to_are_named_and_not_met() -> None:
    """Rationale: rows without a value were left out of the table and of the count, "10 of 17"."""
    met, scatter = (Held(quantity=name, value=0.01, limits=LIMITS["points"]) for name in ("points", "scatter"))
    unmeasured = Held(quantity="range, bias", condition="smooth surfaces", limits=LIMITS["range bias"])
    assert unmeasured.is_shown
    assert not Held(quantity="ground").is_shown
    assert Held(quantity="gap", reference=0.8).is_shown
    assert verdict([met, scatter, unmeasured], "The twin") == (
        "The twin meets all 2 limits that could be measured; not measured: 'range, bias (smooth surfaces)'."
    )
    missed = Held(quantity="ground", value=0.5, limits=LIMITS["points"])
    assert verdict([met, missed, unmeasured], "The fit").endswith(
        "allowed; not measured: 'range, bias (smooth surfaces)'."
    )
    assert verdict([unmeasured], "The fit").startswith("The fit has nothing that can be held to a limit; not measured")
    assert held_table([unmeasured])[1] == [("range, bias", "smooth surfaces", "-10 to 10", "not measured")]


def test_the_table_has_the_columns_that_say_something() -> None:
    rows = [
        Held(quantity="points", reference=1234, value=0.01, limits=LIMITS["points"]),
        Held(quantity="scatter", reference=20.0, unit="mm", note="assumed"),
    ]
    assert held_table(rows, reference="real") == (
        ["quantity", "real", "value", "limit", "", "note"],
        [("points", "1,234", "0.01", "-0.05 to 0.05", "met", ""), ("scatter [mm]", "20", "", "", "", "assumed")],
    )
