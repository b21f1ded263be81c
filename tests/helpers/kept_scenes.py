"""Plugin of pytest: a scene of the package is loaded once in a process, and compiled once for a file of tests.

Nobody changes a `Scene` or a `World`, so tests may have the same ones. To load `drive` takes 0.4 s, to compile `car`
0.2 s; together this was a third of what tests that render took. A test with the argument `monkeypatch` has its own: it
may change what makes them. What sensors come to on equal terms is found once, too: it takes a second for two.
"""

import contextlib
import inspect
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import on_import
import pytest

_scenes: dict[tuple[Path, tuple[str, ...]], Any] = {}
_worlds: dict[tuple[object, ...], Any] = {}
_in_use = True
MOST = 4
"""Choice: worlds that are kept; what Dr.Jit compiles depends on all that are alive."""


def _file(path: Path) -> Path:
    """Return a file's whole path; an empty one for what is none, such as names that no system takes."""
    with contextlib.suppress(OSError, ValueError):
        return path.resolve(strict=True)
    return Path()


def _are_texts(overrides: Any) -> bool:
    return isinstance(overrides, list | tuple) and all(isinstance(change, str) for change in overrides)


def trimmed(scene: Any) -> Any:
    """What is kept of a scene; `use_trimmed` leaves bodies out."""
    return scene


def use_trimmed(monkeypatch: pytest.MonkeyPatch, trim: Callable[[Any], Any], scenes: dict[Any, Any]) -> None:
    """Keep scenes in a test that changes other modules, less of each, and in a place of their own."""
    for name, value in (("_in_use", True), ("trimmed", trim), ("_scenes", scenes)):
        monkeypatch.setattr(sys.modules[__name__], name, value)


def _scene_file(module: ModuleType) -> None:
    load = module._loaded

    def loaded(scene: Any, overrides: Any, *, option: str, settings: Any, **others: Any) -> Any:
        # What is given and empty may be refused.
        is_plain = not settings and all(value is None for value in others.values()) and isinstance(scene, str | Path)
        is_plain &= not overrides if overrides is None or isinstance(overrides, dict) else _are_texts(overrides)
        path = _file(module.scene_path(scene)) if is_plain and _in_use else Path()
        if path.parent != module.catalog.folder("scenes").resolve():
            return load(scene, overrides, option=option, settings=settings, **others)
        key = (path, tuple(overrides or ()))
        if key not in _scenes:
            _scenes[key] = trimmed(load(path, key[1], option=option, settings={}))
        return _scenes[key]

    module._loaded = loaded  # type: ignore[attr-defined]


def _simulator(module: ModuleType) -> None:
    build = module.build_world

    def built(scene: Any, *, centre_m: Any, **keywords: Any) -> Any:
        key = (id(scene), centre_m.tobytes(), *sorted(keywords.items()))
        if not _in_use or all(scene is not kept for kept in _scenes.values()):
            return build(scene, centre_m=centre_m, **keywords)
        if key not in _worlds:
            if len(_worlds) == MOST:
                _worlds.clear()
            _worlds[key] = build(scene, centre_m=centre_m, **keywords)
        return _worlds[key]

    module.build_world = built  # type: ignore[attr-defined]


def _equal_terms(module: ModuleType) -> None:
    for name in ("_terms", "verdict"):
        setattr(module, name, _asked_once(getattr(module, name)))


def _asked_once(function: Callable[..., Any]) -> Callable[..., Any]:
    answers: dict[bytes, Any] = {}

    def asked(*given: Any, **keywords: Any) -> Any:
        if not _in_use:
            return function(*given, **keywords)
        key = pickle.dumps((given, keywords))
        if key not in answers:
            answers[key] = function(*given, **keywords)
        return answers[key]

    return asked


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    global _in_use
    _in_use = "monkeypatch" not in inspect.signature(getattr(item, "function", lambda: None)).parameters


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """Worlds go with the file: what is compiled later would depend on those that are there. So do changed scenes."""
    if nextitem is None or nextitem.path != item.path:
        _worlds.clear()
        for key in [key for key in _scenes if key[1]]:
            del _scenes[key]


on_import.change("lidarscene.scene.scene_file", _scene_file)
on_import.change("lidarscene.rendering.simulator", _simulator)
on_import.change("lidarscene.studies.ranging.equal_terms", _equal_terms)
