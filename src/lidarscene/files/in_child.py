"""Read foreign bytes in a separate process: a compiled parser of a damaged file may crash, or wait without end.

The child answers requests over a pipe, with a function that it imports. If it dies, or takes longer than a file of
this size may, the file counts as damaged. It ends with its parent, whose end of the pipe closes.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from ..errors import InputError, LidarSceneError, OptionWarning, warn

LEAST_S = 60.0
"""Choice: least time limit [s] of an answer, for a small file on a busy machine."""

SLOWEST_BYTES_S = 2e6
"""Choice: speed at which the time limit of an answer, besides `LEAST_S`, has the whole file read."""

MOST_MEMORY = 16 << 30
"""Bytes of address space of the child, where the system can limit it."""


class Child:
    """Child process that answers requests.

    Args:
        handler: function of a request; it is pickled, so a module's function or an instance of a module's class
    """

    def __init__(self, handler: Callable[..., Any]) -> None:
        # The same modules as here, whatever the environment says.
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)}
        self._process = subprocess.Popen(
            [sys.executable, "-c", f"from {__name__} import serve; serve()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
        )
        self._handler: Callable[..., Any] | None = handler  # until it has been sent

    @property
    def is_alive(self) -> bool:
        """False once the process has ended."""
        return self._process.poll() is None

    def ask(self, path: Path, *request: object) -> Any:
        """Send a request about a file and return its answer. Issues the child's own `OptionWarning`s.

        Raises:
            InputError: if a file, a key or a value cannot be understood
            LidarSceneError: for a missing package
        """
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        watch = threading.Timer(LEAST_S + path.stat().st_size / SLOWEST_BYTES_S, process.kill)
        watch.daemon = True
        watch.start()
        try:
            if self._handler is not None:
                pickle.dump(self._handler, process.stdin)
                self._handler = None
            pickle.dump(request, process.stdin)
            process.stdin.flush()
            error, answer, notes = pickle.load(process.stdout)
        except (OSError, EOFError, pickle.UnpicklingError):
            self.end()
            raise InputError(f"{path}: damaged: its reader ended or did not answer") from None
        finally:
            watch.cancel()
        for note in notes:
            warn(note)
        if error is not None:
            raise error(answer)
        return answer

    def end(self) -> None:
        """End the child."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):  # what was not sent yet
                    pipe.close()


def serve() -> None:
    """Answer the requests on the standard input until it ends; the first object there is their handler."""
    requests, answers = sys.stdin.buffer, _answers()
    _limit_memory()
    handle: Callable[..., Any] = pickle.load(requests)
    while True:
        try:
            request = pickle.load(requests)
        except EOFError:
            return
        reply: tuple[type[LidarSceneError] | None, Any]
        with warnings.catch_warnings(record=True) as notes:
            warnings.simplefilter("always")
            try:
                reply = None, handle(*request)
            except InputError as error:
                reply = InputError, str(error)
            except LidarSceneError as error:
                reply = LidarSceneError, str(error)
            except (Exception, MemoryError) as error:
                reply = InputError, f"damaged: {' '.join(str(error).split())[:200] or type(error).__name__}"
        messages = [note.message for note in notes if isinstance(note.message, OptionWarning)]
        pickle.dump((*reply, messages), answers, protocol=pickle.HIGHEST_PROTOCOL)
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
