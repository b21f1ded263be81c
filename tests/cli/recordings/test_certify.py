"""The command `certify`."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import Run
from helpers.twins import use_few_trees

from lidarscene import Simulator, load_scene, load_sensor
from lidarscene.catalog import sensor_path
from lidarscene.rendering.render_options import FrameOptions

pytestmark = pytest.mark.usefixtures("rough_charts")

SENSOR = "vlp-16"
TURNS = 4


@pytest.fixture(autouse=True)
def _few_trees(monkeypatch: pytest.MonkeyPatch) -> None:
    use_few_trees(monkeypatch)


@pytest.fixture(scope="module")
def turns(mi: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Turns of a VLP-16 at rest in a street, as lists of points of a file each."""
    folder = tmp_path_factory.mktemp("certify") / "turns"
    folder.mkdir()
    simulator = Simulator(load_scene("street"), load_sensor(SENSOR))
    for number in range(TURNS):
        cloud = simulator.render(FrameOptions(seed=100 + number)).in_sensor_frame()
        rows = np.column_stack([cloud.xyz_m, cloud.intensity]).astype(np.float32)
        (folder / f"{number}.bin").write_bytes(rows.tobytes())
    return folder


def certificate(run: Run, *words: str) -> tuple[int, dict[str, Any]]:
    ran = run("certify", *words, "-o", "out", "--json")
    numbers = json.loads(ran.out)
    assert numbers.items() >= json.loads(Path("out/certificate.json").read_text()).items()
    return ran.code, numbers


def rows_of(numbers: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {row["quantity"]: row for row in numbers["rows"]}


def test_turns_at_rest(run: Run, turns: Path) -> None:
    """Whoever recorded is who simulates: it passes."""
    code, numbers = certificate(run, str(turns), "--sensor", SENSOR)
    rows = rows_of(numbers)
    assert numbers["frames_judged"] == TURNS - 1
    assert numbers["seen"] == "Held out: the twin is made of frames 0."
    assert rows["share kept at rest on smooth surfaces, worst octave of the range"]["met"]
    assert rows["range, scatter at rest, bins within the limits"]["value"] == 1.0
    assert rows["told apart by a classifier"]["real"] == pytest.approx(0.5, abs=0.06)
    assert rows["told apart on smooth surfaces"]["source"].startswith("this project's choice")
    assert (code, numbers["verdict"].partition(":")[0]) == (0, "Pass"), numbers["verdict"]
    assert {"background light", "photons", "second returns", "other light and weather"} <= numbers["not_covered"].keys()
    assert {"index.html", "kept-range.csv", "scatter-strength.png", "recorded.png"} <= {
        Path(name).name for name in numbers["files"]
    }


def test_a_clock_of_more_jitter_fails_by_its_noise(run: Run, turns: Path, no_charts: None) -> None:
    """A jitter of 300 ps is 45 mm for some 8 mm."""
    text = sensor_path(SENSOR).read_text()
    assert "jitter_ps = 38" in text
    Path("late.toml").write_text(text.replace("jitter_ps = 38", "jitter_ps = 300"))
    code, numbers = certificate(run, str(turns), "--sensor", "late.toml", "--frame", "1")
    rows = rows_of(numbers)
    assert (code, numbers["passed"]) == (1, False)
    assert rows["range, scatter at rest, worst bin"]["value"] > 3.0
    assert rows["told apart by range texture alone"]["value"] > 0.9
    assert rows["share kept at rest on smooth surfaces, worst octave of the range"]["met"]


def test_without_scikit_learn_it_says_so(run: Run, turns: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One turn stands alone, and is judged by every second column."""
    monkeypatch.setattr("lidarscene.studies.twin.certificate.is_installed", lambda _: False)
    ran = run("certify", str(turns / "0.bin"), "--sensor", SENSOR, "-o", "out")
    line = next(line for line in ran.out.splitlines() if line.startswith("told apart on smooth surfaces"))
    assert "not measured" in line
    assert "pip install 'lidarscene[certify]'" in line
    assert "every second column" in ran.out
