"""Terminal: prints a command's answer, its one-line error, its notes and its progress.

Names of files may hold letters that a terminal lacks, the reader of a pipe may be gone, a disk full, a stream closed
from the start: none of these may end in a traceback, or cost a file.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, NamedTuple, TextIO, cast

from ..errors import BackendError, LidarSceneError, OptionError, OptionWarning, OutputError
from .options import flag_of

if TYPE_CHECKING:
    from ..figures.report import Report

FIRST_LINE_S, LONGEST_PAUSE_S = 10.0, 300.0
"""Choice: seconds until the first line of progress in a log, and the longest between two."""


class Answer(NamedTuple):
    """Result of a command: text to print, the program's exit code, and the numbers that `--json` prints instead."""

    text: str
    code: int = 0
    numbers: Any = None


def print_text(text: str) -> None:
    """Print a text in any terminal encoding. A closed pipe (`| head`) is no error."""
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    # A terminal of another encoding gets an escape for a letter that it lacks, not a traceback.
    printed = text.rstrip("\n").encode(encoding, "backslashreplace").decode(encoding)
    try:
        sys.stdout.write(printed + "\n")
        sys.stdout.flush()
    except OSError as error:
        _discard(sys.stdout)
        if not isinstance(error, BrokenPipeError):
            raise OutputError(f"standard output: cannot be written: {error.strerror}") from None


def save_report(report: Report, folder: Path) -> Answer:
    """Write a study's report into a folder. The code is 1 if a figure could not be drawn."""
    with progress("files", after_s=1.0) as show:
        report.save(folder, progress=show)
    text = f"{report}\nwrote {folder / report.pages[0]} and the files beside it"
    files = [str(folder / name) for name in report.file_names]
    return Answer(text, 1 if report.undrawn else 0, {**(report.numbers or {}), "files": files})


def print_error(text: str) -> None:
    """Print an error to the error stream, or to standard output if the caller has closed that."""
    line = f"lidarscene: error: {text}"
    if not _ERRORS_TO_STDOUT:
        tell(line)
        return
    with suppress(OutputError):  # both streams are lost
        print_text(line)


def tell(line: str) -> None:
    """Print a line to the error stream at once."""
    sys.stderr.write(f"{line}\n")
    sys.stderr.flush()


_ERRORS_TO_STDOUT: list[bool] = []


class ErrorStream:
    """An error stream that takes everything: progress and notes for a full disk or a closed pipe must not end a run."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write a text, or drop it and all later ones."""
        try:
            return self._stream.write(text)
        except OSError:
            _discard(self._stream)
            return len(text)

    def flush(self) -> None:
        """Write what is buffered, or drop it and all later texts."""
        try:
            self._stream.flush()
        except OSError:
            _discard(self._stream)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def secure_streams() -> None:
    """Open the standard streams that the caller has closed (`2>&-`), and let the error stream take everything.

    Otherwise the next file that is opened would have a closed stream's number, and get what libraries print there.
    Answers then go to the error stream, and errors to standard output; notes and progress are dropped.
    """
    closed = [number for number, stream in enumerate((sys.stdin, sys.stdout, sys.stderr)) if stream is None]
    for _ in closed:
        os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # a file gets the lowest number that is free
    if 0 in closed:
        sys.stdin = os.fdopen(0, closefd=False)
    if 2 in closed:
        sys.stderr = os.fdopen(2, "w", closefd=False)
        _ERRORS_TO_STDOUT.append(True)
    sys.stderr = cast(TextIO, ErrorStream(sys.stderr))
    if 1 in closed:
        sys.stdout = sys.stderr


def _discard(stream: TextIO) -> None:
    """Lead a stream into nothing: Python flushes it once more when it ends, and that must not fail."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def error_text(error: LidarSceneError) -> str:
    """Message of an error, with the command line's names of options."""
    text = error.message_with(flag_of) if isinstance(error, OptionError) else str(error)
    # The advice of a BackendError takes several lines; all other messages take one.
    return text if isinstance(error, BackendError) else _with_path_last(printable(text))


def _with_path_last(text: str) -> str:
    """Message that begins with the mistake: the files that it begins with come behind it."""
    paths: list[str] = []
    while True:
        where, _, mistake = text.partition(": ")
        path, _, option = where.partition(" --")
        if not mistake or not _is_file(path, mistake):
            return f"{text} ({', of '.join(paths)})" if paths else text
        paths.insert(0, path)
        text = f"--{option}: {mistake}" if option else mistake


def _is_file(word: str, mistake: str) -> bool:
    """Whether the first word of a message names a file: keys have dots, too."""
    return mistake.startswith("no such ") or os.path.isabs(word) or ("." in word and os.path.exists(word))


def mute_errors() -> None:
    """Close the error stream at exit: compiled libraries report objects there that they think are leaked."""
    with suppress(OSError, ValueError):
        sys.stderr.flush()
        _discard(sys.stderr)


def printable(text: str) -> str:
    """Escape unprintable letters of a text, so that it stays one line whatever a file's name or a value holds."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def end_cleanly() -> None:
    """Make SIGTERM (sent by `timeout`, a cluster, a system that goes down) end the program as Ctrl-C does; note both.

    Without this Python ends at once at SIGTERM, and leaves half-written files. Libraries turn what a signal raises
    within them into errors of their own: after Ctrl-C while Dr.Jit is imported no back end works.
    """

    def end(number: int, frame: FrameType | None) -> None:
        _ENDED_BY.append(number)
        if number == signal.SIGINT:
            signal.default_int_handler(number, frame)
        signal.signal(number, signal.SIG_IGN)
        sys.exit(128 + number)

    signal.signal(signal.SIGTERM, end)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else it is ignored, as `nohup` and `&` ask
        signal.signal(signal.SIGINT, end)


_ENDED_BY: list[int] = []


def ended_by() -> int | None:
    """Number of the signal that ends the program; None before one came."""
    return _ENDED_BY[0] if _ENDED_BY else None


_QUIET: list[bool] = []


@contextmanager
def quietly(quiet: bool) -> Iterator[None]:
    """Hide all progress inside the block, if ``quiet``."""
    _QUIET.append(quiet)
    try:
        yield
    finally:
        _QUIET.pop()


def is_quiet() -> bool:
    """Whether the command that runs is to show no progress."""
    return any(_QUIET)


@contextmanager
def explained(text: str, *, after_s: float = 1.0) -> Iterator[None]:
    """Print a line to the error stream if the block takes longer than ``after_s``."""

    def explain() -> None:
        tell(f"lidarscene: {text}")

    timer = threading.Timer(after_s, explain)
    timer.daemon = True
    if not is_quiet():
        timer.start()
    try:
        yield
    finally:
        timer.cancel()


class Lines:
    """Progress of a run as plain lines in a log: the first after ten seconds, then fewer and fewer.

    The time left is estimated from the steps after the first: that one waits for files, compilers and worker processes.
    """

    def __init__(self, counted: str, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._counted, self._clock = counted, clock
        self._since = clock()
        self._next_s = FIRST_LINE_S
        self._first: tuple[float, int] | None = None

    def __call__(self, finished: int, total: int, words: str = "") -> None:
        """Print a line if one is due; with words on what there is so far."""
        from ..outputs.size import duration_text

        seconds = self._clock() - self._since
        if self._first is None and finished > 0:
            self._first = seconds, finished
        if is_quiet() or seconds < self._next_s or not 0 < finished < total:
            return
        assert self._first is not None
        first_s, first = self._first
        line = f"{finished:,} of {total:,} {self._counted} ({finished / total:.1%})"
        if finished > first:
            self._next_s = seconds + min(seconds, LONGEST_PAUSE_S)
            line += f", some {duration_text((seconds - first_s) * (total - finished) / (finished - first))} left"
        else:
            self._next_s = seconds + FIRST_LINE_S
        tell(f"lidarscene: {line}{'; ' if words else ''}{words}")


@contextmanager
def progress(counted: str, *, after_s: float = 0.0, logged: bool = False) -> Iterator[Callable[..., None]]:
    """Give a function of (finished, total) steps that shows progress: a bar on a terminal, removed at the end.

    It takes words on what there is so far as a third argument, if there are any.

    Args:
        counted: name of the steps
        after_s: time before the bar appears: a shorter run has none
        logged: whether `Lines` are printed where the error stream is no terminal
    """
    if is_quiet() or not sys.stderr.isatty():
        yield Lines(counted) if logged else lambda finished, total, words="": None
        return
    since = time.monotonic()
    bars: list[Callable[[int, str], None]] = []
    with ExitStack() as opened:

        def report(finished: int, total: int, words: str = "") -> None:
            if not bars and time.monotonic() - since >= after_s:
                bars.append(opened.enter_context(_bar(counted, total)))
            for bar in bars:
                bar(finished, words)

        yield report


@contextmanager
def _bar(counted: str, total: int) -> Iterator[Callable[[int, str], None]]:
    """Show a bar until the block ends; loads `rich`, which no other run needs."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(counted, total=total)
        yield lambda finished, words: bar.update(
            task, completed=finished, description=f"{counted}: {words}" if words else counted
        )


@contextmanager
def notes() -> Iterator[None]:
    """Print each `OptionWarning` as a one-line note, once, as soon as it is issued.

    Warnings of libraries are for programmers, who ask for them with Python's -W.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("always", OptionWarning)
        show_other, printed = warnings.showwarning, set[str]()

        def show(message: Any, *about: Any, **more: Any) -> None:
            if isinstance(message, OptionWarning):
                note = printable(message.message_with(flag_of))
                if note not in printed:
                    printed.add(note)
                    tell(f"lidarscene: note: {note}")
            elif sys.warnoptions:
                show_other(message, *about, **more)

        warnings.showwarning = show
        yield
