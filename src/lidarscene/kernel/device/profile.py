"""Profile: what Dr.Jit launched and compiled, counted from its history, and the memory that the process held."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from .backend import mitsuba


@dataclass(slots=True)
class KernelHistory:
    """Kernels of our formulas; what Dr.Jit brings ready-made (memory set, compression) counts as ``helpers``.

    compiled    new to this process and to the cache on disk
    from_disk   compiled by an earlier process
    compile_s   LLVM's or the driver's time; 0 where nothing was compiled
    codegen_s   from the recorded operations to the text of kernels, every launch
    device_s    of all kernels and helpers
    """

    launched: int = 0
    compiled: int = 0
    from_disk: int = 0
    helpers: int = 0
    codegen_s: float = 0.0
    compile_s: float = 0.0
    device_s: float = 0.0

    def take(self) -> None:
        """Count what has run since the last call. Call it after every frame: the history keeps kernels' texts."""
        import drjit as dr

        dr.sync_thread()
        for one in dr.kernel_history():
            self.device_s += 1e-3 * one["execution_time"]
            if one["type"] != dr.KernelType.JIT:
                self.helpers += 1
                continue
            self.launched += 1
            self.from_disk += bool(one["cache_disk"])
            self.compiled += not (one["cache_hit"] or one["cache_disk"])
            self.codegen_s += 1e-3 * one["codegen_time"]
            self.compile_s += 1e-3 * one["backend_time"]


@contextmanager
def kernel_history() -> Iterator[KernelHistory]:
    """Have Dr.Jit write down what it runs; what is taken when the block ends counts too."""
    mitsuba()
    import drjit as dr

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        history = KernelHistory()
        yield history
        dr.kernel_history_clear()


def peak_memory_bytes() -> int | None:
    """The most that this process has held at once; None where the system does not tell.

    Linux's own count goes before getrusage's, in which a process begins with what its parent held.
    """
    with suppress(OSError, ValueError):
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return 1024 * int(line.split()[1])
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak
