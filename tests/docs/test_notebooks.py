"""The notebooks run from top to bottom, and show what they showed when they were written.

`PYTHONPATH=src:tests python tests/docs/test_notebooks.py` runs them and writes their outputs anew.
"""

import importlib.util
import json
import subprocess
from pathlib import Path
from typing import Any

import matplotlib as mpl
import nbformat
import pytest
from helpers.documentation import ROOT
from helpers.in_this_process import draw_roughly
from helpers.notebooks import run, written
from helpers.run_seed import chosen
from helpers.sources import module_of
from helpers.twins import use_few_evaluations, use_few_trees

from lidarscene.formats.registry import SUFFIXES

pytestmark = pytest.mark.fixed_streams

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


LAST_VERDICT = 'verdict(lidarscene.certify("os0-32", scene=scene))'
FEWER = {
    "apd_sipm": {
        "klux in (1, 10, 100)": "klux in (1,)",
        'PAIR, "illuminance_klux"': 'PAIR, "illuminance_klux", points=4',
        'PAIR, "reflectivity"': 'PAIR, "reflectivity", points=4',
        "stop=300": "stop=300, points=4",
        'compare(\n    "street"': 'compare(\n    "car"',
        "(100, 400, 1600)": "(100,)",
        "illuminance_klux=(1, 10, 100)": "illuminance_klux=(1, 100)",
        'step_deg": 0.6, "scanner.elevation_step_deg": 0.6': 'step_deg": 2, "scanner.elevation_step_deg": 2',
    },
    "child": {"frames=20": "frames=2", "range(0, 80, 8)": "range(0, 80, 40)"},
    "twin": {f'sensor="fitted/sensor.toml")\n{LAST_VERDICT}': 'sensor="fitted/sensor.toml")\nprint(scene)'},
    "frames": {"frames=3": "frames=1", "in range(3)": "in range(1)", 'seed": 7': 'seed": 7, "street.length_m": 450'},
}
"""What the test changes in a notebook: more frames, points and verdicts take a minute, and run the same code."""

SAVES = """
from pathlib import Path
Path("left.ply").write_text("ply")
print(Path.cwd(), Path("left.ply").is_file())
"""


def kinds(notebook: dict[str, Any]) -> list[list[list[str]]]:
    """The kinds of what each cell shows: numbers may differ by a rounding on another machine."""
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    return [[sorted(output.get("data", {"text": ""})) for output in cell["outputs"]] for cell in cells]


@pytest.mark.parametrize("path", chosen(1, NOTEBOOKS), ids=lambda path: path.stem)
def test_a_notebook_runs(mi, path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use_few_trees(monkeypatch)
    use_few_evaluations(monkeypatch)
    draw_roughly(monkeypatch)
    mpl.use("agg")
    stored = json.loads(path.read_text(encoding="utf-8"))
    assert kinds(run(path, FEWER.get(path.stem))) == kinds(stored)


def test_a_notebook_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: one that was run at the top of the repository left a cloud of 5 MB there, which was then published."""
    monkeypatch.chdir(tmp_path)
    cell = {"cell_type": "code", "source": [SAVES]}
    (tmp_path / "saves.ipynb").write_text(json.dumps({"cells": [cell]}), encoding="utf-8")
    (output,) = run(tmp_path / "saves.ipynb")["cells"][0]["outputs"]
    folder, is_there = output["text"][0].split()
    assert is_there == "True"
    assert not Path(folder).exists()
    assert [path.name for path in tmp_path.iterdir()] == ["saves.ipynb"]
    assert Path.cwd() == tmp_path
    assert [path.name for path in ROOT.iterdir() if path.name.endswith(SUFFIXES)] == []


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_valid_and_small(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert path.stat().st_size < 600_000
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.outputs or "import" in cell.source for cell in code)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_installs_the_package_where_it_is_missing(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = next(cell for cell in json.loads(path.read_text("utf-8"))["cells"] if cell["cell_type"] == "code")
    for missing in (False, True):
        calls: list[list[str]] = []
        monkeypatch.setattr(importlib.util, "find_spec", lambda _, missing=missing: None if missing else "here")
        monkeypatch.setattr(subprocess, "run", lambda words, calls=calls, **_: calls.append(words))
        exec("".join(first["source"]), {})
        assert [(words[1:4], words[-1].partition("[")[0]) for words in calls] == [
            (["-m", "pip", "install"], "lidarscene")
        ] * missing


def test_a_repository_of_github_has_links_to_services() -> None:
    pages = module_of(ROOT / "docs" / "notebook_pages.py")
    for address in ("https://github.com/me/lidar", "https://github.com/me/lidar.git"):
        text = pages._services("child", address)
        assert "(https://colab.research.google.com/github/me/lidar/blob/main/docs/notebooks/child.ipynb)" in text
        assert "(https://mybinder.org/v2/gh/me/lidar/HEAD?labpath=docs%2Fnotebooks%2Fchild.ipynb)" in text
    assert pages._services("child", "https://example.org/source") == ""


def test_there_are_five_and_the_docs_name_them() -> None:
    page = (ROOT / "docs" / "tutorials.md").read_text(encoding="utf-8")
    assert len(NOTEBOOKS) == 5
    assert [path.name for path in NOTEBOOKS if f"notebooks/{path.name}" not in page] == []


if __name__ == "__main__":
    mpl.use("agg")
    for notebook in NOTEBOOKS:
        notebook.write_text(written(run(notebook)), encoding="utf-8")
