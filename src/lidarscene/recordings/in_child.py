"""Read a recording in a process of its own, with `files.in_child`."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..files.in_child import Child
from .recording import Recording


def open_in_child(reader: str, path: Path, metadata: Path | None, *options: int) -> Recording:
    """Open a recording in a child process. Raises InputError, also where the child ends.

    reader   module of this package and function that opens it, "ouster_reader.open_ouster"
    options  further arguments of that function
    """
    child = Child(f"{__name__}:handler")
    try:
        count, described, unit_json = child.ask(path, reader, path, metadata, *options)
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


def handler() -> Callable[..., Any]:
    """Function of requests: the first opens the recording and answers its count and metadata, others are frames."""
    recording: Recording | None = None

    def handle(*request: Any) -> Any:
        nonlocal recording
        if recording is not None:
            return recording.read(*request)
        module, _, function = request[0].partition(".")
        opener: Callable[..., Recording] = getattr(importlib.import_module(f"{__package__}.{module}"), function)
        recording = opener(*request[1:])
        return recording.count, dict(recording.metadata), recording.unit_json

    return handle
