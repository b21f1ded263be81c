"""The notebooks run from top to bottom, and show what they showed when they were written.

`PYTHONPATH=src:tests python tests/docs/test_notebooks.py` runs them and writes their outputs anew.
"""

import json
from pathlib import Path
from typing import Any

import matplotlib as mpl
import nbformat
import pytest
from helpers.documentation import ROOT
from helpers.notebooks import run, written

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


def kinds(notebook: dict[str, Any]) -> list[list[list[str]]]:
    """The kinds of what each cell shows: numbers may differ by a rounding on another machine."""
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    return [[sorted(one.get("data", {"text": ""})) for one in cell["outputs"]] for cell in cells]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(mi, path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    mpl.use("agg")
    kept = json.loads(path.read_text(encoding="utf-8"))
    assert kinds(run(path)) == kinds(kept)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_valid_and_small(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert path.stat().st_size < 600_000
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.outputs or "import" in cell.source for cell in code)


def test_there_are_three_and_the_docs_name_them() -> None:
    page = (ROOT / "docs" / "notebooks.md").read_text(encoding="utf-8")
    assert len(NOTEBOOKS) == 3
    assert [path.name for path in NOTEBOOKS if f"notebooks/{path.name}" not in page] == []


if __name__ == "__main__":
    mpl.use("agg")
    for one in NOTEBOOKS:
        one.write_text(written(run(one)), encoding="utf-8")
