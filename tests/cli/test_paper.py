"""`lidarscene paper`: everything it promises is there, and what it refuses."""

import contextlib
import csv
import io
import json
import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
from helpers.in_this_process import arrange_nothing
from helpers.paper_results import results, use

from lidarscene.cli import main

STEMS = ("fig-4e", "fig-5a", "fig-5b", "fig-5c", "fig-6a", "fig-6b", "fig-6c")
PICTURES = [f"{stem}.{suffix}" for stem in STEMS for suffix in ("png", "svg")]
NAMES = ["index.html", "index.md", *PICTURES, *(f"{stem}.csv" for stem in STEMS)]


def run_paper(folder: Path, *options: str) -> str:
    """The command in this process, on what is found once for all tests: what it prints."""
    output = io.StringIO()
    with contextlib.redirect_stdout(output), pytest.MonkeyPatch.context() as patch:
        arrange_nothing(patch)
        use(patch, results())
        assert main.main(["paper", "-o", str(folder), *options]) == 0
    return output.getvalue()


@pytest.fixture(scope="module")
def paper_run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """The command run once: its folder, its JSON."""
    output_folder = tmp_path_factory.mktemp("paper") / "new" / "out"
    return output_folder, json.loads(run_paper(output_folder, "--json"))


@pytest.fixture(scope="module")
def folder(paper_run: tuple[Path, Any]) -> Path:
    return paper_run[0]


def test_all_files_are_there_and_nothing_else(folder: Path) -> None:
    assert sorted(path.name for path in folder.iterdir()) == sorted(NAMES)
    assert len(PICTURES) == 14


@pytest.mark.parametrize(
    ("name", "first"),
    list(zip(STEMS, ["gain", *["photons"] * 3, "distance_m", "elevation_deg", "illuminance_klux"], strict=True)),
)
def test_csv(folder: Path, name: str, first: str) -> None:
    with (folder / f"{name}.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert rows[0][0] == first
    assert len(rows) > 100
    assert {len(row) for row in rows} == {len(rows[0])}
    assert all(float(cell) >= -30.0 for row in rows[1:] for cell in row)


def test_markdown_links_and_tables(folder: Path) -> None:
    text = (folder / "index.md").read_text("utf-8")
    links = re.findall(r"\]\(([^)]+)\)", text)
    assert len(links) == 21
    assert all((folder / link).is_file() for link in links)
    for word in ("## Claims", "## Errata", "3.22191 klux", "A(0) cos(theta)", "333.2", "350.605"):
        assert word in text
    for table in re.findall(r"(?:^\|.*\|\n)+", text, re.MULTILINE):
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in table.splitlines()}) == 1


def test_both_pages_tell_the_same_claims(paper_run: tuple[Path, Any]) -> None:
    folder, numbers = paper_run
    page = (folder / "index.html").read_text("utf-8")
    assert page.count("<tr>") == len(numbers["claims"]) + len(numbers["errata"]) + 2
    assert numbers["claims"] == json.loads(json.dumps([asdict(claim) for claim in results().claims]))
    assert numbers["errata"] == json.loads(json.dumps([asdict(erratum) for erratum in results().errata]))
    assert len(numbers["claims"]) >= 35
    assert all(Path(name).is_file() for name in numbers["files"])
