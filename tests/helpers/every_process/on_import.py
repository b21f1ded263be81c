"""Change a module of the program, or a library, right after it is imported; neither knows of it."""

import importlib.abc
import importlib.machinery
import sys
from collections.abc import Callable, Sequence
from types import ModuleType

_changes: dict[str, Callable[[ModuleType], None]] = {}


def change(name: str, function: Callable[[ModuleType], None]) -> None:
    """Call the function with the module of this name, now or when it is imported; once."""
    if name in _changes:
        return
    _changes[name] = function
    if name in sys.modules:
        function(sys.modules[name])


class _Importer(importlib.abc.MetaPathFinder):
    """Imports the modules that are to be changed as the other finders do, and changes each right after."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if name not in _changes:
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path, target)
        if spec is None or spec.loader is None:
            return None
        execute = spec.loader.exec_module

        def executed(module: ModuleType) -> None:
            execute(module)
            _changes[name](module)

        spec.loader.exec_module = executed  # type: ignore[method-assign]
        return spec


sys.meta_path.insert(0, _Importer())
