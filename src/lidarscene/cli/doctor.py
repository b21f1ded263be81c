"""Doctor: this machine in, a report of what lidarscene can run on it out.

A back end fails for reasons outside of this package (drivers, LLVM). Users see each reason and what helps.
"""

import importlib.metadata
import os
import platform
import sys
from collections.abc import Iterator

from ..kernel.device import backend
from ..kernel.device.backend import BackendReport

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
SETTINGS = ("LIDARSCENE_VARIANT", "DRJIT_LIBLLVM_PATH", "DRJIT_LIBCUDA_PATH", "DRJIT_CACHE_DIR", "CUDA_VISIBLE_DEVICES")


def run_doctor() -> tuple[str, bool]:
    """Text of the report, and whether rays can be traced here. Works with a broken back end."""
    settings = {name: os.environ[name] for name in SETTINGS if name in os.environ}
    report = backend.probe()
    ray, healthy = _ray(report)
    sections = {
        "machine": _machine(),
        "packages": ((name, _version(name)) for name in PACKAGES),
        "settings": settings.items() or [("none", "")],
        "back ends": _backends(report),
        "proof": [("one ray", ray)],
    }
    lines = []
    for title, rows in sections.items():
        lines += [title, *(f"  {name:<20}{_indent(text)}".rstrip() for name, text in rows)]
    if report.error:
        lines += ["error", "  " + report.error.replace("\n", "\n  ")]
    lines.append("lidarscene can trace rays here" if healthy else "lidarscene cannot trace rays here")
    return "\n".join(lines), healthy


def _machine() -> Iterator[tuple[str, str]]:
    yield "Python", f"{platform.python_version()} ({sys.executable})"
    yield "system", platform.platform()
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    yield "CPUs", f"{os.cpu_count()}, {usable} of them usable here"


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
