"""The command `render`: a scene and a sensor, or a rig of them, in; point clouds, frame after frame, out.

Arguments become options of the library, one for one, and `outputs.record.record` does the rest. The options that choose
formats list the registries' entries, so that a new format needs no line here.
"""

from __future__ import annotations

import argparse
import itertools
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from ..outputs.output_options import Outputs
from ..rendering.render_options import FrameOptions, TraceOptions
from .options import CommandOptions, add_options, options_from, scene_changes
from .terminal import Answer, progress

if TYPE_CHECKING:
    from ..kernel.device.profile import KernelHistory
    from ..outputs.record import RecordedRun

RENDER_HELP = """\
examples:
  lidarscene render car -o out/car.ply --picture out/car.png
  lidarscene render car -o out/car.ply --sensor table1-sipm --set laser.peak_power_w=75
  lidarscene render my_mesh.glb -o cloud.ply
  lidarscene render my_scene.xml -o cloud.ply --pose -5,0,1.8,0,-2,0 --json
  lidarscene render drive -o out/drive --frames 10 --deskew
"""

TAKEN_EVERY = 16
"""Chunks after which `--profile` takes Dr.Jit's history: some 50 MB of kernels' texts. It waits for the device then."""

PATIENCE_S = 1.0
"""Choice: length of a run beyond which a terminal shows its progress."""

KEYS = {"missed": "keep_missed"}
"""Key of a file in `Plan.files` -> in the JSON, where they differ."""


def add_render(commands: Any) -> None:
    """Add `render`."""
    render = commands.add_parser(
        "render",
        help="render point clouds of a scene",
        epilog=RENDER_HELP,
        description="Simulate one or more frames of a lidar in a scene, and write their point clouds.",
    )
    render.add_argument(
        "scene",
        metavar="SCENE",
        type=Path,
        help="scene file (.toml), Mitsuba scene (.xml), mesh (.glb, .obj, ...), or the name of a scene, such as car",
    )
    group = render.add_argument_group("simulation")
    add_options(group, CommandOptions, "sensor", "rig", overrides="LABEL:KEY=VALUE for one sensor of a rig")
    add_options(group, CommandOptions, "scene_overrides", "ego_mesh")
    add_options(group, FrameOptions, pose="for a rig, the pose of its vehicle (default: the origin)")
    add_options(
        group,
        CommandOptions,
        frames="-o is then a folder for frame_0000.ply and so on, or one file with all frames: a ROS 2 bag "
        "(.mcap, .db3), a Rerun log (.rrd) or packets (.pcap)",
    )
    add_options(group, FrameOptions, "begin_s", "seed")
    add_options(group, TraceOptions, "rays", "interactions", "background_rays", "vectors")
    add_options(group, FrameOptions, "chunk")
    group = render.add_argument_group("output files")
    add_options(group, Outputs, "path", "format", "epoch", "topic", "frame_id", "labels", "dataset")
    add_options(group, Outputs, "imu", "poses", "range_image", "ambient", "waveforms", "pulses")
    add_options(group, FrameOptions, coordinates="--frame is the old name")
    add_options(group, Outputs, "merge", "deskew", "own_car", "all_around", "rrd", "colours", "truth", "ascii")
    add_options(group, Outputs, "missed", "keep_rays", "picture")
    group.add_argument(
        "--profile",
        action="store_true",
        help="print the time of each stage, the kernels launched and compiled, and the peak memory",
    )
    render.set_defaults(run=run_render)


def run_render(arguments: argparse.Namespace) -> Answer:
    """Run `render`.

    Raises:
        InputError: before anything is traced
        OutputError: before anything is traced
    """
    from ..kernel.device.profile import kernel_history

    with kernel_history() if arguments.profile else nullcontext() as history:
        run = _record(arguments, history)
        if history is not None:
            history.take()
        return Answer(_as_text(arguments, run, history), numbers=_numbers(run, history))


def _record(arguments: argparse.Namespace, history: KernelHistory | None) -> RecordedRun:
    """Make the library's options from the arguments and call `record`; ``history`` counts what Dr.Jit runs."""
    from ..outputs.record import record
    from ..sensor.rig_file import load_rig

    if arguments.rig is not None and arguments.sensor is not None:
        raise InputError("--sensor and --rig: must be only one of them, got both")
    overrides = arguments.overrides
    sensor = arguments.sensor
    # `load_rig` applies the overrides itself: they may name one sensor of the rig.
    if arguments.rig is not None:
        sensor, overrides = load_rig(arguments.rig, overrides=overrides), ()
    with _progress(history) as report:
        return record(
            arguments.scene,
            sensor,
            outputs=options_from(Outputs, arguments),
            trace=options_from(TraceOptions, arguments),
            frame=options_from(FrameOptions, arguments),
            frames=arguments.frames,
            overrides=overrides,
            scene_overrides=scene_changes(arguments),
            progress=report,
        )


def _others(run: RecordedRun) -> list[str]:
    """Files of several frames beside their clouds: those of each frame counted by folder and suffixes."""
    clouds = {cloud.files["output"] for cloud in run.clouds}
    counts = Counter(
        # A dot in a name may be that of a number.
        f"{''.join(suffix for suffix in path.suffixes if suffix[1:].isalpha())} in {path.parent}"
        for path in run.files
        if path not in clouds and path not in run.run_files
    )
    return [f"{count} {place}" for place, count in counts.items()] + [str(path) for path in run.run_files]


def _as_text(arguments: argparse.Namespace, run: RecordedRun, history: KernelHistory | None) -> str:
    """Text of the summary of all frames."""
    from ..outputs import run_report

    one_file = len({cloud.files["output"] for cloud in run.clouds}) < len(run.clouds)
    frames = len({cloud.number for cloud in run.clouds})
    written = [f"{frames} frames in {arguments.path}" if one_file else f"{len(run.clouds)} clouds in {arguments.path}"]
    if len(run.clouds) == 1:
        written = [str(path) for path in run.files]
    else:
        written += _others(run)
    profile = "" if history is None else "\n" + run_report.profile_as_text(run.summary, history)
    return run_report.as_text(run.summary, written, run.surroundings[0]) + profile


def _numbers(run: RecordedRun, history: KernelHistory | None) -> dict[str, Any]:
    """Numbers of the summary of all frames, and of each of them if there are several."""
    from ..outputs import run_report

    names = [{KEYS.get(key, key): str(path) for key, path in cloud.files.items()} for cloud in run.clouds]
    summary = run_report.as_dict(run.summary) | {"scene": run.surroundings[0].as_dict()}
    if history is not None:
        summary["profile"] = run_report.profile_as_dict(history)
    # A single cloud keeps the flat form that scripts read; several have a list.
    if len(names) == 1:
        return summary | names[0]
    frames = [run_report.as_dict(cloud.summary) | files for cloud, files in zip(run.clouds, names, strict=True)]
    return summary | {"frames": frames}


@contextmanager
def _progress(history: KernelHistory | None) -> Iterator[Callable[[int, int], None]]:
    """Give an observer that shows progress and takes Dr.Jit's history now and then, which holds every kernel's text."""
    chunks = itertools.count(1)
    with progress("pulses", after_s=PATIENCE_S, logged=True) as display:

        def report(finished: int, pulses: int) -> None:
            display(finished, pulses)
            if history is not None and next(chunks) % TAKEN_EVERY == 0:
                history.take()

        yield report
