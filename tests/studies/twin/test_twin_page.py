"""The sentence that a twin's page begins with."""

from lidarscene.studies.twin.judge import TwinQuantity
from lidarscene.studies.twin.twin_page import verdict


def test_the_verdict_names_the_limits_that_are_missed() -> None:
    met = TwinQuantity(quantity="points", value=0.01, low=-0.05, high=0.05)
    told = TwinQuantity(quantity="signal, mean", condition="3 to 5 m", real=3.0, simulated=4.0, value=0.3)
    missed = [
        TwinQuantity(quantity="range, bias", condition="smooth surfaces", value=14.0, low=-10.0, high=10.0, unit="mm"),
        TwinQuantity(quantity="real returns kept", value=0.9, low=0.95),
        TwinQuantity(quantity="signal", value=0.5, high=0.15),
        TwinQuantity(quantity="ground", value=0.5, high=0.15),
    ]
    assert verdict([met, met, told]) == "The twin meets all 2 limits."
    assert verdict([told]) == "Nothing of this frame can be held to a limit."
    assert verdict([met, told, missed[0]]) == (
        "The twin meets 1 of 2 limits; it misses 'range, bias (smooth surfaces)', 14 where -10 to 10 is allowed."
    )
    assert verdict([met, *missed]).startswith("The twin meets 1 of 5 limits; it misses 'range, bias (")
    assert verdict([met, *missed]).endswith("; 'signal', 0.5 where at most 0.15 is allowed; 1 more.")


def test_a_row_without_numbers_is_left_out() -> None:
    assert not TwinQuantity(quantity="signal, mean error over the range", high=0.15).has_values
    assert TwinQuantity(quantity="share", value=0.0).has_values
    assert TwinQuantity(quantity="gap", real=0.8).has_values
