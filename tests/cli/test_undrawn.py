"""A figure that cannot be drawn costs no numbers: every command that draws, where nothing can be drawn.

`fit` is in tests/studies/fit/test_recording_fit.py; `range --eye-safety`, `twin` and `catalog check` draw nothing.
"""

import csv
import json
import re
from pathlib import Path

import pytest
from helpers.clouds import small_cloud
from helpers.command_line import COARSE, Run
from helpers.paper_results import results, use
from helpers.recordings import OUSTER

UNCHANGED = """
sensor = "table1-apd"
evaluations = 12
eye_safety = "off"
[free]
"detector.gain" = { low = 5, high = 150 }
[objectives]
area = { minimize = "aperture_area_mm2" }
power = { minimize = "mean_power_mw" }
"""
"""A study whose objectives do not depend on its free key: its front is one design."""

SWEEP = "range table1-apd --over distance --n 3 --csv out/a.csv --plot out/a.png"
BARS = "range table1-apd --sensitivities --plot out/a.png"
FOV = f"fov table1-apd table1-sipm -o out --time 0.001,0.01 --cell 2 {' '.join(COARSE)}"


@pytest.mark.parametrize(
    ("line", "numbers"),
    [
        ("design study.toml -o out", ("design.json", "front.csv", "front-power.csv", "index.html", "index.md")),
        (SWEEP, ("a.csv",)),
        (BARS, ()),
        (FOV, ("coverage.csv", "table1-sipm-range.csv", "index.html", "index.md")),
        ("compare a.ply b.ply -o out", ("compare.json", "error-range.csv", "index.html")),
        ("certify OUSTER --scene twin/scene.toml -o out", ("certificate.json", "index.html")),
        ("paper -o out", ("index.html", "index.md", "fig-4e.csv")),
    ],
)
def test_numbers_without_figures(
    line: str,
    numbers: tuple[str, ...],
    run: Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    request: pytest.FixtureRequest,
) -> None:
    """Each figure is one line on the error stream, the code says that something is missing, the page has all else."""
    if "twin" in line:
        request.getfixturevalue("mi")
        assert run("twin", str(OUSTER), "--held-out", "columns", "-o", "twin").code == 0
    if "paper" in line:
        use(monkeypatch, results())
    if "compare" in line:
        for name in ("a", "b"):
            small_cloud(50).save(tmp_path / f"{name}.ply")
    (tmp_path / "study.toml").write_text(UNCHANGED)
    (tmp_path / "out").mkdir()
    request.getfixturevalue("failing_charts")
    ran = run(*line.replace("OUSTER", str(OUSTER)).split())
    assert ran.code == 1
    assert ran.out
    notes = [note for note in ran.err.splitlines() if "cannot be drawn" in note]
    assert notes == ran.err.splitlines()
    assert re.fullmatch(
        r"lidarscene: note: figure '[\w-]+': cannot be drawn: ValueError: no chart; the numbers are not affected",
        notes[0],
    )
    names = {path.name for path in (tmp_path / "out").iterdir() if path.is_file()}
    assert set(numbers) <= names
    assert not [name for name in names if name.endswith((".png", ".svg", ".part"))]
    for name in names:
        text = (tmp_path / "out" / name).read_text(errors="replace")
        if name.endswith(".csv"):
            assert len(list(csv.reader(text.splitlines()))) > 1
        elif name.endswith(".json"):
            assert json.loads(text)
        elif name.endswith((".html", ".md")):
            assert text.count("(not drawn)") == len(notes)
            assert not re.search(r"\.(png|svg)\b", text)


def test_a_front_of_one_design_is_drawn(run: Run, tmp_path: Path) -> None:
    """Rationale: `design` ended in a traceback after all evaluations."""
    (tmp_path / "study.toml").write_text(UNCHANGED)
    printed = run.well("design", "study.toml", "-o", "out")
    assert "No design changes area, power" in printed
    assert (tmp_path / "out" / "front-power.png").read_bytes().startswith(b"\x89PNG")


def test_json_names_what_is_written(run: Run, tmp_path: Path, failing_charts: None) -> None:
    (tmp_path / "study.toml").write_text(UNCHANGED)
    ran = run("design", "study.toml", "-o", "out", "--json")
    assert ran.code == 1
    files = json.loads(ran.out)["files"]
    assert files
    assert all((tmp_path / file).is_file() for file in files)
    assert json.loads(run(*SWEEP.split(), "--json").out)["csv"] == "out/a.csv"
    assert "plot" not in json.loads(run(*SWEEP.split(), "--json").out)
