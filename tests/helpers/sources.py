"""Syntax trees of Python files, for the tests of names and of imports."""

import ast
import gc
from functools import cache
from pathlib import Path


@cache
def parsed(folder: Path) -> dict[Path, ast.Module]:
    """Trees of all Python files below a folder.

    No search for garbage goes through them, neither while they grow, which takes four times as long, nor later.
    """
    gc.disable()
    try:
        return {path: ast.parse(path.read_text(encoding="utf-8")) for path in sorted(folder.rglob("*.py"))}
    finally:
        gc.freeze()
        gc.enable()
