"""Studies in one call: what comes out is what the commands print, whatever names a sensor."""

import dataclasses
import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from helpers.clouds import small_cloud
from helpers.command_line import Run
from helpers.mistakes import calls, told

import lidarscene
from lidarscene.cli.main import main
from lidarscene.errors import InputError, OptionWarning
from lidarscene.files.toml import validate
from lidarscene.studies import api
from lidarscene.studies.compare.bench import Bench
from lidarscene.studies.design.study_file import StudyFile

GAIN = "detector.gain"


def study(klux: float) -> dict[str, Any]:
    """Tables of a study file of one free key."""
    free, snr = {"low": 5, "high": 150}, {"maximize": "snr", "illuminance_klux": klux}
    return {"sensor": "apd-905", "free": {GAIN: free}, "objectives": {"snr": snr}}


def test_the_maximum_range_of_names_and_sensors_is_what_the_command_prints(capsys: pytest.CaptureFixture[str]) -> None:
    report = lidarscene.max_range(
        ["table1-sipm", lidarscene.load_sensor("table1-apd")], illuminance_klux=20, reflectivity=0.3
    )
    options = ["range", "table1-sipm", "table1-apd", "--illuminance-klux", "20", "--reflectivity", "0.3"]
    assert main(options) == 0
    assert capsys.readouterr().out == f"{report}\n"
    assert main([*options, "--json"]) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert [numbers[name]["range_m"] for name in report.table["name"]] == report.table["range_m"]
    assert report.table["name"] == ["table1-sipm", "table1-apd"]


def test_one_sensor_twice_and_changed(no_charts: None) -> None:
    apd = lidarscene.load_sensor("table1-apd")
    table = lidarscene.max_range(["table1-apd", apd, apd.replace("laser.peak_power_w=90")]).table
    assert table["name"] == ["table1-apd", "table1-apd (2)", "table1-apd (3)"]
    ranges_m = table["range_m"]
    assert ranges_m[0] == ranges_m[1] < ranges_m[2]
    assert lidarscene.max_range("table1-apd", overrides="laser.peak_power_w=90").table["range_m"] == ranges_m[2:]


def test_another_probability_is_named_in_the_column() -> None:
    usual, half = (lidarscene.max_range("table1-apd", **options).table for options in ({}, {"probability": 0.5}))
    assert "range_m" in usual
    assert "range_m" not in half
    assert half["range_pd50_m"][0] > usual["range_m"][0]
    swept = lidarscene.sweep("table1-apd", "illuminance_klux", points=2, stop=100.0, probability=0.5)
    assert list(swept.table) == ["illuminance_klux", "table1-apd range_pd50_m"]
    assert swept.table["table1-apd range_pd50_m"][1] == pytest.approx(half["range_pd50_m"][0])
    assert swept.numbers["probability"] == 0.5


@pytest.mark.parametrize(
    ("call", "options"),
    [
        (
            lambda: lidarscene.sweep(["table1-apd", lidarscene.load_sensor("sipm-905")], "illuminance_klux", points=3),
            "table1-apd sipm-905 --over illuminance_klux --n 3",
        ),
        (
            lambda: lidarscene.sweep(lidarscene.load_sensor("apd-905").replace("laser.peak_power_w=9"), GAIN, points=2),
            f"apd-905 --set laser.peak_power_w=9 --over {GAIN} --n 2",
        ),
        (
            lambda: lidarscene.sensitivities("table1-apd", reflectivity=0.5),
            "table1-apd --sensitivities --reflectivity 0.5",
        ),
        (lambda: lidarscene.eye_safety("table1-apd"), "table1-apd --eye-safety"),
    ],
)  # fmt: skip
def test_each_report_of_range_is_what_the_command_prints(
    call: Callable[[], lidarscene.Report], options: str, run: Run, tmp_path: Path, no_charts: None
) -> None:
    report = call()
    assert run("range", *options.split()).out == f"{report}\n"
    assert json.loads(run("range", *options.split(), "--json").out) == json.loads(report.as_json())
    assert len({len(column) for column in report.table.values()}) == 1
    report.save(tmp_path / "out")
    assert sorted(report.file_names) == sorted(path.name for path in (tmp_path / "out").iterdir())


def test_a_sensor_of_ones_own_equations_is_swept_over_conditions_alone() -> None:
    """It has no file, so that its keys have no values; over a condition it is the sensor that it was made of."""
    apd = lidarscene.load_sensor("table1-apd")
    changed = dataclasses.replace(apd, name="changed")
    over_distance = lidarscene.sweep([apd, changed], "distance", points=5).table
    assert over_distance["changed"] == over_distance["table1-apd"]
    with told("'changed' | load_sensor"):
        lidarscene.sweep(changed, "detector.gain")


@pytest.mark.parametrize(
    "call",
    [
        lambda klux: lidarscene.max_range("table1-apd", illuminance_klux=klux),
        lambda klux: lidarscene.sweep("table1-apd", "distance", illuminance_klux=klux, points=2),
        lambda klux: lidarscene.sweep("table1-apd", "illuminance_klux", stop=klux, points=2),
        lambda klux: lidarscene.sensitivities("table1-apd", illuminance_klux=klux),
        lambda klux: lidarscene.fov("table1-apd", illuminance_klux=klux),
        lambda klux: lidarscene.compare("car", ["table1-apd", "vlp-16"], illuminance_klux=[klux]),
        lambda klux: validate(StudyFile, study(klux), "study"),
        lambda klux: Bench(lidarscene.load_scene("car", overrides={"sun.illuminance_klux": klux})),
    ],
)
def test_lux_for_klux_are_noticed_wherever_light_is_given(call: Callable[[float], object]) -> None:
    """More than the sun has is doubted, and what no lamp has is refused, as by `render`."""
    with pytest.raises((InputError, ValueError), match=r"did you mean 100\?"):
        call(100_000.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", OptionWarning)
        with pytest.raises(OptionWarning, match="no sun has more than 140: if these are lux"):
            call(5_000.0)


def test_clouds_are_compared_as_they_are(tmp_path: Path) -> None:
    cloud = small_cloud(50)
    cloud.save(tmp_path / "a.ply")
    report = lidarscene.compare([cloud, tmp_path / "a.ply"])
    assert report.table["points"] == [50, 50]
    assert "compare.json" in report.file_names


def test_a_fit_has_its_sensor_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from lidarscene.figures.report import Report
    from lidarscene.studies.fit import recording_fit

    monkeypatch.setattr(recording_fit, "fit_recordings", lambda *_, **__: ("name = 'fitted'", Report("Fit")))
    lidarscene.fit("os1.pcap", "os1-128").save(tmp_path / "out")
    assert (tmp_path / "out" / "sensor.toml").read_text() == "name = 'fitted'"


test_mistakes = calls(
    (lambda: lidarscene.max_range([]), "sensors | at least one | none"),
    (lambda: lidarscene.max_range(3), "sensors | names, files or Sensors | int"),  # type: ignore[arg-type]
    (lambda: lidarscene.max_range("table1-apd", illuminance_klux=-1), "illuminance_klux -1 | 0 or more"),
    (lambda: lidarscene.max_range("table1-apd", illuminance=1), "'illuminance' | illuminance_klux?"),
    (lambda: lidarscene.max_range("table1-apd", reflectvity=1), "'reflectvity' | reflectivity?"),
    (lambda: lidarscene.fov("table1-apd", cell=1), "'cell' | times_s"),
    (lambda: lidarscene.fov("table1-apd", pose=(0, 0, 1)), "pose | scene"),
    (lambda: lidarscene.compare("car", ["table1-apd"]), "sensors | two or more | 1"),
    (lambda: lidarscene.compare("car", sensor="table1-apd"), "'sensor' | sensors?"),
    (lambda: lidarscene.compare("car"), "compare | sensors | scene | two clouds or more"),
    (lambda: lidarscene.fit("a.pcap"), "sensor | name the sensor | scene"),
    (lambda: lidarscene.fit("a.pcap", "os1-128", poses="p.csv"), "poses | scene"),
    (lambda: lidarscene.fit("a.pcap", scene="a.toml", frames=[1]), "frames | scene"),
    (lambda: lidarscene.fit("a.pcap", sensors="os1-128"), "'sensors' | sensor?"),
    (lambda: lidarscene.sweep("table1-apd", "power"), "over power | laser.peak_power_w?"),
    (lambda: lidarscene.sweep("table1-apd", "distance", quantity="range"), "over distance quantity range"),
    (lambda: lidarscene.sweep("table1-apd", "reflectivity", reflectivity=1), "reflectivity | over reflectivity"),
    (lambda: lidarscene.sweep("table1-apd", "illuminance"), "over illuminance | illuminance_klux?"),
    (lambda: lidarscene.compare("car", illuminances_klux=[1]), "'illuminances_klux' | illuminance_klux?"),
    (lambda: lidarscene.sweep("table1-apd", "distance", start=2, stop=1), "start 2 stop 1 | below stop"),
    (lambda: lidarscene.sweep("table1-apd", "distance", pionts=3), "'pionts' | points"),
    (lambda: lidarscene.sensitivities("table1-apd", distanse=3), "'distanse' | distance"),
    (lambda: lidarscene.eye_safety([]), "sensors | at least one | none"),
    (lambda: lidarscene.eye_safety("vlp-16", override=()), "'override' | overrides?"),
    (lambda: lidarscene.design("gian", "out"), "design 'gian' | gain?"),
    (lambda: lidarscene.design("gain", foldr="out"), "'foldr' | folder?"),
    (lambda: lidarscene.twin("nothing.pcap", "out"), "nothing.pcap | no such recording"),
    (lambda: lidarscene.twin("a.pcap", "out", heldout="columns"), "'heldout' | held_out?"),
)


def test_the_front_door_is_public() -> None:
    names = {"compare", "design", "eye_safety", "fit", "fov", "max_range", "sensitivities", "sweep", "twin"}
    assert names <= set(lidarscene.__all__)
    assert lidarscene.compare is api.compare


def test_the_page_of_several_sensors_begins_with_the_question(tmp_path: Path, no_charts: None) -> None:
    """One sensor has no verdict; of several, what it rests on is said in order, and the light is drawn."""
    alone = lidarscene.max_range("table1-apd")
    assert alone.figure_names == ["snr"]
    assert "**Verdict" not in alone.as_markdown()
    report = lidarscene.max_range(["table1-apd", "table1-sipm"], probability=0.5)
    page = report.as_markdown()
    places = [page.index(f"**{lead}.** ") for lead in ("Question", "Verdict", "What differs", "What would change it")]
    assert places == sorted(places)
    assert report.figure_names == ["snr", "light"]
    report.save(tmp_path / "out")
    rows = (tmp_path / "out" / "light.csv").read_text(encoding="utf-8").splitlines()
    assert rows[0] == "illuminance_klux,table1-apd range_pd50_m,table1-sipm range_pd50_m"
    terms = report.numbers["table1-apd"]["equal_terms"]
    assert float(rows[4].split(",")[1]) == pytest.approx(terms["ranges_m"]["100 klux"], rel=1e-6)
    assert terms["ranges_m"]["100 klux"] == pytest.approx(terms["range_pd50_m"], rel=1e-6)
