"""Kernels that Dr.Jit launches, and which of them an earlier block of code did not: those were compiled for it."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from lidarscene.kernel.device.backend import is_cuda
from lidarscene.rendering.simulator import Simulator

Kernel = dict[str, Any]

ASSEMBLING = 300
"""Choice: operations below which a kernel of a GPU puts columns together; those seen have 13 to 258, the smallest that
computes points 409."""


@contextmanager
def launched(after: Sequence[Kernel] | None = None) -> Iterator[list[Kernel]]:
    """The kernels of our formulas that are launched in this block; the list is filled when it ends.

    Args:
        after: kernels launched before, beside which none of the block may be new
    """
    import drjit as dr

    kernels: list[Kernel] = []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.sync_thread()
        dr.kernel_history_clear()
        yield kernels
        dr.sync_thread()
        kernels += dr.kernel_history((dr.KernelType.JIT,))
    if after is not None:
        assert_none_is_new(kernels, after)


def new(later: Sequence[Kernel], before: Sequence[Kernel]) -> list[Kernel]:
    """Kernels that were compiled or loaded in between: neither the first run of a test nor a later one, neither the
    cache on disk nor another test of this process can hide one.

    Dr.Jit calls a kernel from the disk a hit too (`cache_hit`), so `cache_disk` has to be asked as well; and what it
    has in memory may be of another test, so that only what ``before`` launched is known.
    """
    known_hashes = {kernel["hash"] for kernel in before}
    return [
        kernel
        for kernel in later
        if not kernel["cache_hit"] or kernel["cache_disk"] or kernel["hash"] not in known_hashes
    ]


def assert_none_is_new(later: Sequence[Kernel], before: Sequence[Kernel]) -> None:
    """Fails with the number of operations and lanes of each kernel that is; and where none was launched at all.

    On a GPU small ones may be (`ASSEMBLING`): points of chunks, and columns on their way to NumPy, are put together
    there, by a kernel for each set of columns.
    """
    assert before
    assert later
    least = ASSEMBLING if is_cuda() else 0
    missed = [
        (kernel["operation_count"], kernel["size"])
        for kernel in new(later, before)
        if kernel["operation_count"] >= least
    ]
    assert not missed, f"of {len(later)} kernels these are new (operations, lanes): {missed}"


def count_frames(sim: Simulator) -> list[int]:
    """Number of frames of each launch from now on; the list grows."""
    started, start = list[int](), sim._started

    def counted(frames: Sequence[Any], first: int) -> Any:
        started.append(len(frames))
        return start(frames, first)

    sim._started = counted  # type: ignore[method-assign]
    return started
