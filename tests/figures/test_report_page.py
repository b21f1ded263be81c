"""Pages: names that a user or a file chose are text, and nothing else."""

import pytest

from lidarscene.figures.report_page import Page

NAME = "[a](javascript:b)|`c` <script>\n# *d* _e_"
ESCAPED = r"\[a\](javascript:b)\|\`c\` \<script> # \*d\* \_e\_"


@pytest.mark.parametrize("where", ["title", "heading", "paragraph", "caption", "header", "cell"])
def test_names_are_text_in_markdown(where: str) -> None:
    """Rationale: sensors are named by their files, and pages are sent to others."""
    page = Page(NAME if where == "title" else "t")
    if where == "heading":
        page.heading(NAME)
    if where == "paragraph":
        page.paragraph(NAME)
    if where == "caption":
        page.figure(name="f", number="1", caption=NAME)
        page.pictures([("f", NAME)])
    if where in ("header", "cell"):
        page.table([NAME if where == "header" else "h"], [[NAME if where == "cell" else "c"]])
    text = page.as_markdown()
    assert text.count(ESCAPED) == (2 if where == "caption" else 1)
    assert "javascript" not in text.replace(ESCAPED, "")
    assert "<script" not in page.as_html()


def test_a_number_stays_on_the_line_of_its_unit() -> None:
    """In HTML alone, where lines wrap; words and numbers without a unit wrap as they like."""
    page = Page("t")
    page.table(["h"], [["99.37 to 99.50 %"], ["-2.74 ± 0.29 mm"], ["3 motorcycles of 7"]])
    text = page.as_html()
    assert "99.37 to 99.50\u00a0%" in text
    assert "-2.74 ± 0.29\u00a0mm" in text
    assert "3 motorcycles of 7" in text
    assert "\u00a0" not in page.as_markdown()
