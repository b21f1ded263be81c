"""Share the lanes of a small frame out among all cores.

Dr.Jit gives its threads blocks of 16,384 lanes. A frame of 20,000 beams is two blocks, one of them four times the
other, and most cores have nothing to do. Dr.Jit can make blocks smaller, though not from Python: the function that does
so is in its library.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable
from pathlib import Path
from typing import cast

from .backend import drjit, is_cuda

LARGEST = 16_384
"""Dr.Jit's own, in lanes."""

LEAST = 1_024
"""Lanes of a block: of a frame of 30,000 beams, blocks of 32 take 6 % more of the cores, those of 128 no more."""

BLOCKS = 4
"""For each thread, so that one that is slower, or has the harder rays, does not end last by much."""


def block_of(lanes: int, threads: int) -> int:
    """Return how many lanes a block should have, a power of two."""
    size = LARGEST
    while size > LEAST and size * BLOCKS * threads > lanes:
        size //= 2
    return size


def share_out(lanes: int) -> None:
    """Set the size of blocks for kernels of so many lanes; results do not depend on it."""
    setter = _setter()
    if setter is not None:
        setter(block_of(lanes, drjit().thread_count()))


@functools.cache
def _setter() -> Callable[[int], None] | None:
    """Return what sets the size, or None where there is no such function, as on a GPU."""
    if is_cuda():
        return None
    folder = Path(str(drjit().__file__)).parent
    for name in ("libdrjit-core.so", "libdrjit-core.dylib"):
        try:
            # The name as C++ compilers of Linux and macOS write it, of a function of one `unsigned int`: lanes, a power
            # of two and no fewer than a packet has.
            set_block_size = ctypes.CDLL(str(folder / name))._Z23jit_llvm_set_block_sizej
        except (OSError, AttributeError):
            continue
        set_block_size.argtypes, set_block_size.restype = [ctypes.c_uint32], None
        return cast(Callable[[int], None], set_block_size)
    return None
