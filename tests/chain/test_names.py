"""Public names and docstrings: a class has a name of its own, and a docstring the form that tools read."""

import ast
import re
from collections import defaultdict
from functools import cache
from pathlib import Path

import pytest
from helpers.sources import parsed

ROOT = Path(__file__).parents[2]
FOLDERS = ("src", "tests", "tools", "benchmarks", "docs")

PREPOSITION = re.compile(
    r"(About|Above|Across|After|Against|Along|Among|Around|As|At|Before|Behind|Below|Beneath|Beside|Between|Beyond|By|"
    r"Despite|During|Except|For|From|In|Inside|Into|Like|Near(?! field| infrared)|Of|Off|On|Onto|Out|Outside|Over|Per|"
    r"Since|Than|Through|To|Toward|Towards|Under|Until|Upon|Via|With|Within|Without)\b(?!-)"
)
ENTRY = re.compile(r"^    (\w+):", re.MULTILINE)
# A name, two spaces and what it is: no tool reads that.
COLUMNS = re.compile(r"^\w+(, \w+)* {2,}\S", re.MULTILINE)

Documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


@cache
def documented(folder: str) -> tuple[tuple[str, Documented, str], ...]:
    """Place, node and docstring of all that has one."""
    return tuple(
        (f"{path.relative_to(ROOT)} {getattr(node, 'name', '')}", node, text)
        for path, module in parsed(ROOT / folder).items()
        for node in statements(module)
        if isinstance(node, Documented) and (text := ast.get_docstring(node))
    )


def statements(module: ast.Module) -> list[ast.AST]:
    """A module and all statements in it, without their expressions, which are most of the tree."""
    found: list[ast.AST] = [module]
    for node in found:
        found += [part for part in ast.iter_child_nodes(node) if isinstance(part, ast.stmt | ast.excepthandler)]
    return found


def section(text: str, title: str) -> list[str]:
    """Names of the entries of a section of a docstring."""
    found = re.search(rf"^{title}:\n((?:    .*\n?)+)", text, re.MULTILINE)
    return ENTRY.findall(found[1]) if found else []


def fields(node: ast.ClassDef, classes: dict[str, ast.ClassDef]) -> set[str]:
    """Names that a class, or a base of it, declares, assigns to itself or takes."""
    names: set[str] = set()
    for part in ast.walk(node):
        if isinstance(part, ast.Name | ast.Attribute) and isinstance(part.ctx, ast.Store):
            names.add(part.id if isinstance(part, ast.Name) else part.attr)
        elif isinstance(part, ast.arg):
            names.add(part.arg)
        elif isinstance(part, ast.FunctionDef) and part.decorator_list:
            names.add(part.name)
    for base in node.bases:
        name = re.split(r"[.\[]", ast.unparse(base))
        names |= fields(classes[name[-1]], classes) if name[-1] in classes and name[-1] != node.name else set()
    return names


def test_public_classes_have_names_of_their_own() -> None:
    """A reader who meets a class in one place may look its name up."""
    places = defaultdict(list)
    for place, node, _ in documented("src"):
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            places[node.name].append(place)
    assert {name: files for name, files in places.items() if len(files) > 1} == {}


@pytest.mark.parametrize("folder", FOLDERS)
def test_docstrings_open_with_what_they_are_about(folder: str) -> None:
    """A verb or a noun; a preposition goes on a sentence that is not there."""
    assert [place for place, _, text in documented(folder) if PREPOSITION.match(text)] == []


@pytest.mark.parametrize("folder", FOLDERS)
def test_docstrings_name_what_is_there(folder: str) -> None:
    """Entries of Args are parameters, those of Attributes are fields, and none stands in columns."""
    everything = (*documented("src"), *documented(folder))
    classes = {node.name: node for _, node, _ in everything if isinstance(node, ast.ClassDef)}
    wrong = []
    for place, node, text in documented(folder):
        if isinstance(node, ast.Module):
            continue
        if entries := section(text, "Args") + section(text, "Attributes"):
            of_class = isinstance(node, ast.ClassDef)
            there = (
                fields(node, classes) if of_class else {a.arg for a in ast.walk(node.args) if isinstance(a, ast.arg)}
            )
            wrong += [f"{place}: {name}" for name in entries if name not in there]
        wrong += [f"{place}: {line[0]}" for line in COLUMNS.finditer(text)]
    assert wrong == []
