"""Run: the frames of a job that are not there yet, given out to a Dask cluster a few at a time."""

from __future__ import annotations

import itertools
import math
import time
import uuid
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .manifest import write_manifest
from .store import Store
from .tasks import FrameTask, Job
from .work import render_frame

GIVEN_OUT_TO_EACH = 16
"""Frames that the scheduler knows for each thread: enough to keep workers busy, and never millions."""

COUNT_EVERY_S = 5.0
"""How often the cluster's threads are counted."""


@dataclass(slots=True)
class Progress:
    """How far a job is.

    reused  frames that were there already, or come twice in the job
    failed  cause by key
    """

    frames: int
    reused: int = 0
    rendered: int = 0
    failed: dict[str, str] = field(default_factory=dict)

    @property
    def done(self) -> int:
        """Frames of which the end is known."""
        return self.reused + self.rendered + len(self.failed)


Told = Callable[[Progress, FrameTask | None, str], None]
Connect = Callable[[], AbstractContextManager[Any]]


def run_job(
    job: Job, folder: Path, *, connect: Connect, threads: int | None = None, told: Told | None = None
) -> Progress:
    """Render what is missing into ``folder`` and write its manifest.

    connect  gives a Dask client, if there is something to do; ``lambda: nullcontext(client)`` for one's own. All
             workers must see ``folder``, and the files of the job, by the same names
    threads  of Dr.Jit in each worker; as many as Dask gives it if None
    told     called after each frame, with its task and cause if it failed
    Raises OutputError where the manifest cannot be written; failures of frames are in what is returned.
    """
    store = Store(folder.absolute())
    there = bytearray(store.row(task.key) is not None for task in job.tasks())
    progress = Progress(len(there), reused=sum(there))
    if progress.reused < progress.frames:
        missing = itertools.compress(job.tasks(), (not one for one in there))
        with connect() as client:
            _render(missing, _Given(client, store, threads), progress, told or (lambda *_: None))
    write_manifest(job, store, progress.failed)
    return progress


def _render(missing: Iterable[FrameTask], given: _Given, progress: Progress, told: Told) -> None:
    """Give all of these out, never too many at once, and wait for them."""

    def take() -> None:
        task, cause = given.next()
        if cause:
            progress.failed[task.key] = cause
        else:
            progress.rendered += 1
        told(progress, task if cause else None, cause)

    given_out: set[str] = set()
    for task in missing:
        if task.key in given_out:  # twice in the job
            progress.reused += 1
            continue
        given_out.add(task.key)
        given.submit(task)
        while given.is_enough():
            take()
    while given.tasks:
        take()


class _Given:
    """Frames that the cluster has and has not brought back, by the names that Dask knows them by."""

    def __init__(self, client: Any, store: Store, threads: int | None) -> None:
        from distributed import as_completed

        self.tasks: dict[str, FrameTask] = {}
        self._client = client
        self._how = (str(store.folder), threads)
        self._run = uuid.uuid4().hex[:8]  # Dask would give a name that it still knows the answer of the last run
        self._waiting = as_completed(loop=client.loop, with_results=True, raise_errors=False)
        self._counted_s, self._threads = -math.inf, 0

    def submit(self, task: FrameTask) -> None:
        """Give a frame out."""
        name = f"render-{task.key}-{self._run}"
        self._waiting.add(self._client.submit(render_frame, task, *self._how, key=name, pure=False))
        self.tasks[name] = task

    def is_enough(self) -> bool:
        """Whether the cluster, which may grow and shrink, has all that it should have at once."""
        now = time.monotonic()
        if now - self._counted_s > COUNT_EVERY_S:
            self._counted_s, self._threads = now, sum(self._client.nthreads().values())
        return len(self.tasks) >= GIVEN_OUT_TO_EACH * max(1, self._threads)

    def next(self) -> tuple[FrameTask, str]:
        """Wait for one; with what went wrong, if something did."""
        future, result = next(self._waiting)
        return self.tasks.pop(future.key), result if isinstance(result, str) else _cause(result[1])


def _cause(error: Any) -> str:
    """One line of what Dask itself says went wrong."""
    from distributed import KilledWorker

    if isinstance(error, KilledWorker):
        return "every worker that rendered it died, each time anew; was there too little memory?"
    return " ".join(f"{type(error).__name__}: {error}".split())
