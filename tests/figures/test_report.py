"""Pages: names that a user or a file chose are text, and nothing else."""

import json
import math
from pathlib import Path

import pytest
from helpers.mistakes import told

from lidarscene.figures.report import Figure, Report

NAME = "[a](javascript:b)|`c` <script>\n# *d* _e_"
ESCAPED = r"\[a\](javascript:b)\|\`c\` &lt;script&gt; # \*d\* \_e\_"


@pytest.mark.parametrize("block", ["title", "heading", "paragraph", "caption", "header", "cell"])
def test_names_are_text_in_markdown(block: str, tmp_path: Path) -> None:
    """Rationale: sensors are named by their files, and pages are sent to others."""
    report = Report(NAME if block == "title" else "t", embeds=False)
    if block == "heading":
        report.add_heading(NAME)
    if block == "paragraph":
        report.add_paragraph(NAME)
    if block == "caption":
        report.add_figure(Figure("f", lambda path: None, (("x",), [(1.0,)]), NAME))
        report.add_pictures([("g", NAME, lambda path: None)])
    if block in ("header", "cell"):
        report.add_table([NAME if block == "header" else "h"], [[NAME if block == "cell" else "c"]])
    text = report.as_markdown()
    assert text.count(ESCAPED) == (2 if block == "caption" else 1)
    assert "javascript" not in text.replace(ESCAPED, "")
    report.save(tmp_path / "out")
    page = (tmp_path / "out" / "index.html").read_text()
    assert "<script" not in page
    assert "&lt;script&gt;" in page


def test_a_number_stays_on_the_line_of_its_unit(tmp_path: Path) -> None:
    """Numbers stay in HTML alone, where lines wrap; words and numbers without a unit wrap as they like."""
    report = Report("t")
    report.add_table(["h"], [["99.37 to 99.50 %"], ["-2.74 ± 0.29 mm"], ["3 motorcycles of 7"]])
    report.save(tmp_path)
    text = (tmp_path / "index.html").read_text()
    assert "99.37 to 99.50\u00a0%" in text
    assert "-2.74 ± 0.29\u00a0mm" in text
    assert "3 motorcycles of 7" in text
    assert "\u00a0" not in report.as_markdown()


def test_one_report_in_all_its_forms(tmp_path: Path) -> None:
    """The text has neither title nor figures; numbers stand to the right, in the CSV with the given digits."""
    report = Report("Title", numbers={"x": math.nan}, pages=("index.html", "index.md", "index.json"), digits=3)
    report.add_paragraph("Said.")
    report.add_heading("Part")
    report.add_table(("name", "value", "limit"), [("a", "1,234", ""), ("long", "-0.5", "at most 1")])
    assert report.as_text() == "Said.\n\nPart\nname  value  limit\na     1,234\nlong   -0.5  at most 1"
    report.add_figure(Figure("f", lambda path: path.write_bytes(b"PNG"), (("x", "y"), [(1 / 3, "a")]), "Shown."))
    report.save(tmp_path)
    assert (tmp_path / "f.csv").read_text() == "x,y\n0.333,a\n"
    assert "data:image/png" in (tmp_path / "index.html").read_text()
    assert (tmp_path / "index.md").read_text().startswith("# Title\n\nSaid.\n\n## Part\n")
    assert json.loads((tmp_path / "index.json").read_text()) == {"x": None}


def test_a_report_in_a_notebook_and_in_pandas(tmp_path: Path) -> None:
    """Nothing is drawn before it is asked for; numbers stay numbers, and without them cells are text."""
    drawn: list[Path] = []
    report = Report("Title", main_table=(("a", "b"), [(1, "x"), (2.5, "y")]))
    with told("'Title' | figures"):
        report.plot()
    report.add_figure(Figure("f", lambda path: drawn.append(path) or path.write_bytes(b"PNG"), (("x",), [(1.0,)]), "C"))
    assert not drawn
    assert report.table == {"a": [1, 2.5], "b": ["x", "y"]}
    assert report.plot().png == report.plot("f").png == b"PNG"
    report.plot().save(tmp_path / "f.png")
    assert (tmp_path / "f.png").read_bytes() == b"PNG"
    with told("plot | f | 'g'"):
        report.plot("g")
    assert "data:image/png;base64,UE5H" in report._repr_html_()
    other = Report("Other")
    other.add_table(("h",), [("1",)])
    assert other.table == {"h": ["1"]}
    assert str(other) == other.as_text()


def test_files_in_a_folder_of_a_report_join_those_that_are_there(tmp_path: Path) -> None:
    report = Report("Title")
    report.add_file("designs/b.toml", lambda path: path.write_text("b"))
    (tmp_path / "out" / "designs").mkdir(parents=True)
    (tmp_path / "out" / "designs" / "a.toml").write_text("a")
    report.save(tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out" / "designs").iterdir()) == ["a.toml", "b.toml"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["designs", "index.html"]
