"""The door to trimesh: a signal that comes while it is imported is not lost."""

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
