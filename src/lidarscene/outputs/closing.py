"""Closing of files on threads: frames' files are completed while the next frames are traced.

What is left to do for a frame whose points are computed takes long and needs no device: its points are written, boxes
are counted, and each file waits until the disk has it. Several frames do so at once, since a disk serves many that wait
as fast as one; they are no more than have the points of one chunk. Where a file has a line for each frame, the frames
go on `in_turn`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from types import TracebackType
from typing import Self

from ..kernel.device import blocks

MOST_FRAMES = 4
"""Choice: frames whose files are completed at once. A frame waits four times for the disk, up to 10 ms each time; a GPU
takes 10 to 20 ms for a frame."""


class Closing:
    """Threads that complete the files of frames; they are complete when the block ends.

    Args:
        frames: number of frames whose files are completed at once
    """

    def __init__(self, frames: int = 1) -> None:
        self._threads = ThreadPoolExecutor(max_workers=frames)
        self._frames: deque[Future[None]] = deque()
        self._most = frames

    def __call__(self, files: ExitStack) -> None:
        """Take a frame's files, and complete them; wait until those of earlier frames are, but for the last ones.

        Raises:
            OutputError: if those of an earlier frame cannot be written; these stay where they are
        """
        self._wait(self._most - 1)
        self._frames.append(self._threads.submit(files.pop_all().close))

    def in_turn(self) -> Callable[[], object]:
        """Return a function that waits until the files of the last frame are complete, and raises what that raised."""
        return self._frames[-1].result if self._frames else lambda: None

    def _wait(self, left: int) -> None:
        while len(self._frames) > left:
            self._frames.popleft().result()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        try:
            if error is None:
                self._wait(0)
        finally:
            self._threads.shutdown()


def frames_at_once(pulses: int, chunk: int | None) -> int:
    """Return how many frames may be in memory beside the next one while their files are completed; 0: none.

    Args:
        chunk: `FrameOptions.chunk`
    """
    return min(blocks.lanes_per_chunk(chunk) // pulses, MOST_FRAMES)
