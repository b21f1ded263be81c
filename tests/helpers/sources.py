"""Syntax trees of Python files, for the tests of names and of imports."""

import ast
import gc
from functools import cache
from pathlib import Path


def parse(code: str) -> ast.Module:
    """The tree of a file's code, without a search for garbage while it grows, which takes four times as long."""
    gc.disable()
    try:
        return ast.parse(code)
    finally:
        gc.enable()


@cache
def parsed(folder: Path) -> dict[Path, ast.Module]:
    """Trees of all Python files below a folder, through which no search for garbage goes."""
    trees = {path: parse(path.read_text(encoding="utf-8")) for path in sorted(folder.rglob("*.py"))}
    gc.freeze()
    return trees
