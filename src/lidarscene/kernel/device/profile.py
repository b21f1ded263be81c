"""Count the kernels that Dr.Jit launches and compiles, and read the peak memory of the process.

Compiling a kernel costs 10 to 500 ms, running it often less than one. Whether a second frame compiles anything decides
its speed, and cannot be seen from its results. So `--profile` and the tests count kernels from Dr.Jit's own history.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from .backend import mitsuba


@dataclass(slots=True)
class KernelHistory:
    """Counts and times of kernels.

    Attributes:
        launched: kernels of recorded operations
        compiled: those of them that neither this process nor the cache on disk had
        from_disk: those that an earlier process compiled
        helpers: launches of Dr.Jit's ready-made kernels, such as filling memory or compressing a mask
        codegen_s: time from recorded operations to the text of kernels; every launch needs it
        compile_s: time of LLVM or of the GPU's driver; 0 if nothing was compiled
        device_s: run time of all kernels and helpers
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
        for kernel in dr.kernel_history():
            self.device_s += 1e-3 * kernel["execution_time"]
            if kernel["type"] != dr.KernelType.JIT:
                self.helpers += 1
                continue
            self.launched += 1
            self.from_disk += bool(kernel["cache_disk"])
            self.compiled += not (kernel["cache_hit"] or kernel["cache_disk"])
            self.codegen_s += 1e-3 * kernel["codegen_time"]
            self.compile_s += 1e-3 * kernel["backend_time"]


@contextmanager
def kernel_history() -> Iterator[KernelHistory]:
    """Have Dr.Jit keep a history of its kernels within the block. Call `take` of the result to count them."""
    mitsuba()
    import drjit as dr

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        history = KernelHistory()
        yield history
        dr.kernel_history_clear()


def peak_memory_bytes() -> int | None:
    """Return the largest resident memory of this process so far; None if the system does not say."""
    # Linux's own count comes first: by getrusage a process starts with the peak of its parent.
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
