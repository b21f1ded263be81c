"""A recording: a file of one or many frames, which are read one at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from ..errors import InputError
from .sweep import Sweep


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """The frames of a file: `len`, `[frame]` and iteration; a context manager that closes the file.

    count       number of frames
    read        function from a frame's number to its sweep
    close_file  function that closes the file
    metadata    text by key: format, sensor, mode, ...
    """

    path: Path
    count: int
    read: Callable[[int], Sweep]
    close_file: Callable[[], None] = lambda: None
    metadata: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, frame: int) -> Sweep:
        """Read the sweep of this number, from 0; from the end if negative. Raises InputError beyond the recording."""
        if not -self.count <= frame < self.count:
            raise InputError(f"{self.path}: frame must be 0 to {self.count - 1}, got {frame}")
        return self.read(frame % self.count)

    def __iter__(self) -> Iterator[Sweep]:
        return (self.read(frame) for frame in range(self.count))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close_file()
