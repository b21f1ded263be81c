"""The command `render`: a scene and a sensor, or a rig of them, in; point clouds, frame after frame, out.

Arguments become options of the library, one for one, and `outputs.record.record` does the rest. The options that choose
formats list the registries' entries, so that a new format needs no line here.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from ..files.json_text import json_text
from ..formats.registry import DATASETS, FORMATS, LABELS, PACKETS
from ..outputs.output_options import FEW_PULSES, FRAMES, Outputs
from ..rendering.render_options import CHUNKS, COORDINATES, MEETINGS, RAYS, SEEDS, FrameOptions, TraceOptions
from .terminal import progress
from .words import number as seconds
from .words import pose, pulses, whole_number

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

TRACE, FRAME = TraceOptions(), FrameOptions()
"""Defaults of the options."""

TAKEN_EVERY = 16
"""Chunks after which `--profile` takes Dr.Jit's history: some 50 MB of kernels' texts. It waits for the device then."""

PATIENCE_S = 1.0
"""Runs longer than this show their progress on a terminal."""

SAME = (
    "format",
    "ascii",
    "colours",
    "labels",
    "dataset",
    "deskew",
    "merge",
    "picture",
    "range_image",
    "ambient",
    "waveforms",
    "pulses",
)
"""Options of the command line that are fields of `Outputs` by the same name."""

KEYS = {"missed": "keep_missed"}
"""Key of a file in `Plan.files` -> in the JSON, where they differ."""


def add_render(commands: Any) -> None:
    """Add `render`."""
    render = commands.add_parser(
        "render",
        help="a point cloud of a scene",
        epilog=RENDER_HELP,
        description="Simulate one frame of a lidar in a scene, or several, and write their point clouds.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    render.add_argument(
        "scene",
        metavar="SCENE",
        type=Path,
        help="scene file (.toml), Mitsuba scene (.xml), mesh (.glb, .obj, ...), or a scene's name, such as car",
    )
    add = render.add_argument_group("what is simulated").add_argument
    add("--sensor", metavar="NAME|FILE", help="catalogue name or sensor file (default: the scene's)")
    add("--rig", metavar="RIG.toml", type=Path, help="several sensors on one vehicle, in place of --sensor")
    add(
        "--set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        dest="overrides",
        help="change a value of the sensor file, such as detector.gain=60; may be repeated; LABEL:KEY=VALUE for one "
        "sensor of a rig",
    )
    add(
        "--scene-set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        dest="scene_overrides",
        help="change a value of the scene file, such as sun.illuminance_klux=1 or bodies.car.yaw_deg=30",
    )
    add(
        "--pose",
        type=pose,
        metavar="X,Y,Z[,YAW,PITCH,ROLL]",
        help="where the sensor stands, or the rig's vehicle, metres and degrees (default: the scene's; the origin for "
        "a rig); positive pitch looks up",
    )
    add(
        "--frames",
        metavar="N",
        type=whole_number(FRAMES),
        help="so many frames, one after the other; -o is then a folder for frame_0000.ply and so on, or one file of "
        "all of them: a bag of ROS 2 (.mcap, .db3) or packets (.pcap)",
    )
    add(
        "--begin",
        metavar="S",
        type=seconds,
        default=FRAME.begin_s,
        help="when the first frame begins, by the clock of the scene's motions (default 0)",
    )
    add("--seed", metavar="N", type=whole_number(SEEDS), default=FRAME.seed, help="same seed, same cloud (default 0)")
    add(
        "--rays",
        metavar="N",
        type=whole_number(RAYS),
        default=TRACE.rays,
        help="of each pulse, over the footprint of its beam (default 1: its axis)",
    )
    add(
        "--interactions",
        metavar="N",
        type=whole_number(MEETINGS),
        default=TRACE.interactions,
        help="panes, mirrors and gaps that a beam may meet; with 0 it ends at the first (default 3)",
    )
    add(
        "--background-rays",
        metavar="K",
        type=whole_number(RAYS),
        help="of each pulse, over the receiver's field of view, for its background (default: as its rays)",
    )
    add("--vectors", action="store_true", help="normals of the surfaces and their velocities over the ground, too")
    add(
        "--chunk",
        metavar="N",
        type=whole_number(CHUNKS),
        default=FRAME.chunk,
        help="rays at a time: bounds the memory, no more",
    )
    add = render.add_argument_group("what is written").add_argument
    add(
        "-o",
        "--output",
        metavar="OUT.ply|DIR",
        type=Path,
        required=True,
        help="the point cloud, its name ends as its format's do; a folder with --frames and --dataset, and with "
        "--rig unless merged",
    )
    _add_format_options(add)
    add(
        "--coordinates",
        "--frame",
        choices=COORDINATES,
        default=FRAME.coordinates,
        help="of the points (default world); --frame is the older name",
    )
    add("--merge", action="store_true", help="one cloud of all sensors of the rig")
    add("--deskew", action="store_true", help="write OUT.deskewed.ply too: the cloud without the sensor's own motion")
    add("--colours", metavar="COLUMN", help="give points of a PLY file red, green and blue by a column, as intensity")
    add("--no-truth", action="store_true", help="leave the columns of ground truth out of the cloud")
    add("--ascii", action="store_true", help="write text instead of binary")
    add("--keep-missed", metavar="F.npz", type=Path, help="every pulse without an echo point, and why")
    add("--picture", metavar="F.png", type=Path, help="a view of the cloud and its range image (or F.svg)")
    add("--json", action="store_true", help="print the summary as JSON")
    add(
        "--profile",
        action="store_true",
        help="print the time by stage, kernels launched and compiled, and the peak of memory",
    )
    render.set_defaults(run=render_text)


def _add_format_options(add: Callable[..., Any]) -> None:
    """Add the options that choose formats."""
    add(
        "--format",
        choices=FORMATS | PACKETS,
        metavar="NAME",
        help=f"format of the cloud, where its name does not say it: {', '.join(FORMATS)}; or the sensor's own packets: "
        f"{', '.join(PACKETS)}",
    )
    add(
        "--labels",
        choices=LABELS,
        metavar="NAME",
        help=f"write boxes or classes of points beside the cloud, as {', '.join(LABELS)} has them",
    )
    add(
        "--dataset",
        choices=DATASETS,
        metavar="NAME",
        help=f"make the folder -o a data set, clouds and labels: {', '.join(DATASETS)}",
    )
    add(
        "--range-image",
        metavar="F.png|F.npz",
        type=Path,
        help="range, intensity and status by ring and azimuth, a pixel a beam",
    )
    add(
        "--ambient",
        metavar="F.npz|F.png",
        type=Path,
        help="background counts of every pulse, a near-infrared picture by ring and azimuth",
    )
    add(
        "--waveforms",
        metavar="F.npz",
        type=Path,
        help="power on the detector and its signal against time, of the pulses of --pulses",
    )
    add(
        "--pulses",
        metavar="0,100,2000-2010",
        type=pulses,
        help=f"which ones of a frame, 0 for its first (default: {FEW_PULSES} of them, evenly)",
    )


def render_text(arguments: argparse.Namespace) -> str:
    """Run `render`; returns the text to print. Raises InputError and OutputError before anything is traced."""
    from ..kernel.device.profile import kernel_history

    with kernel_history() if arguments.profile else nullcontext() as history:
        run = _record(arguments, history)
        if history is not None:
            history.take()
        return (_as_json if arguments.json else _as_text)(arguments, run, history)


def _record(arguments: argparse.Namespace, history: KernelHistory | None) -> RecordedRun:
    """Make the library's options from the arguments and call `record`; ``history`` counts what Dr.Jit runs."""
    from ..outputs.record import record
    from ..sensor.rig_file import load_rig

    if arguments.rig is not None and arguments.sensor is not None:
        raise InputError("--sensor and --rig: must be only one of them, got both")
    values = vars(arguments)
    outputs = Outputs(
        arguments.output,
        truth=not arguments.no_truth,
        missed=arguments.keep_missed,
        **{name: values[name] for name in SAME},
    )
    trace = TraceOptions(
        rays=arguments.rays,
        interactions=arguments.interactions,
        background_rays=arguments.background_rays,
        vectors=arguments.vectors,
    )
    frame = FrameOptions(
        seed=arguments.seed,
        begin_s=arguments.begin,
        pose=arguments.pose,
        coordinates=arguments.coordinates,
        chunk=arguments.chunk,
    )
    overrides = arguments.overrides
    sensor = arguments.sensor
    # `load_rig` applies the overrides itself: they may name one sensor of the rig.
    if arguments.rig is not None:
        sensor, overrides = load_rig(arguments.rig, overrides=overrides), ()
    with _progress(history) as report:
        return record(
            arguments.scene,
            sensor,
            outputs=outputs,
            trace=trace,
            frame=frame,
            frames=arguments.frames,
            overrides=overrides,
            scene_overrides=arguments.scene_overrides,
            progress=report,
        )


def _as_text(arguments: argparse.Namespace, run: RecordedRun, history: KernelHistory | None) -> str:
    """Text of the summary of all frames."""
    from ..outputs import run_report

    one_file = len({cloud.files["output"] for cloud in run.clouds}) < len(run.clouds)
    written = [f"{len(run.clouds)} {'frames' if one_file else 'clouds'} in {arguments.output}"]
    if len(run.clouds) == 1:
        written = [str(path) for path in run.files]
    profile = "" if history is None else "\n" + run_report.profile_as_text(run.summary, history)
    return run_report.as_text(run.summary, written, run.surroundings[0]) + profile


def _as_json(_: argparse.Namespace, run: RecordedRun, history: KernelHistory | None) -> str:
    """JSON of the summary of all frames, and of each of them if there are several."""
    from ..outputs import run_report

    names = [{KEYS.get(key, key): str(path) for key, path in cloud.files.items()} for cloud in run.clouds]
    summary = run_report.as_dict(run.summary) | {"scene": run.surroundings[0].as_dict()}
    if history is not None:
        summary["profile"] = run_report.profile_as_dict(history)
    # A single cloud keeps the flat form that scripts read; several have a list.
    if len(names) == 1:
        return json_text(summary | names[0])
    frames = [run_report.as_dict(cloud.summary) | files for cloud, files in zip(run.clouds, names, strict=True)]
    return json_text(summary | {"frames": frames})


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
