"""Closing of files on a thread: a frame's files are completed while the next frame is traced.

What is left to do for a frame whose points are written takes long and needs no device: boxes are counted, and each file
waits until the disk has it. The frames are completed in order, since some files have a line for each; never more than
one at a time, so that no more than two frames are in memory.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from types import TracebackType
from typing import Self

from ..kernel.device import blocks


class Closing:
    """Thread that completes the files of frames; they are complete when the block ends."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1)
        self._frame: Future[None] | None = None

    def __call__(self, files: ExitStack) -> None:
        """Take a frame's files, and complete them; wait until those of the frame before are complete.

        Raises:
            OutputError: if those of the frame before cannot be written; these stay where they are
        """
        self._wait()
        self._frame = self._thread.submit(files.pop_all().close)

    def _wait(self) -> None:
        if self._frame is not None:
            frame, self._frame = self._frame, None
            frame.result()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        try:
            if error is None:
                self._wait()
        finally:
            self._thread.shutdown()


def fits_beside_next(pulses: int, chunk: int | None) -> bool:
    """Return whether a frame is so small that it may be in memory beside the next one.

    Args:
        chunk: `FrameOptions.chunk`
    """
    return pulses <= blocks.lanes_per_chunk(chunk)
