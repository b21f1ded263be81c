"""Killed workers and clients, corrupt files, frames that fail: nothing is lost, and nothing is done twice."""

import contextlib
import itertools
import json
import math
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from helpers.child import assert_ended
from helpers.folders import part_name
from helpers.small_job import STOP, fails_in_company
from helpers.waiting import PATIENCE_S, wait_until

from lidarscene import __version__
from lidarscene.batch import dispatch, work
from lidarscene.batch.dispatch import Progress, run_job
from lidarscene.batch.store import Store
from lidarscene.batch.tasks import FrameTask, Job
from lidarscene.kernel.device import gpus

ROOT = Path(__file__).parents[2]

WriteJob = Callable[..., Path]


@pytest.fixture
def long_job(write_job: WriteJob, tmp_path: Path) -> Path:
    """Ten frames of 5 151 beams, given out one or two at a time: enough to be killed among them."""
    path = write_job(tmp_path, step=0.4)
    path.write_text(path.read_text().replace("seeds = [0, 7]", "seed_count = 5"))
    return path


def clouds(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted((folder / "frames").rglob("*.ply"))}


def times(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in (folder / "frames").rglob("*.ply")}


def all_done(job: Job, folder: Path) -> bool:
    store = Store(folder)
    return all(store.row(task.key) is not None for task in job.tasks())


def test_each_local_worker_sees_one_gpu(client: Any) -> None:
    client.wait_for_workers(2, timeout=PATIENCE_S)
    assert sorted(client.run(os.getenv, gpus.VISIBLE).values()) == ["GPU-first", "GPU-second"]


INTRUDER = """
import asyncio, os, ssl, sys
from distributed.comm import connect
from distributed.protocol.pickle import dumps
from distributed.security import Security

async def intrude(folder, way, scheme, how, port, operation):
    try:
        address = f"{scheme}://127.0.0.1:{port}"
        comm = await asyncio.wait_for(connect(address, timeout=SECONDS, **how), SECONDS)
        call = {"op": operation, "function": dumps(os.mkdir), "args": dumps((os.path.join(folder, f"{way}-{port}"),))}
        await comm.write({**call, "kwargs": dumps({}), "wait": True, "reply": True})
        await asyncio.wait_for(comm.read(), SECONDS)
        comm.abort()
    except Exception:  # whatever stops it
        pass

def ways(pem):
    if pem:
        its = Security(**dict.fromkeys(("tls_ca_file", "tls_client_cert", "tls_client_key"), pem))
        return {"key": ("tls", its.get_connection_args("client"))}
    none = {"ssl_context": ssl._create_unverified_context(), "require_encryption": True}
    own = Security.temporary().get_connection_args("client")
    return {"plain": ("tcp", {}), "none": ("tls", none), "own": ("tls", own)}

async def main(folder, *doors):
    chosen = ways(sys.stdin.read()).items()
    tried = [intrude(folder, way, *how, *door.split("/")) for way, how in chosen for door in doors]
    await asyncio.gather(*tried)

asyncio.run(main(*sys.argv[1:]))
"""
"""A program of another user: tries to run code at ports, each with the operation that does so, with the key on its
standard input or without.
"""


def test_who_lacks_the_key_runs_no_code(client: Any, tmp_path: Path) -> None:
    """Rationale: every user of a machine reaches its ports on loopback. A second process tries all ports that this one
    and its workers listen on; with the key it succeeds at the scheduler, two nannies and two workers.
    """
    psutil = pytest.importorskip("psutil")
    client.wait_for_workers(2, timeout=PATIENCE_S)  # a test before may have killed one, which its nanny replaces
    processes = [psutil.Process(), *psutil.Process().children(recursive=True)]
    # Before psutil 6 the method had another name.
    sockets = [getattr(process, "net_connections", None) or process.connections for process in processes]
    ports = {
        connection.laddr.port
        for connections_of in sockets
        for connection in connections_of(kind="tcp")
        if connection.status == psutil.CONN_LISTEN
    }
    nannies = [nanny.address for nanny in client.cluster.workers.values()]
    doors = {_port(address): "run" for address in [*nannies, *client.nthreads()]}
    doors[_port(client.cluster.scheduler_address)] = "run_function"
    assert len(doors) == 5
    assert doors.keys() <= ports
    # In vain for two seconds, though a port that is open takes some milliseconds.
    _intrude(tmp_path, [f"{port}/{request}" for port in ports for request in ("run", "run_function")], seconds=2.0)
    assert os.listdir(tmp_path) == []
    pem = client.security.tls_client_key + client.security.tls_client_cert
    _intrude(tmp_path, [f"{port}/{request}" for port, request in doors.items()], seconds=PATIENCE_S, pem=pem)
    assert set(os.listdir(tmp_path)) == {f"key-{port}" for port in doors}
    # The key itself is in no argument and no environment, which others may read.
    secret = client.security.tls_client_key.splitlines()[1]
    for process in processes:
        assert secret not in " ".join([*process.cmdline(), *process.environ().values()])


def _intrude(folder: Path, doors: list[str], *, seconds: float, pem: str = "") -> None:
    program = [sys.executable, "-c", INTRUDER.replace("SECONDS", str(seconds)), str(folder), *doors]
    subprocess.run(program, input=pem, text=True, check=True, timeout=PATIENCE_S)


def _port(address: str) -> int:
    return int(address.rsplit(":", 1)[1])


def test_a_killed_worker_costs_nothing(client: Any, long_job: Path, tmp_path: Path) -> None:
    """SIGKILL to one of two workers after the third frame: all frames come, with the bytes of a run without it."""
    job, killed = Job.read(long_job), []

    def kill(progress: Progress, *_: object) -> None:
        if progress.rendered == 3:
            killed.append(next(iter(client.run(os.getpid).values())))
            os.kill(killed[0], signal.SIGKILL)

    progress = run_job(job, tmp_path / "killed", connect=lambda: nullcontext(client), threads=1, report=kill)
    assert len(killed) == 1
    # A frame that the worker had written, but not told of, is found when it is asked for again.
    assert (progress.rendered + progress.reused, progress.failed) == (10, {})
    assert progress.rendered >= 5
    assert run_job(job, tmp_path / "calm", connect=lambda: nullcontext(client), threads=1).rendered == 10
    assert clouds(tmp_path / "killed") == clouds(tmp_path / "calm")


def test_a_stopped_worker_is_replaced(
    client: Any, long_job: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SIGSTOP to one of two workers in its first frame: a process that neither works nor ends. It is reported.

    However long its first bundle took: the limit is that of its heartbeats.
    """
    monkeypatch.setattr(dispatch, "LEAST_LIMIT_S", math.inf)
    monkeypatch.setattr(dispatch, "SILENT_S", 10.0)
    monkeypatch.setattr(dispatch, "COUNT_EVERY_S", 0.5)
    job, lines = Job.read(long_job), list[str]()
    worker, stopped = next(iter(client.run(os.getpid).items()))
    client.run(exec, STOP, {}, workers=[worker])
    progress = run_job(job, tmp_path / "stopped", connect=lambda: nullcontext(client), threads=1, waiting=lines.append)
    assert (progress.rendered + progress.reused, progress.failed) == (10, {})
    assert [re.sub(r"\d+ s;", "N s;", line) for line in lines] == [
        f"{worker} is silent for N s; its frames go to another worker"
    ]
    assert all_done(job, tmp_path / "stopped")
    psutil = pytest.importorskip("psutil")
    wait_until(lambda: not psutil.pid_exists(stopped) or psutil.Process(stopped).status() == "zombie")
    client.wait_for_workers(2, timeout=PATIENCE_S)


HANG = """
import time
from lidarscene.batch import work
render = work._render
def hang(*arguments):
    work._render = render
    time.sleep(3600.0)
work._render = hang
"""


def test_a_worker_that_hangs_is_replaced(
    client: Any, long_job: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It waits for a disk that does not answer, say: its bundle never comes back, though it sends heartbeats.

    So a worker that is busy for longer than `SILENT_S` is not taken for one that was stopped.
    """
    monkeypatch.setattr(dispatch, "LEAST_LIMIT_S", 15.0)
    monkeypatch.setattr(dispatch, "LATENESS", 0.0)
    monkeypatch.setattr(dispatch, "SILENT_S", 10.0)
    monkeypatch.setattr(dispatch, "COUNT_EVERY_S", 0.5)
    job, lines = Job.read(long_job), []
    client.run(exec, HANG, {}, workers=[next(iter(client.nthreads()))])
    progress = run_job(job, tmp_path, connect=lambda: nullcontext(client), threads=1, waiting=lines.append)
    assert (progress.rendered + progress.reused, progress.failed) == (10, {})
    assert [line.partition(" hangs for ")[2] != "" for line in lines] == [True] * len(lines) != []
    client.wait_for_workers(2, timeout=PATIENCE_S)


class SilentClient:
    """A client of one worker, whose last heartbeat stays the same."""

    cluster, loop, scheduler = None, None, SimpleNamespace(identity=None)

    def sync(self, _: Any) -> dict[str, Any]:
        return {"workers": {"worker": {"last_seen": 1.0}}}

    def who_has(self, _: Any) -> dict[str, Any]:
        return {}

    processing = dict


@pytest.mark.parametrize(
    ("ticks_s", "silent"), [([5.0] * 8, {"worker"}), ([5.0, 600.0, 5.0, 5.0], set())], ids=["the worker", "all"]
)
def test_silence_is_counted_while_this_process_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ticks_s: list[float], silent: set[str]
) -> None:
    """Ctrl-Z stops the command and its workers: when it goes on, none of them has been silent."""
    monkeypatch.setattr("distributed.as_completed", lambda **_: None)
    watching = dispatch._Dispatcher(SilentClient(), Store(tmp_path), 1, lambda _: None)
    times_s, overs = itertools.accumulate([0.0, *ticks_s]), iter([False] * len(ticks_s) + [True])
    monkeypatch.setattr(dispatch, "time", SimpleNamespace(monotonic=lambda: next(times_s)))
    monkeypatch.setattr(watching, "_over", SimpleNamespace(wait=lambda _: next(overs)))
    watching._watch()
    assert watching._silent == silent


def test_a_killed_client_is_run_again(client: Any, long_job: Path, tmp_path: Path) -> None:
    """SIGKILL to the command after some frames: its worker ends with it, and the next run does the rest only.

    The first has 2,000 seeds, so that it cannot be done before the kill; of the five of the second it begins with one
    half, those of the first sun.
    """
    out, text = tmp_path / "out", long_job.read_text()
    long_job.write_text(text.replace("seed_count = 5", "seed_count = 2000"))
    command = [sys.executable, "-m", "lidarscene", "batch", str(long_job), "-o", str(out), "--workers", "1"]
    first = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
    try:
        wait_until(lambda: len(list(out.glob("rows/*/*.json"))) >= 3 or first.poll() is not None)
    finally:
        first.kill()
        first.wait()
    wait_until(lambda: not _lives(first.pid))  # the group: its worker too
    long_job.write_text(text)
    before, done_before = (times(out), sum(Store(out).row(task.key) is not None for task in Job.read(long_job).tasks()))
    assert 3 <= done_before <= 5
    second = run_job(Job.read(long_job), out, connect=lambda: nullcontext(client), threads=1)
    assert (second.frames, second.reused, second.rendered, second.failed) == (10, done_before, 10 - done_before, {})
    after = times(out)
    assert sum(after[name] == when for name, when in before.items()) >= done_before
    assert all_done(Job.read(long_job), out)


def _lives(group: int) -> bool:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(group, 0)
        return True
    return False


def test_a_corrupt_file_is_made_again_and_no_other(client: Any, job: Job, tmp_path: Path) -> None:
    out, connects = tmp_path / "out", []

    def connect() -> Any:
        connects.append(1)
        return nullcontext(client)

    assert run_job(job, out, connect=connect, threads=1).rendered == 4
    clouds_before, before = clouds(out), times(out)
    spoilt = next((out / "frames").rglob("*.ply"))
    spoilt.write_bytes(spoilt.read_bytes()[:-100])
    (spoilt.parent / part_name(spoilt.name)).write_bytes(b"half")
    repaired = run_job(job, out, connect=connect, threads=1)
    assert (repaired.rendered, repaired.reused) == (1, 3)
    assert clouds(out) == clouds_before
    assert {name for name, when in times(out).items() if when != before[name]} == {spoilt.name}
    assert list(out.rglob("*.part")) == []
    third = run_job(job, out, connect=connect, threads=1)
    assert (third.rendered, third.reused) == (0, 4)
    assert len(connects) == 2  # nothing to do needs no cluster


FULL_DISK = """
import os, subprocess, sys
if subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={sys.argv[1]}", "none", "out"]).returncode:
    sys.exit(77)
sys.path[:0] = sys.argv[2:]
from helpers.small_job import threads_of_this_process
from lidarscene.batch import cluster
from lidarscene.cli import main
cluster.local_client = threads_of_this_process
for _ in range(2):
    code = main.main(["batch", "job.toml", "-o", "out", "--json"])
    print("RUN", code, sorted(name for _, _, names in os.walk("out") for name in names), "", sep="\\n")
    subprocess.run(["mount", "-o", "remount,size=10m", "out"], check=True)
"""


def test_frames_that_go_while_the_job_runs_are_told(client: Any, job: Job, tmp_path: Path) -> None:
    """Two of four frames were there before, one of which goes at the first report; so does one that was rendered."""
    out, (first, second, *_) = tmp_path / "out", [task.key for task in job.tasks()]

    def connect() -> Any:
        return nullcontext(client)

    run_job(job, out, connect=connect, threads=1)
    store = Store(out)
    for task in list(job.tasks())[1:]:
        store.cloud(task.key, "ply").unlink()

    def lose(progress: Progress, *_: object) -> None:
        store.cloud(first, "ply").unlink(missing_ok=True)
        store.cloud(second, "ply").unlink(missing_ok=True)

    progress = run_job(job, out, connect=connect, threads=1, report=lose)
    assert (progress.reused, progress.rendered, sorted(progress.failed)) == (0, 2, sorted([first, second]))
    assert progress.finished == 4
    again = run_job(job, out, connect=connect, threads=1)
    assert (again.reused, again.rendered, again.failed) == (2, 2, {})


@pytest.mark.skipif(sys.platform != "linux", reason="a small disk is made by Linux's tmpfs")
def test_a_disk_that_is_full_and_then_larger(mi: Any, job_file: Path, tmp_path: Path) -> None:
    """Rationale: a real one, on which two of four clouds fit at most."""
    (tmp_path / "out").mkdir()
    store, task = Store(tmp_path / "probe"), next(Job.read(job_file).tasks())
    assert work.render_frames([task], str(store.folder), 1)[0] == [""]
    size = int(2.5 * store.cloud(task.key, "ply").stat().st_size)
    own_mount = ["unshare", "--user", "--map-root-user", "--mount", sys.executable, "-c", FULL_DISK, str(size)]
    completed = subprocess.run(
        [*own_mount, str(ROOT / "src"), str(ROOT / "tests")],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    if completed.returncode in (1, 77) and not completed.stdout:
        pytest.skip(f"no disk of its own can be mounted here: {completed.stderr}")
    assert_ended(completed, stderr=None)
    _, first_run, second_run = completed.stdout.split("RUN\n")
    code, files, summary_text = first_run.split("\n", 2)
    code_again, listing, _ = second_run.split("\n", 2)
    failed = [line for line in completed.stderr.splitlines() if line.startswith("failed")]
    assert failed
    assert all(line.endswith("cannot be written: No space left on device") for line in failed)
    rows_kept = files.count(".json")
    assert rows_kept == 4 - len(failed) > 0
    assert ".part" not in files
    summary = json.loads(summary_text)
    assert (summary["reused"], summary["rendered"], summary["failed"]) == (rows_kept, 4 - rows_kept, {})
    assert code != code_again == "0"
    assert listing.count(".ply") == 4


def test_failures_are_told_and_do_not_stop_the_rest(client: Any, write_job: WriteJob, tmp_path: Path) -> None:
    """A scene whose material nobody knows, between two good ones, and then mended; the manifest has all of them."""
    from pyarrow import parquet

    path = write_job(tmp_path)
    wall = (tmp_path / "wall.toml").read_text()
    (tmp_path / "bad.toml").write_text(wall.replace("concrete", "concrate"))
    (tmp_path / "far.toml").write_text(wall.replace("[10, 0, 1.8]", "[12, 0, 1.8]"))
    path.write_text(path.read_text().replace('["wall.toml"]', '["wall.toml", "bad.toml", "far.toml"]'))
    job, out, reports = Job.read(path), tmp_path / "out", []

    def record_report(progress: Progress, task: FrameTask | None, cause: str) -> None:
        reports.append((task, cause))

    def run_again() -> Progress:
        return run_job(Job.read(path), out, connect=lambda: nullcontext(client), threads=1, report=record_report)

    progress = run_again()
    assert (progress.rendered, len(progress.failed)) == (8, 4)
    assert [cause for task, cause in reports if task] == list(progress.failed.values())
    assert all("no material 'concrate' in the catalogue" in cause for cause in progress.failed.values())
    rows = parquet.read_table(out / "manifest.parquet").to_pylist()
    assert [row["key"] for row in rows] == [task.key for task in job.tasks()]
    for row, task in zip(rows, job.tasks(), strict=True):
        assert (row["seed"], row["number"], row["scene"]) == (task.frame.seed, 0, task.scene.path)
        assert {name: row[name] for name in task.parameters} == task.parameters
        assert (row["format"], row["coordinates"], row["truth"]) == ("ply", "world", True)
        assert (row["rays"], row["interactions"], row["begin_s"], row["version"]) == (1, 3, 0.0, __version__)
        if "bad.toml" in row["scene"]:
            assert row["error"] == progress.failed[task.key]
            assert row["points"] is row["file"] is None
        else:
            assert row["error"] is None
            assert row["beams"] == 21 * 11
            assert row["bytes"] == (out / row["file"]).stat().st_size
            assert row["missed_no_surface"] == row["beams"] - row["hits"] > 0
            assert row["seconds"] == pytest.approx(sum(json.loads(row["seconds_by_stage"]).values()))
    (tmp_path / "bad.toml").write_text(wall)
    progress = run_again()
    assert (progress.rendered, progress.reused, progress.failed) == (4, 8, {})
    rows = parquet.read_table(out / "manifest.parquet").to_pylist()
    assert {row["error"] for row in rows} == {None}


def test_frames_that_kill_every_worker_have_a_cause() -> None:
    """What Dask says of them, in one line."""
    from distributed import KilledWorker

    cause = dispatch._cause(KilledWorker("render-x", None, 3))
    assert "died" in cause
    assert dispatch._cause(RuntimeError("a\nb")) == "the worker said RuntimeError: a b"


def test_a_bundle_that_fails_is_taken_apart(
    client: Any, long_job: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: frames are given out several at a time, and one that kills its worker must not take others along."""
    bundle_sizes, submit = [], dispatch._Dispatcher.submit
    long_job.write_text(long_job.read_text().replace("seed_count = 5", "seed_count = 10"))

    def submit_and_count(self: Any, bundle: list[FrameTask]) -> None:
        bundle_sizes.append(len(bundle))
        submit(self, bundle)

    monkeypatch.setattr(dispatch, "BUNDLE_S", 1000.0)  # several frames to a bundle, however slow this machine is
    monkeypatch.setattr(dispatch, "write_manifest", lambda *_: set())  # of frames without files
    monkeypatch.setattr(dispatch, "render_frames", fails_in_company)
    monkeypatch.setattr(dispatch._Dispatcher, "submit", submit_and_count)
    progress = run_job(Job.read(long_job), tmp_path / "out", connect=lambda: nullcontext(client), threads=1)
    assert max(bundle_sizes) > 1
    assert (progress.rendered, list(progress.failed.values())) == (18, ["the worker said RuntimeError: broken"] * 2)
