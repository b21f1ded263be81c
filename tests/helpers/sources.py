"""Python files that are in no package, as modules, and syntax trees, for the tests of names and of imports."""

import ast
import gc
import importlib.util
from functools import cache
from pathlib import Path
from types import ModuleType


def module_of(path: Path) -> ModuleType:
    """The module of a file, made anew by each call."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


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
