"""Read a recording in a process of its own: a compiled parser of foreign bytes may crash, or wait without end.

The child opens the recording and answers with its sweeps over a pipe. If it dies, or takes longer than a file of this
size may, the recording counts as damaged. It ends with its parent, whose end of the pipe closes.
"""

from __future__ import annotations

import importlib
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from ..errors import InputError, LidarSceneError
from .recording import Recording

LEAST_S = 60.0
SLOWEST_BYTES_S = 2e6
"""Time limit of an answer: at least `LEAST_S`, and as if the whole file were read for each at this speed."""

MOST_MEMORY = 16 << 30
"""Bytes of address space of the child, where the system can limit it."""


def open_in_child(reader: str, path: Path, metadata: Path | None, *options: int) -> Recording:
    """Open a recording in a child process. Raises InputError, also where the child ends.

    reader   module of this package and function that opens it, "ouster_reader.open_ouster"
    options  further arguments of that function
    """
    child = _Child(path)
    try:
        count, described, unit_json = child.ask(reader, path, metadata, *options)
    except BaseException:
        child.end()
        raise
    return Recording(
        path=path, count=count, read=child.ask, close_file=child.end, metadata=described, unit_json=unit_json
    )


class _Child:
    """Child process that serves one recording."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._limit_s = LEAST_S + path.stat().st_size / SLOWEST_BYTES_S
        # The same modules as here, whatever the environment says.
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)}
        self._process = subprocess.Popen(
            [sys.executable, "-c", f"from {__name__} import serve; serve()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
        )

    def ask(self, *request: object) -> Any:
        """Send a request and return its answer. Raises InputError, and LidarSceneError for a missing package."""
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        watch = threading.Timer(self._limit_s, process.kill)
        watch.daemon = True
        watch.start()
        try:
            pickle.dump(request, process.stdin)
            process.stdin.flush()
            error, answer = pickle.load(process.stdout)
        except (OSError, EOFError, pickle.UnpicklingError):
            self.end()
            raise InputError(f"{self._path}: damaged: its reader ended or did not answer") from None
        finally:
            watch.cancel()
        if error is not None:
            raise error(answer)
        return answer

    def end(self) -> None:
        """End the child."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()


def serve() -> None:
    """Answer the requests on the standard input until it ends: first the recording, then frames by number."""
    requests, answers = sys.stdin.buffer, _answers()
    _limit_memory()
    recording: Recording | None = None
    while True:
        try:
            request = pickle.load(requests)
        except EOFError:
            return
        try:
            if recording is None:
                module, _, function = request[0].partition(".")
                opener: Callable[..., Recording] = getattr(importlib.import_module(f"{__package__}.{module}"), function)
                recording = opener(*request[1:])
                answer: Any = recording.count, dict(recording.metadata), recording.unit_json
            else:
                answer = recording.read(*request)
            reply: tuple[type[LidarSceneError] | None, Any] = (None, answer)
        except InputError as error:
            reply = InputError, str(error)
        except LidarSceneError as error:
            reply = LidarSceneError, str(error)
        except (Exception, MemoryError) as error:
            reply = InputError, f"damaged: {' '.join(str(error).split())[:200] or type(error).__name__}"
        pickle.dump(reply, answers, protocol=pickle.HIGHEST_PROTOCOL)
        answers.flush()


def _answers() -> IO[bytes]:
    """Pipe for answers; what libraries print goes to the error stream in its place."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    return answers


def _limit_memory() -> None:
    """Limit the address space, where the system can."""
    try:
        import resource
    except ImportError:  # Windows
        return
    resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # a crash is expected, and its memory is of no use
