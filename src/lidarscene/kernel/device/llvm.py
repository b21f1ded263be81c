"""Find an LLVM library that Dr.Jit can use.

Dr.Jit compiles CPU kernels with LLVM. It looks for the library once, while it is imported, and takes the first it
finds. It refuses LLVM 14, and with 15 and 16 the first kernel aborts the whole process. So this module chooses the
library, and reads its version before Dr.Jit is imported. It never loads LLVM into this process, because two LLVMs in
one process can clash: the version is read from the file's name, or read by a separate process.
"""

import functools
import glob
import os
import platform
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ...errors import BackendError
from ...files.installed_llvm import (
    OLDEST,
    PATH_VARIABLE,
    is_library,
    libraries_in,
    users_path,
    version_in_name,
    write_path,
)
from ...files.installed_llvm import in_environment as _in_environment

WHEEL = "karellen-llvm-core"  # LLVM as a wheel, for Linux on x86_64
PATIENCE_S = 120  # time limit of a helper process: it takes 0.1 s, and far longer on a busy machine

_ASK = """
import ctypes, sys
numbers = [ctypes.c_uint() for _ in range(3)]
ctypes.CDLL(sys.argv[1]).LLVMGetVersion(*map(ctypes.byref, numbers))
sys.stdout.write(".".join(str(n.value) for n in numbers))
"""


@dataclass(frozen=True, slots=True)
class LlvmCandidate:
    """A library that was examined, and why it cannot be used."""

    path: str
    source: str  # where it was found: an environment variable, this Python environment, the system
    version: tuple[int, ...]  # () if unknown
    problem: str = ""  # "" if it is usable

    @property
    def usable(self) -> bool:
        """True if no problem was found."""
        return not self.problem

    def __str__(self) -> str:
        version = ".".join(map(str, self.version)) or "of unknown version"
        return f"LLVM {version}, {self.path} ({self.source}): {self.problem or 'usable'}"


def use() -> None:
    """Set the path from which Dr.Jit loads LLVM.

    Raises:
        BackendError: if no library is usable
    """
    path = choose().path
    if path != users_path():
        write_path(path)


def choose() -> LlvmCandidate:
    """Return the first usable library. A path that the user has set is final: usable, or `BackendError`."""
    looked_at = candidates()
    rejected = []
    for candidate in looked_at:
        if candidate.usable:
            return candidate
        if candidate.source == PATH_VARIABLE:
            alternative = next((library for library in looked_at if library.usable), None)
            fix = f"unset it, and {alternative.path} is used" if alternative else remedy()
            raise BackendError(f"{PATH_VARIABLE}={candidate.path}: {candidate.problem}; try: {fix}")
        rejected.append(f"\n    {candidate}")
    if not rejected:
        raise BackendError(f"no LLVM library found; try: {remedy()}")
    raise BackendError(f"no LLVM {OLDEST} or newer found; try: {remedy()}; looked at:{''.join(rejected)}")


def candidates() -> Iterator[LlvmCandidate]:
    """Examine all libraries, best first: the user's, this environment's, the wheel's, the system's."""
    if users := users_path():
        yield examine(users, PATH_VARIABLE)
    examined: set[str] = set()
    for source, paths in (
        ("this Python environment", _in_environment),
        (f"wheel {WHEEL}", _in_wheel),
        ("system", _in_system),
    ):
        real = dict.fromkeys(os.path.realpath(path) for path in paths() if is_library(path))
        batch = [examine(path, source) for path in real if path not in examined]
        examined.update(real)
        yield from sorted(batch, key=lambda library: (library.usable, library.version), reverse=True)


def examine(path: str, source: str) -> LlvmCandidate:
    """Return a library's version and problem, without loading it into this process."""
    bare_name = os.path.basename(path) == path and not os.path.exists(path)  # the loader searches for it
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


@functools.cache
def ask_version(path: str) -> tuple[int, ...]:
    """Read the version from the library itself, in a separate process (about 0.1 s).

    Raises:
        BackendError: if Mitsuba has no back end that works on this machine
    """
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
    if "LLVMGetVersion" in last:  # the function came with LLVM 16
        raise BackendError(f"too old (before 16), or not LLVM; {OLDEST} or newer is needed")
    raise BackendError(f"it cannot be loaded ({last})")


def remedy() -> str:
    """Return the command that installs LLVM on this system."""
    if sys.platform == "darwin":
        return "brew install llvm"
    if sys.platform == "win32":
        return f"install LLVM {OLDEST} or newer (winget install LLVM.LLVM)"
    if platform.machine() == "x86_64":
        return f"pip install {WHEEL}"
    return f"install LLVM {OLDEST} or newer (apt install libllvm19, dnf install llvm-libs)"


# --- where to look: generators of paths, links and repetitions welcome -------------------------------


def _in_wheel() -> Iterator[str]:
    """Yield libraries of a wheel installed elsewhere: `pip install --target`, on PYTHONPATH."""
    import importlib.metadata

    try:
        wheel = importlib.metadata.distribution(WHEEL)
    except importlib.metadata.PackageNotFoundError:
        return
    yield from (str(wheel.locate_file(file)) for file in wheel.files or ())
    yield from libraries_in([str(wheel.locate_file("lib"))])


def _in_system() -> Iterator[str]:
    machine = platform.machine()
    if sys.platform == "win32":
        programs = [os.environ.get(variable) for variable in ("ProgramFiles", "ProgramW6432", "LOCALAPPDATA")]
        folders = [os.path.join(program, "LLVM", "bin") for program in programs if program]
        folders += os.environ.get("PATH", "").split(os.pathsep)
    elif sys.platform == "darwin":
        brew = [os.environ.get("HOMEBREW_PREFIX", "/opt/homebrew"), "/opt/homebrew", "/usr/local"]
        folders = [folder for prefix in brew for folder in glob.iglob(f"{prefix}/opt/llvm*/lib")] + ["/opt/local/lib"]
        folders += glob.glob("/opt/local/libexec/llvm-*/lib")
    else:
        yield from _in_linker_cache(machine)
        folders = [f"/usr/lib/{machine}-linux-gnu", "/usr/lib64", "/usr/lib", "/usr/local/lib"]
        for pattern in ("/usr/lib/llvm*/lib", "/usr/lib64/llvm*/lib*", "/usr/lib/llvm/*/lib64", "/opt/llvm*/lib"):
            folders += glob.glob(pattern)
    yield from libraries_in(folders)


def _in_linker_cache(machine: str) -> Iterator[str]:
    """Yield libraries that ldconfig lists for this machine; a system may have those of several architectures."""
    tag = {"x86_64": "x86-64", "aarch64": "AArch64"}.get(machine, "")
    import subprocess

    try:
        cache = subprocess.run(["/sbin/ldconfig", "-p"], capture_output=True, text=True, timeout=PATIENCE_S).stdout
    except (OSError, subprocess.TimeoutExpired):
        return
    for line in cache.splitlines():
        name, arrow, path = line.strip().partition(" => ")
        if arrow and tag in name and Path(path).name.startswith("libLLVM"):
            yield path
