"""The command `batch`: a job file in; clouds of all its frames, made by many processes, and a manifest out.

A job may run for days. Its bar and its lines of failures go to the error stream, its result to standard output.
"""

from __future__ import annotations

import argparse
import functools
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..batch import WORKERS
from .options import CommandOptions, add_options
from .terminal import Answer, Lines, is_quiet
from .words import whole_number

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress as Bar

    from ..batch.dispatch import Progress
    from ..batch.tasks import FrameTask

BATCH_HELP = """\
examples:
  lidarscene batch job -o out/job
  lidarscene batch job -o out/job --workers 2
  lidarscene batch job.toml -o /shared/job --scheduler tcp://10.0.0.1:8786

The same command resumes an interrupted run: it renders what is missing.
docs/batch.md has the job file, docs/clusters.md SLURM, Kubernetes and millions of frames.
"""

MOST_LINES = 50
"""Failures that are printed; the manifest has all of them."""


def add_batch(commands: Any) -> None:
    """Add `batch`."""
    batch = commands.add_parser(
        "batch",
        help="render a job of many frames: scenes x sensors x sweeps x seeds, in many processes",
        epilog=BATCH_HELP,
        description="Render every frame of a job that is not in the folder yet, and write a manifest of all frames.",
    )
    batch.add_argument("job", metavar="JOB", type=Path, help="job file, or the name of an example")
    add = batch.add_argument
    add_options(batch, CommandOptions, output="it gets frames/ and manifest.parquet; existing frames stay")
    add(
        "--scheduler",
        metavar="ADDRESS",
        help="address of a running Dask cluster that sees the same files (default: processes on this machine)",
    )
    add(
        "--workers",
        metavar="N",
        type=whole_number(WORKERS),
        help="number of processes on this machine (default: one for each GPU, or for each core without GPUs)",
    )
    batch.set_defaults(run=run_batch)


def run_batch(arguments: argparse.Namespace) -> Answer:
    """Run `batch`; the code is 1 if frames failed.

    Raises:
        InputError: before anything is rendered
        OutputError: before anything is rendered
    """
    from ..batch.job_run import batch
    from ..batch.store import Store

    with _Display() as display:
        progress = batch(
            arguments.job,
            arguments.output,
            workers=arguments.workers,
            scheduler=arguments.scheduler,
            connected=display.connected,
            report=display.report,
            waiting=display.report_waiting,
        )
    manifest = Store(arguments.output).manifest
    return Answer(_as_text(progress, manifest), 1 if progress.failed else 0, _numbers(progress, manifest))


class _Display(ExitStack):
    """Progress of a job on the error stream: a bar on a terminal, and a line for each failure in any case."""

    def __init__(self) -> None:
        super().__init__()
        self._lines = Lines("frames to render")

    # Packages are asked for when a job is read, and a job with a mistake has no bar.
    @functools.cached_property
    def _console(self) -> Console:
        from rich.console import Console

        return Console(stderr=True, soft_wrap=True, highlight=False, markup=False)

    @functools.cached_property
    def _bar(self) -> Bar:
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        hidden = is_quiet() or not sys.stderr.isatty()
        bar = Bar(*columns, console=self._console, transient=True, disable=hidden, refresh_per_second=2)
        bar.add_task("frames", total=None)
        return self.enter_context(bar)

    def connected(self, client: Any, frames: int) -> None:
        """Print the address of a client's dashboard, and that workers are missing; show the bar of so many frames."""
        from ..batch.cluster import dashboard

        if (link := dashboard(client)) and not is_quiet():
            self._console.print(f"dashboard     {link}")
        if not client.nthreads():
            self._console.print("the scheduler has no workers yet; waiting for them")
        self._bar.update(self._bar.task_ids[0], total=frames, refresh=True)

    def report_waiting(self, line: str) -> None:
        """Print what the job waits for."""
        self._console.print(line)

    def report(self, progress: Progress, task: FrameTask | None, cause: str) -> None:
        """Show one more finished frame, and its task and cause if it failed."""
        self._bar.update(self._bar.task_ids[0], completed=progress.finished)
        if self._bar.disable:
            # Reused frames took no time: they would spoil the estimate of the time left.
            self._lines(progress.finished - progress.reused, progress.frames - progress.reused)
        # A job with a mistake in it fails a million times: the first lines are enough.
        if task is not None and len(progress.failed) <= MOST_LINES:
            self._console.print(f"failed        {_frame(task)}: {cause}")


def _frame(task: FrameTask) -> str:
    """Text that identifies a frame in its job: scene, trajectory, sensor, swept values, seed and number."""
    sensor = f"{task.sensor.rig} {task.sensor.label}" if task.sensor.rig else task.sensor.name
    names = [Path(task.scene.path).name, task.scene.trajectory, Path(sensor).name]
    names += [f"{key}={value}" for key, value in task.parameters.items()]
    return " ".join(filter(None, [*names, f"seed {task.frame.seed}", f"frame {task.frame.number}"]))


def _as_text(progress: Progress, manifest: Path) -> str:
    lines = [
        f"frames        {progress.frames:>12,}",
        f"rendered      {progress.rendered:>12,}",
        f"there already {progress.reused:>12,}",
        f"failed        {len(progress.failed):>12,}"
        + ("   their causes are in the manifest; the same command tries them again" if progress.failed else ""),
        f"wrote         {manifest}",
    ]
    return "\n".join(lines)


def _numbers(progress: Progress, manifest: Path) -> dict[str, Any]:
    return {
        "frames": progress.frames,
        "rendered": progress.rendered,
        "reused": progress.reused,
        "failed": progress.failed,
        "manifest": str(manifest),
    }
