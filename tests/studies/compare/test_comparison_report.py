"""Verdicts in words, on numbers made by hand."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
from helpers.clouds import small_cloud

from lidarscene.detection.outcomes import Status
from lidarscene.studies.compare.comparison_report import (
    Comparison,
    crossing_lines,
    fate_table,
    group_table,
    sweep_table,
    verdict,
)
from lidarscene.studies.compare.comparison_statistics import DetectionRate
from lidarscene.studies.compare.illuminance_sweep import IlluminanceStep, IlluminanceSweep, RateCrossing
from lidarscene.studies.compare.observations import Observation, Surfaces

PULSES = 400


def observation(name: str, hits: Any, *, sigma_mm: float = 10.0, dark: int = 0) -> Observation:
    """One that found these of its pulses; its ranges are so much too long and too short in turn."""
    mask = np.isin(np.arange(PULSES), hits)
    true_m = np.full(20, 50.0, np.float32)
    error_m = 1e-3 * sigma_mm * np.where(np.arange(20) % 2 == 0, 1.0, -1.0)
    cloud = small_cloud(
        n=20,
        range_m=(true_m + error_m).astype(np.float32),
        true_range_m=true_m,
        status=np.full(20, Status.ECHO, np.uint8),
        body_names=("left", "right"),
    )
    surfaces = Surfaces(
        pulse=np.arange(PULSES),
        detected=mask,
        snr=np.where(np.arange(PULSES) < dark, 0.0, 5.0),
        true_range_m=np.full(PULSES, 50.0),
        incidence_angle_rad=np.zeros(PULSES),
        reflectivity=np.full(PULSES, 0.1),
        body=(np.arange(PULSES) >= PULSES // 2).astype(int),
        class_id=np.zeros(PULSES, int),
    )
    losses = {"below threshold": int((~mask).sum()), "out of window": 0, "hidden": 0}
    return Observation(name=name, cloud=cloud, surfaces=surfaces, pulses_fired=PULSES, losses=losses)


def comparison(*observed: Observation, matched: bool = True) -> Comparison:
    from lidarscene.studies.compare.observations import groupings

    return Comparison(
        title="t",
        observations=observed,
        sensors=(None,) * len(observed),
        groups=groupings(observed),
        matched=matched,
        population="the pulses",
        notes=(),
    )


def first_pulses(count: int) -> range:
    return range(count)


def test_who_finds_more_and_who_measures_finer() -> None:
    """Whatever the order in which they are given."""
    weak, strong = (
        observation("weak", first_pulses(200), sigma_mm=10.0),
        observation("strong", first_pulses(300), sigma_mm=30.0),
    )
    for pair in ((weak, strong), (strong, weak)):
        sentence = verdict(comparison(*pair))
        assert sentence.startswith(
            "strong detects most, 75.00 % of the pulses, 25 percentage points more; weak 50.00 %."
        )
        assert "Ranges scatter least with weak: 10.3 mm against 30.8 mm of strong." in sentence  # sqrt(20 / 19)


def test_equal_scatter_has_no_least() -> None:
    pair = (observation(name, first_pulses(200), sigma_mm=10.0) for name in ("a", "b"))
    assert verdict(comparison(*pair)).endswith(". Ranges scatter by 10.3 mm with each.")


def test_matched_pulses_tell_apart_what_two_rates_do_not() -> None:
    """20 of 400 more, none less: 5 +- 2.2 % pulse by pulse. As two shares of 400 each is sure to 5 %."""
    a, b = observation("a", first_pulses(200)), observation("b", first_pulses(220))
    assert "b detects most" in verdict(comparison(a, b))


def test_shares_of_different_pulses_are_not_subtracted() -> None:
    """Each has its own interval (Wilson): half of 400 is 45.12 to 54.88 %; the sentence calls none better."""
    a, b = observation("a", first_pulses(200)), observation("b", first_pulses(400))
    for pair in ((a, b), (b, a)):
        sentence = verdict(comparison(*pair, matched=False))
        assert sentence.startswith("The sensors fire different pulses, so they cannot be ranked.")
        assert "a 50.00 % (45.12 to 54.88 %)" in sentence
        assert "b 100.00 % (" in sentence
        assert "percentage points" not in sentence


def test_the_same_number_of_other_pulses_is_alike() -> None:
    sentence = verdict(comparison(observation("a", first_pulses(200)), observation("b", range(200, 400))))
    assert "a and b detect equally many of the pulses, within chance" in sentence


def test_pulses_without_light_and_bodies_that_differ_most() -> None:
    """A loses, of 200 pulses on each body, 10 on the left one, B 60 on the right one."""
    a, b = observation("a", range(10, 400), dark=7), observation("b", [*range(200), *range(260, 400)])
    header, rows = fate_table(comparison(a, b))
    assert [row[header.index("of these without any light")] for row in rows] == ["7", "0"]
    _, rows = group_table(comparison(a, b), "body", most=1)
    assert [row[0] for row in rows] == ["right"]
    assert rows[0][-2:] == ["60", "0"]


def test_a_body_that_one_sensor_alone_meets_has_its_row() -> None:
    """B's beams pass the right one by."""
    a, b = observation("a", range(100, 300)), observation("b", first_pulses(50))
    assert b.surfaces is not None
    left = {
        each.name: values[:200] for each in fields(Surfaces) if (values := getattr(b.surfaces, each.name)) is not None
    }
    _, rows = group_table(comparison(a, replace(b, surfaces=Surfaces(**left)), matched=False), "body")
    assert [row[:2] for row in rows] == [["left", "200"], ["right", "200"]]
    assert [row[2].split()[0] for row in rows] == ["50.00", "50.00"]
    assert [row[3].split()[0] for row in rows] == ["25.00", "-"]


def test_crossings_and_the_sweep_in_words() -> None:
    def lit(klux: float, share: int) -> IlluminanceStep:
        return IlluminanceStep(
            illuminance_klux=klux,
            rate=DetectionRate(group="all", surfaces=100, found=share, expected=0.01 * share),
            false_alarms=0,
            sigma_m=0.012,
        )

    swept = IlluminanceSweep(
        illuminances_klux=(1.0, 50.0),
        courses={"a": [lit(1.0, 60), lit(50.0, 50)], "b": [lit(1.0, 80), lit(50.0, 20)]},
        crossings={"b": [RateCrossing(illuminance_klux=7.0, expected=0.55, ahead_below="b", ahead_above="a")]},
        on_plane_klux={"b": 3.2},
    )
    crossed, plane = crossing_lines(swept, "a")
    assert crossed == "a overtakes b at 7 klux, where both are expected to detect 55.00 %."
    assert plane.endswith("a and b have the same range, at P_d 0.9, at 3.2 klux.")
    _, rows = sweep_table(swept)
    assert rows[1] == ["50 klux", "50.00 %", "50.00 %", "0", "12.0 mm", "20.00 %", "20.00 %", "0", "12.0 mm"]
