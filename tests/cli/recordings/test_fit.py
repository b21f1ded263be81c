"""`lidarscene fit`: what it refuses, and the code that it ends with."""

import json
import shlex
from pathlib import Path
from typing import Any

import pytest
from helpers.recordings import OUSTER

from lidarscene.cli import main
from lidarscene.figures.report import Report
from lidarscene.studies.fit import recording_fit


def run_fit(folder: Path, *options: str) -> int:
    return main.main(["fit", str(OUSTER), "--sensor", "os0-128", "--report", str(folder / "r"), *options])


@pytest.mark.parametrize(("passed", "code"), [(True, 0), (False, 1)])
def test_the_code_says_whether_the_laws_held(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], passed: bool, code: int
) -> None:
    calls: list[Any] = []

    def record_call(*arguments: Any, **more: Any) -> tuple[str, Report]:
        calls.append((arguments, more))
        return "name = 'fitted'", Report("Fit", numbers={"found": 1}, passed=passed)

    monkeypatch.setattr(recording_fit, "fit_recordings", record_call)
    words = shlex.split(f"-o {tmp_path / 'u.toml'} --metadata u.json --json --sensor-index 1 --frames 2,0")
    assert run_fit(tmp_path, *words) == code
    assert json.loads(capsys.readouterr().out) == {"found": 1, "files": [str(tmp_path / "r" / "index.html")]}
    assert (tmp_path / "u.toml").read_text() == "name = 'fitted'"
    ((arguments, more),) = calls
    assert arguments == ([OUSTER], "os0-128")
    assert more == {"metadata": Path("u.json"), "sensor_index": 1, "frames": (2, 0)}


def test_with_a_scene_it_is_another_fit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from lidarscene.studies.fit.on_scene import scene_fit as on_scene

    calls: list[Any] = []
    monkeypatch.setattr(
        on_scene, "fit_on_scene", lambda inputs: (calls.append(inputs), ("", Report("Fit", passed=True)))[1]
    )
    files = ["--scene", "twin/scene.toml", "--poses", "p.csv", "--metadata", "u.json", "--sensor-index", "1"]
    assert run_fit(tmp_path, "-o", str(tmp_path / "u.toml"), *files) == 0
    (inputs,) = calls
    assert inputs == on_scene.SceneFitInputs(
        recordings=[OUSTER],
        scene=Path("twin/scene.toml"),
        sensor="os0-128",
        metadata=Path("u.json"),
        poses=Path("p.csv"),
        sensor_index=1,
    )


def test_one_packet_tells_too_little(tmp_path: Path, capsys: pytest.CaptureFixture[str], library: Any) -> None:
    """A real sensor's sixteen columns: one line, and nothing is written."""
    library("ouster.sdk.core")
    assert run_fit(tmp_path, "-o", str(tmp_path / "u.toml")) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "os0-32-one-packet.pcap: must have SIGNAL, NEAR_IR or REFLECTIVITY of enough pulses" in message
    assert not any(tmp_path.rglob("*.toml"))
