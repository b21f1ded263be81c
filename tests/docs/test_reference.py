"""The reference for Python has every public name, and what the hooks of the site add to docstrings."""

import pkgutil
from types import ModuleType

import pytest
from helpers.documentation import ROOT, text_of
from helpers.sources import module_of

import lidarscene
from lidarscene.rendering.option_fields import options_of

PHYSICS = ROOT / "src" / "lidarscene" / "physics"


def hook(name: str) -> ModuleType:
    """A hook that the site is built with."""
    pytest.importorskip("mkdocs")
    return module_of(ROOT / "docs" / f"{name}.py")


def names_of_page(page: str) -> list[str]:
    """What a page takes from the code."""
    lines = text_of(ROOT / "docs" / page).splitlines()
    return [line.removeprefix("::: lidarscene.") for line in lines if line.startswith("::: ")]


def test_every_public_name_is_there() -> None:
    """Rationale: the tool takes a name of a package for the package, so functions of that name have their full path."""
    paths = names_of_page("api.md")
    assert sorted(path.rpartition(".")[2] for path in paths) == sorted(set(lidarscene.__all__) - {"__version__"})
    assert not [path for path in paths if (PHYSICS.parent / path.replace(".", "/")).is_dir()]
    assert all(callable(pkgutil.resolve_name(f"lidarscene.{path}")) for path in paths)


def test_every_module_of_formulas_is_there() -> None:
    modules = [path.relative_to(PHYSICS.parent) for path in PHYSICS.rglob("*.py") if path.stem != "__init__"]
    assert sorted(names_of_page("api_physics.md")) == sorted(".".join(path.with_suffix("").parts) for path in modules)


def test_equations_and_pages_of_docstrings_are_drawn_and_linked() -> None:
    math = ".. math:: K = B / A,\\quad\n    A = 1 \\tag{T7}"
    text = f"As in (docs/theory_light.md 9) and `docs/theory.md`,\n\n{math}\n\nand so on."
    first, equation, last = hook("equations").drawn(text).split("\n\n")
    assert first == "As in ([theory light, 9](theory_light.md)) and `docs/theory.md`,"
    assert equation.strip().startswith('<div class="equation" id="T7"')
    assert "\\" not in equation.partition("<math ")[2].partition("<annotation")[0]
    assert last.strip() == "and so on."


@pytest.mark.parametrize(
    "kind", [lidarscene.TraceOptions, lidarscene.FrameOptions, lidarscene.Observers, lidarscene.Outputs]
)
def test_the_page_lists_the_options_of_a_class(kind: type) -> None:
    page = hook("option_tables").on_page_markdown(f"::: lidarscene.{kind.__name__}\n::: lidarscene.Scene")
    rows, _, rest = page.partition("\n|---|---|\n")[2].partition("\n\n")
    assert rows.splitlines() == [f"| `{name}` | {entry.help} |" for name, (_, entry) in options_of(kind).items()]
    assert rest == "::: lidarscene.Scene"


def test_long_tables_of_keys_are_folded_below_their_names() -> None:
    fold = hook("folded_tables").on_page_markdown
    rows = [f"| `key_{n}` | - | text | words |\n" for n in range(6)]
    head = "<!-- keys Some + Other -->\n| key | default | values | meaning |\n|---|---|---|---|\n"
    short, long = (f"Before\n\n{head}{''.join(rows[:count])}\nBehind\n" for count in (5, 6))
    assert fold(short) == short.replace("<!-- keys Some + Other -->\n", "")
    summary, _, table = fold(long).partition("</summary>\n\n")
    assert [f"<code>key_{n}</code>" in summary for n in range(6)] == [True] * 6
    assert table == long.partition("-->\n")[2].replace("\nBehind", "\n</details>\n\nBehind")
