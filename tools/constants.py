#!/usr/bin/env python3
"""Numbers of the code that have a name, and what each says of itself: its source, the accuracy it buys, or a choice.

`tools/constants.py` prints them all as a table of Markdown, `tools/constants.py Choice` those of one word.
"""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

SOURCE = Path(__file__).parents[1] / "src" / "lidarscene"

WORDS = ("Source", "Accuracy bought", "Choice")
"""What the docstring below a constant begins with, before a colon."""

WRITTEN = ("array", "geomspace", "linspace", "radians")
"""Functions of numbers that are a way to write others."""


class Constant(NamedTuple):
    """A named number: its line, name or names, code, word (None: it says none of `WORDS`), and what it says then."""

    line: int
    name: str
    code: str
    word: str | None
    text: str


def constants(code: str) -> Iterator[Constant]:
    """Constants of a module and its classes that are written in fractional numbers; others if they have a word.

    What is computed from other constants shows where it is from.
    """
    module = ast.parse(code)
    for owner in [module, *(node for node in ast.walk(module) if isinstance(node, ast.ClassDef))]:
        for statement, following in zip(owner.body, [*owner.body[1:], None], strict=True):
            targets = statement.targets if isinstance(statement, ast.Assign) else [getattr(statement, "target", None)]
            names = [node.id for target in targets if target for node in ast.walk(target) if isinstance(node, ast.Name)]
            value = getattr(statement, "value", None)
            if value is None or not names or not all(name.strip("_").isupper() for name in names):
                continue
            words, _, text = _docstring(following).partition(": ")
            word = words if words in WORDS else None
            if word or _is_fractional(value):
                yield Constant(statement.lineno, ", ".join(names), ast.unparse(value), word, " ".join(text.split()))


def _docstring(statement: ast.stmt | None) -> str:
    value = statement.value if isinstance(statement, ast.Expr) else None
    return value.value if isinstance(value, ast.Constant) and isinstance(value.value, str) else ""


def _is_fractional(value: ast.expr) -> bool:
    return _is_written(value) and any(isinstance(getattr(node, "value", None), float) for node in ast.walk(value))


def _is_written(value: ast.expr) -> bool:
    """Whether a value stands in the code as it is."""
    if isinstance(value, ast.Call):
        return (
            isinstance(value.func, ast.Attribute) and value.func.attr in WRITTEN and all(map(_is_written, value.args))
        )
    try:
        ast.literal_eval(value)
    except ValueError:
        return False
    return True


def table(words: tuple[str, ...]) -> str:
    """Table of the constants that begin with one of the words."""
    lines = ["| where | constant | value | is | of |", "|---|---|---|---|---|"]
    for path in sorted(SOURCE.rglob("*.py")):
        for constant in constants(path.read_text(encoding="utf-8")):
            if constant.word in words:
                value = constant.code if len(constant.code) <= 60 else f"{constant.code[:57]}..."
                place = f"{path.relative_to(SOURCE).as_posix()}:{constant.line}"
                cells = (place, f"`{constant.name}`", f"`{value}`", constant.word.lower(), constant.text)
                lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(table(tuple(sys.argv[1:]) or WORDS))
