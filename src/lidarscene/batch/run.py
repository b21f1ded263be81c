"""Run: the frames of a job that are not there yet, given out to a Dask cluster a few at a time."""

from __future__ import annotations

import itertools
import math
import pickle
import threading
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
from .work import ELSEWHERE, THERE, render_frames

BUNDLE_S = 1.0
"""How long a worker should be busy with what it is given at once: Dask needs some 7 ms for each time."""

MOST_IN_BUNDLE = 100
"""Frames."""

BUNDLES_FOR_EACH = 2
"""That the scheduler knows for each thread, one of them waiting: more would be bound to a worker that turns out to be
the slower one.
"""

AGAIN_EVERY_S = 1.0
"""How often frames are asked for that another run was at."""

WITHOUT_WORKERS_S = 120.0
"""How long a cluster of this machine may be without any worker. Dask starts a new one for each that dies, which takes
three quarters of a minute where eight other programs run, but none for one that dies while it starts.
"""

STARTS = 3
"""Clusters that are tried without a frame that one of them ends."""

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
    job: Job,
    folder: Path,
    *,
    connect: Connect,
    threads: int | None = None,
    told: Told | None = None,
    waiting: Callable[[], object] = lambda: None,
) -> Progress:
    """Render what is missing into ``folder`` and write its manifest.

    connect  gives a Dask client, if there is something to do; ``lambda: nullcontext(client)`` for one's own. All
             workers must see ``folder``, and the files of the job, by the same names. It is called again if all
             workers of a cluster of this machine are gone
    threads  of Dr.Jit in each worker; as many as Dask gives it if None
    told     called after each frame, with its task and cause if it failed
    waiting  called when the cluster has had no worker for a while
    Other runs may be at work in the same folder: each frame is rendered by one of them.
    Raises OutputError where the manifest cannot be written, LidarSceneError where the scheduler or the workers end
    before the job does; failures of frames are in what is returned.
    """
    store = Store(folder.absolute())
    there = bytearray(store.row(task.key) is not None for task in job.tasks())
    progress = Progress(len(there), reused=sum(there))
    ended: dict[str, bool] = {}
    starts = 0
    while progress.done < progress.frames:
        missing = itertools.compress(job.tasks(), (not one for one in there))
        progress.reused = sum(there) + sum(ended.values())
        before = len(ended)
        try:
            with connect() as client, _Given(client, store, threads, waiting) as given:
                _render(missing, given, progress, told or (lambda *_: None), ended)
        except (_SchedulerGone, _WorkersGone) as error:
            # A cluster of this machine is made anew; one of others is theirs.
            starts = 1 if len(ended) > before else starts + 1
            if isinstance(error, _WorkersGone) and starts < STARTS:
                continue
            gone = "Dask scheduler has" if isinstance(error, _SchedulerGone) else "workers of this machine are"
            raise LidarSceneError(
                f"the {gone} gone; {progress.done:,} of {progress.frames:,} frames were done, and the same command "
                "goes on from there"
            ) from error
    write_manifest(job, store, progress.failed)
    return progress


def _render(
    missing: Iterator[FrameTask], given: _Given, progress: Progress, told: Told, ended: dict[str, bool]
) -> None:
    """Give all of these out, never too many at once, and wait for them.

    ended  keys of the frames of which the end is known, with whether another run did them
    """
    elsewhere: list[FrameTask] = []

    def take() -> None:
        for task, cause in given.next():
            if cause == ELSEWHERE:
                elsewhere.append(task)
                continue
            ended[task.key] = cause == THERE
            if cause == THERE:
                progress.reused += 1
            elif cause:
                progress.failed[task.key] = cause
            else:
                progress.rendered += 1
            failed = task.key in progress.failed
            told(progress, task if failed else None, cause if failed else "")

    seen: set[str] = set()
    left = progress.frames - progress.reused
    while bundle := list(itertools.islice(missing, given.share(left))):
        left -= len(bundle)
        once = list({task.key: task for task in bundle if task.key not in seen}.values())
        progress.reused += len(bundle) - len(once)  # twice in the job
        seen.update(task.key for task in once)
        if new := [task for task in once if task.key not in ended]:
            given.submit(new)
        while given.is_enough():
            take()
    while given.bundles:
        take()
    # What another run was at is done by now, or its run was killed, or we wait for it.
    while elsewhere:
        for task in elsewhere:
            given.submit([task])
        elsewhere.clear()
        while given.bundles:
            take()
        if elsewhere:
            time.sleep(AGAIN_EVERY_S)


class _SchedulerGone(Exception):
    """Raised when the scheduler answers no more."""


class _WorkersGone(Exception):
    """Raised when a cluster of this machine has had no worker for too long."""


class _Given:
    """Bundles of frames that the cluster has and has not brought back, by the names that Dask knows them by."""

    def __init__(self, client: Any, store: Store, threads: int | None, waiting: Callable[[], object]) -> None:
        from distributed import as_completed

        self.bundles: dict[str, list[FrameTask]] = {}
        self._client = client
        self._how = (str(store.folder), threads)
        self._names = (f"render-{uuid.uuid4().hex}-{number}" for number in itertools.count())
        self._waiting = as_completed(loop=client.loop, with_results=True, raise_errors=False)
        self._counted_s, self._threads = -math.inf, 1
        self._frame_s = BUNDLE_S
        self._futures: dict[str, Any] = {}
        self._over, self._no_workers, self._told_waiting = threading.Event(), False, waiting

    def __enter__(self) -> _Given:
        threading.Thread(target=self._watch, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()

    def _watch(self) -> None:
        """Notice when there is no worker left: a bundle that no one has never comes back."""
        since, was_told = time.monotonic(), False
        while not self._over.wait(min(COUNT_EVERY_S, WITHOUT_WORKERS_S / 4.0)):
            try:
                is_any = bool(self._client.nthreads())
            except Exception:  # a scheduler that is gone is noticed by who waits for its frames
                return
            if is_any:
                since, was_told = time.monotonic(), False
            elif time.monotonic() - since > WITHOUT_WORKERS_S:
                if not was_told:
                    self._told_waiting()
                was_told = True
                if self._client.cluster is not None:
                    self._no_workers = True
                    self._client.cancel(list(self._futures.values()), force=True)
                    return

    def share(self, left: int) -> int:
        """How many frames the next bundle should have if so many are left."""
        by_time = int(BUNDLE_S / max(self._frame_s, 1e-3))
        return max(1, min(by_time, MOST_IN_BUNDLE, left // (2 * self._count())))

    def submit(self, bundle: list[FrameTask]) -> None:
        """Give some frames out, to be rendered one after the other."""
        name = next(self._names)  # a new one in each run: Dask would answer an old one from its memory
        call = pickle.dumps(_Call(bundle, *self._how))
        self._futures[name] = self._client.submit(pickle.loads, call, key=name, pure=False)
        self._waiting.add(self._futures[name])
        self.bundles[name] = bundle
        if self._no_workers:  # they were gone before this one was there to be cancelled
            raise _WorkersGone

    def is_enough(self) -> bool:
        """Whether the cluster has all that it should have at once."""
        return len(self.bundles) >= BUNDLES_FOR_EACH * self._count()

    def next(self) -> list[tuple[FrameTask, str]]:
        """Wait for a bundle; its frames, with what went wrong, if something did."""
        future, result = next(self._waiting)
        bundle = self.bundles.pop(future.key)
        self._futures.pop(future.key, None)
        if future.cancelled():  # if by no one here, it is how Dask says that the scheduler is gone
            raise _WorkersGone if self._no_workers else _SchedulerGone
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
