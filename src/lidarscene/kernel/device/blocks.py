"""Divide the lanes of a small frame among the cores, as many as its work is worth.

Dr.Jit gives its threads blocks of 16,384 lanes. A frame of 20,000 beams is two blocks, one of them four times the
other, and most cores have nothing to do. Dr.Jit can make blocks smaller, though not from Python: the function that does
so is in its library.
"""

from __future__ import annotations

import ctypes
import functools
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import cast

from .backend import core_function, drjit, is_cuda
from .gate import exclusive

LARGEST_BLOCK = 4_096
"""Largest block, lanes, a quarter of Dr.Jit's own: a millisecond's work of one thread, for which the others spin at the
end of a kernel."""

SMALLEST_BLOCK = 1_024
"""Smallest block, lanes. With 30,000 beams, blocks of 32 cost 6 % more processor time, those of 128 none."""

BLOCKS_PER_THREAD = 4
"""Blocks for each thread: a slower thread, or one with harder rays, then ends little later than the others."""


LANES_PER_THREAD = 4_096
"""Lanes of a frame, some 4 ms of work, for which a further thread is used. Each spins for 20 ms when it has nothing to
do: 32 threads take ten times the processor time of two for a frame of 29,000 beams."""

LANES_PER_LAUNCH = 2**19
"""Lanes of a launch of several small frames on a CPU, with which Python and idle threads take little of the time: half
as many cost vlp-16 3 % and os1-128 5 % more, twice as many save 1 % at most. A sequence is divided evenly into
launches of about so many."""

LANES_PER_CHUNK = 2**20
"""Lanes of a chunk of a large frame on a CPU: some 100 MB of arrays; fewer spend more of their time in Python."""

LANES_PER_LAUNCH_CUDA = 2**21
"""Lanes of a launch on a GPU, of small frames or a chunk of a large one: some 8 ms of work."""


class _Threads:
    """Number of Dr.Jit's threads for small frames, and the number that it had before.

    Attributes:
        most: the most to use: Dr.Jit's own choice, one for each core, or what somebody has set since
        used: what was set here last
        of_frame: those of the frame that was set last
    """

    def __init__(self) -> None:
        self.most = self.used = self.of_frame = 0

    def limit(self, count: int) -> None:
        """Use this many threads from now on, and never more."""
        self.most = self.of_frame = self.used = count
        drjit().set_thread_count(count)

    def set_for(self, lanes: int) -> None:
        """Use as many threads as a frame of so many lanes is worth."""
        self._notice()
        self.of_frame = thread_count(lanes, self.most)
        self._use(self.of_frame)

    def rest(self) -> None:
        """Use one thread for now."""
        self._notice()
        self._use(1)

    def resume(self) -> None:
        """Use the threads of the frame again."""
        self._notice()
        self._use(self.of_frame)

    def _notice(self) -> None:
        """Take over the number that somebody has set since."""
        if (count := drjit().thread_count()) != self.used:
            self.most = self.of_frame = self.used = count

    def _use(self, count: int) -> None:
        if count != self.used:
            self.used = count
            drjit().set_thread_count(count)


_threads = _Threads()


def usable_cores() -> int:
    """Return how many cores of this machine this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def thread_count(lanes: int, most: int) -> int:
    """Return how many threads a frame of so many lanes should have, of ``most``."""
    return max(min(most, lanes // LANES_PER_THREAD), 1)


@exclusive
def use_threads(count: int) -> None:
    """Set the number of Dr.Jit's threads, the most that any frame uses."""
    _threads.limit(count)


def lanes_per_launch() -> int:
    """Return how many lanes several small frames that are traced together should have."""
    return LANES_PER_LAUNCH_CUDA if is_cuda() else LANES_PER_LAUNCH


def lanes_per_chunk(chosen: int | None) -> int:
    """Return the lanes of a chunk of a large frame: the ``chosen`` ones, else no fewer than of a launch."""
    return chosen or (LANES_PER_LAUNCH_CUDA if is_cuda() else LANES_PER_CHUNK)


def share_frame(lanes: int) -> None:
    """Set threads and blocks for a frame or a chunk of so many lanes; results do not depend on it."""
    if not is_cuda():
        _threads.set_for(lanes)
    share_out(lanes)


def rest() -> None:
    """End the threads until `share_out`, within `resting`."""
    if not is_cuda():
        _threads.rest()


@contextmanager
def resting() -> Iterator[None]:
    """End the threads, each of which spins for 20 ms, while Python prepares what comes next.

    Kernels of few operations run on one thread meanwhile. `share_out` brings the threads back for more, and so does
    the end, of an exception too. Whoever sets their number in between to 1 is not noticed.
    """
    rest()
    try:
        yield
    finally:
        if not is_cuda():
            _threads.resume()


def block_size(lanes: int, threads: int) -> int:
    """Return how many lanes a block should have, a power of two."""
    size = LARGEST_BLOCK
    while size > SMALLEST_BLOCK and size * BLOCKS_PER_THREAD * threads > lanes:
        size //= 2
    return size


def share_out(lanes: int) -> None:
    """Set the size of blocks for kernels of so many lanes, with the frame's threads; results do not depend on it."""
    if not is_cuda():
        _threads.resume()
    setter = _block_size_setter()
    if setter is not None:
        setter(block_size(lanes, drjit().thread_count()))


@functools.cache
def _block_size_setter() -> Callable[[int], None] | None:
    """Return Dr.Jit's function that sets the size; None if there is none, as on a GPU."""
    if is_cuda():
        return None
    # `jit_llvm_set_block_size(unsigned int)`. The size is a power of two, at least the width of a packet.
    setter = core_function("_Z23jit_llvm_set_block_sizej")
    if setter is not None:
        setter.argtypes = [ctypes.c_uint32]
    return cast(Callable[[int], None] | None, setter)
