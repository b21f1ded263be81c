"""Runs that share a folder, and workers that are gone: nothing is waited for without end. Most are threads here."""

import contextlib
from pathlib import Path
from typing import Any

import pytest
from helpers.mistakes import told

from lidarscene.batch import cluster, dispatch, work
from lidarscene.batch.dispatch import Progress, run_job
from lidarscene.batch.tasks import FrameTask, Job
from lidarscene.errors import LidarSceneError


def test_two_runs_share_a_folder(threads: Any, job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames that another run has, at first or until the end, are no failures nor done twice: they are waited for."""
    first, second, third, fourth = (task.key for task in job.tasks())
    answers = {
        first: ["", ""],
        second: [work.ELSEWHERE, work.ELSEWHERE, work.REUSED],
        third: [work.REUSED],
        fourth: [work.ELSEWHERE, ""],
    }
    monkeypatch.setattr(work, "_rendered", lambda task, *_: contextlib.nullcontext(answers[task.key].pop(0)))
    monkeypatch.setattr(dispatch, "write_manifest", lambda *_: set())  # of frames without files
    monkeypatch.setattr(dispatch, "AGAIN_EVERY_S", 0.0)
    progress = run_job(job, tmp_path / "out", connect=threads)
    assert (progress.rendered, progress.reused, progress.failed, progress.finished) == (2, 2, {}, 4)
    assert answers == {first: [""], second: [], third: [], fourth: []}


def test_workers_that_are_all_gone(threads: Any, job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: a worker that is killed while it starts is not started anew, and a job without workers waited without
    end. What was done is not done again.
    """
    clusters, rendered = [], []

    @contextlib.contextmanager
    def connect() -> Any:
        with threads() as client:
            clusters.append(client.cluster)
            yield client

    def lose(task: FrameTask, *_: object) -> Any:
        rendered.append(task.key)
        return contextlib.nullcontext("")

    def kill(progress: Progress, *_: object) -> None:
        if progress.rendered == 1:
            clusters[0].scale(0)

    monkeypatch.setattr(work, "_rendered", lose)
    monkeypatch.setattr(dispatch, "write_manifest", lambda *_: set())  # of frames without files
    monkeypatch.setattr(dispatch, "WITHOUT_WORKERS_S", 0.4)
    monkeypatch.setattr(dispatch, "BUNDLES_FOR_EACH", 1)
    monkeypatch.setattr(dispatch, "MOST_IN_BUNDLE", 1)
    waited: list[str] = []
    progress = run_job(job, tmp_path / "out", connect=connect, report=kill, waiting=waited.append)
    assert (progress.rendered, progress.reused, progress.failed) == (4, 0, {})
    assert len(clusters) == 2
    assert waited == ["there are no workers; waiting for them"]


def test_workers_that_never_come(threads: Any, job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    attempts = []

    @contextlib.contextmanager
    def connect() -> Any:
        with threads() as client:
            client.cluster.scale(0)
            attempts.append(1)
            yield client

    monkeypatch.setattr(dispatch, "WITHOUT_WORKERS_S", 0.2)
    with told("workers of this machine | 0 of 4 frames", LidarSceneError):
        run_job(job, tmp_path / "out", connect=connect)
    assert len(attempts) == dispatch.STARTS


def test_a_pool_that_cannot_start_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: a worker that dies while the pool starts ended in a traceback of Dask."""
    attempts = []

    def fail_to_start(workers: int) -> Any:
        attempts.append(workers)
        raise RuntimeError("Nanny failed\nto start")

    monkeypatch.setattr(cluster, "_start_cluster", fail_to_start)
    with told("2 worker processes | Nanny failed to start", LidarSceneError), cluster.local_client(2):
        pass
    assert len(attempts) == cluster.STARTS
