"""What a terminal is told: a command's answer, its one line of complaint, its notes; whatever letters it has.

Names of files may hold letters that a terminal lacks, and a reader may be gone: neither may end in a traceback.
"""

from __future__ import annotations

import os
import signal
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple

from ..errors import BackendError, LidarSceneError, OptionError, OptionWarning, OutputError

OPTIONS = {
    "path": "--output",
    "missed": "--keep-missed",
    "truth": "--no-truth",
    "begin_s": "--begin",
    "overrides": "--set",
    "scene_overrides": "--scene-set",
}
"""Options by their names in Python, where it is not the same with dashes."""


FIRST_LINE_S, LONGEST_PAUSE_S = 10.0, 300.0


class Answer(NamedTuple):
    """What a command says, and the code that the program ends with."""

    text: str
    code: int = 0


def option(name: str) -> str:
    """How the command line calls an option of the library."""
    return OPTIONS.get(name, f"--{name.replace('_', '-')}")


def say(text: str) -> None:
    """Print a text, whatever the terminal's encoding. A reader that has gone (`| head`) is no mistake."""
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    # A terminal of another encoding gets an escape for a letter that it lacks, not a traceback.
    shown = text.rstrip("\n").encode(encoding, "backslashreplace").decode(encoding)
    try:
        sys.stdout.write(shown + "\n")
        sys.stdout.flush()
    except OSError as error:
        # Python writes what is left once more when it ends: to nowhere, then.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not isinstance(error, BrokenPipeError):
            raise OutputError(f"standard output: cannot be written: {error.strerror}") from None


def complain(text: str) -> None:
    """Say what went wrong."""
    sys.stderr.write(f"lidarscene: error: {text}\n")


def told(error: LidarSceneError) -> str:
    """The message of an error, with the names that the command line has for options."""
    text = error.message_with(option) if isinstance(error, OptionError) else str(error)
    # How to get a back end takes several lines; everything else is told in one.
    return text if isinstance(error, BackendError) else printable(text)


def printable(text: str) -> str:
    """In one line, whatever a file's name or a value holds."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def end_cleanly() -> None:
    """Let SIGTERM, of `timeout`, a cluster or a system that goes down, end the program as Ctrl-C does.

    Else Python ends at once, and leaves what is written only in part.
    """

    def end(number: int, _: object) -> None:
        signal.signal(number, signal.SIG_IGN)
        _ENDED_BY.append(number)
        sys.exit(128 + number)

    signal.signal(signal.SIGTERM, end)


_ENDED_BY: list[int] = []


def ended_by() -> int | None:
    """The signal that ends the program, once it has come."""
    return _ENDED_BY[0] if _ENDED_BY else None


class Lines:
    """How far a run is, as plain lines in a log: the first after ten seconds, then fewer and fewer."""

    def __init__(self, of: str, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._of, self._clock = of, clock
        self._since = clock()
        self._next_s = FIRST_LINE_S

    def __call__(self, done: int, total: int) -> None:
        """So many of so many are done."""
        from ..outputs.size import in_words

        seconds = self._clock() - self._since
        if seconds < self._next_s or not 0 < done < total:
            return
        self._next_s = seconds + min(seconds, LONGEST_PAUSE_S)
        left = in_words(seconds * (total - done) / done)
        sys.stderr.write(f"lidarscene: {done:,} of {total:,} {self._of} ({done / total:.1%}), some {left} left\n")
        sys.stderr.flush()


@contextmanager
def progress(of: str, *, after_s: float = 0.0, logged: bool = False) -> Iterator[Callable[[int, int], None]]:
    """Who is told that (done, total) of a run's steps are done: a bar on a terminal, gone at the end.

    of       what is counted
    after_s  a run that is shorter has no bar
    logged   whether a log, in place of a terminal, has `Lines`
    """
    if not sys.stderr.isatty():
        yield Lines(of) if logged else lambda done, total: None
        return
    since = time.monotonic()
    bars: list[Callable[[int], None]] = []
    with ExitStack() as shown:

        def told(done: int, total: int) -> None:
            if not bars and time.monotonic() - since >= after_s:
                bars.append(shown.enter_context(_bar(of, total)))
            for bar in bars:
                bar(done)

        yield told


@contextmanager
def _bar(of: str, total: int) -> Iterator[Callable[[int], None]]:
    """A bar; its package is loaded no earlier."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(of, total=total)
        yield lambda done: bar.update(task, completed=done)


@contextmanager
def notes() -> Iterator[None]:
    """Options that change nothing are noted in one line each, when they are noticed."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", OptionWarning)
        others = warnings.showwarning

        def show(message: Any, *about: Any, **more: Any) -> None:
            if isinstance(message, OptionWarning):
                sys.stderr.write(f"lidarscene: note: {printable(message.message_with(option))}\n")
            else:
                others(message, *about, **more)

        warnings.showwarning = show
        yield
