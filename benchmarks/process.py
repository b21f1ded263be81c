"""Whole processes: from their start to a file, and the memory that they take."""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from table import Row, Section, verdict

ROOT = Path(__file__).parents[1]
GOAL_S, GOAL_COLD_S = 1.2, 4.0
GOAL_GIB = 2.0

STAGES = """
import sys, time
marks = [("interpreter", time.time())]
def mark(name): marks.append((name, time.time()))
import numpy
mark("import numpy")
import pydantic
mark("import pydantic")
from lidarscene.kernel.device.backend import mitsuba
mi = mitsuba()
mark("import mitsuba, load LLVM")
from lidarscene import load_scene, load_sensor; from lidarscene.cli import main as cli
from lidarscene.formats import ply
from lidarscene.rendering.simulator import Simulator
mark("import lidarscene")
scene = load_scene(sys.argv[1])
sensor = load_sensor(scene.sensor_name)
mark("read files")
simulator = Simulator(scene, sensor)
mark("build the world")
cloud = simulator.render()
mark("beams to points, warm kernel cache")
cloud.save(sys.argv[2])
mark("write")
import json
print(json.dumps(marks))
"""


def start(scenes: Sequence[Path], *, rounds: int, warm_up: bool = True) -> Section:
    """Time from process start to a .ply, by the command line, and what it is made of; of the first, cold, too."""
    rows = [row for scene in scenes for row in _started(scene, rounds, warm_up=warm_up, cold=scene == scenes[0])]
    return Section("From process start to a file", START, rows)


def _started(scene: Path, rounds: int, *, warm_up: bool, cold: bool) -> list[Row]:
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "cloud.ply"
        command = ["-m", "lidarscene", "render", str(scene), "-o", str(target)]
        if warm_up:
            _run(command)  # fills the kernel cache
        plain, stages, uncached = [], [], []
        for number in range(rounds):
            plain.append(_run(command))
            stages.append(_stages(scene, target))
            if warm_up and cold:
                uncached.append(_run(command, caches=Path(folder) / f"caches-{number}"))
    title = f"process start to end: render {scene.name}"
    rows = [
        _row(title, [times[0] for times in plain], "", GOAL_S if cold else None),
        _row("its time of the processor", [times[3] for times in plain], "all threads"),
    ]
    if uncached:
        seconds = [times[0] for times in uncached]
        rows.append(_row("the same with nothing cached", seconds, "no kernel, no mesh", GOAL_COLD_S))
        rows.append(_row("its time of the processor", [times[3] for times in uncached], "all threads"))
    return rows + [_row(f"of which: {name}", [times[name] for times in stages]) for name in stages[0]]


START = """`lidarscene render` in a process of its own, with a warm kernel cache; below it the same work in steps, with
the imports first."""

MEMORY = """The kernel's count of the memory that a process ever held at once, for one frame. The first three by the
command line, which writes while it traces; the last is the cloud itself, as `render` of the Python API returns it."""

BESIDES = ("--picture", "p.png", "--labels", "kitti", "--keep-missed", "m.npz")

WHOLE = """
import json, sys
from lidarscene import load_scene, load_sensor
from lidarscene.rendering.simulator import Simulator; from lidarscene.rendering.simulator import Summary
scene = load_scene(sys.argv[1])
simulator = Simulator(scene, load_sensor(scene.sensor_name, overrides=sys.argv[2:]))
summary = Summary()
cloud = simulator.render(summary=summary)
columns = {column.attribute: getattr(cloud, column.attribute) for column in cloud.columns}
size = sum(values.nbytes for values in columns.values() if any(values.strides))  # one number, repeated, has none
told = {"beams": summary.beams, "points": summary.points, "seconds": summary.seconds, "size": size}
print(json.dumps(told))
"""


def memory(scene: Path, *, step_deg: float) -> Section:
    """Peak memory and time of one large frame."""
    overrides = [f"scanner.{axis}_step_deg={step_deg}" for axis in ("azimuth", "elevation")]
    rows = [
        *_large(scene, ".ply", overrides),
        *_large(scene, ".laz", overrides),
        *_large(scene, ".ply", overrides, BESIDES),
        *_cloud_rows(scene, overrides),
    ]
    return Section("A large frame", MEMORY, rows)


def _large(scene: Path, suffix: str, overrides: Sequence[str], more_options: Sequence[str] = ()) -> list[Row]:
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / f"big{suffix}"
        files = [str(Path(folder) / option) if Path(option).suffix else option for option in more_options]
        command = ["-m", "lidarscene", "render", str(scene), "-o", str(target), "--json", *files]
        seconds, peak, answer, _ = _run(command + [f"--set={override}" for override in overrides])
        size = target.stat().st_size / 2**30
    extras = ", ".join(option[2:] for option in more_options if option.startswith("--"))
    title = f"peak memory, {scene.name} to {suffix}{' with ' if extras else ''}{extras}"
    goal = verdict(f"under {GOAL_GIB:g} GiB", peak < GOAL_GIB)
    row = Row(title, f"{peak:.2f} GiB", "one run", f"a file of {size:.2f} GiB", goal)
    return [row, _time(seconds, json.loads(answer))]


def _cloud_rows(scene: Path, overrides: Sequence[str]) -> list[Row]:
    seconds, peak, answer, _ = _run(["-c", WHOLE, str(scene), *overrides])
    measured = json.loads(answer)
    note = f"the cloud's columns are {measured['size'] / 2**30:.2f} of it"
    title = f"peak memory, {scene.name} to a cloud in Python"
    return [Row(title, f"{peak:.2f} GiB", "one run", note), _time(seconds, measured)]


def _time(seconds: float, summary: dict[str, Any]) -> Row:
    parts = ", ".join(f"{name} {value:.1f}" for name, value in summary["seconds"].items())
    frame = f"{summary['beams']:,} beams, {summary['points']:,} points; {parts}"
    return Row("its time from start to end", f"{seconds:.1f} s", "one run", frame)


def _stages(scene: Path, target: Path) -> dict[str, float]:
    since = time.time()
    wall, _, answer, _ = _run(["-c", STAGES, str(scene), str(target)])
    marks = json.loads(answer)
    times = np.array([since, *(moment for _, moment in marks), since + wall])
    return dict(zip([*(name for name, _ in marks), "leave"], np.diff(times), strict=True))


def _row(quantity: str, seconds: Sequence[float], note: str = "", goal: float | None = None) -> Row:
    median = float(np.median(seconds))
    goal_text = "" if goal is None else verdict(f"under {goal:g} s", median < goal)
    return Row(quantity, f"{median:.2f} s", f"{min(seconds):.2f} to {max(seconds):.2f}", note, goal_text)


def _run(arguments: list[str], *, caches: Path | None = None) -> tuple[float, float, str, float]:
    """Wall seconds, peak memory [GiB], output and seconds of the processor of a Python of its own.

    Args:
        caches: a folder for what is kept between runs; None: where it always is
    """
    environment: dict[str, Any] = dict(os.environ, PYTHONPATH=str(ROOT / "src"))
    if caches is not None:
        (caches / "kernels").mkdir(parents=True)
        environment |= {"DRJIT_CACHE_DIR": str(caches / "kernels"), "LIDARSCENE_CACHE": str(caches / "meshes")}
    since = time.perf_counter()
    with subprocess.Popen([sys.executable, *arguments], env=environment, stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        answer = child.stdout.read().decode()
        _, status, usage = os.wait4(child.pid, 0)  # this child's own peak, which RUSAGE_CHILDREN is not
        child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise SystemExit(f"benchmarks: {' '.join(arguments)[:200]} ended with {child.returncode}")
    unit = 1 if sys.platform == "darwin" else 1024
    busy_s = usage.ru_utime + usage.ru_stime
    return time.perf_counter() - since, usage.ru_maxrss * unit / 2**30, answer, busy_s
