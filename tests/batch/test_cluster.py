"""`batch --scheduler ADDRESS`: a scheduler and workers of their own processes, as a user starts them by hand."""

import contextlib
import json
import math
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from multiprocessing.spawn import get_preparation_data
from pathlib import Path
from typing import Any

import pytest
from helpers.mistakes import told
from helpers.run_seed import chosen
from helpers.small_job import STOP
from helpers.waiting import PATIENCE_S, wait_until

from lidarscene.batch import cluster, dispatch
from lidarscene.batch.dispatch import Connect, Progress, run_job
from lidarscene.batch.tasks import Job
from lidarscene.cli import main
from lidarscene.errors import LidarSceneError, OptionWarning

ROOT = Path(__file__).parents[2]
WITHOUT = "raise ModuleNotFoundError(\"No module named 'lidarscene'\")"
OLDER = "import lidarscene._version\nlidarscene._version.__version__ = '0.0.9'"

Printed = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def _dask(mi: Any) -> None:
    pytest.importorskip("distributed")
    pytest.importorskip("pyarrow")


class Scheduler:
    """A scheduler of its own, on a free port, and workers beside it."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.processes = folder, list[subprocess.Popen[bytes]]()
        scheduler_file = folder / "scheduler.json"
        self.start("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(scheduler_file))
        wait_until(lambda: _is_whole(scheduler_file) or not self.runs)
        self.address = json.loads(scheduler_file.read_text())["address"]

    @property
    def runs(self) -> bool:
        return bool(self.processes) and self.processes[0].poll() is None

    def start(self, *command: str, first: Path | None = None) -> None:
        """Start a part of Dask; ``first`` is where its Python looks for modules first."""
        path = os.pathsep.join(str(entry) for entry in (first, os.environ["PYTHONPATH"]) if entry)
        with (self.folder / f"{len(self.processes)}.log").open("wb") as log:
            started = subprocess.Popen(
                [sys.executable, "-m", "dask", *command, "--no-dashboard"],
                cwd=self.folder,
                stdout=log,
                stderr=log,
                env=os.environ | {"PYTHONPATH": path},
            )
        self.processes.append(started)

    def start_workers(self, count: int, *options: str, first: Path | None = None) -> None:
        """Start workers by the command of docs/clusters.md."""
        words = f"--nworkers {count} --nthreads 1 --memory-limit 0 --host 127.0.0.1"
        self.start("worker", self.address, *shlex.split(words), *options, first=first)

    def end(self, processes: int) -> None:
        """End all but the first of its processes, so many; workers end their own ones."""
        while len(self.processes) > processes:
            process = self.processes.pop()
            process.terminate()
            process.wait(PATIENCE_S)


def _is_whole(file: Path) -> bool:
    """Whether it is there and written to its end."""
    with contextlib.suppress(FileNotFoundError, json.JSONDecodeError):
        return bool(json.loads(file.read_text()))
    return False


@pytest.fixture(scope="module")
def _scheduler_factory(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[], Scheduler]]:
    """Gives the scheduler of this module, or a new one if it is dead; no process of it lives after this module."""
    started: list[Scheduler] = []

    def current_scheduler() -> Scheduler:
        if not (started and started[-1].runs):
            started.append(Scheduler(tmp_path_factory.mktemp("dask")))
        return started[-1]

    yield current_scheduler
    for scheduler in started:
        scheduler.end(0)


@pytest.fixture
def idle_scheduler(_scheduler_factory: Callable[[], Scheduler]) -> Scheduler:
    """A scheduler without workers."""
    scheduler = _scheduler_factory()
    scheduler.end(1)
    return scheduler


@pytest.fixture
def scheduler_with_worker(_scheduler_factory: Callable[[], Scheduler]) -> Scheduler:
    """A scheduler with a worker, the same for all tests until one of them kills it."""
    scheduler = _scheduler_factory()
    if len(scheduler.processes) == 1:
        scheduler.start_workers(1)
    return scheduler


@pytest.mark.parametrize(
    ("module", "text", "message"),
    chosen(
        1,
        [
            ("lidarscene.py", WITHOUT, "the worker said ModuleNotFoundError: No module named 'lidarscene'"),
            ("sitecustomize.py", OLDER, "gave this frame out, the worker has 0.0.9"),
        ],
    ),
)
def test_workers_that_do_not_fit(
    idle_scheduler: Scheduler, job_file: Path, tmp_path: Path, capsys: Printed, module: str, text: str, message: str
) -> None:
    """Every frame fails with that cause; nothing is written, and nothing waits for ever."""
    (tmp_path / "path").mkdir()
    (tmp_path / "path" / module).write_text(text)
    idle_scheduler.start_workers(1, "--no-nanny", first=tmp_path / "path")  # which only starts it anew when it dies
    argv = ["batch", str(job_file), "-o", str(tmp_path / "out"), "--scheduler", idle_scheduler.address]
    code = main.main(argv)
    idle_scheduler.end(1)
    assert code == 1
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("failed")]
    assert len(lines) == 4
    assert all(line.endswith(message) for line in lines)
    assert list((tmp_path / "out").rglob("*.ply")) == []


def test_the_bits_of_render(scheduler_with_worker: Scheduler, job_file: Path, tmp_path: Path, capsys: Printed) -> None:
    """A worker, started by hand, by address; then once more, when nothing is left to do."""
    out = tmp_path / "out"
    address = scheduler_with_worker.address
    argv = ["batch", str(job_file), "-o", str(out), "--json", "--scheduler", address]
    assert main.main(argv) == 0
    first = capsys.readouterr()
    note = f"lidarscene: note: --scheduler {address}: whoever reaches this port, or those of the workers, runs"
    assert first.err.count(note) == 1
    assert "dashboard     http://127.0.0.1:" in first.err
    assert main.main(argv) == 0
    resumed = json.loads(capsys.readouterr().out)
    assert [json.loads(first.out)[name] for name in ("rendered", "reused")] == [4, 0]
    assert [resumed[name] for name in ("rendered", "reused")] == [0, 4]
    for task in Job.read(job_file).tasks():
        rendered_file = tmp_path / "alone.ply"
        changes = [f"--scene-set={override}" for override in task.scene.overrides]
        changes += [f"--set={override}" for override in task.sensor.overrides]
        assert (
            main.main(["render", task.scene.path, "-o", str(rendered_file), f"--seed={task.frame.seed}", *changes]) == 0
        )
        (written,) = out.rglob(f"{task.key}.ply")
        assert written.read_bytes() == rendered_file.read_bytes()


@pytest.mark.filterwarnings("ignore:.* whoever reaches this port:lidarscene.errors.OptionWarning")
def test_a_scheduler_that_dies(
    scheduler_with_worker: Scheduler, write_job: Callable[..., Path], threads: Connect, tmp_path: Path, capfd: Printed
) -> None:
    """SIGKILL after the third frame of ten: one line; with a new scheduler the rest is rendered, and no more.

    Of the ten the worker has eight by then at most: each bundle is half of what is left.
    """
    path = write_job(tmp_path, step=0.4)
    path.write_text(path.read_text().replace("seeds = [0, 7]", "seed_count = 5"))
    job, out = Job.read(path), tmp_path / "out"

    def kill(progress: Progress, *_: object) -> None:
        if progress.rendered == 3:
            scheduler_with_worker.processes[0].kill()

    with told("Dask scheduler | 10 frames", LidarSceneError):
        run_job(job, out, connect=lambda: cluster.remote_client(scheduler_with_worker.address), report=kill)
    assert capfd.readouterr().err == ""
    scheduler_with_worker.end(0)
    frames_done = len(list(out.rglob("*.json")))
    assert 3 <= frames_done < 10
    progress = run_job(job, out, connect=threads)
    assert (progress.reused, progress.rendered, progress.failed) == (frames_done, 10 - frames_done, {})


def test_a_stopped_worker_of_another_machine(
    idle_scheduler: Scheduler, job_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It cannot be ended from here: its frames, which it has claimed, are rendered by the other worker."""
    monkeypatch.setattr(dispatch, "LEAST_LIMIT_S", math.inf)
    monkeypatch.setattr(dispatch, "SILENT_S", 10.0)
    monkeypatch.setattr(dispatch, "COUNT_EVERY_S", 0.5)
    for _ in range(2):
        idle_scheduler.start_workers(1, "--no-nanny")
    stopped, lines = [], list[str]()

    def connect() -> Any:
        from distributed import Client

        client = Client(idle_scheduler.address)
        client.wait_for_workers(2, timeout=PATIENCE_S)
        worker, pid = next(iter(client.run(os.getpid).items()))
        client.run(exec, STOP, {}, workers=[worker])
        stopped.append(pid)
        return client

    job = Job.read(job_file)
    try:
        progress = run_job(job, tmp_path / "out", connect=connect, threads=1, waiting=lines.append)
    finally:
        os.kill(stopped[0], signal.SIGCONT)
        idle_scheduler.end(1)
    assert (progress.finished, progress.failed) == (progress.frames, {})
    assert len(lines) == 1
    assert re.search(r" is silent for \d+ s; its frames go to another worker$", lines[0])


def test_processes_do_not_run_the_script_while_jobs_overlap(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: a new process is told which script to run. The script keeps its classes, which reports pickle."""
    script = sys.modules["__main__"]
    monkeypatch.setattr(script, "__file__", "/of/the/script.py", raising=False)
    monkeypatch.setattr(script, "__spec__", None)
    with contextlib.ExitStack() as first, contextlib.ExitStack() as second:
        for jobs in (first, second):
            jobs.enter_context(cluster._HIDDEN_SCRIPT)
        first.close()
        assert not {"init_main_from_path", "init_main_from_name"} & get_preparation_data("worker").keys()
        assert sys.modules["__main__"] is script
    assert get_preparation_data("worker")["init_main_from_path"] == "/of/the/script.py"


def test_a_scheduler_that_asks_for_a_key(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    """The key is in files that Dask's own configuration names, and nothing is noted; without it, one line."""
    pytest.importorskip("cryptography")
    import dask
    from distributed import LocalCluster, Security

    security = Security.temporary()
    tls = {"ca-file": security.tls_ca_file}
    tls |= {f"client.{part}": getattr(security, f"tls_client_{part}") for part in ("cert", "key")}
    for name, text in tls.items():
        (tmp_path / name).write_text(text)
    files = {f"distributed.comm.tls.{name}": str(tmp_path / name) for name in tls}
    with LocalCluster(n_workers=0, security=security, dashboard_address=None) as scheduler:
        address = scheduler.scheduler_address
        with dask.config.set(files), cluster.remote_client(address) as client:
            assert client.scheduler_info()["address"] == address
        with told(f"Dask scheduler | {address} | ssl_context", LidarSceneError), cluster.remote_client(address):
            pass
    assert not [warning for warning in recwarn if issubclass(warning.category, OptionWarning)]


@pytest.mark.parametrize("listens", [True, False], ids=["another program", "nobody"])
def test_a_wrong_address(
    job_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Printed, listens: bool
) -> None:
    """One line, also where something listens that never answers, for which Dask alone would wait for ever."""
    monkeypatch.setattr(cluster, "PATIENCE_S", 0.4)
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        if listens:
            listener.listen()
        address = f"tcp://127.0.0.1:{listener.getsockname()[1]}"
        assert main.main(["batch", str(job_file), "-o", str(tmp_path / "out"), "--scheduler", address]) == 1
    message = capsys.readouterr().err
    # A machine that is busy may spend this before the first refusal comes.
    reasons = ("no answer\n",) if listens else ("Connection refused\n", "no answer\n")
    assert message.startswith(f"lidarscene: error: no Dask scheduler answers at {address}: ")
    assert message.endswith(reasons)
    assert message.count("\n") == 1
    assert main.main(["batch", str(job_file), "-o", str(tmp_path / "out"), "--scheduler", "nonsense"]) == 1
    assert "no Dask scheduler answers at nonsense: missing port" in capsys.readouterr().err
