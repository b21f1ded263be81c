"""The machine and the versions that a figure belongs to."""

import importlib.metadata
import os
import platform
from pathlib import Path

from lidarscene.kernel.device import backend
from lidarscene.kernel.device.blocks import usable_cores

PACKAGES = (
    "lidarscene",
    "mitsuba",
    "drjit",
    "karellen-llvm-core",
    "numpy",
    "trimesh",
    "scipy",
    "open3d",
    "embreex",
    "mujoco",
    "mujoco-lidar",
    "warp-lang",
)


def description_lines() -> list[str]:
    """Lines of text."""
    report = backend.probe()
    back_end = f"{report.variant}, LLVM {'.'.join(map(str, report.llvm_loaded)) or 'not loaded'}"
    return [
        f"CPU: {_cpu()}, {usable_cores()} of {os.cpu_count()} cores, {_memory()}",
        f"System: {platform.platform()}, Python {platform.python_version()}",
        f"Back end: {back_end}",
        "Packages: " + ", ".join(f"{name} {_version(name)}" for name in PACKAGES),
    ]


def _cpu() -> str:
    facts: dict[str, str] = {}
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            key, _, value = line.partition(":")
            facts.setdefault(key.strip(), value.strip())
    except OSError:
        return platform.processor() or platform.machine()
    name = facts.get("model name", platform.machine())
    family, model = facts.get("cpu family"), facts.get("model")
    return f"{name} (family {family}, model {model}, {facts.get('cpu MHz', '?')} MHz)"


def _memory() -> str:
    try:
        return f"{os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES') / 2**30:.0f} GiB of memory"
    except (AttributeError, ValueError, OSError):
        return "memory unknown"


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "from source" if package == "lidarscene" else "not installed"
