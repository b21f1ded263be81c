"""Studies in one call: what comes out is what the commands print, whatever names a sensor."""

import json
from pathlib import Path
from typing import Any

import pytest
from helpers.clouds import small_cloud

import lidarscene
from lidarscene.cli.main import main
from lidarscene.errors import InputError
from lidarscene.studies import api


def test_the_maximum_range_of_names_and_sensors_is_what_the_command_prints(capsys: pytest.CaptureFixture[str]) -> None:
    report = lidarscene.max_range(["vlp-16", lidarscene.load_sensor("table1-apd")], illuminance=20, reflectivity=0.3)
    options = ["range", "vlp-16", "table1-apd", "--illuminance", "20", "--reflectivity", "0.3"]
    assert main(options) == 0
    assert capsys.readouterr().out == f"{report}\n"
    assert main([*options, "--json"]) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert [numbers[name]["maximum_range_m"] for name in report.table["name"]] == report.table["maximum_range_m"]
    assert report.table["name"] == ["vlp-16", "table1-apd"]


def test_one_sensor_twice_and_changed(no_charts: None) -> None:
    apd = lidarscene.load_sensor("table1-apd")
    table = lidarscene.max_range(["table1-apd", apd, apd.replace("laser.peak_power_w=90")]).table
    assert table["name"] == ["table1-apd", "table1-apd (2)", "table1-apd (3)"]
    ranges_m = table["maximum_range_m"]
    assert ranges_m[0] == ranges_m[1] < ranges_m[2]
    assert (
        lidarscene.max_range("table1-apd", overrides="laser.peak_power_w=90").table["maximum_range_m"] == ranges_m[2:]
    )


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


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        (lambda: lidarscene.max_range([]), "sensors: must be at least one, got none"),
        (lambda: lidarscene.max_range(3), "sensors: must be names, files or Sensors, got int"),
        (lambda: lidarscene.max_range("table1-apd", illuminance=-1), "illuminance"),
        (lambda: lidarscene.max_range("table1-apd", reflectvity=1), "unknown option 'reflectvity'; did you mean refl"),
        (lambda: lidarscene.fov("table1-apd", cell=1), "unknown option 'cell'; did you mean|known here: times_s"),
        (lambda: lidarscene.fov("table1-apd", pose=(0, 0, 1)), "pose: goes with scene"),
        (lambda: lidarscene.compare("car", ["table1-apd"]), "sensors: must be two or more, got 1"),
        (lambda: lidarscene.compare("car", sensor="table1-apd"), "unknown option 'sensor'; did you mean sensors[?]"),
        (lambda: lidarscene.compare("car"), "compare: must have sensors for a scene, or two clouds or more"),
        (lambda: lidarscene.fit("a.pcap"), "fit: must have a sensor, or a scene, with which poses go"),
        (lambda: lidarscene.twin("nothing.pcap", "out"), "nothing.pcap"),
    ],
)  # fmt: skip
def test_mistakes_are_one_line(call: Any, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        call()


def test_the_front_door_is_public() -> None:
    assert {"compare", "fit", "fov", "max_range", "twin"} <= set(lidarscene.__all__)
    assert lidarscene.compare is api.compare
