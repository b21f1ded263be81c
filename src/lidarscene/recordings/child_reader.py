"""Read a recording in a separate process, with `files.in_child`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..files.in_child import Child
from .recording import Recording


def open_in_child(opener: Callable[..., Recording], path: Path, *options: Any) -> Recording:
    """Open a recording in a child process by `opener(path, *options)`.

    Raises:
        InputError: also where the child ends
    """
    child = Child(_Frames(opener))
    try:
        count, described, unit_json = child.ask(path, path, *options)
    except BaseException:
        child.end()
        raise
    return Recording(
        path=path,
        count=count,
        read=lambda frame: child.ask(path, frame),
        close_file=child.end,
        metadata=described,
        unit_json=unit_json,
    )


class _Frames:
    """Answers of the child: the first request opens the recording, later ones are numbers of frames."""

    def __init__(self, opener: Callable[..., Recording]) -> None:
        self.opener = opener
        self.recording: Recording | None = None

    def __call__(self, *request: Any) -> Any:
        if self.recording is not None:
            return self.recording.read(*request)
        self.recording = self.opener(*request)
        return self.recording.count, dict(self.recording.metadata), self.recording.unit_json
