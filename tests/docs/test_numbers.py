"""Every number of a page has its account, a comment behind it such as `= range_m(APD)`, to the digits that it shows.

`helpers.page_numbers` is the namespace of the expressions.
"""

import ast
import re
from pathlib import Path

import pytest
from helpers import page_numbers
from helpers.documentation import PAGES, differs, stretches, text_of

pytestmark = pytest.mark.fixed_streams


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_numbers_are_what_their_accounts_give(page: Path, request: pytest.FixtureRequest) -> None:
    if "paint_over_lambert" in text_of(page):
        request.getfixturevalue("mi")
    wrong = []
    for stretch in stretches(page):
        if stretch.expression:
            given = page_numbers.values(stretch.expression)
            printed = stretch.numbers[-len(given) :]
            if len(printed) < len(given):
                wrong.append(f"{len(printed)} numbers before {stretch.expression}")
            pairs = zip(printed, given, strict=False)
            wrong += [f"{why}: {stretch.expression}" for pair in pairs if (why := differs(*pair))]
    assert not wrong, "\n".join([page.name, *wrong])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_numbers_have_an_account(page: Path) -> None:
    """But for those of names, equations and citations, and of tables that a test writes."""
    bare = []
    for stretch in stretches(page):
        count = len(page_numbers.values(stretch.expression)) if stretch.expression else 0
        before = len(stretch.numbers) - count
        bare += [w for w, plain in zip(stretch.words[:before], stretch.plain[:before], strict=True) if not plain]
    assert bare == []


def test_every_name_is_used_on_a_page() -> None:
    """The namespace has what an expression or another of its functions names, and no more."""
    source = Path(page_numbers.__file__).read_text(encoding="utf-8")
    given: list[str] = []
    for node in ast.parse(source).body:
        if isinstance(node, ast.Import | ast.ImportFrom):
            given += [alias.asname or alias.name for alias in node.names]
        elif isinstance(node, ast.FunctionDef):
            given.append(node.name)
        elif isinstance(node, ast.Assign):
            given += [name.id for target in node.targets for name in ast.walk(target) if isinstance(name, ast.Name)]
    expressions = [stretch.expression or "" for page in PAGES for stretch in stretches(page)]
    words = re.findall(r"\w+", " ".join([source, *expressions, Path(__file__).read_text(encoding="utf-8")]))
    assert [name for name in given if words.count(name) < 2] == []
