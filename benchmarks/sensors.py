"""Every sensor as people run it: the whole chain against the least that its rays can cost, and against Open3D.

Run alone: python benchmarks/sensors.py [--scene FILE] [--rounds N] [SENSOR ...]. Each line is printed when it is
measured, in a process of its own: worlds of other sensors in the process make a small frame a third slower.
"""

import argparse
import contextlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import bare
import chain
import clock
import numpy as np
from table import Section, line

from lidarscene import load_scene, load_sensor
from lidarscene.catalog import names
from lidarscene.errors import LidarSceneError
from lidarscene.rendering.render_options import FrameOptions
from lidarscene.rendering.simulator import Simulator

ROOT = Path(__file__).parents[1]
FIRST, DEFAULT, BARE, GLASS, OPEN3D = "first surface", "default", "bare Embree", "bare Embree through glass", "Open3D"
SEQUENCE = "in sequence"

FRAMES = 24
"""Frames of a sequence: of a small sensor the first launch has one, and those that follow as many as are worth it."""
COLUMNS = (
    "sensor",
    "beams",
    "bare, CPU ms",
    "first surface / bare",
    "default / bare",
    "default / bare through glass",
    "Open3D / default",
    "first, clock",
    "default, clock",
    "Open3D / default, clock",
    "in sequence / bare",
)

TEXT = """A frame of each sensor with its own rays, from pulse numbers to a `PointCloud`, over what others need for
these rays: medians of ratios in a round, by the time of the processor of all threads, three by the clock.
`bare` is `bare.cpp`: closest hits and sun rays with Mitsuba's Embree, and nothing else. `bare through glass` traces the
beams that meet a pane first once more, straight on through all panes: the least that the default can cost, which goes
on through panes and off mirrors. `Open3D` has its beam rays ready, makes the sun rays of its hits, and stops at the
first surface. `in sequence` is the default, a frame of {frames} that follow each other. Load of the machine over 1, 5
and 15 minutes at the end, this included: {load}."""


def measure(scene_file: Path, *, sensors: Sequence[str] = (), rounds: int) -> Section:
    """One row for each of these sensors, or of the catalogue's."""
    rows = [*measured_rows(scene_file, sensors or names("sensors"), rounds)]
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    return Section("Every sensor", TEXT.format(load=load, frames=FRAMES), rows, COLUMNS)


def measured_rows(scene_file: Path, sensors: Sequence[str], rounds: int) -> Iterator[tuple[str, ...]]:
    """Yield the cells of each sensor's row."""
    if len(sensors) == 1:
        yield _row(scene_file, sensors[0], rounds)
        return
    for name in sensors:
        command = [sys.executable, __file__, name, "--scene", str(scene_file), "--rounds", str(rounds)]
        printed = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
        yield tuple(cell.strip() for cell in printed.splitlines()[-1].strip("| ").split("|"))


def _row(scene_file: Path, name: str, rounds: int) -> tuple[str, ...]:
    scene, sensor, library = load_scene(scene_file), load_sensor(name), bare.compile_library()
    simulators = {
        label: Simulator(scene, sensor, **options) for label, options in ((FIRST, {"interactions": 0}), (DEFAULT, {}))
    }
    tasks: dict[str, Callable[[], Any]] = {label: simulator.render for label, simulator in simulators.items()}
    tasks[SEQUENCE] = lambda: _sequence(simulators[DEFAULT])
    if library is not None:
        tasks[BARE] = bare.task(library, simulators[FIRST])
        tasks[GLASS] = _through_glass(library, simulators, tasks[BARE])
    with contextlib.suppress(LidarSceneError):  # without Open3D its cells are empty
        tasks[OPEN3D] = chain.open3d_tasks(simulators[FIRST])[OPEN3D]
    seconds, busy = clock.both_in_turns(tasks, rounds=rounds)
    busy[SEQUENCE] /= FRAMES

    def ratio(times: clock.Seconds, slow: str, fast: str) -> str:
        return f"{clock.ratio(times, slow, fast)[0]:.2f}" if slow in tasks and fast in tasks else "-"

    return (
        name,
        f"{simulators[FIRST].sensor.scanner.pulses:,}",
        f"{1e3 * np.median(busy[BARE]):.1f}" if BARE in tasks else "-",
        ratio(busy, FIRST, BARE),
        ratio(busy, DEFAULT, BARE),
        ratio(busy, DEFAULT, GLASS),
        ratio(busy, OPEN3D, DEFAULT),
        ratio(seconds, FIRST, BARE),
        ratio(seconds, DEFAULT, BARE),
        ratio(seconds, OPEN3D, DEFAULT),
        ratio(busy, SEQUENCE, BARE),
    )


def _sequence(simulator: Simulator) -> int:
    """Render frames one after the other as `render_frames` does; count their points."""
    points = 0
    for number in range(FRAMES):
        left = FRAMES - number - 1
        ahead = partial(simulator.begin, FrameOptions(number=number + 1), left) if left else None
        points += len(simulator.render(number=number, ahead=ahead))
    return points


def _through_glass(library: Any, simulators: dict[str, Simulator], first: Callable[[], Any]) -> Callable[[], Any]:
    """First surfaces of all beams, and what is behind the panes of those that meet one."""
    behind = bare.task(library, simulators[DEFAULT])  # this world's own scene has no panes
    lanes = np.flatnonzero(first()[0] < behind()[0] * (1.0 - 1e-6))
    onward = bare.task(library, simulators[DEFAULT], lanes=lanes)
    return lambda: (first(), onward())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sensors", nargs="*", metavar="SENSOR")
    parser.add_argument("--scene", type=Path, default=ROOT / "scenes" / "street.toml")
    parser.add_argument("--rounds", type=int, default=7)
    arguments = parser.parse_args()
    print(line(COLUMNS), end="")
    for row in measured_rows(arguments.scene, arguments.sensors or names("sensors"), arguments.rounds):
        print(line(row), end="", flush=True)


if __name__ == "__main__":
    main()
