"""Dispatch: hand the missing frames of a job out to a Dask cluster, a few at a time."""

from __future__ import annotations

import functools
import itertools
import math
import os
import pickle
import signal
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import LidarSceneError
from .dataset import Place, require_no_other_clouds, write_tables
from .drives import DriveTask, drives_of
from .manifest import write_manifest
from .store import Store
from .tasks import FrameTask, Job
from .work import ELSEWHERE, REUSED, render_frames

BUNDLE_S = 1.0
"""Choice: work [s] in one bundle of frames: Dask needs some 7 ms for each bundle."""

MOST_IN_BUNDLE = 100
"""Most frames in one bundle."""

BUNDLES_FOR_EACH = 2
"""Bundles queued per thread; more would pin work to slow workers."""

AGAIN_EVERY_S = 1.0
"""Choice: interval at which frames are tried again that another run was rendering."""

WITHOUT_WORKERS_S = 120.0
"""Choice: longest time that a cluster of this machine may be without any worker. Dask replaces a worker that dies,
which takes three quarters of a minute where eight other programs run, but not one that dies while it starts."""

SILENT_S = 30.0
"""Choice: time without a heartbeat after which a worker counts as stopped, or a tenth of a second for each worker of a
large cluster. Dask's workers send one every half second, and every 1 + n / 200 s if there are n, from a thread that
does not render: compiling a world delays them by 0.2 s."""

UNKNOWN_S = 900.0
"""Choice: time limit of a bundle before any has come back: worlds are compiled, and files come over a network."""

LEAST_LIMIT_S = 60.0
"""Choice: shortest time limit of a bundle: a shorter one would call a busy machine dead."""

LATENESS = 20.0
"""Choice: time of a bundle over what it and those before it on its worker should take, beyond which it is late, after
`LEAST_LIMIT_S` at least. Frames of one job differ, and so do machines; a worker whose disk is dead sends heartbeats,
but never a frame."""

STARTS = 3
"""Consecutive clusters that may end without finishing a frame."""

COUNT_EVERY_S = 5.0
"""Choice: interval at which the cluster's threads are counted."""


@dataclass(slots=True)
class Progress:
    """Progress of a job.

    Attributes:
        frames: number of frames in the job
        reused: frames that were in the folder before, or occur twice in the job
        rendered: frames rendered by this run
        failed: key of a frame -> cause of its failure
    """

    frames: int
    reused: int = 0
    rendered: int = 0
    failed: dict[str, str] = field(default_factory=dict)

    @property
    def finished(self) -> int:
        """Frames that are reused, rendered or failed."""
        return self.reused + self.rendered + len(self.failed)


FrameCallback = Callable[[Progress, FrameTask | None, str], None]
Bundle = Sequence[FrameTask | DriveTask]
Connect = Callable[[], AbstractContextManager[Any]]


def run_job(
    job: Job,
    folder: Path,
    *,
    connect: Connect,
    threads: int | None = None,
    report: FrameCallback | None = None,
    waiting: Callable[[str], object] = lambda _: None,
) -> Progress:
    """Render the missing frames of a job into ``folder``; write its manifest and, if none failed, a data set's tables.

    Other runs may work in the same folder: each frame is rendered by one of them.

    Args:
        connect: gives a Dask client, called if frames are missing; ``lambda: nullcontext(client)`` for an existing
            client. All workers must see ``folder``, and the files of the job, by the same names. It is called again if
            all workers of a cluster of this machine are gone
        threads: threads of Dr.Jit in each worker; None: those of the Dask worker
        report: called after each frame, with its task and cause if it failed
        waiting: called with a line when the cluster has had no worker for a while, or when a worker is silent or hangs:
            its frames are given to another, and it is ended where that is possible

    Raises:
        InputError: for a folder with clouds of another data set
        OutputError: where the manifest cannot be written
        LidarSceneError: where a drive's file cannot be written, or where the scheduler or the workers end before the
            job does; the result lists frames that failed
    """
    store = Store(folder.absolute())
    require_no_other_clouds(store.folder, (task.place for task in job.tasks()))
    drives = drives_of(job.tasks())
    unwritten, written = _sort_drives(drives, store)
    stored = bytearray(task.key in written or store.row(task.key) is not None for task in job.tasks())
    causes: dict[Path, str] = {}
    progress = Progress(len(stored), reused=sum(stored))
    ended: dict[str, bool] = {}
    starts = 0
    while progress.finished < progress.frames or unwritten:
        missing = itertools.compress(job.tasks(), (not is_stored for is_stored in stored))
        progress.reused = sum(stored) + sum(ended.values())
        before = len(ended)
        try:
            with connect() as client, _Dispatcher(client, store, threads, waiting) as dispatcher:
                _render(missing, dispatcher, progress, report or (lambda *_: None), ended)
                _write_drives(unwritten, dispatcher, progress, causes)
        except (_SchedulerGone, _WorkersGone) as error:
            # A cluster of this machine is started again; a remote one is not ours to start.
            starts = 1 if len(ended) > before else starts + 1
            if isinstance(error, _WorkersGone) and starts < STARTS:
                continue
            subject = "Dask scheduler has" if isinstance(error, _SchedulerGone) else "workers of this machine are"
            raise LidarSceneError(
                f"the {subject} gone; {progress.finished:,} of {progress.frames:,} frames were done, and the same "
                "command goes on from there"
            ) from error
    for key in write_manifest(job, store, progress.failed, drives):
        if ended.get(key, True):
            progress.reused -= 1
        else:
            progress.rendered -= 1
        progress.failed[key] = "its files are gone, the same command renders it again"
    for file, cause in causes.items():
        raise LidarSceneError(
            f"{store.folder / file}: {cause}; its frames are kept, the same command goes on from there"
        )
    if job.file.dataset is not None and not progress.failed:
        write_tables(store.folder, functools.partial(_rows, job, store))
    return progress


def _sort_drives(drives: Sequence[DriveTask], store: Store) -> tuple[list[DriveTask], set[str]]:
    """Return the whole drives without a file, and the keys of the frames of all others."""
    unwritten: list[DriveTask] = []
    written: set[str] = set()
    for drive in drives:
        if store.row(drive.key) is None:
            unwritten.append(drive)
        else:
            drive.remove_frames(store)  # of a run that was broken off after it wrote the file
            written.update(frame.key for frame in drive.frames)
    return unwritten, written


def _rows(job: Job, store: Store) -> Iterator[tuple[Place, Mapping[str, Any]]]:
    """Iterate over the places of the job's frames in the data set, and their rows."""
    for task in job.tasks():
        row = store.row(task.key, read=False)
        if task.place is not None and row is not None:
            yield task.place, row


def _render(
    missing: Iterator[FrameTask],
    dispatcher: _Dispatcher,
    progress: Progress,
    report: FrameCallback,
    ended: dict[str, bool],
) -> None:
    """Hand out the missing frames, a bounded number at once, and wait for all of them.

    Args:
        ended: filled: key of a finished frame -> whether another run rendered it
    """
    elsewhere: list[FrameTask] = []

    def take() -> None:
        for task, cause in dispatcher.next():
            assert isinstance(task, FrameTask)
            if cause == ELSEWHERE:
                elsewhere.append(task)
                continue
            ended[task.key] = cause == REUSED
            if cause == REUSED:
                progress.reused += 1
            elif cause:
                progress.failed[task.key] = cause
            else:
                progress.rendered += 1
            failed = task.key in progress.failed
            report(progress, task if failed else None, cause if failed else "")

    keys: set[str] = set()
    remaining = progress.frames - progress.reused
    while bundle := list(itertools.islice(missing, dispatcher.share(remaining))):
        remaining -= len(bundle)
        distinct = list({task.key: task for task in bundle if task.key not in keys}.values())
        progress.reused += len(bundle) - len(distinct)  # twice in the job
        keys.update(task.key for task in distinct)
        if new := [task for task in distinct if task.key not in ended]:
            dispatcher.submit(new)
        while dispatcher.is_enough():
            take()
    while dispatcher.bundles:
        take()
    # Frames that another run was rendering: they are done by now, or that run was killed, or we wait.
    while elsewhere:
        for task in elsewhere:
            dispatcher.submit([task])
        elsewhere.clear()
        while dispatcher.bundles:
            take()
        if elsewhere:
            time.sleep(AGAIN_EVERY_S)


def _write_drives(
    unwritten: list[DriveTask], dispatcher: _Dispatcher, progress: Progress, causes: dict[Path, str]
) -> None:
    """Write the drives that have all their frames, a bounded number at once, and wait for all of them.

    Args:
        unwritten: emptied
        causes: filled: file of a drive -> why it could not be written
    """
    waiting = [drive for drive in unwritten if not any(frame.key in progress.failed for frame in drive.frames)]
    unwritten[:] = waiting
    while unwritten:
        while waiting and not dispatcher.is_enough():
            dispatcher.submit([waiting.pop(0)])
        for drive, cause in dispatcher.next():
            assert isinstance(drive, DriveTask)
            if cause == ELSEWHERE:
                waiting.append(drive)
                time.sleep(AGAIN_EVERY_S)
                continue
            unwritten.remove(drive)
            if cause not in ("", REUSED):
                causes[drive.file] = cause


class _SchedulerGone(Exception):
    """Raised when the scheduler answers no more."""


class _WorkersGone(Exception):
    """Raised when a cluster of this machine has had no worker for too long."""


class _Dispatcher:
    """Hands bundles of frames to the cluster and collects their results.

    Attributes:
        bundles: Dask's key of a bundle -> its frames, for all that have not come back
    """

    def __init__(self, client: Any, store: Store, threads: int | None, waiting: Callable[[str], object]) -> None:
        from distributed import as_completed

        self.bundles: dict[str, Bundle] = {}
        self._client = client
        self._arguments = (str(store.folder), threads)
        self._names = (f"render-{uuid.uuid4().hex}-{number}" for number in itertools.count())
        self._waiting = as_completed(loop=client.loop, with_results=True, raise_errors=False)
        self._counted_s, self._threads = -math.inf, 1
        self._frame_s = BUNDLE_S
        self._longest_s: float | None = None  # of a frame, over all bundles
        self._futures: dict[str, Any] = {}
        self._since_s: dict[str, float] = {}
        self._late: dict[str, str] = {}  # name of a bundle that was taken back -> address of the worker that hangs
        self._now_s = 0.0  # stands still while this process is stopped, say by Ctrl-Z, and its workers with it
        self._heard: dict[str, tuple[float, float]] = {}  # address of a worker -> its last heartbeat, and our time then
        self._silent: set[str] = set()  # addresses of workers without heartbeats
        self._reported: set[str] = set()  # those of them whose frames were given to others
        self._over, self._no_workers, self._on_waiting = threading.Event(), False, waiting

    def __enter__(self) -> _Dispatcher:
        threading.Thread(target=self._watch, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()

    def _watch(self) -> None:
        """Watch for a cluster without workers and for workers that are silent or hang (runs in a thread).

        A bundle that no worker has never comes back, nor one whose worker was stopped or waits for a dead disk.
        """
        since_s, was_reported = self._now_s, False
        interval_s, ticked_s = min(COUNT_EVERY_S, WITHOUT_WORKERS_S / 4.0), time.monotonic()
        while not self._over.wait(interval_s):
            before_s, ticked_s = ticked_s, time.monotonic()
            self._now_s += min(ticked_s - before_s, 2.0 * interval_s)
            try:
                workers = self._client.sync(self._client.scheduler.identity)["workers"]
            except Exception:  # `next` reports a scheduler that is gone
                return
            if workers:
                since_s, was_reported = self._now_s, False
                self._listen(workers)
                self._take_back()
            elif self._now_s - since_s > WITHOUT_WORKERS_S:
                if not was_reported:
                    self._on_waiting("there are no workers; waiting for them")
                was_reported = True
                if self._client.cluster is not None:
                    self._no_workers = True
                    self._client.cancel(list(self._futures.values()), force=True)
                    return

    def _listen(self, workers: Mapping[str, Mapping[str, Any]]) -> None:
        """Note which workers are silent. Clocks of other machines do not matter: a heartbeat is a new number."""
        heard = {}
        for address, worker in workers.items():
            beat, heard_s = self._heard.get(address, (None, 0.0))
            heard[address] = worker["last_seen"], heard_s if worker["last_seen"] == beat else self._now_s
        limit_s = max(SILENT_S, 0.1 * len(workers))
        self._heard = heard
        self._silent = {address for address, (_, heard_s) in heard.items() if self._now_s - heard_s > limit_s}
        self._reported &= self._silent

    def _take_back(self) -> None:
        """End the workers that are silent or have late bundles, or let other workers render what these have."""
        late = {
            name: self._now_s - since_s
            for name, since_s in list(self._since_s.items())
            if (bundle := self.bundles.get(name)) and self._now_s - since_s > self._limit_s(_frame_count(bundle))
        }
        self._since_s.update(dict.fromkeys(late, self._now_s))
        if not (late or self._silent):
            return
        # A result that was not fetched before its worker stopped is with that worker, too.
        places = {name: workers[0] for name, workers in self._client.who_has(list(self.bundles)).items() if workers}
        places |= {name: address for address, names in self._client.processing().items() for name in names}
        ended = set[str]()
        for name, address in places.items():
            future, is_silent = self._futures.get(name), address in self._silent
            if future is None or not (is_silent or name in late):
                continue
            if address not in self._reported | ended:
                if is_silent:
                    cause = f"is silent for {self._now_s - self._heard[address][1]:.0f} s"
                else:
                    cause = f"hangs for {late[name]:.0f} s"
                self._on_waiting(f"{address} {cause}; its frames go to another worker")
            ended.add(address)
            if self._client.cluster is None:
                self._late[name] = address
                self._client.cancel([future], force=True)
        self._reported |= ended & self._silent
        for nanny in self._client.cluster.workers.values() if ended and self._client.cluster else ():
            if nanny.worker_address in ended and nanny.pid:
                os.kill(nanny.pid, signal.SIGKILL)  # also ends a stopped process; its nanny starts another

    def _limit_s(self, frames: int) -> float:
        """Time after which a bundle of so many frames is late [s]."""
        if self._longest_s is None:
            return max(UNKNOWN_S, LATENESS * frames)
        return max(LEAST_LIMIT_S, LATENESS * self._longest_s * frames * (BUNDLES_FOR_EACH + 1))

    def share(self, remaining: int) -> int:
        """Number of frames for the next bundle, if this many remain."""
        by_time = int(BUNDLE_S / max(self._frame_s, 1e-3))
        return max(1, min(by_time, MOST_IN_BUNDLE, remaining // (2 * self._count())))

    def submit(self, bundle: Bundle, *, hanging: str | None = None) -> None:
        """Hand out some frames, to be rendered one after the other.

        Args:
            hanging: address of a worker that has them and hangs: others render them, whatever it has claimed
        """
        name = next(self._names)  # unique to each run: Dask would answer a repeated one from its memory
        call = pickle.dumps(_Call(bundle, *self._arguments, hanging is None))
        shunned = self._silent if hanging is None else self._silent | {hanging}
        awake = [worker for worker in self._client.nthreads() if worker not in shunned] if shunned else []
        self._futures[name] = self._client.submit(
            pickle.loads, call, key=name, pure=False, workers=awake or None, allow_other_workers=bool(awake)
        )
        self._since_s[name] = self._now_s
        self._waiting.add(self._futures[name])
        self.bundles[name] = bundle
        if self._no_workers:  # the workers went before `_watch` could cancel this bundle
            raise _WorkersGone

    def is_enough(self) -> bool:
        """Whether the cluster has all the bundles that it should have at once."""
        return len(self.bundles) >= BUNDLES_FOR_EACH * self._count()

    def next(self) -> list[tuple[FrameTask | DriveTask, str]]:
        """Wait for a bundle: its frames, each with the cause of its failure or ""."""
        future, result = next(self._waiting)
        bundle = self.bundles.pop(future.key)
        self._futures.pop(future.key, None)
        self._since_s.pop(future.key, None)
        hanging = self._late.pop(future.key, None)
        if future.cancelled() and hanging is not None:
            self.submit(bundle, hanging=hanging)
            return []
        if future.cancelled():  # either by `_watch`, or by Dask because the scheduler is gone
            raise _WorkersGone if self._no_workers else _SchedulerGone
        if future.status == "finished":
            causes, seconds = result
            self._frame_s = seconds / _frame_count(bundle)
            self._longest_s = max(self._frame_s, self._longest_s or 0.0)
            return list(zip(bundle, causes, strict=True))
        if len(bundle) == 1:
            return [(bundle[0], _cause(result[1]))]
        for task in bundle:  # one by one, to find which of them fails; finished ones cost nothing
            self.submit([task])
        return []

    def _count(self) -> int:
        """Number of threads of the cluster, which may grow and shrink."""
        time_s = time.monotonic()
        if time_s - self._counted_s > COUNT_EVERY_S:
            try:
                threads = sum(self._client.nthreads().values())
            except OSError as error:
                raise _SchedulerGone from error
            self._counted_s, self._threads = time_s, max(1, threads)
        return self._threads


def _frame_count(bundle: Bundle) -> int:
    return sum(task.frame_count for task in bundle)


class _Call:
    """Call of `render_frames` that unpickling executes.

    The worker unpickles it inside the task. A worker without lidarscene then fails the task with that cause; if Dask
    itself had to unpickle the function, the worker would end.
    """

    def __init__(self, bundle: Bundle, folder: str, threads: int | None, claiming: bool) -> None:
        self._arguments = (bundle, folder, threads, claiming)

    def __reduce__(self) -> tuple[Any, ...]:
        return render_frames, self._arguments


def _cause(error: Any) -> str:
    """One line for a failure that Dask reports."""
    from distributed import KilledWorker

    if isinstance(error, KilledWorker):
        return "every worker that rendered it died, each time anew; was there too little memory?"
    return " ".join(f"the worker said {type(error).__name__}: {error}".split())
