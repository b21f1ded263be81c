"""Eye safety of whole sensors: what enters a still eye, which criterion limits, and what the report says."""

import json
import math
import re
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from helpers import photons
from helpers.documentation import ROOT
from helpers.mistakes import calls
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarscene.catalog import names
from lidarscene.sensor.sensor_file import load_sensor, sensor_from_tables
from lidarscene.sensor.sensor_model import Sensor
from lidarscene.studies.eye_safety import exposure
from lidarscene.studies.eye_safety.criteria import ViewerCheck, geometry, margin_of
from lidarscene.studies.eye_safety.exposure import PulseTrain, counted_train, scanned_train, stationary_train
from lidarscene.studies.eye_safety.eye_safety_report import (
    EyeSafetyReport,
    both_reports,
    eye_safety_report,
    not_known,
    report_text,
)

TABLE_1 = load_sensor("table1-apd")
PULSE_J = 45 * 6e-9 * math.sqrt(math.pi / (4 * math.log(2)))  # 287.4 nJ
C4 = 10**0.41


def with_laser(**changes: float) -> Sensor:
    return replace(TABLE_1, laser=replace(TABLE_1.laser, **changes))


def margins(report: EyeSafetyReport, viewer: str = "eye") -> dict[str, float]:
    return {c.quantity: margin_of(c) for c in report.criteria if c.subject == viewer}


def test_table_1_standing_still() -> None:
    """Computed by hand: 7.7e-8 C4 J, 3.9e-4 C4 W, and C5 = 0.4 for 5e5 pulses in 10 s, all of the beam in the pupil."""
    report = eye_safety_report(TABLE_1)
    assert report.pulse_energy_j == pytest.approx(PULSE_J)
    margins_by_name = margins(report)
    assert margins_by_name["single pulse"] == pytest.approx(7.7e-8 * C4 / PULSE_J, rel=1e-9)
    assert margins_by_name["average power"] == pytest.approx(3.9e-4 * C4 / (PULSE_J * 50e3), rel=1e-9)
    assert margins_by_name["pulse train"] == pytest.approx(0.4 * 7.7e-8 * C4 / PULSE_J, rel=1e-9)
    assert margins_by_name["pulse group"] == pytest.approx(7e-4 * C4 * 10**0.75 / (PULSE_J * 5e5), rel=1e-4)
    assert (report.limiting.quantity, report.is_class_1) == ("average power", False)
    assert report.class_1_peak_power_w == pytest.approx(3.139, rel=1e-3)
    assert margins_by_name == margins(report, "telescope")


def test_table_1_scanned() -> None:
    """Computed by hand: 21 columns of a row cross 7 mm at 100 mm (4.01 degrees at 0.2), about pi 10^2 = 314 pulses a
    frame.
    """
    train = scanned_train(TABLE_1, aperture_m=7e-3, distance_m=0.1)
    assert train.per_period == pytest.approx(math.pi * (math.degrees(math.atan(0.035)) / 0.2) ** 2, rel=0.05)
    assert train.period_s == pytest.approx(601 * 126 / 50e3)
    assert train.most_within(1e-3) == 21
    report = eye_safety_report(TABLE_1, scanned=True)
    margins_by_name = margins(report)
    assert margins_by_name["pulse group"] == pytest.approx(7e-4 * C4 * 400e-6**0.75 / (21 * PULSE_J), rel=1e-3)
    number = train.per_period * 7  # the aperture is passed seven times in 10 s
    assert margins_by_name["pulse train"] == pytest.approx(5 * number**-0.25 * 7.7e-8 * C4 / PULSE_J, rel=1e-3)
    assert (report.limiting.quantity, report.limiting.subject) == ("pulse train", "eye")


def test_smaller_pulses_or_a_wider_beam_pass() -> None:
    """The margin is one at the peak power that the report allows; a 25 mm beam sends 15 % through the pupil."""
    allowed = eye_safety_report(TABLE_1).class_1_peak_power_w
    assert eye_safety_report(with_laser(peak_power_w=allowed)).margin == pytest.approx(1.0)
    wide = eye_safety_report(with_laser(exit_diameter_m=25e-3))
    share = 1 - math.exp(-2 * (7 / 25) ** 2)
    assert margins(wide)["single pulse"] == pytest.approx(7.7e-8 * C4 / (share * PULSE_J), rel=1e-6)
    assert wide.limiting.subject == "telescope"


def test_larger_source() -> None:
    """3 mrad is twice alpha_min: C6 = 2 for a pulse; for the mean power T2 grows too."""
    point, larger = margins(eye_safety_report(TABLE_1)), margins(eye_safety_report(TABLE_1, source_rad=3e-3))
    assert larger["single pulse"] == pytest.approx(2 * point["single pulse"])
    t2 = 10 * 10 ** (1.5 / 98.5)
    assert larger["average power"] == pytest.approx(point["average power"] * 2 * 7e-4 * t2**-0.25 / 3.9e-4)
    assert margins(eye_safety_report(with_laser(source_rad=3e-3))) == larger


def test_1550_nm() -> None:
    """10 mW in the mean, 8 mJ in a pulse, and nothing for the retina."""
    margins_by_name = margins(eye_safety_report(with_laser(wavelength_m=1550e-9)))
    assert margins_by_name["average power"] == pytest.approx(10e-3 / (PULSE_J * 50e3))
    assert margins_by_name["single pulse"] == pytest.approx(8e-3 / PULSE_J)
    assert "pulse train" not in margins_by_name


def test_pulses_closer_than_the_grouping_time_count_as_one() -> None:
    """Five pulses at 1 MHz fall into 5 us; they are compared together, 2e6 of them in 10 s: C5 = 0.4."""
    report = eye_safety_report(with_laser(repetition_rate_hz=1e6))
    train = next(c for c in report.criteria if c.quantity == "pulse train")
    assert train.simulated == pytest.approx(5 * PULSE_J)
    assert train.reference == pytest.approx(0.4 * 7e-4 * C4 * 5e-6**0.75, rel=1e-6)
    assert "5 within 5 us as one" in train.note


def test_blue_light_has_its_own_limit() -> None:
    report = eye_safety_report(with_laser(wavelength_m=450e-9))
    assert report.limiting.quantity == "blue light"
    assert report.limiting.reference == pytest.approx(3.9e-5)


def test_given_number_of_pulses() -> None:
    """One pulse in each frame: a train of 0.66 Hz; more of them are never better."""
    report = eye_safety_report(TABLE_1, pulses_in_aperture=1)
    assert margins(report)["average power"] == pytest.approx(3.9e-4 * C4 / (PULSE_J * 50e3 / 75726))
    limits = [eye_safety_report(TABLE_1, pulses_in_aperture=n).margin for n in (1, 2, 30, 900, 75726)]
    assert limits == sorted(limits, reverse=True)
    assert limits[-1] == pytest.approx(eye_safety_report(TABLE_1).margin, rel=1e-6)


def test_report_as_data_and_text() -> None:
    report = eye_safety_report(TABLE_1)
    data = json.loads(json.dumps(report.as_dict()))
    assert (data["limiting"], data["is_class_1"]) == ("average power", False)
    assert data["margin"] == pytest.approx(report.margin)
    assert {c["unit"] for c in data["criteria"]} == {"J", "W"}
    text = report_text(TABLE_1)
    for phrase in (
        "not a certification",
        "287.4 nJ a pulse",
        "14.37 mW in the mean",
        "197.9 nJ",
        "1.002 mW",
        "NOT within class 1: average power limits (eye), margin 0.0698",
        "laser.exit_diameter_mm is not given",
    ):
        assert phrase in text
    assert max(len(line) for line in text.splitlines()) <= 120
    assert "within class 1: " in report_text(with_laser(peak_power_w=0.1))


def test_all_shots_of_a_point_count_in_the_mean() -> None:
    """10,000 points a second with 50 shots each: 500 kHz of 4.258 nJ."""
    text = report_text(photons.sensor("laser.repetition_rate_khz=10", "histogram.shots=50"))
    assert "500 kHz: 4.258 nJ a pulse, 2.129 mW in the mean" in text


@pytest.mark.parametrize(
    ("source", "judged"),
    [
        ({}, True),  # the user's own number
        ({"laser": "data sheet, page 3"}, True),
        ({"laser": "unknown; assumed: as its sisters"}, False),
        ({"laser": "data sheet", "laser.peak_power_w": "fitted: 100 m at 80 %"}, False),
        ({"laser": "unknown", "laser.peak_power_w": "measured", "laser.pulse_fwhm_ns": "measured"}, True),
        ({"laser.peak_power_w": "measured", "laser.pulse_fwhm_ns": "assumed"}, False),
    ],
)
def test_no_verdict_of_a_laser_that_is_not_known(source: dict[str, str], judged: bool) -> None:
    """Neither with a margin below one nor with one far above it."""
    coarse = replace(TABLE_1.scanner, azimuth_step_rad=0.02, elevation_step_rad=0.02, columns=31, rows=31)
    for power, verdict in ((45.0, "not class 1"), (0.1, "class 1")):
        sensor = replace(with_laser(peak_power_w=power), sources=source, scanner=coarse)
        report = eye_safety_report(sensor)
        assert report.verdict == (verdict if judged else "not judged")
        assert report.is_class_1 == ((verdict == "class 1") if judged else None)
        assert report.as_dict()["verdict"] == report.verdict
        text = report_text(sensor)
        assert ("within class 1" in text.replace("NOT within", "within")) == judged
        assert text.splitlines()[1].startswith("scanned: " if judged else "NOT JUDGED: laser.p")


def test_no_product_of_the_catalogue_is_judged_by_a_guess() -> None:
    judged = [name for name in names("sensors") if not not_known(load_sensor(name))]
    assert judged == ["apd-905", "biaxial-905", "mems-1550", "sipm-905", "table1-apd", "table1-sipm"]


test_mistakes = calls(
    (lambda: eye_safety_report(with_laser(wavelength_m=355e-9)), "table1-apd | wavelength | 400 to 2600 nm | 355 nm"),
    (lambda: eye_safety_report(with_laser(pulse_fwhm_s=3e-5)), "the pulses overlap"),
    (lambda: eye_safety_report(TABLE_1, scanned=True, pulses_in_aperture=3), "scanned | pulses_in_aperture | not both"),
    (lambda: eye_safety_report(TABLE_1, pulses_in_aperture=0), "1 to 75726 pulses | 0"),
)


# --- trains -----------------------------------------------------------------------------------------


@given(
    gaps=st.lists(st.integers(0, 50), min_size=0, max_size=12),
    rest=st.integers(1, 60),
    pulses=st.integers(1, 60),
    window=st.integers(1, 400),
)
@settings(max_examples=200)
def test_trains_against_counting(gaps: list[int], rest: int, pulses: int, window: int) -> None:
    """Rationale: the closed forms must be what counting a long list gives."""
    times = np.concatenate([[0], np.cumsum(gaps)]).astype(float)
    period = float(times[-1] + rest)
    train = PulseTrain(time_s=times, period_s=period)
    long = np.concatenate([times + k * period for k in range(pulses + window + 2)])
    starts = long[: len(times)]
    spans = long[pulses - 1 : pulses - 1 + len(times)] - starts
    assert train.shortest_span_s(pulses) == pytest.approx(spans.min(), abs=1e-9)
    counts = [int(((long >= t) & (long < t + window - 1e-6)).sum()) for t in starts]
    assert train.most_within(float(window)) == max(counts)
    assert train.mean_rate_hz == pytest.approx(len(times) / period)


def test_groups() -> None:
    train = PulseTrain(time_s=np.array([0.0, 1.0, 2.0, 10.0, 11.0]), period_s=20.0)
    assert [train.groups_per_period(t) for t in (0.5, 1.5, 2.5, 15.0)] == [5, 3, 2, 1]


def test_scanned_beams_never_exceed_standing_ones() -> None:
    scanned = margins(eye_safety_report(TABLE_1, scanned=True))
    assert all(scanned[name] >= margin for name, margin in margins(eye_safety_report(TABLE_1)).items())


def test_aperture_counts_shrink_with_distance() -> None:
    """7 mm a long way off holds one pulse; a beam as wide as 35 mm touches it in many more."""
    counts = [scanned_train(TABLE_1, aperture_m=7e-3, distance_m=r).per_period for r in (0.1, 0.3, 1.0, 100.0)]
    assert counts == sorted(counts, reverse=True)
    assert counts[-1] == 1
    wide = scanned_train(TABLE_1, aperture_m=7e-3, distance_m=0.1, beam_diameter_m=35e-3)
    assert wide.per_period > 20 * counts[0]


def test_simple_trains() -> None:
    assert (stationary_train(TABLE_1).per_period, stationary_train(TABLE_1).period_s) == (1, 2e-5)
    np.testing.assert_allclose(counted_train(TABLE_1, pulses_in_aperture=3).time_s, [0, 2e-5, 4e-5])


@pytest.mark.parametrize("times", [[], [1.0], [0.0, 1.0, 0.5], [0.0, 2.0]])
def test_trains_are_checked(times: list[float]) -> None:
    with pytest.raises(ValueError, match="go up from 0"):
        PulseTrain(time_s=np.array(times), period_s=2.0)


def test_shots_without_a_period_of_their_own_are_even() -> None:
    """10,000 points a second with 50 shots each: one every 2 us, whose last is a period before the next point."""
    sensor = photons.sensor("laser.repetition_rate_khz=10", "histogram.shots=50")
    assert sensor.histogram is not None
    even = replace(sensor, histogram=replace(sensor.histogram, period_s=None))
    times = exposure._shots_s(even)
    assert (len(times), times[0]) == (50, 0.0)
    assert np.diff(times) == pytest.approx(2e-6)


def test_an_elliptic_beam_is_as_narrow_as_its_smaller_divergence() -> None:
    """Rationale: through a telescope 2 m away more of it enters than of a round beam of the larger one."""
    wide, narrow, small = (
        geometry(with_laser(exit_diameter_m=2e-3, divergence_rad=across, divergence_elevation_rad=up), "telescope", 1.0)
        for across, up in ((3e-3, 3e-3), (3e-3, 1e-3), (1e-3, 1e-3))
    )
    assert narrow == pytest.approx(small)
    assert narrow[2] < wide[2]


@pytest.mark.parametrize(("factor", "verdict"), [(0.999, "class 1"), (1.001, "not class 1")])
def test_the_peak_that_class_1_allows_is_where_the_verdict_changes(factor: float, verdict: str) -> None:
    allowed_w = eye_safety_report(TABLE_1, scanned=True).class_1_peak_power_w
    report = eye_safety_report(with_laser(peak_power_w=factor * allowed_w), scanned=True)
    assert (report.verdict, report.is_class_1) == (verdict, verdict == "class 1")


def test_a_group_lasts_to_the_end_of_its_last_pulse() -> None:
    """The wavelength is 1550 nm, where no grouping time hides it: two pulses of 6 ns that start 1 us apart last 1.006
    us.
    """
    sensor = with_laser(wavelength_m=1550e-9)
    train = PulseTrain(time_s=np.array([0.0, 1e-6]), period_s=1.0)
    check = ViewerCheck(sensor=sensor, viewer="eye", train=train, energy_j=1e-6, source_rad=1.5e-3, time_base_s=100.0)
    details = [criterion.note for criterion in check.criteria() if criterion.quantity == "pulse group"]
    assert details == ["2 pulses in 1.006 us"]


@pytest.mark.parametrize(("apart_s", "count"), [(1e-3, 2), (1e-6, 1)])
def test_pulses_that_come_once_in_a_while_still_count_once(apart_s: float, count: int) -> None:
    """Two pulses every thousand seconds: in the ten that count there are two, or one where they are within 5 us."""
    train = PulseTrain(time_s=np.array([0.0, apart_s]), period_s=1000.0)
    check = ViewerCheck(sensor=TABLE_1, viewer="eye", train=train, energy_j=1e-6, source_rad=1.5e-3, time_base_s=100.0)
    (detail,) = (criterion.note for criterion in check.criteria() if criterion.quantity == "pulse train")
    assert f" for {count} pulses in 10 s" in detail


@pytest.mark.parametrize("page", ["photon_counting", "recipes", "own_sensor"])
def test_designs_of_the_guides_are_of_class_1(page, tmp_path, monkeypatch):
    """Rationale: who starts from an example starts from a design that may be built, as long as its beam moves."""
    pages = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    tables = [tomllib.loads(block) for block in re.findall(r"```toml\n(.*?)```", pages, re.DOTALL)]
    monkeypatch.chdir(tmp_path)
    for block in re.findall(r"```python\n(.*?)```", pages, re.DOTALL):
        if "savetxt" in block:  # the table of directions that a design names
            exec(block, {})
    designs = [
        sensor_from_tables(table, where=page, folder=tmp_path)
        for table in tables
        if {"laser", "detector"} <= set(table)
    ]
    assert designs
    for design in designs:
        scanned, _ = both_reports(design)
        assert scanned.is_class_1, (design.name, scanned.margin)
