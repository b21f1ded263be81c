"""The door to Open3D: opened by the system's libusb or by the packaged one, and what it says when shut."""

import ctypes
import importlib.util
import sys
from collections.abc import Iterator
from types import ModuleType

import pytest
from helpers.mistakes import told

from lidarscene.errors import LidarSceneError
from lidarscene.files import open3d as open3d_door

MODULE = ModuleType("open3d")
WAY_OUT = "pip install 'lidarscene[open3d]' | pip install open3d"
NO_LIBUSB = ImportError("libusb-1.0.so.0: cannot open shared object file: No such file or directory")


@pytest.fixture(autouse=True)
def _forget() -> Iterator[None]:
    """Every test opens the door anew, and leaves nothing of its own behind it."""
    open3d_door.open3d.cache_clear()
    yield
    open3d_door.open3d.cache_clear()


def queue_imports(monkeypatch: pytest.MonkeyPatch, *results: ModuleType | Exception) -> list[str]:
    """Have the import give these results one after the other; returns a log of what was done."""
    log: list[str] = []
    queue = list(results)

    def import_next() -> ModuleType:
        log.append("import")
        result = queue.pop(0)
        if isinstance(result, Exception):
            raise result
        return result

    monkeypatch.setattr(open3d_door, "_import", import_next)
    monkeypatch.setattr(open3d_door, "_preload_libusb", lambda: log.append("libusb") or True)
    return log


def test_a_plain_import_is_enough_and_done_once(monkeypatch: pytest.MonkeyPatch) -> None:
    log = queue_imports(monkeypatch, MODULE)
    assert open3d_door.open3d() is open3d_door.open3d() is MODULE
    assert log == ["import"]


def test_libusb_is_loaded_only_where_it_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    log = queue_imports(monkeypatch, NO_LIBUSB, MODULE)
    assert open3d_door.open3d() is MODULE
    assert log == ["import", "libusb", "import"]


@pytest.mark.parametrize(
    ("error", "named"),
    [
        (ModuleNotFoundError("No module named 'open3d'"), WAY_OUT),
        (NO_LIBUSB, "pip install libusb-package | apt install libusb-1.0-0"),
        (OSError("libGL.so.1: cannot open\nshared object file"), "apt install | libgl1"),
        (ImportError("/lib/libm.so.6: version `GLIBC_2.38' not found"), "apt install"),
        (ImportError("numpy.core.multiarray failed to import"), "--force-reinstall"),
    ],
)
def test_shut_it_says_in_one_line_why_and_what_to_do(monkeypatch, error, named):
    queue_imports(monkeypatch, error)
    monkeypatch.setattr(open3d_door, "_preload_libusb", lambda: False)
    with told(f"Open3D cannot be imported | {' '.join(str(error).split())} | {named}", LidarSceneError):
        open3d_door.open3d()


def test_what_fails_after_libusb_is_what_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    queue_imports(monkeypatch, NO_LIBUSB, OSError("libGL.so.1: cannot open shared object file"))
    with told("libGL.so.1 | apt install", LidarSceneError):
        open3d_door.open3d()


def test_a_failure_is_not_remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: a notebook user installs what was missing and tries again."""
    queue_imports(monkeypatch, ModuleNotFoundError("No module named 'open3d'"), MODULE)
    with pytest.raises(LidarSceneError):
        open3d_door.open3d()
    assert open3d_door.open3d() is MODULE


def test_without_the_module_it_is_the_module_that_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    with told(WAY_OUT, LidarSceneError):
        open3d_door.open3d()


def test_libusb_may_be_missing_or_broken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert not open3d_door._preload_libusb()
    monkeypatch.undo()

    def raise_os_error(*_: object, **__: object) -> None:
        raise OSError("invalid ELF header")

    monkeypatch.setattr(ctypes, "CDLL", raise_os_error)
    assert not open3d_door._preload_libusb()


def test_the_real_door(open3d: ModuleType) -> None:
    """Rationale: on a machine without libusb only the packaged one makes this work."""
    assert open3d_door.open3d() is open3d
    assert open3d.t.geometry.RaycastingScene is not None
