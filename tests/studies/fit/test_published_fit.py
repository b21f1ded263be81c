"""Numbers of a sensor fitted to published ranges, against sensors whose numbers are known, and what is refused."""

import importlib.util
import math
from pathlib import Path

import numpy as np
import pytest
from helpers.documentation import ROOT
from helpers.mistakes import told

from lidarscene import catalog
from lidarscene.cli import main
from lidarscene.files.toml_edit import put_values, remove_values
from lidarscene.sensor.readout import PublishedFile
from lidarscene.sensor.sensor_file import load_sensor, published_performance
from lidarscene.studies import published_values
from lidarscene.studies.fit.published_fit import POWER, PublishedRanges, fit_published
from lidarscene.studies.fit.tuning import RANGE_SIGMA
from lidarscene.studies.held import Held

NOISE, SUN = "detector.circuit_noise_na", "optics.sun_irradiance_w_m2"
ASSUMED = {("published", "unknowns", NOISE): [50.0, 2.0], ("published", "unknowns", SUN): [12.6, 3.0]}

AS_COPIED = {
    "livox-avia": (f"{POWER}=10.81", f"{NOISE}=50", f"{SUN}=12.6", "tdc.threshold_to_noise=6"),
    "livox-mid-360": (f"{POWER}=2.794", f"{NOISE}=50", f"{SUN}=12.6", "tdc.threshold_to_noise=5.6"),
    "rs-e1": (
        "optics.aperture_radius_mm=4",
        "detector.spads=5",
        f"{POWER}=0.1206",
        "histogram.threshold_floor=3.4",
        "histogram.threshold_slope=0.5",
    ),
}
"""Overrides that make a product the receiver that all of its kind had, with the power for its range at 10 %."""


def sensor_file(folder: Path, values: dict[tuple[str, ...], object]) -> str:
    """Path of a livox-mid-40 with one published range, noise from the amplifier alone, and these values."""
    text = catalog.path_of("sensors", "livox-mid-40").read_text(encoding="utf-8")
    text = remove_values(text, [("published", "also"), ("published", "unknowns")])
    quiet = {("detector", "load_resistance_ohm"): 1e12, ("detector", "surface_dark_current_na"): 0.0}
    path = folder / "mine.toml"
    path.write_text(put_values(text, {**quiet, ("detector", "bulk_dark_current_na"): 0.0, **values}), encoding="utf-8")
    return str(path)


def test_one_dark_range_knows_power_over_noise(tmp_path: Path) -> None:
    """R^2 goes with power over noise: the power alone is known to twice the range's deviation, the rest is assumed."""
    path = sensor_file(tmp_path, {("published", "illuminance_klux"): 0.0, **ASSUMED})
    power, noise, sun = fit_published(path)
    assert [number.key for number in (power, noise, sun)] == [POWER, NOISE, SUN]
    assert power.sigma_alone == pytest.approx(2.0 * RANGE_SIGMA, rel=1e-3)
    assert power.sigma == pytest.approx(math.hypot(2.0 * RANGE_SIGMA, math.log(2.0)), rel=1e-3)
    assert (noise.value, noise.sigma) == pytest.approx((50.0, math.log(2.0)), rel=1e-3)
    assert (sun.value, sun.sigma, sun.sigma_alone) == pytest.approx((12.6, math.log(3.0), math.log(3.0)), rel=1e-3)
    assert not noise.is_determined
    assert not sun.is_determined
    assert "not determined" in str(sun)
    settings = (f"{POWER}={power.value}", f"{NOISE}={noise.value}")
    ranges = PublishedRanges.of(published(path))
    assert ranges is not None
    assert ranges.simulated_m(load_sensor(path, overrides=settings)) == pytest.approx([90.0], rel=1e-3)


def published(name: str) -> PublishedFile:
    performance = published_performance(name)
    assert performance is not None
    return performance


def test_day_and_night_know_sunlight_over_noise(tmp_path: Path) -> None:
    """Ranges of a sensor with three times the sun's light and half the noise lead to both ratios, p and p^2."""
    true = {POWER: 3.0, NOISE: 25.0, SUN: 37.8}
    path = sensor_file(tmp_path, {("published", "dark"): [], **ASSUMED})
    sensor = load_sensor(path, overrides=[f"{key}={value}" for key, value in true.items()])
    shares = np.array([0.1, 0.2, 0.8])
    day, night = (
        PublishedRanges(reflectivity=shares, illuminance_klux=np.full(3, klux), range_m=shares).simulated_m(sensor)
        for klux in (100.0, 0.0)
    )
    pairs = [[float(share), float(range_m)] for share, range_m in zip(shares, day, strict=True)]
    values = {
        ("published", "range_m"): pairs[0][1],
        ("published", "also"): pairs[1:],
        ("published", "dark"): [[float(share), float(range_m)] for share, range_m in zip(shares, night, strict=True)],
        # The assumptions are so far off that they say nothing of the ratios.
        ("published", "unknowns", NOISE): [50.0, 1e3],
        ("published", "unknowns", SUN): [12.6, 1e3],
    }
    fitted = {number.key: number.value for number in fit_published(sensor_file(tmp_path, values))}
    assert fitted[POWER] / fitted[NOISE] == pytest.approx(true[POWER] / true[NOISE], rel=0.01)
    assert fitted[SUN] / fitted[NOISE] ** 2 == pytest.approx(true[SUN] / true[NOISE] ** 2, rel=0.02)


def test_nothing_to_fit() -> None:
    assert fit_published("mems-1550") == ()
    assert fit_published("os1-128") == ()


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({("published", "unknowns", "detector.colour"): [1.0, 2.0]}, "published.unknowns.detector.colour"),
        ({("published", "unknowns", NOISE): [1.0, 1.0]}, "published.unknowns | > 1 | 1"),
    ],
)
def test_unknowns_are_numbers_of_the_file(tmp_path: Path, values: dict[tuple[str, ...], object], named: str) -> None:
    with told(named):
        load_sensor(sensor_file(tmp_path, values))


def law_rows(name: str, overrides: tuple[str, ...] = ()) -> list[Held]:
    return published_values.laws(load_sensor(name, overrides=overrides), published(name))


@pytest.mark.parametrize(
    ("name", "quantity"),
    [("livox-avia", "range exponent"), ("livox-mid-360", "range exponent"), ("rs-e1", "range, brighter over darker")],
)
def test_a_receiver_that_contradicts_its_maker_is_refused(name: str, quantity: str) -> None:
    """Those that all of a kind shared miss the limit of their law; those of the file do not."""
    assert quantity in {row.quantity for row in law_rows(name, AS_COPIED[name]) if row.verdict is False}
    assert [row for row in law_rows(name) if not row.verdict] == []


def test_a_sensor_that_sees_nothing_is_refused() -> None:
    """A threshold that no echo reaches, nor any light: rows that fail, and no error."""
    rows = law_rows("livox-mid-360", ("tdc.threshold_to_noise=1e4", f"{POWER}=1e-6"))
    assert [row.quantity for row in rows if row.verdict is False] == ["range exponent"]


def test_nights_are_held_to_days() -> None:
    """The Avia reaches 450 m without light for 320 m in it; without sunlight in the receiver both are the same."""
    (row,) = (row for row in law_rows("livox-avia", (f"{SUN}=0",)) if row.condition.startswith("80%, "))
    assert row.reference == pytest.approx(450.0 / 320.0)
    assert row.simulated == pytest.approx(1.0)
    assert not row.verdict


def test_check_fails_with_a_number_off_its_fit(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(published_values, "SHOTS", 200)
    assert main.main(["catalog", "check", "livox-mid-360"]) == 0
    assert "with the others as they are" in capsys.readouterr().out
    monkeypatch.setattr(published_values, "LAW_SIGMAS", 0.1)
    assert main.main(["catalog", "check", "livox-mid-360"]) == 1
    assert "NOT MET" in capsys.readouterr().out


def test_the_tool_leaves_its_own_files_as_they_are(tmp_path: Path) -> None:
    """tools/fit_catalogue.py writes what the catalogue has."""
    spec = importlib.util.spec_from_file_location("fit_catalogue", ROOT / "tools" / "fit_catalogue.py")
    assert spec is not None
    assert spec.loader is not None
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    text = catalog.path_of("sensors", "livox-mid-360").read_text(encoding="utf-8")
    assert tool.fitted_text(text, "livox-mid-360", tmp_path) == text
