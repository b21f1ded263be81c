"""Run: the frames of a job that are not there yet, given out to a Dask cluster a few at a time."""

from __future__ import annotations

import itertools
import math
import pickle
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import LidarSceneError
from .manifest import write_manifest
from .store import Store
from .tasks import FrameTask, Job
from .work import render_frames

BUNDLE_S = 1.0
"""How long a worker should be busy with what it is given at once: Dask needs some 7 ms for each time."""

MOST_IN_BUNDLE = 100
"""Frames."""

BUNDLES_FOR_EACH = 2
"""That the scheduler knows for each thread, one of them waiting: more would be bound to a worker that turns out to be
the slower one.
"""

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
    Raises OutputError where the manifest cannot be written, LidarSceneError where the scheduler ends before the job
    does; failures of frames are in what is returned.
    """
    store = Store(folder.absolute())
    there = bytearray(store.row(task.key) is not None for task in job.tasks())
    progress = Progress(len(there), reused=sum(there))
    if progress.reused < progress.frames:
        missing = itertools.compress(job.tasks(), (not one for one in there))
        with connect() as client:
            try:
                _render(missing, _Given(client, store, threads), progress, told or (lambda *_: None))
            except _SchedulerGone as error:
                raise LidarSceneError(
                    f"the Dask scheduler has gone; {progress.done:,} of {progress.frames:,} frames were done, and the "
                    "same command goes on from there"
                ) from error
    write_manifest(job, store, progress.failed)
    return progress


def _render(missing: Iterator[FrameTask], given: _Given, progress: Progress, told: Told) -> None:
    """Give all of these out, never too many at once, and wait for them."""

    def take() -> None:
        for task, cause in given.next():
            if cause:
                progress.failed[task.key] = cause
            else:
                progress.rendered += 1
            told(progress, task if cause else None, cause)

    seen: set[str] = set()
    left = progress.frames - progress.reused
    while bundle := list(itertools.islice(missing, given.share(left))):
        left -= len(bundle)
        new = list({task.key: task for task in bundle if task.key not in seen}.values())
        progress.reused += len(bundle) - len(new)  # twice in the job
        seen.update(task.key for task in new)
        if new:
            given.submit(new)
        while given.is_enough():
            take()
    while given.bundles:
        take()


class _SchedulerGone(Exception):
    """Raised when the scheduler answers no more."""


class _Given:
    """Bundles of frames that the cluster has and has not brought back, by the names that Dask knows them by."""

    def __init__(self, client: Any, store: Store, threads: int | None) -> None:
        from distributed import as_completed

        self.bundles: dict[str, list[FrameTask]] = {}
        self._client = client
        self._how = (str(store.folder), threads)
        self._names = (f"render-{uuid.uuid4().hex}-{number}" for number in itertools.count())
        self._waiting = as_completed(loop=client.loop, with_results=True, raise_errors=False)
        self._counted_s, self._threads = -math.inf, 1
        self._frame_s = BUNDLE_S

    def share(self, left: int) -> int:
        """How many frames the next bundle should have if so many are left."""
        by_time = int(BUNDLE_S / max(self._frame_s, 1e-3))
        return max(1, min(by_time, MOST_IN_BUNDLE, left // (2 * self._count())))

    def submit(self, bundle: list[FrameTask]) -> None:
        """Give some frames out, to be rendered one after the other."""
        name = next(self._names)  # a new one in each run: Dask would answer an old one from its memory
        call = pickle.dumps(_Call(bundle, *self._how))
        self._waiting.add(self._client.submit(pickle.loads, call, key=name, pure=False))
        self.bundles[name] = bundle

    def is_enough(self) -> bool:
        """Whether the cluster has all that it should have at once."""
        return len(self.bundles) >= BUNDLES_FOR_EACH * self._count()

    def next(self) -> list[tuple[FrameTask, str]]:
        """Wait for a bundle; its frames, with what went wrong, if something did."""
        future, result = next(self._waiting)
        bundle = self.bundles.pop(future.key)
        if future.cancelled():  # by no one here: it is how Dask says that the scheduler is gone
            raise _SchedulerGone
        if future.status == "finished":
            causes, seconds = result
            self._frame_s = seconds / len(bundle)
            return list(zip(bundle, causes, strict=True))
        if len(bundle) == 1:
            return [(bundle[0], _cause(result[1]))]
        for task in bundle:  # alone, to know which of them it is; those that are done cost nothing
            self.submit([task])
        return []

    def _count(self) -> int:
        """Threads of the cluster, which may grow and shrink."""
        now = time.monotonic()
        if now - self._counted_s > COUNT_EVERY_S:
            try:
                threads = sum(self._client.nthreads().values())
            except OSError as error:
                raise _SchedulerGone from error
            self._counted_s, self._threads = now, max(1, threads)
        return self._threads


class _Call:
    """What a worker is to do, done by unpickling it: in the task, where a worker without lidarscene fails it with that
    cause, and not on the way to it, where Dask ends the worker.
    """

    def __init__(self, bundle: list[FrameTask], folder: str, threads: int | None) -> None:
        self._arguments = (bundle, folder, threads)

    def __reduce__(self) -> tuple[Any, ...]:
        return render_frames, self._arguments


def _cause(error: Any) -> str:
    """One line of what Dask itself says went wrong."""
    from distributed import KilledWorker

    if isinstance(error, KilledWorker):
        return "every worker that rendered it died, each time anew; was there too little memory?"
    return " ".join(f"the worker said {type(error).__name__}: {error}".split())
