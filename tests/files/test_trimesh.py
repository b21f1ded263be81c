"""The door to trimesh: a signal that comes while it is imported, or reads a file, is not lost."""

import contextlib
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from lidarscene.files import trimesh as door

SWALLOWING = """
import signal
try:
    if came:
        signal.raise_signal(came)
except BaseException:
    pass
ready = True
"""
"""What trimesh does around packages that it may find; a signal comes meanwhile."""


@pytest.fixture
def library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Write a library of this name, during whose import a signal comes; the true one is back when the test ends."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "trimesh", raising=False)
    before = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    door.trimesh.cache_clear()
    yield lambda came: (tmp_path / "trimesh.py").write_text(f"came = {int(came)}{SWALLOWING}", encoding="utf-8")
    door.trimesh.cache_clear()
    signal.signal(signal.SIGINT, before)


def test_ctrl_c_while_it_is_imported_is_heard(library: Any) -> None:
    """Rationale: `certify` went on to its end, as if nobody had pressed it."""
    library(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        door.trimesh()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert door.trimesh().ready


def swallow(number: int, after: Exception | None) -> None:
    """Catch a signal as trimesh's parsers do, and go on with the error ``after``, if it is one."""
    with contextlib.suppress(BaseException):
        signal.raise_signal(number)
    if after is not None:
        raise after


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("after", [None, ValueError("no texture"), KeyError("texture")])
def test_a_signal_that_a_parser_catches_is_heard_behind_it(number: int, after: Exception | None) -> None:
    """A signal is raised where it comes; where it is caught there, or becomes another error, it is raised again."""
    came: list[int] = []

    class Heard(BaseException): ...

    def handler(number: int, _: object) -> None:
        came.append(number)
        raise Heard

    before = signal.signal(number, handler)
    try:
        with pytest.raises(Heard), door.signals_heard():
            swallow(number, after)
        assert came == [number, number]
        with pytest.raises(Heard), door.signals_heard():
            signal.raise_signal(number)
        assert came == [number] * 3
        signal.signal(number, lambda number, _: came.append(number))  # that goes on
        with door.signals_heard():
            signal.raise_signal(number)
        assert came == [number] * 4
    finally:
        signal.signal(number, before)


def test_it_is_imported_by_any_thread_and_where_ctrl_c_is_ignored(library: Any) -> None:
    library(0)
    imported: list[Any] = []
    thread = threading.Thread(target=lambda: imported.append(door.trimesh().ready))
    thread.start()
    thread.join()
    assert imported == [True]
    door.trimesh.cache_clear()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    assert door.trimesh().ready
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
