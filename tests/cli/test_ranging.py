"""`lidarscene range`: what it prints and writes, and what it refuses, in one line, with nothing written."""

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import Run

from lidarscene import catalog, load_sensor
from lidarscene.physics.optics import air
from lidarscene.studies.ranging import plane, sweep_report

APD, SIPM = "table1-apd", "table1-sipm"


def range_text(run: Run, *typed: str) -> str:
    """What the command prints; each argument is of one word or more."""
    printed = run.well("range", *" ".join(typed).split())
    return printed


def range_json(run: Run, *typed: str) -> Any:
    def refuse(word: str) -> None:
        raise ValueError(f"{word} is not JSON")

    return json.loads(range_text(run, *typed, "--json"), parse_constant=refuse)


def table(path: Path) -> tuple[list[str], np.ndarray[Any, Any]]:
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    return rows[0], np.array(rows[1:], dtype=np.float64)


# --- one set of conditions --------------------------------------------------------------------------


def test_summary(run: Run) -> None:
    out = range_text(run, APD, SIPM, "--probability", "0.5")
    assert "100 klux, sun 60° off the normal, reflectivity 0.1, incidence 0°, transmittance 0.98" in out
    apd, sipm = out.splitlines()[-2:]
    assert apd.split() == ["table1-apd", "350.605", "m", "signal", "352.751", "m", "599.6", "m", "61.4618", "1"]
    assert sipm.split()[1] == "280.871"
    assert "range at P_d 0.5" in out


def test_one_sensor_has_one_range(run: Run) -> None:
    """Alone, beside another, as its file has it on equal terms, in the sweep's notes and beside sensitivities."""
    reached_m = range_json(run, APD)[APD]["range_m"]
    pair = range_json(run, APD, SIPM)[APD]
    assert pair["range_m"] == pair["equal_terms"]["file_range_m"] == reached_m
    for argv in ((APD,), (APD, "--over", "distance"), (APD, "--sensitivities"), (APD, SIPM)):
        assert f"{reached_m:.1f}" in range_text(run, *argv)
    assert plane.detection_probability(load_sensor(APD), plane.Target(), reached_m)[0] == pytest.approx(0.9, abs=1e-9)
    half = range_json(run, APD, SIPM, "--probability", "0.5")[APD]
    assert half["range_pd50_m"] == half["equal_terms"]["file_range_pd50_m"] > reached_m


def test_a_range_beyond_the_window_is_said(run: Run) -> None:
    """Seven pulses in the time of one: 38.5 m are unambiguous, and echoes from farther appear nearer."""
    mode = ("os1-128", "--set", "histogram.multiplier=7")
    allowed = "the range that its signal allows"
    folding = load_sensor("os1-128", overrides=["histogram.multiplier=7"])
    signal_m = plane.detection_range_m(folding, plane.Target(), 0.9)[0]
    message = f"os1-128: its window ends at 38.5 m, before {allowed} ({signal_m:.6g} m); echoes from beyond 38.5 m"
    assert range_text(run, *mode).splitlines()[-1].startswith(message)
    assert range_json(run, *mode)["os1-128"]["note"].startswith(message)
    folded = range_json(run, *mode)["os1-128"]
    assert (folded["limited_by"], folded["signal_range_m"]) == ("window", pytest.approx(signal_m, rel=1e-9))
    assert folded["range_m"] == folded["window_m"] == pytest.approx(38.54, abs=0.01)
    plain = range_json(run, "os1-128")["os1-128"]
    assert plain["note"] is None
    assert plain["limited_by"] == "signal"
    assert plain["range_m"] == plain["signal_range_m"]
    dim = range_text(run, APD, "--illuminance-klux", "0.1").splitlines()
    assert dim[-1].startswith(f"table1-apd: its window ends at 599.6 m, before {allowed} (")
    assert dim[-2].split()[1:4] == ["599.585", "m", "window"]
    notes = range_json(run, *mode, "--over", "illuminance_klux", "--n", "3")["notes"]
    assert any("echoes from beyond 38.5 m are reported too near" in note for note in notes)


@pytest.mark.parametrize(
    ("argv", "status", "word"),
    [
        ((APD, "--reflectivity", "0"), "never_detected", "never"),
        ((SIPM, "--set", "detector.cells=10"), "saturated", "saturated"),
        (
            (
                *(SIPM, "--illuminance-klux", "0", "--probability", "0.5"),
                *("--set=detector.cell_floor=0", "--set=detector.dark_count_rate_hz=0"),
            ),
            "no_limit",
            "no limit",
        ),
    ],
)
def test_statuses_have_words(run: Run, argv: tuple[str, ...], status: str, word: str) -> None:
    (entry,) = range_json(run, *argv).values()
    assert entry["status"] == status
    assert word in range_text(run, *argv)
    assert "nan" not in range_text(run, *argv)


def test_fixed_threshold_has_no_closed_form(run: Run, tmp_path: Path) -> None:
    text = catalog.path_of("sensors", APD).read_text("utf-8")
    (tmp_path / "fixed.toml").write_text(text.replace("threshold_to_noise = 5", "threshold_level = 1e-6", 1))
    assert range_json(run, "fixed.toml")[APD]["closed_form_m"] is None
    assert range_text(run, "fixed.toml", "--over", "distance", "--plot", "f.png")


# --- sweeps -----------------------------------------------------------------------------------------


def test_range_from_the_snr(run: Run) -> None:
    half = ("--over", "distance", "--probability", "0.5")
    out = range_text(run, APD, SIPM, *half)
    assert "table1-apd: range 350.605 m at P_d 0.5, where SNR 5" in out
    assert "table1-sipm: range 280.871 m at P_d 0.5, where SNR 5" in out
    assert range_text(run, APD, *half, "--quantity", "pd").count("P_d 0.5") == 1


@pytest.mark.parametrize(
    ("swept", "first", "ends"),
    [
        ("distance", "distance_m", (10.0, 1000.0)),
        ("illuminance_klux", "illuminance_klux", (0.1, 100.0)),
        ("elevation", "elevation_deg", (-12.5, 12.5)),
        ("azimuth", "azimuth_deg", (-60.0, 60.0)),
        ("reflectivity", "reflectivity", (0.01, 1.0)),
        ("incidence", "incidence_deg", (0.0, 85.0)),
        ("tdc.threshold_to_noise", "tdc.threshold_to_noise", (1.0, 25.0)),
        ("optics.aperture_radius_mm", "optics.aperture_radius_mm", (5.0, 125.0)),
    ],
)
def test_csv(run: Run, tmp_path: Path, swept: str, first: str, ends: tuple[float, float]) -> None:
    """First the swept quantity with its unit, then a column for each sensor under its name."""
    range_text(run, APD, SIPM, "--over", swept, "--csv", "new/out.csv", "--n", "21")
    header, values = table(tmp_path / "new" / "out.csv")
    assert header == [first, APD, SIPM]
    assert values.shape == (21, 3)
    assert (values[0, 0], values[-1, 0]) == pytest.approx(ends)
    assert (np.diff(values[:, 0]) > 0).all()
    assert np.isfinite(values).all()
    assert (tmp_path / "new" / "out.csv").read_bytes().count(b"\r") == 0


def test_csv_holds_what_is_printed_as_json(run: Run, tmp_path: Path) -> None:
    entry = range_json(
        run,
        SIPM,
        "--over illuminance_klux --from 0 --to 100 --scale linear --n 5 --probability=0.5",
        "--set=detector.cell_floor=0 --set=detector.dark_count_rate_hz=0 --csv o.csv",
    )
    _, values = table(tmp_path / "o.csv")
    assert entry["csv"] == "o.csv"
    assert entry["over"] == "illuminance_klux"
    assert entry["x"] == [0.0, 25.0, 50.0, 75.0, 100.0]
    curve = entry["sensors"][SIPM]
    assert curve["status"] == ["no_limit", "found", "found", "found", "found"]
    assert curve["values"][0] is None
    assert values[0, 1] == np.inf
    assert values[1:, 1] == pytest.approx(curve["values"][1:], rel=1e-9)


def test_aperture_law(run: Run) -> None:
    flat = range_text(run, APD, "--over", "elevation")
    assert "the same everywhere, elevation does not matter" in flat
    assert "aperture law: A(theta) as the sensor's own scanner has it" in flat
    edges = range_json(
        run,
        *(APD, "--over", "elevation", "--from", "-30", "--to", "30", "--n", "3", "--aperture-law", "mirror"),
        *("--probability", "0.5"),
    )
    low, middle, high = edges["sensors"][APD]["values"]
    assert low > middle == pytest.approx(350.605, rel=1e-5)
    assert high < middle


def test_extreme_plots_do_not_fail(run: Run) -> None:
    """Nothing to draw, and no limit anywhere: a picture all the same."""
    for argv in (("--reflectivity", "0"), ("--illuminance-klux", "0"), ("--quantity", "pd", "--reflectivity", "0")):
        range_text(run, APD, "--over", "laser.peak_power_w", *argv, "--plot", "o.png")
    range_text(run, SIPM, "--over", "laser.peak_power_w", "--set", "detector.cells=5", "--plot", "o.png")


def test_eye_safety_and_sensitivities(run: Run, tmp_path: Path) -> None:
    assert "scanned: not class 1; stationary: not class 1" in range_text(run, APD, "--eye-safety")
    out = range_text(run, SIPM, "--sensitivities", "--plot", "tornado.png")
    assert "laser.peak_power_w" in out
    assert "wrote tornado.png" in out
    assert (tmp_path / "tornado.png").stat().st_size > 10_000


def test_eye_safety_of_a_fitted_laser_is_no_verdict(run: Run) -> None:
    """The exit code, the headline and the JSON say so; a power that the user gives is judged."""
    ran = run("range", "vlp-16", "--eye-safety")
    assert (ran.code, ran.err) == (1, "")
    assert "\nNOT JUDGED: laser.peak_power_w is fitted" in ran.out
    ran = run("range", APD, "vlp-16", "--eye-safety", "--json")
    verdicts = [
        (verdict_of_motion["sensor"], verdict_of_motion["motion"], verdict_of_motion["verdict"])
        for verdict_of_motion in json.loads(ran.out)
    ]
    assert (ran.code, verdicts) == (
        1,
        [(APD, "scanned", "not class 1"), (APD, "stationary", "not class 1")]
        + [("vlp-16", motion, "not judged") for motion in ("scanned", "stationary")],
    )
    assert "stationary: class 1" in range_text(run, "vlp-16", "--eye-safety", "--set", "laser.peak_power_w=0.01")


def test_every_aperture_law_is_told_in_a_line() -> None:
    for law in ("scanner", "constant", "cosine", "mirror"):
        assert re.match(r"A\(theta\) (= A\(0\)|as )", sweep_report.law_text(law))


def test_more_than_the_sun_is_noted(run: Run) -> None:
    """Rationale: 500 may be lux, or a lamp: a scene of so much renders with the same note."""
    ran = run("range", APD, "--illuminance-klux", "500")
    assert ran.code == 0
    assert ran.err == (
        "lidarscene: note: --illuminance-klux is 500 klux, and no sun has more than 140: if these are lux, give "
        "--illuminance-klux 0.5\n"
    )


# --- mistakes ---------------------------------------------------------------------------------------


def test_haze_is_in_kilometres_whatever_is_asked(run: Run) -> None:
    """The range in a visibility of 2 km, by Kim's extinction: in the summary, in a sweep and beside sensitivities."""
    sensor = load_sensor(APD)
    alpha = air.extinction_from_visibility_per_m(visibility_m=2000.0, wavelength_m=sensor.laser.wavelength_m)
    limit_m, _ = plane.detection_range_m(sensor, plane.Target(transmittance=1.0, extinction_per_m=float(alpha)), 0.9)
    hazy = ("--visibility", "2")
    assert range_json(run, APD, *hazy)[APD]["range_m"] == pytest.approx(limit_m, rel=1e-9)
    swept = range_json(run, APD, "--over", "illuminance_klux", "--from", "10", "--to", "100", "--n", "2", *hazy)
    assert swept["sensors"][APD]["values"][-1] == pytest.approx(limit_m, rel=1e-9)
    assert f"range {limit_m:.3f} m at P_d 0.9" in range_text(run, APD, "--sensitivities", *hazy)


def test_an_axis_of_angles_ends_where_the_narrower_field_does(run: Run) -> None:
    """The APD's raster is narrowed to 20 degrees: both are asked where both look."""
    narrow = f"{APD}:scanner.azimuth_fov_deg=20"
    swept = range_json(run, SIPM, APD, "--over", "azimuth", "--n", "3", "--set", narrow)
    assert swept["x"] == pytest.approx([-10.0, 0.0, 10.0], abs=0.2)
