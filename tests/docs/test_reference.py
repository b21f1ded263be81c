"""The reference for Python has every public name, and the lists of docstrings come out as tables."""

import importlib.util
from types import ModuleType

import pytest
from helpers.documentation import ROOT, text_of

import lidarscene

PHYSICS = ROOT / "src" / "lidarscene" / "physics"


@pytest.fixture(scope="module")
def docstrings() -> ModuleType:
    """The extension that the site is built with."""
    pytest.importorskip("griffe")
    spec = importlib.util.spec_from_file_location("docstrings", ROOT / "docs" / "docstrings.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def names_of_page(page: str) -> list[str]:
    """What a page takes from the code."""
    lines = text_of(ROOT / "docs" / page).splitlines()
    return [line.removeprefix("::: lidarscene.") for line in lines if line.startswith("::: ")]


def test_every_public_name_is_there() -> None:
    assert sorted(names_of_page("api.md")) == sorted(set(lidarscene.__all__) - {"__version__"})


def test_every_module_of_formulas_is_there() -> None:
    modules = [path.relative_to(PHYSICS.parent) for path in PHYSICS.rglob("*.py") if path.stem != "__init__"]
    assert sorted(names_of_page("api_physics.md")) == sorted(".".join(path.with_suffix("").parts) for path in modules)


def test_lists_become_tables(docstrings: ModuleType) -> None:
    """Names, whatever is two spaces on, and lines that go on; text with single spaces stays text."""
    markdown = docstrings.as_markdown(
        "What it does.\n\nrange_m  in metres, a | b,\n         in 2 rows\nx, y     both\nRaises InputError. Not a list."
    )
    assert markdown == (
        "What it does.\n\n\n| | |\n|---|---|\n| `range_m` | in metres, a \\| b, in 2 rows |\n| `x, y` | both |\n\n"
        "Raises InputError. Not a list."
    )


def test_equations_and_pages_of_docstrings_are_drawn_and_linked(docstrings: ModuleType) -> None:
    text = "As in docs/theory_light.md 21,\n\n.. math:: K = B / A,\\quad\n          A = 1 \\tag{T7}\n\nand so on."
    first, second, third = docstrings.as_markdown(text).split("\n\n")
    assert first == "As in [theory light, 21](theory_light.md),"
    assert second.strip().startswith('<div class="equation"><math ')
    assert "tag" not in second
    assert third.strip() == "and so on."


def test_no_list_of_the_public_names_is_lost(docstrings: ModuleType) -> None:
    """Each word of their docstrings is on the page, whether in a table or not."""
    for name in names_of_page("api.md"):
        text = str(getattr(lidarscene, name).__doc__)
        markdown = docstrings.as_markdown("\n".join(line.strip() for line in text.splitlines()))
        words = markdown.replace("\\|", "|").replace("|", " ").replace("`", " ").split()
        assert [word for word in text.replace("|", " ").replace("`", " ").split() if word not in words] == []
