"""Pages: names that a user or a file chose are text, and nothing else."""

import json
import math
from pathlib import Path

import pytest

from lidarscene.figures.report import Figure, Report

NAME = "[a](javascript:b)|`c` <script>\n# *d* _e_"
ESCAPED = r"\[a\](javascript:b)\|\`c\` &lt;script&gt; # \*d\* \_e\_"


@pytest.mark.parametrize("block", ["title", "heading", "paragraph", "caption", "header", "cell"])
def test_names_are_text_in_markdown(block: str, tmp_path: Path) -> None:
    """Rationale: sensors are named by their files, and pages are sent to others."""
    report = Report(NAME if block == "title" else "t", tmp_path, embeds=False)
    if block == "heading":
        report.heading(NAME)
    if block == "paragraph":
        report.paragraph(NAME)
    if block == "caption":
        report.figure(Figure("f", lambda path: None, (("x",), [(1.0,)]), NAME))
        report.pictures([("f", NAME)])
    if block in ("header", "cell"):
        report.table([NAME if block == "header" else "h"], [[NAME if block == "cell" else "c"]])
    text = report.as_markdown()
    assert text.count(ESCAPED) == (2 if block == "caption" else 1)
    assert "javascript" not in text.replace(ESCAPED, "")
    assert "<script" not in report.as_html()
    assert "&lt;script&gt;" in report.as_html()


def test_a_number_stays_on_the_line_of_its_unit() -> None:
    """In HTML alone, where lines wrap; words and numbers without a unit wrap as they like."""
    report = Report("t")
    report.table(["h"], [["99.37 to 99.50 %"], ["-2.74 ± 0.29 mm"], ["3 motorcycles of 7"]])
    text = report.as_html()
    assert "99.37 to 99.50\u00a0%" in text
    assert "-2.74 ± 0.29\u00a0mm" in text
    assert "3 motorcycles of 7" in text
    assert "\u00a0" not in report.as_markdown()


def test_one_report_in_all_its_forms(tmp_path: Path) -> None:
    """The text has neither title nor figures; numbers stand to the right, in the CSV with the given digits."""
    report = Report("Title", tmp_path, digits=3)
    report.paragraph("Said.")
    report.heading("Part")
    report.table(("name", "value", "limit"), [("a", "1,234", ""), ("long", "-0.5", "at most 1")])
    assert report.as_text() == "Said.\n\nPart\nname  value  limit\na     1,234\nlong   -0.5  at most 1"
    report.figure(Figure("f", lambda path: path.write_bytes(b"PNG"), (("x", "y"), [(1 / 3, "a")]), "Shown."))
    report.write("index.html", "index.md", "index.json", numbers={"x": math.nan})
    assert (tmp_path / "f.csv").read_text() == "x,y\n0.333,a\n"
    assert "data:image/png" in (tmp_path / "index.html").read_text()
    assert (tmp_path / "index.md").read_text().startswith("# Title\n\nSaid.\n\n## Part\n")
    assert json.loads((tmp_path / "index.json").read_text()) == {"x": None}
