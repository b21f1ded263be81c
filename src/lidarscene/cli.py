"""The command line: parse, one public call, write."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import __version__
from .errors import InputError, LidarSceneError

if TYPE_CHECKING:
    from .geometry import Pose
    from .simulate import Summary


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; the exit code is 0, 2 for usage, input and output mistakes, 3 without a back end."""
    arguments = _parser().parse_args(argv)
    try:
        return int(arguments.run(arguments))
    except LidarSceneError as error:
        sys.stderr.write(f"lidarscene: error: {error}\n")
        return error.exit_code
    except KeyboardInterrupt:
        sys.stderr.write("lidarscene: interrupted, nothing was written\n")
        return 130
    except BrokenPipeError:
        # The reader of our output has gone (`lidarscene catalog | head`): nothing is wrong.
        sys.stderr.close()
        return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="lidarscene", description="What an automotive direct-time-of-flight lidar would really report."
    )
    parser.add_argument("--version", action="version", version=f"lidarscene {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_render(commands.add_parser("render", help="a point cloud of a scene"))

    catalog = commands.add_parser("catalog", help="what sensors and materials there are")
    catalog.add_argument("kind", nargs="?", choices=("sensors", "materials"))
    catalog.add_argument("name", nargs="?", help="print this entry, with the sources of its numbers")
    catalog.set_defaults(run=_catalog)

    doctor = commands.add_parser("doctor", help="what this machine can run, and why not more")
    doctor.set_defaults(run=_doctor)

    schema = commands.add_parser("schema", help="JSON Schema of a file, for editors")
    schema.add_argument("kind", choices=("scene", "sensor", "material"))
    schema.set_defaults(run=_schema)
    return parser


def _add_render(render: argparse.ArgumentParser) -> None:
    add = render.add_argument
    add("scene", metavar="SCENE", type=Path, help="scene file (.toml) or Mitsuba scene (.xml)")
    add("-o", "--output", metavar="OUT.ply", type=Path, required=True, help="point cloud to write")
    add("--sensor", metavar="NAME|FILE", help="catalogue name or sensor file (default: the scene's)")
    add("--set", metavar="KEY=VALUE", action="append", default=[], dest="overrides",
        help="change a value of the sensor file, such as detector.gain=60")  # fmt: skip
    add("--seed", type=_whole(0, 2**32 - 1), default=0, help="same seed, same cloud (default 0)")
    add("--pose", type=_pose, metavar="X,Y,Z[,YAW,PITCH,ROLL]",
        help="where the sensor stands, metres and degrees, over the scene's own; write --pose=-1,... if negative")  # fmt: skip
    add("--chunk", metavar="N", type=_whole(1, 2**31 - 1), help="pulses traced at a time; bounds the memory")
    add("--frame", choices=("world", "sensor"), default="world", help="frame of the points (default world)")
    add("--no-truth", action="store_true", help="leave the ground truth out")
    add("--ascii", action="store_true", help="write text instead of binary")
    add("--keep-missed", metavar="F.npz", type=Path, help="write every pulse without an echo point, and why")
    add("--picture", metavar="F.png", type=Path, help="draw the cloud and its range image")
    add("--json", action="store_true", help="print the summary as JSON")
    render.set_defaults(run=_render)


def _render(arguments: argparse.Namespace) -> int:
    from . import api, report
    from .io.files import require_writable
    from .simulate import DEFAULT_CHUNK, Simulator, Summary

    summary = Summary()
    since = time.perf_counter()
    for path in (arguments.output, arguments.keep_missed, arguments.picture):
        if path is not None:
            require_writable(path)
    if arguments.output.suffix.lower() != ".ply":
        raise InputError(f"--output {arguments.output}: a name that ends in .ply was expected")
    scene = api.load_scene(arguments.scene)
    sensor = api.load_sensor(arguments.sensor or scene.sensor_name, overrides=arguments.overrides)
    since = summary.spent("load", since)
    simulator = Simulator(scene, sensor, pose=arguments.pose)
    since = summary.spent("build", since)
    missed = report.MissedPulses() if arguments.keep_missed else None
    with _progress(sensor.scanner.pulses) as progress:
        cloud = simulator.render(
            seed=arguments.seed, chunk=arguments.chunk or DEFAULT_CHUNK, frame=arguments.frame,
            progress=progress, missed=missed, summary=summary,
        )  # fmt: skip
    since = time.perf_counter()
    if arguments.no_truth:
        cloud = cloud.without_truth()
    cloud.save(arguments.output, ascii=arguments.ascii)
    if missed is not None:
        missed.save(arguments.keep_missed, sensor)
    since = summary.spent("write", since)
    if arguments.picture is not None:
        from .plots import frame_picture

        frame_picture(cloud, arguments.picture)
        summary.spent("picture", since)
    _print_summary(arguments, summary)
    return 0


def _print_summary(arguments: argparse.Namespace, summary: Summary) -> None:
    from . import report

    written = {"output": str(arguments.output)}
    for key in ("picture", "keep_missed"):
        if getattr(arguments, key) is not None:
            written[key] = str(getattr(arguments, key))
    if arguments.json:
        sys.stdout.write(json.dumps(report.as_dict(summary) | written) + "\n")
    else:
        sys.stdout.write(report.as_text(summary, written) + "\n")


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


def _catalog(arguments: argparse.Namespace) -> int:
    from . import catalog, report

    if arguments.name:
        sys.stdout.write(catalog.path_of(arguments.kind, arguments.name).read_text(encoding="utf-8"))
        return 0
    for kind in (arguments.kind,) if arguments.kind else catalog.KINDS:
        sys.stdout.write(report.catalog_text(kind) + "\n")
    return 0


def _doctor(_: argparse.Namespace) -> int:
    from .doctor import run_doctor

    text, healthy = run_doctor()
    sys.stdout.write(text.rstrip("\n") + "\n")
    return 0 if healthy else 1


def _schema(arguments: argparse.Namespace) -> int:
    from .io.material_file import MaterialFile
    from .io.scene_file import SceneFile
    from .io.sensor_file import SensorFile

    model: Any = {"scene": SceneFile, "sensor": SensorFile, "material": MaterialFile}[arguments.kind]
    sys.stdout.write(json.dumps(model.model_json_schema(by_alias=True), indent=2) + "\n")
    return 0


def _whole(low: int, high: int) -> Callable[[str], int]:
    """An argparse type: a whole number in this range."""

    def parsed(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"a whole number from {low} to {high} was expected, {text} came")
        return value

    return parsed


def _pose(text: str) -> Pose:
    """An argparse type: three or six numbers, metres and degrees."""
    import math

    from .geometry import Pose

    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if not 3 <= len(numbers) <= 6 or not all(math.isfinite(number) for number in numbers):
        raise argparse.ArgumentTypeError(
            f"X,Y,Z[,YAW,PITCH,ROLL] in metres and degrees was expected, {text} came"
        )
    x, y, z, yaw, pitch, roll = numbers + [0.0] * (6 - len(numbers))
    return Pose.from_degrees(position_m=(x, y, z), yaw_deg=yaw, pitch_deg=pitch, roll_deg=roll)
