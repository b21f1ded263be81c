"""Doctor: this machine in, a report of what lidarscene can run on it out.

A back end fails for reasons outside of this package (drivers, LLVM). Users see each reason and what helps.
"""

import importlib.metadata
import os
import platform
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ..files.installed_llvm import PATH_VARIABLE, users_path
from ..kernel.device import backend
from ..kernel.device.backend import BackendReport
from ..kernel.device.blocks import usable_cores
from ..kernel.device.gate import exclusive

PACKAGES = (
    "lidarscene",
    "mitsuba",
    "drjit",
    "karellen-llvm-core",
    "numpy",
    "trimesh",
    "pydantic",
    "matplotlib",
    "open3d",
)
SETTINGS = ("LIDARSCENE_VARIANT", PATH_VARIABLE, "DRJIT_LIBCUDA_PATH", "DRJIT_CACHE_DIR", "CUDA_VISIBLE_DEVICES")


@dataclass(frozen=True, slots=True, kw_only=True)
class Findings:
    """What lidarscene can run on this machine.

    Attributes:
        sections: title -> rows of a name and a text
        error: why no back end works, or ""
        healthy: whether rays can be traced here
    """

    sections: dict[str, list[tuple[str, str]]]
    error: str
    healthy: bool

    def as_text(self) -> str:
        """Lines of all sections, and the verdict."""
        lines = []
        for title, rows in self.sections.items():
            lines += [title, *(f"  {name:<20}{_indent(text)}".rstrip() for name, text in rows or [("none", "")])]
        if self.error:
            lines += ["error", "  " + self.error.replace("\n", "\n  ")]
        lines.append("lidarscene can trace rays here" if self.healthy else "lidarscene cannot trace rays here")
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """Entries for JSON; a name that comes twice, such as a library that was looked at, has a list."""
        entries: dict[str, Any] = {}
        for title, rows in self.sections.items():
            texts: dict[str, list[str]] = {}
            for name, text in rows:
                texts.setdefault(_key(name), []).append(text)
            entries[_key(title)] = {name: text[0] if len(text) == 1 else text for name, text in texts.items()}
        return {**entries, "error": self.error or None, "can_trace_rays": self.healthy}


@exclusive
def examine() -> Findings:
    """Examine this machine. Works with a broken back end."""
    settings = {name: os.environ[name] for name in SETTINGS if name in os.environ}
    if not users_path():
        settings.pop(PATH_VARIABLE, None)
    report = backend.probe()
    ray, healthy = _ray(report)
    sections = {
        "machine": list(_machine()),
        "packages": [(name, _version(name)) for name in PACKAGES],
        "settings": list(settings.items()),
        "back ends": list(_backends(report)),
        "proof": [("one ray", ray)],
    }
    return Findings(sections=sections, error=report.error or "", healthy=healthy)


def _key(words: str) -> str:
    """Key of a title or a name in JSON."""
    return words.strip().replace(" ", "_")


def _machine() -> Iterator[tuple[str, str]]:
    yield "Python", f"{platform.python_version()} ({sys.executable})"
    yield "system", platform.platform()
    yield "CPUs", f"{os.cpu_count()}, {usable_cores()} of them usable here"


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def _backends(report: BackendReport) -> Iterator[tuple[str, str]]:
    yield "CUDA", report.cuda
    yield "LLVM", report.llvm
    for candidate in report.candidates:
        yield "  looked at", str(candidate)
    if not report.candidates:
        yield "  looked at", "no library found"
    if report.llvm_loaded:
        yield "  loaded", ".".join(map(str, report.llvm_loaded))
    yield "variant", report.variant or "none"


def _ray(report: BackendReport) -> tuple[str, bool]:
    """Trace one ray against a plate to prove that the back end works."""
    if not report.variant:
        return "not traced", False
    try:
        expected_m, got_m = backend.trace_one_ray()
    except Exception as error:  # the report is for whatever is broken here
        return f"failed: {error}", False
    right = abs(got_m - expected_m) < 1e-4
    verdict = "right" if right else "WRONG"
    return f"plate at {expected_m:.4f} m, range found {got_m:.4f} m: {verdict}", right


def _indent(text: str) -> str:
    return text.replace("\n", "\n" + " " * 22)
