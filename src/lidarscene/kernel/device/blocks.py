"""Divide the lanes of a small frame among all cores.

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

LARGEST_BLOCK = 16_384
"""Dr.Jit's own size of a block, lanes."""

SMALLEST_BLOCK = 1_024
"""Smallest block, lanes. With 30,000 beams, blocks of 32 cost 6 % more processor time, those of 128 none."""

BLOCKS_PER_THREAD = 4
"""Blocks for each thread: a slower thread, or one with harder rays, then ends little later than the others."""


def block_size(lanes: int, threads: int) -> int:
    """Return how many lanes a block should have, a power of two."""
    size = LARGEST_BLOCK
    while size > SMALLEST_BLOCK and size * BLOCKS_PER_THREAD * threads > lanes:
        size //= 2
    return size


def share_out(lanes: int) -> None:
    """Set the size of blocks for kernels of so many lanes; results do not depend on it."""
    setter = _block_size_setter()
    if setter is not None:
        setter(block_size(lanes, drjit().thread_count()))


@functools.cache
def _block_size_setter() -> Callable[[int], None] | None:
    """Return Dr.Jit's function that sets the size; None if there is none, as on a GPU."""
    if is_cuda():
        return None
    folder = Path(str(drjit().__file__)).parent
    for name in ("libdrjit-core.so", "libdrjit-core.dylib"):
        try:
            # Mangled name (Itanium ABI: Linux and macOS) of `jit_llvm_set_block_size(unsigned int)`. The size is a
            # power of two, at least the width of a packet.
            set_block_size = ctypes.CDLL(str(folder / name))._Z23jit_llvm_set_block_sizej
        except (OSError, AttributeError):
            continue
        set_block_size.argtypes, set_block_size.restype = [ctypes.c_uint32], None
        return cast(Callable[[int], None], set_block_size)
    return None
