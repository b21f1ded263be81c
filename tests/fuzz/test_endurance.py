"""Many frames in one process, and runs that are killed at any moment. `make test-all` takes thousands (ENDURANCE=1)."""

import contextlib
import gc
import os
import random
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from helpers.command_line import COARSE
from helpers.folders import begun
from helpers.run_seed import run_seed
from helpers.scene_text import scene_of
from helpers.waiting import PATIENCE_S, wait_until
from helpers.walls import MOVING

from lidarscene import PointCloud, Simulator, load_sensor
from lidarscene.kernel.device.profile import kernel_history

LONG = os.environ.get("ENDURANCE") == "1"
FRAMES, WARM = (3000, 500) if LONG else (40, 10)
KILLS = 20 if LONG else 1
ROOT = Path(__file__).parents[2]

GROWTH = 8 << 20
"""Bytes that memory may grow by in the frames after the warm ones: the points of each, 27 kB, would be 67 MB."""


def _resident() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory and open files are read from /proc")
def test_frames_compile_and_leave_nothing(mi: Any, tmp_path: Path) -> None:
    """No growth of memory, of open files, of files, of kernels; a scene that moves, another seed in each frame."""
    sensor = load_sensor("table1-apd", overrides=[option.removeprefix("--set=") for option in COARSE])
    simulator = Simulator(scene_of(tmp_path, MOVING), sensor)
    memory = files = compiled = 0
    with kernel_history() as history:
        for number in range(FRAMES):
            simulator.render(number=number % 5, seed=number).save(tmp_path / "a.ply")
            history.take()
            if number == WARM:
                gc.collect()
                memory, files, compiled = _resident(), len(os.listdir("/proc/self/fd")), history.compiled
    gc.collect()
    assert history.launched >= FRAMES
    assert history.compiled == compiled
    assert len(os.listdir("/proc/self/fd")) == files
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.ply", "scene.toml"]
    assert _resident() - memory < GROWTH


LONG_RUN = "-m lidarscene render moving.toml -o out --frames 200 --sensor=table1-apd --labels=kitti"
LONG_RUN += " --keep-missed=out/m.npz"


@pytest.mark.skipif(sys.platform == "win32", reason="signals are those of POSIX")
def test_killed_at_any_moment(mi: Any, tmp_path: Path) -> None:
    """What has its name is whole. Asked to end, a run leaves nothing else; killed, what one frame had begun, which the
    next run that writes this frame removes.
    """
    (tmp_path / "moving.toml").write_text(MOVING)
    rng, out = random.Random(run_seed()), tmp_path / "out"
    for number in range(KILLS):
        signal_number = (signal.SIGTERM, signal.SIGKILL)[number % 2]
        running = subprocess.Popen(
            [sys.executable, *shlex.split(LONG_RUN), *COARSE], cwd=tmp_path, stderr=subprocess.DEVNULL
        )
        before = _clouds(out)
        wait_until(lambda before=before, running=running: _clouds(out) != before or running.poll() is not None)
        time.sleep(rng.random() * 0.3)
        running.send_signal(signal_number)
        running.wait(PATIENCE_S)
        assert running.returncode == (-signal_number if signal_number == signal.SIGKILL else 128 + signal_number)
        parts_left = begun(out, running.pid)
        assert len(parts_left) <= (4 if signal_number == signal.SIGKILL else 0)
        for path in out.glob("*.ply"):
            PointCloud.load(path)
        left_frames = {name.split(".")[0].split("_")[-1] for name in parts_left}
        assert len(left_frames) <= 1
    if LONG:
        command = running.args
        subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
        assert list(out.rglob("*.part")) == []


def _clouds(out: Path) -> dict[str, int]:
    with contextlib.suppress(FileNotFoundError):  # the folder comes and goes while the run looks whether it can write
        return {cloud.name: cloud.stat().st_mtime_ns for cloud in out.glob("*.ply")}
    return {}
