"""`batch`: run a job file on processes of this machine, or on a Dask cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from .. import catalog
from ..errors import OptionError
from ..files.arguments import checks_arguments
from ..files.atomic import require_writable
from ..formats.registry import FORMATS
from ..kernel.device.blocks import usable_cores
from ..kernel.device.gpus import gpus_in_use
from . import WORKERS, cluster
from .dispatch import FrameCallback, Progress, run_job
from .job_file import read_job
from .store import Store
from .tasks import Job


@checks_arguments
def batch(
    job: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    connected: Callable[[Any, int], object] = lambda *_: None,
    report: FrameCallback | None = None,
    waiting: Callable[[str], object] = lambda _: None,
) -> Progress:
    """Render every frame of a job that is not in the folder yet, and write a manifest of all of them.

    The same call resumes an interrupted run.

    Args:
        job: job file, or the name of an example
        output: folder of the frames and of manifest.parquet
        workers: number of processes on this machine; if None, one for each GPU, or for each core without GPUs
        scheduler: address of a running Dask cluster that sees the same files; if None, processes on this machine
        connected: called with each client of Dask and the number of frames
        report: called after each frame with the progress, and its task and cause if it failed
        waiting: called with a line that says what the job waits for

    Raises:
        InputError: before anything is rendered
        OutputError: before anything is rendered
        LidarSceneError: where the scheduler or the workers end before the job does; frames that fail are in the result
    """
    if scheduler is not None and workers is not None:
        raise OptionError("{scheduler} and {workers}: must be only one of them, got both")
    if workers is not None:
        WORKERS.check("workers", workers)
    path, folder = catalog.file_or_example(job), Path(output)
    cluster.require_packages(FORMATS[read_job(path).format].extra, local=scheduler is None)
    checked = Job.read(path)
    if os.path.exists(folder) and not os.path.isdir(folder):
        raise OptionError("{output} {0}: must be a folder, got a file", folder)
    require_writable(Store(folder).manifest)
    count = workers or len(gpus_in_use()) or usable_cores()

    @contextmanager
    def connect() -> Iterator[Any]:
        with cluster.local_client(count) if scheduler is None else cluster.remote_client(scheduler) as client:
            connected(client, len(checked))
            yield client

    # Each worker renders with its share of the cores, so that workers do not fight over them.
    threads = max(1, usable_cores() // count) if scheduler is None else None
    return run_job(checked, folder, connect=connect, threads=threads, report=report, waiting=waiting)
