"""Two workers against one: frames a second of `lidarscene batch`'s own loop, in turns, on clusters that stand.

Workers share cores, memory and caches with whatever runs beside them: a loaded machine says nothing about two of them.
"""

import os
import shutil
import statistics
import tempfile
import time
from contextlib import ExitStack, nullcontext
from pathlib import Path
from typing import Any

from table import Row, Section, verdict

from lidarscene.batch import cluster
from lidarscene.batch.dispatch import run_job
from lidarscene.batch.tasks import Job

GOAL = 0.9
WORKERS = (1, 2)

JOB = """
scenes = ["{scene}"]
sensors = ["table1-apd"]
seed_count = {frames}
[sweep.sensor]
"scanner.azimuth_step_deg" = [{step}]
"scanner.elevation_step_deg" = [{step}]
"""


def measure(scene: Path, *, frames: int, step_deg: float, rounds: int) -> Section:
    """Seconds of a job on one worker and on two, each of one thread, and the ratio of each round."""
    cluster.require_packages(local=True)
    seconds: dict[int, list[float]] = {count: [] for count in WORKERS}
    busy: dict[int, list[float]] = {count: [] for count in WORKERS}
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        file = folder / "job.toml"
        file.write_text(JOB.format(scene=scene, frames=frames, step=step_deg), encoding="utf-8")
        job = Job.read(file)
        clients = {count: stack.enter_context(cluster.local_client(count)) for count in WORKERS}
        for number in range(rounds + 1):  # the first compiles kernels and worlds
            for count, client in clients.items():
                spent, worked = _seconds(job, folder / "out", client)
                if number:
                    seconds[count].append(spent)
                    busy[count].append(worked / frames)
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    ratios = [seconds_of_one / (two * WORKERS[-1]) for seconds_of_one, two in zip(*seconds.values(), strict=True)]
    rows = [
        Row(
            f"{count} worker{'s' * (count > 1)}",
            f"{statistics.median(values):.2f} s",
            _spread(values, "s"),
            f"for a frame {statistics.median(busy[count]) * 1e3:.0f} ms of a worker's core",
        )
        for count, values in seconds.items()
    ]
    goal = verdict(f"at least {GOAL}", statistics.median(ratios) >= GOAL)
    rows.append(Row("efficiency of two", f"{statistics.median(ratios):.2f}", _spread(ratios), "", goal))
    text = (
        f"`lidarscene batch`: {frames} frames of {scene.name}, {step_deg} degrees, written as PLY, by workers of one "
        f"thread that stand and have compiled; client and scheduler run beside them. The efficiency is the time of one "
        f"worker over twice that of two. Load of the machine over 1, 5 and 15 minutes, this included: {load}."
    )
    return Section("Two workers against one", text, rows)


def _seconds(job: Job, out: Path, client: Any) -> tuple[float, float]:
    """Seconds from the start to the manifest, and of all workers' cores."""
    since, before = time.perf_counter(), _cpu_s(client)
    progress = run_job(job, out, connect=lambda: nullcontext(client), threads=1)
    spent, worked = time.perf_counter() - since, _cpu_s(client) - before
    assert progress.rendered == len(job), progress.failed
    shutil.rmtree(out)
    return spent, worked


def _cpu_s(client: Any) -> float:
    return sum(client.run(time.process_time).values())


def _spread(values: list[float], unit: str = "") -> str:
    return f"{min(values):.2f} to {max(values):.2f} {unit}".strip()
