"""A small job: a wall under two suns, two seeds, a coarse raster; and a cluster of two processes."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from helpers.walls import WALL
from lidarscene.batch import cluster, work
from lidarscene.batch.dispatch import Connect
from lidarscene.batch.tasks import FrameTask, Job
from lidarscene.kernel.device import gpus
from lidarscene.kernel.device.backend import VARIANT_VARIABLE

JOB = """
scenes = ["wall.toml"]
seeds = [0, 7]
[sweep.scene]
"sun.illuminance_klux" = [1, 100]
[sweep.sensor]
"scanner.azimuth_fov_deg" = [40]
"scanner.elevation_fov_deg" = [20]
"scanner.azimuth_step_deg" = [{step}]
"scanner.elevation_step_deg" = [{step}]
"""

STOP = """
import os, signal
from lidarscene.batch import work
work._write = lambda *_: os.kill(os.getpid(), signal.SIGSTOP)
"""
"""Program for a worker: it is stopped as soon as it has claimed a frame."""


@pytest.fixture
def job_file(tmp_path: Path) -> Path:
    """Four frames of 21 x 11 beams."""
    return _write_job(tmp_path)


@pytest.fixture
def write_job() -> Callable[..., Path]:
    """Writes such a job into a folder, with another raster."""
    return _write_job


def _write_job(folder: Path, step: float = 2.0) -> Path:
    (folder / "wall.toml").write_text(WALL, encoding="utf-8")
    path = folder / "job.toml"
    path.write_text(JOB.format(step=step), encoding="utf-8")
    return path


@pytest.fixture
def job(job_file: Path) -> Job:
    return Job.read(job_file)


@pytest.fixture(scope="module")
def client(mi: Any) -> Iterator[Any]:
    """A client of two worker processes, on two cards that are not there."""
    pytest.importorskip("distributed")
    pytest.importorskip("pyarrow")
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(VARIANT_VARIABLE, raising=False)
        patch.setenv(gpus.VISIBLE, "GPU-first,GPU-second")
        with cluster.local_client(2) as client:
            yield client


@pytest.fixture
def threads(mi: Any, monkeypatch: pytest.MonkeyPatch) -> Connect:
    """A scheduler and one worker that are threads of this process, where no process of a worker matters."""
    use_no_worlds_of_others(monkeypatch)
    return threads_of_this_process


def use_no_worlds_of_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing that a worker keeps goes from test to test, nor stays after it."""
    for name in ("_scenes", "_sensors", "_worlds"):
        monkeypatch.setattr(work, name, work._Cache())


@contextmanager
def threads_of_this_process(*_: object) -> Iterator[Any]:
    """A client of them."""
    from distributed import Client

    with Client(processes=False, n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0") as client:
        yield client


def fails_in_company(tasks: Sequence[FrameTask], *_: object) -> tuple[list[str], float]:
    """A worker that breaks on every bundle, and on the frames of seed 7 also when they come alone.

    It stands here because workers import it by name, which they cannot do of a test file.
    """
    if len(tasks) > 1 or tasks[0].frame.seed == 7:
        raise RuntimeError("broken")
    return [""], 1e-3
