"""LLVM for Dr.Jit: this machine in, the path of a shared library that works out.

Dr.Jit compiles for the CPU with LLVM, which it looks for once, while it is imported, and takes what
it finds: it refuses LLVM 14, and with 15 and 16 the first kernel aborts the whole process. So the
library is chosen here, its version known before Dr.Jit is imported. Nothing here loads LLVM into
this process: two of them in one process can clash.
"""

import functools
import glob
import itertools
import os
import platform
import re
import site
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ...errors import BackendError

OLDEST = 17
PATH_VARIABLE = "DRJIT_LIBLLVM_PATH"  # where Dr.Jit reads it
WHEEL = "karellen-llvm-core"  # LLVM as a wheel, for Linux on x86_64
PATIENCE_S = 120  # with a program that is asked: it takes 0.1 s, and far longer on a machine that is busy

_NAME = re.compile(
    r"libLLVM(-(?P<dashed>\d+(\.\d+)*))?(\.(?P<mac>\d+(\.\d+)*))?\.(so|dylib)(\.(?P<so>\d+(\.\d+)*))?"
)
_FOLDER = re.compile(r"[/\\](llvm[-@]?|Cellar[/\\]llvm(@\d+)?[/\\])(?P<version>\d+(\.\d+)*)[/\\]")
_ASK = """
import ctypes, sys
numbers = [ctypes.c_uint() for _ in range(3)]
ctypes.CDLL(sys.argv[1]).LLVMGetVersion(*map(ctypes.byref, numbers))
sys.stdout.write(".".join(str(n.value) for n in numbers))
"""

_chosen: str | None = None  # what use() wrote to PATH_VARIABLE, to tell it from the user's word


@dataclass(frozen=True, slots=True)
class LlvmCandidate:
    """A library that was looked at, and what speaks against it."""

    path: str
    source: str  # who named it
    version: tuple[int, ...]  # empty where it cannot be told
    problem: str = ""

    @property
    def usable(self) -> bool:
        """True where nothing speaks against it."""
        return not self.problem

    def __str__(self) -> str:
        version = ".".join(map(str, self.version)) or "of unknown version"
        return f"LLVM {version}, {self.path} ({self.source}): {self.problem or 'usable'}"


def use() -> None:
    """Tell Dr.Jit which library to load. Raises `BackendError` where there is none."""
    global _chosen
    path = choose().path
    if path != os.environ.get(PATH_VARIABLE):
        os.environ[PATH_VARIABLE] = _chosen = path


def choose() -> LlvmCandidate:
    """The first usable library; the user's word, where given, is final."""
    looked_at = candidates()
    found = []
    for candidate in looked_at:
        if candidate.usable:
            return candidate
        if candidate.source == PATH_VARIABLE:
            other = next((c for c in looked_at if c.usable), None)
            fix = f"unset it, and {other.path} is used" if other else remedy()
            raise BackendError(f"{PATH_VARIABLE}={candidate.path}: {candidate.problem}; try: {fix}")
        found.append(f"\n    {candidate}")
    if not found:
        raise BackendError(f"no LLVM library found; try: {remedy()}")
    raise BackendError(f"no LLVM {OLDEST} or newer found; try: {remedy()}; looked at:{''.join(found)}")


def candidates() -> Iterator[LlvmCandidate]:
    """Every library worth a look, best first: the user's, this environment's, the system's."""
    users = os.environ.get(PATH_VARIABLE)
    if users and users != _chosen:
        yield examine(users, PATH_VARIABLE)
    seen: set[str] = set()
    for source, paths in (
        ("this Python environment", _in_environment),
        (f"wheel {WHEEL}", _in_wheel),
        ("system", _in_system),
    ):
        real = dict.fromkeys(os.path.realpath(p) for p in paths() if _is_library(p))
        batch = [examine(path, source) for path in real if path not in seen]
        seen.update(real)
        yield from sorted(batch, key=lambda c: (c.usable, c.version), reverse=True)


def examine(path: str, source: str) -> LlvmCandidate:
    """What can be told of a library without loading it into this process."""
    bare_name = os.path.basename(path) == path and not os.path.exists(path)  # the loader's business
    if not bare_name and not os.path.isfile(path):
        kind = "a folder, not a library" if os.path.isdir(path) else "no such file"
        return LlvmCandidate(path, source, (), kind)
    version = version_in_name(path)
    try:
        version = version or ask_version(path)
    except BackendError as error:
        return LlvmCandidate(path, source, (), str(error))
    too_old = version[0] < OLDEST
    return LlvmCandidate(path, source, version, f"too old, {OLDEST} or newer is needed" if too_old else "")


def version_in_name(path: str) -> tuple[int, ...]:
    """The version that a file name, or its folder, tells with its links followed; () if none does."""
    real = os.path.realpath(path)
    name = _NAME.fullmatch(os.path.basename(real))
    folder = _FOLDER.search(real)
    told = [name["dashed"], name["mac"], name["so"]] if name else []
    told += [folder["version"]] if folder else []
    for text in filter(None, told):
        version = tuple(map(int, text.split(".")))
        if version[0] > 3:  # libLLVM.so.1: a number of the interface, not of LLVM
            return version
    return ()


@functools.cache
def ask_version(path: str) -> tuple[int, ...]:
    """The version that the library itself tells, in a process of its own (about 0.1 s)."""
    import subprocess

    try:
        answer = subprocess.run(
            [sys.executable, "-I", "-S", "-c", _ASK, path], capture_output=True, text=True, timeout=PATIENCE_S
        )
    except (OSError, ValueError, subprocess.TimeoutExpired) as error:
        raise BackendError(f"its version cannot be asked ({error})") from None
    if answer.returncode == 0 and answer.stdout:
        return tuple(map(int, answer.stdout.split(".")))
    last = (answer.stderr.strip().splitlines() or [f"exit status {answer.returncode}"])[-1]
    if "LLVMGetVersion" in last:  # there since LLVM 16
        raise BackendError(f"too old (before 16), or not LLVM; {OLDEST} or newer is needed")
    raise BackendError(f"it cannot be loaded ({last})")


def remedy() -> str:
    """What to install on this system."""
    if sys.platform == "darwin":
        return "brew install llvm"
    if sys.platform == "win32":
        return f"install LLVM {OLDEST} or newer (winget install LLVM.LLVM)"
    if platform.machine() == "x86_64":
        return f"pip install {WHEEL}"
    return f"install LLVM {OLDEST} or newer (apt install libllvm19, dnf install llvm-libs)"


# --- where to look: generators of paths, links and repetitions welcome -------------------------------


def _is_library(path: str) -> bool:
    name = os.path.basename(path)
    return bool(name == "LLVM-C.dll" or _NAME.fullmatch(name)) and os.path.isfile(path)


def _libraries_in(folders: Iterable[str]) -> Iterator[str]:
    names = {"win32": ["LLVM-C.dll"], "darwin": ["libLLVM*.dylib"]}.get(sys.platform, ["libLLVM*.so*"])
    for folder, name in itertools.product(folders, names):
        yield from glob.iglob(os.path.join(glob.escape(folder), name))


def _in_environment() -> Iterator[str]:
    inside = ("lib", "bin", os.path.join("Library", "bin"))  # the last two on Windows
    return _libraries_in(os.path.join(sys.prefix, folder) for folder in inside)


def _in_wheel() -> Iterator[str]:
    """The wheel where it lies elsewhere: `pip install --user`, `--target`, a path on PYTHONPATH."""
    import importlib.metadata

    if site.ENABLE_USER_SITE and site.USER_BASE:
        yield from _libraries_in([os.path.join(site.USER_BASE, "lib")])
    try:
        wheel = importlib.metadata.distribution(WHEEL)
    except importlib.metadata.PackageNotFoundError:
        return
    yield from (str(wheel.locate_file(file)) for file in wheel.files or ())
    yield from _libraries_in([str(wheel.locate_file("lib"))])


def _in_system() -> Iterator[str]:
    machine = platform.machine()
    if sys.platform == "win32":
        programs = [os.environ.get(v) for v in ("ProgramFiles", "ProgramW6432", "LOCALAPPDATA")]
        folders = [os.path.join(p, "LLVM", "bin") for p in programs if p]
        folders += os.environ.get("PATH", "").split(os.pathsep)
    elif sys.platform == "darwin":
        brew = [os.environ.get("HOMEBREW_PREFIX", "/opt/homebrew"), "/opt/homebrew", "/usr/local"]
        folders = [f for b in brew for f in glob.iglob(f"{b}/opt/llvm*/lib")] + ["/opt/local/lib"]
        folders += glob.glob("/opt/local/libexec/llvm-*/lib")
    else:
        yield from _in_linker_cache(machine)
        folders = [f"/usr/lib/{machine}-linux-gnu", "/usr/lib64", "/usr/lib", "/usr/local/lib"]
        for pattern in (
            "/usr/lib/llvm*/lib",
            "/usr/lib64/llvm*/lib*",
            "/usr/lib/llvm/*/lib64",
            "/opt/llvm*/lib",
        ):
            folders += glob.glob(pattern)
    yield from _libraries_in(folders)


def _in_linker_cache(machine: str) -> Iterator[str]:
    tag = {"x86_64": "x86-64", "aarch64": "AArch64"}.get(machine, "")
    import subprocess

    try:
        cache = subprocess.run(
            ["/sbin/ldconfig", "-p"], capture_output=True, text=True, timeout=PATIENCE_S
        ).stdout
    except (OSError, subprocess.TimeoutExpired):
        return
    for line in cache.splitlines():
        name, arrow, path = line.strip().partition(" => ")
        if arrow and tag in name and Path(path).name.startswith("libLLVM"):
            yield path
