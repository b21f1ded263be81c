"""No public function takes more than seven parameters: what belongs together is one object."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import lidarscene

SOURCE = Path(lidarscene.__file__).parent

MOST = 7


def functions(node: ast.AST, place: str = "") -> Iterator[tuple[str, int]]:
    """Public functions and methods with the number of their parameters; those inside of functions are nobody's."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.ClassDef) and not child.name.startswith("_"):
            yield from functions(child, f"{place}{child.name}.")
        elif isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            if child.name.startswith("_") and child.name != "__init__":
                continue
            of = child.args
            names = [
                one.arg for one in (*of.posonlyargs, *of.args, *of.kwonlyargs, of.vararg, of.kwarg) if one
            ]
            yield f"{place}{child.name}", len(names) - (bool(place) and names[:1] in (["self"], ["cls"]))
        elif not isinstance(child, ast.ClassDef | ast.Lambda):
            yield from functions(child, place)


def of_file(file: str) -> tuple[str, ...]:
    """Those with too many."""
    tree = ast.parse((SOURCE / file).read_text(encoding="utf-8"))
    return tuple(name for name, count in functions(tree) if count > MOST)


@pytest.mark.parametrize("file", sorted(str(p.relative_to(SOURCE).as_posix()) for p in SOURCE.rglob("*.py")))
def test_no_public_function_takes_more_than_seven(file: str) -> None:
    assert of_file(file) == ()


@pytest.mark.parametrize("code", [
    "def f(a, b, c, d, e, f, g, h): pass",
    "def f(a, b, c, d, *, e, f, g, h): pass",
    "def f(a, /, b, c, d, e, f, *more, **options): pass",
    "class A:\n    def f(self, a, b, c, d, e, f, g, h): pass",
    "class A:\n    def __init__(self, a, b, c, d, e, f, g, h): pass",
    "class A:\n    @classmethod\n    def of(cls, a, b, c, d, e, f, g, h): pass",
    "if True:\n    async def f(a, b, c, d, e, f, g, h): pass",
])  # fmt: skip
def test_eight_are_found(code: str) -> None:
    assert [count for _, count in functions(ast.parse(code))] == [8]


@pytest.mark.parametrize("code", [
    "def _f(a, b, c, d, e, f, g, h): pass",
    "class _A:\n    def f(self, a, b, c, d, e, f, g, h): pass",
    "def f():\n    def g(a, b, c, d, e, f, g, h): pass",
])  # fmt: skip
def test_what_is_not_public_is_not_counted(code: str) -> None:
    assert all(count <= MOST for _, count in functions(ast.parse(code)))


def test_public_names_are_no_folders() -> None:
    """Rationale: `import lidarscene.render` would hide the function of that name."""
    folders = {path.name for path in SOURCE.iterdir() if path.is_dir()}
    assert folders.isdisjoint(lidarscene.__all__)
