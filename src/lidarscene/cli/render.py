"""The command `render`: a scene and a sensor, or a rig of them, in; point clouds, frame after frame, out."""

from __future__ import annotations

import argparse
import itertools
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from ..formats.registry import SUFFIXES as CLOUD_SUFFIXES
from ..outputs.frame_files import FrameFiles
from ..outputs.outputs import (
    SINGLE,
    check_output_options,
    cloud_files,
    is_folder,
    pulses_of_waveforms,
)
from .outputs import add_output_options
from .words import number as seconds
from .words import pose, whole

if TYPE_CHECKING:
    from ..kernel.device.profile import KernelHistory
    from ..rendering.simulator import Simulator
    from ..scene.model import Scene
    from ..sensor.rig import Mounted

RENDER_HELP = """\
examples:
  lidarscene render scenes/car.toml -o out/car.ply --picture out/car.png
  lidarscene render scenes/car.toml -o out/car.ply --sensor table1-sipm --set laser.peak_power_w=75
  lidarscene render my_scene.xml -o cloud.ply --pose -5,0,1.8,0,-2,0 --json
  lidarscene render scenes/drive.toml -o out/drive --frames 10 --deskew
"""

SUFFIXES = {
    "keep_missed": (".npz",), "picture": (".png", ".svg"), "range_image": (".png", ".npz"),
    "ambient": (".png", ".npz"), "waveforms": (".npz",),
}  # fmt: skip

TAKEN_EVERY = 16
"""Chunks after which `--profile` counts what has run: some 50 MB of kernels' texts. It waits for the device then."""

MOST_FRAMES = 10_000
"""By the four digits of their file names."""


def add_render(commands: Any, told: Callable[[Callable[[argparse.Namespace], str]], Any]) -> None:
    """Add `render`; ``told`` makes a command's run function of one that returns its text."""
    render = commands.add_parser(
        "render", help="a point cloud of a scene", epilog=RENDER_HELP,
        description="Simulate one frame of a lidar in a scene, or several, and write their point clouds.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    render.add_argument(
        "scene", metavar="SCENE", type=Path, help="scene file (.toml) or Mitsuba scene (.xml)"
    )
    add = render.add_argument_group("what is simulated").add_argument
    add("--sensor", metavar="NAME|FILE", help="catalogue name or sensor file (default: the scene's)")
    add("--rig", metavar="RIG.toml", type=Path, help="several sensors on one vehicle, in place of --sensor")
    add("--set", metavar="KEY=VALUE", action="append", default=[], dest="overrides",
        help="change a value of the sensor file, such as detector.gain=60; may be repeated; LABEL:KEY=VALUE for one "
        "sensor of a rig")  # fmt: skip
    add("--scene-set", metavar="KEY=VALUE", action="append", default=[], dest="scene_overrides",
        help="change a value of the scene file, such as sun.illuminance_klux=1 or bodies.car.yaw_deg=30")  # fmt: skip
    add("--pose", type=pose, metavar="X,Y,Z[,YAW,PITCH,ROLL]",
        help="where the sensor stands, or the rig's vehicle, metres and degrees (default: the scene's; the origin for "
        "a rig); positive pitch looks up")  # fmt: skip
    add("--frames", metavar="N", type=whole(1, MOST_FRAMES),
        help="so many frames, one after the other; -o is then a folder for frame_0000.ply and so on")  # fmt: skip
    add("--begin", metavar="S", type=seconds, default=0.0,
        help="when the first frame begins, by the clock of the scene's motions (default 0)")  # fmt: skip
    add("--seed", metavar="N", type=whole(0, 2**32 - 1), default=0, help="same seed, same cloud (default 0)")
    add("--rays", metavar="N", type=whole(1, 1024), default=1,
        help="of each pulse, over the footprint of its beam (default 1: its axis)")  # fmt: skip
    add("--interactions", metavar="N", type=whole(0, 8), default=3,
        help="panes, mirrors and gaps that a beam may meet; with 0 it ends at the first (default 3)")  # fmt: skip
    add("--background-rays", metavar="K", type=whole(1, 1024),
        help="of each pulse, over the receiver's field of view, for its background (default: as its rays)")  # fmt: skip
    add("--chunk", metavar="N", type=whole(1, 2**31 - 1), help="rays at a time: bounds the memory, no more")
    add = render.add_argument_group("what is written").add_argument
    add("-o", "--output", metavar="OUT.ply|DIR", type=Path, required=True,
        help="the point cloud, its name ends as its format's do; a folder with --frames and --dataset, and with "
        "--rig unless merged")  # fmt: skip
    add_output_options(add)
    add("--frame", choices=("world", "vehicle", "sensor"), default="world",
        help="frame of the points (default world)")  # fmt: skip
    add("--merge", action="store_true", help="one cloud of all sensors of the rig")
    add("--deskew", action="store_true",
        help="write OUT.deskewed.ply too: the cloud without the sensor's own motion")  # fmt: skip
    add("--no-truth", action="store_true", help="leave the ground truth out")
    add("--ascii", action="store_true", help="write text instead of binary")
    add("--keep-missed", metavar="F.npz", type=Path, help="every pulse without an echo point, and why")
    add("--picture", metavar="F.png", type=Path, help="a view of the cloud and its range image (or F.svg)")
    add("--json", action="store_true", help="print the summary as JSON")
    add("--profile", action="store_true",
        help="print the time by stage, kernels launched and compiled, and the peak of memory")  # fmt: skip
    render.set_defaults(run=told(render_text))


def render_text(arguments: argparse.Namespace) -> str:
    """Run `render`; returns what is printed. Raises InputError and OutputError before anything is traced."""
    from ..kernel.device.profile import kernel_history

    with kernel_history() if arguments.profile else nullcontext() as history:
        return _rendered(arguments, history)


def _rendered(arguments: argparse.Namespace, history: KernelHistory | None) -> str:
    """The same with what Dr.Jit runs counted in ``history``."""
    from ..rendering.rig import require_common_frames
    from ..rendering.simulator import Summary
    from ..scene.file import load_scene
    from ..sensor.rig_file import load_rig

    _check_options(arguments)
    before, since = Summary(), time.perf_counter()
    rig = None if arguments.rig is None else load_rig(arguments.rig, overrides=arguments.overrides)
    labels = [""] if rig is None else [one.label for one in rig.sensors]
    groups = [labels] if arguments.merge else [[label] for label in labels]
    wanted = [_files(arguments, group[0], number) for number in _numbers(arguments) for group in groups]
    _check_outputs(wanted)
    scene = load_scene(arguments.scene, overrides=arguments.scene_overrides)
    sensors = _sensors(arguments, scene) if rig is None else rig.sensors
    _note_thin_beams(arguments, sensors)
    _keep_inputs(arguments, wanted)
    if arguments.waveforms is not None:
        for mounted in sensors:
            pulses_of_waveforms(arguments, mounted.sensor)
    since = before.spent("load", since)
    if arguments.merge:
        require_common_frames(sensors, arguments.frames or 1)
    simulators = dict(_simulators(arguments, scene, sensors))
    for simulator in simulators.values():
        simulator.check_frames(arguments.frames or 1, begin_s=arguments.begin)
    before.spent("build", since)
    written: list[FrameFiles] = []
    for number in _numbers(arguments):
        for group in groups:
            one = FrameFiles(
                arguments=arguments, scene=scene, simulators={label: simulators[label] for label in group},
                number=number, files=wanted[len(written)],
                summary=Summary(seconds={} if written else before.seconds),
            )  # fmt: skip
            one.write(_progress if history is None else partial(_counted, history))
            written.append(one)
            if history is not None:
                history.take()
    return _told(arguments, written, history)


def _numbers(arguments: argparse.Namespace) -> range:
    return range(arguments.frames or 1)


def _sensors(arguments: argparse.Namespace, scene: Scene) -> Sequence[Mounted]:
    """The one that is asked for, or else the scene's, without a label."""
    from ..sensor.catalogue import load_sensor
    from ..sensor.rig import Mounted

    sensor = load_sensor(arguments.sensor or scene.sensor_name, overrides=arguments.overrides)
    return [Mounted(label="", sensor=sensor, pose=arguments.pose or scene.sensor_pose)]


def _note_thin_beams(arguments: argparse.Namespace, sensors: Sequence[Mounted]) -> None:
    """No mistake, but not what who asks for rays expects."""
    if arguments.rays == 1:
        return
    thin = [one.sensor for one in sensors if not (one.sensor.laser.has_width or one.sensor.optics.halo)]
    for name in dict.fromkeys(sensor.name for sensor in thin):
        sys.stderr.write(
            f"lidarscene: note: --rays {arguments.rays} changes nothing: laser.divergence_mrad of '{name}' is 0; "
            "a width is given by --set laser.divergence_mrad=3\n"
        )


def _simulators(
    arguments: argparse.Namespace, scene: Scene, sensors: Sequence[Mounted]
) -> Iterator[tuple[str, Simulator]]:
    from ..rendering.rig import simulators

    vehicle = arguments.pose if arguments.rig is not None else None
    return simulators(
        scene, sensors, pose=vehicle, rays=arguments.rays, interactions=arguments.interactions,
        background_rays=arguments.background_rays,
    )  # fmt: skip


def _files(arguments: argparse.Namespace, label: str, number: int) -> dict[str, Path]:
    """The files of one cloud by what they are. ``label`` is that of the rig's sensor, or of its first if merged."""
    if arguments.merge:
        label = ""
    counted = f"{number:04d}" if arguments.frames else ""
    files = cloud_files(arguments, label, number)
    for key in SUFFIXES:
        path = getattr(arguments, key)
        if path is not None:
            files[key] = path.with_name("_".join(filter(None, (path.stem, label, counted))) + path.suffix)
    return files


def _check_options(arguments: argparse.Namespace) -> None:
    """Refuse options that do not go together."""
    if arguments.rig is not None and arguments.sensor is not None:
        raise InputError("--sensor and --rig: one of them was expected")
    if arguments.merge:
        if arguments.rig is None:
            raise InputError("--merge goes with --rig")
        if arguments.frame == "sensor":
            raise InputError("--merge: a frame that all sensors have was expected, --frame world or vehicle")
        for option in SINGLE:
            if getattr(arguments, option) is not None:
                raise InputError(
                    f"{_option(option)}: goes with the clouds of single sensors, not with --merge"
                )
    many = " and ".join(f"--{name}" for name in ("frames", "rig", "dataset") if getattr(arguments, name))
    named_as_file = arguments.output.name.lower().endswith(CLOUD_SUFFIXES) or arguments.output.is_file()
    if is_folder(arguments) and named_as_file:
        raise InputError(f"--output {arguments.output}: with {many} a folder was expected")
    check_output_options(arguments)


def _option(key: str) -> str:
    return f"--{key.replace('_', '-')}" if key in SUFFIXES else "--output"


def _check_outputs(wanted: Sequence[dict[str, Path]]) -> None:
    """Refuse what could not be written, before any work goes into it."""
    from ..files.atomic import require_writable

    for files in wanted:
        for key, path in files.items():
            if key in SUFFIXES and path.suffix.lower() not in SUFFIXES[key]:
                expected = " or ".join(SUFFIXES[key])
                raise InputError(f"{_option(key)} {path}: a name that ends in {expected} was expected")
            require_writable(path)


def _keep_inputs(arguments: argparse.Namespace, wanted: Sequence[dict[str, Path]]) -> None:
    """Refuse to write over a file that is read."""
    from ..scene.file import files_of_scene
    from ..sensor.rig_file import files_of_rig

    inputs = [
        *files_of_scene(arguments.scene, overrides=arguments.scene_overrides),
        *([Path(arguments.sensor)] if arguments.sensor else []),
    ]
    inputs += files_of_rig(arguments.rig) if arguments.rig is not None else []
    for files in wanted:
        for key, path in files.items():
            if path.exists() and any(os.path.exists(one) and one.samefile(path) for one in inputs):
                raise InputError(f"{_option(key)} {path}: is an input of this run, another name was expected")


def _told(arguments: argparse.Namespace, written: Sequence[FrameFiles], history: KernelHistory | None) -> str:
    """The summary, of all frames together; as JSON with each of them if there are several."""
    from ..outputs import report
    from ..rendering.simulator import Summary

    total = Summary.total([one.summary for one in written])
    names = [{key: str(path) for key, path in one.files.items()} for one in written]
    if not arguments.json:
        many = len(written) > 1
        shown = [f"{len(written)} clouds in {arguments.output}"] if many else list(names[0].values())
        profile = "" if history is None else "\n" + report.profile_as_text(total, history)
        return report.as_text(total, shown) + profile
    told = report.as_dict(total)
    if history is not None:
        told["profile"] = report.profile_as_dict(history)
    if len(written) == 1:
        return json.dumps(told | names[0])
    frames = [report.as_dict(one.summary) | files for one, files in zip(written, names, strict=True)]
    return json.dumps(told | {"frames": frames})


@contextmanager
def _progress(total: int) -> Iterator[Callable[[int], None] | None]:
    """A bar on the terminal's error stream for frames of more than a second; none where nobody looks."""
    if total < 4_000_000 or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("tracing", total=total)
        yield lambda done: bar.update(task, completed=done)


@contextmanager
def _counted(history: KernelHistory, total: int) -> Iterator[Callable[[int], None] | None]:
    """`_progress`, and now and then what Dr.Jit has run: until it is taken it keeps the text of every kernel."""
    chunks = itertools.count(1)
    with _progress(total) as told:

        def done(pulses: int) -> None:
            if told is not None:
                told(pulses)
            if next(chunks) % TAKEN_EVERY == 0:
                history.take()

        yield done
