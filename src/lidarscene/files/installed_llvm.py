"""LLVM in this Python environment: its path is set when lidarscene is imported, for whoever imports Dr.Jit next.

Dr.Jit looks for LLVM once, while it is imported, and takes the first of the system. With LLVM 15 or 16 the first kernel
aborts the process, so that a program with `import lidarscene` before `import mitsuba` must not get that one. The search
here takes a millisecond: it reads names of files in one folder. `kernel.device.llvm` examines all that a machine has.
"""

from __future__ import annotations

import glob
import itertools
import os
import re
import site
import sys
from collections.abc import Iterable, Iterator

OLDEST = 17  # 15 and 16 abort the process: they cannot select an instruction that Dr.Jit emits (fmaximum)
PATH_VARIABLE = "DRJIT_LIBLLVM_PATH"  # Dr.Jit reads the path of the library from it

_NAME = re.compile(r"libLLVM(-(?P<dashed>\d+(\.\d+)*))?(\.(?P<mac>\d+(\.\d+)*))?\.(so|dylib)(\.(?P<so>\d+(\.\d+)*))?")
_FOLDER = re.compile(r"[/\\](llvm[-@]?|Cellar[/\\]llvm(@\d+)?[/\\])(?P<version>\d+(\.\d+)*)[/\\]")


_written = ""  # what this program wrote to PATH_VARIABLE, to tell it from the user's own path


def users_path() -> str:
    """Return the path that the user has set; "" if there is none, or one of `write_path`."""
    path = os.environ.get(PATH_VARIABLE, "")
    return path if path != _written else ""


def write_path(path: str) -> None:
    """Set the path from which Dr.Jit loads LLVM."""
    global _written
    os.environ[PATH_VARIABLE] = _written = path


def write_newest_path() -> None:
    """Set the path of this environment's newest library, if its name tells that it is usable.

    A path that is set stays; Dr.Jit that is already imported has looked.
    """
    if os.environ.get(PATH_VARIABLE) or "drjit" in sys.modules:
        return
    versions = {path: version_in_name(path) for path in map(os.path.realpath, in_environment()) if is_library(path)}
    path = max(versions, key=lambda path: versions[path], default="")
    if path and versions[path] >= (OLDEST,):
        write_path(path)


def version_in_name(path: str) -> tuple[int, ...]:
    """Read the version from the name of the file or its folder, links followed; () if neither has one."""
    real = os.path.realpath(path)
    name = _NAME.fullmatch(os.path.basename(real))
    folder = _FOLDER.search(real)
    numbers = [name["dashed"], name["mac"], name["so"]] if name else []
    numbers += [folder["version"]] if folder else []
    for text in filter(None, numbers):
        version = tuple(map(int, text.split(".")))
        if version[0] > 3:  # libLLVM.so.1: the version of the binary interface, not of LLVM
            return version
    return ()


def is_library(path: str) -> bool:
    """Return whether a file has the name of an LLVM library."""
    name = os.path.basename(path)
    return bool(name == "LLVM-C.dll" or _NAME.fullmatch(name)) and os.path.isfile(path)


def libraries_in(folders: Iterable[str]) -> Iterator[str]:
    """Yield the files of these folders with the name of an LLVM library."""
    names = {"win32": ["LLVM-C.dll"], "darwin": ["libLLVM*.dylib"]}.get(sys.platform, ["libLLVM*.so*"])
    for folder, name in itertools.product(folders, names):
        yield from glob.iglob(os.path.join(glob.escape(folder), name))


def in_environment() -> Iterator[str]:
    """Yield the same of this Python environment, and of the user's own packages."""
    inside = ("lib", "bin", os.path.join("Library", "bin"))  # the last two on Windows
    folders = [os.path.join(sys.prefix, folder) for folder in inside]
    if site.ENABLE_USER_SITE and site.USER_BASE:
        folders.append(os.path.join(site.USER_BASE, "lib"))
    return libraries_in(folders)
