"""The command line: parse, one public call, write."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from . import __version__
from .cli_analysis import add_commands
from .cli_fov import add_fov
from .cli_types import pose, whole, with_joined_pose
from .cli_view import add_view
from .errors import BackendError, InputError, LidarSceneError, OutputError

if TYPE_CHECKING:
    from .simulate import Summary

RENDER_HELP = """\
examples:
  lidarscene render scenes/car.toml -o out/car.ply --picture out/car.png
  lidarscene render scenes/car.toml -o out/car.ply --sensor table1-sipm --set laser.peak_power_w=75
  lidarscene render my_scene.xml -o cloud.ply --pose -5,0,1.8,0,-2,0 --json
"""

SUFFIXES = {"output": (".ply",), "keep_missed": (".npz",), "picture": (".png", ".svg")}


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; the exit code is 0, 2 for usage, input and output mistakes, 3 without a back end."""
    try:
        arguments = _parser().parse_args(with_joined_pose(sys.argv[1:] if argv is None else argv))
        return int(arguments.run(arguments))
    except LidarSceneError as error:
        # How to get a back end takes several lines; everything else is told in one.
        _complain(str(error) if isinstance(error, BackendError) else _printable(str(error)))
        return error.exit_code
    except MemoryError:
        _complain("out of memory; a smaller --chunk needs less")
        return 1
    except KeyboardInterrupt:
        _complain("interrupted")
        return 130


class _Parser(argparse.ArgumentParser):
    """Tells a mistake in one line, as everything else here does."""

    def __init__(self, **options: Any) -> None:
        super().__init__(allow_abbrev=False, **options)

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message}; see {self.prog} -h")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="lidarscene", description="What an automotive direct-time-of-flight lidar would really report."
    )
    parser.add_argument("--version", action="version", version=f"lidarscene {__version__}")
    parser.set_defaults(run=lambda _: _help(parser))
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    _add_render(commands)
    for add in (add_commands, add_fov, add_view):
        add(commands, lambda text_of: lambda arguments: _told(text_of(arguments)))

    catalog = commands.add_parser(
        "catalog", help="what sensors and materials there are",
        description="List the catalogue, print an entry's file, with a source for every number, or check sensors "
        "against what their makers publish.",
    )  # fmt: skip
    catalog.add_argument(
        "kind", nargs="?", choices=("sensors", "materials", "check"), help="list only these, or check sensors"
    )
    catalog.add_argument("name", metavar="NAME", nargs="?", help="print, or check, this entry")
    catalog.add_argument("--json", action="store_true", help="print the check as JSON")
    catalog.set_defaults(run=_catalog)

    doctor = commands.add_parser(
        "doctor", help="what this machine can run, and why not more",
        description="Versions, which back ends work and why the others do not, and one ray traced as proof.",
    )  # fmt: skip
    doctor.set_defaults(run=_doctor)

    schema = commands.add_parser(
        "schema", help="JSON Schema of a file, for editors",
        description="Print the JSON Schema of scene, sensor or material files; editors complete and check with it.",
    )  # fmt: skip
    schema.add_argument("kind", choices=("scene", "sensor", "material"))
    schema.set_defaults(run=_schema)
    return parser


def _add_render(commands: Any) -> None:
    render = commands.add_parser(
        "render", help="a point cloud of a scene", epilog=RENDER_HELP,
        description="Simulate one frame of a lidar in a scene and write its point cloud.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    render.add_argument(
        "scene", metavar="SCENE", type=Path, help="scene file (.toml) or Mitsuba scene (.xml)"
    )
    add = render.add_argument_group("what is simulated").add_argument
    add("--sensor", metavar="NAME|FILE", help="catalogue name or sensor file (default: the scene's)")
    add("--set", metavar="KEY=VALUE", action="append", default=[], dest="overrides",
        help="change a value of the sensor file, such as detector.gain=60; may be repeated")  # fmt: skip
    add("--pose", type=pose, metavar="X,Y,Z[,YAW,PITCH,ROLL]",
        help="where the sensor stands, metres and degrees (default: the scene's); positive pitch looks up")  # fmt: skip
    add("--seed", metavar="N", type=whole(0, 2**32 - 1), default=0, help="same seed, same cloud (default 0)")
    add("--chunk", metavar="N", type=whole(1, 2**31 - 1), help="pulses at a time: bounds the memory, no more")
    add = render.add_argument_group("what is written").add_argument
    add("-o", "--output", metavar="OUT.ply", type=Path, required=True, help="the point cloud")
    add("--frame", choices=("world", "sensor"), default="world", help="frame of the points (default world)")
    add("--no-truth", action="store_true", help="leave the ground truth out")
    add("--ascii", action="store_true", help="write text instead of binary")
    add("--keep-missed", metavar="F.npz", type=Path, help="every pulse without an echo point, and why")
    add("--picture", metavar="F.png", type=Path, help="a view of the cloud and its range image (or F.svg)")
    add("--json", action="store_true", help="print the summary as JSON")
    render.set_defaults(run=_render)


def _help(parser: argparse.ArgumentParser) -> int:
    """No command: say what there is, as a usage mistake."""
    parser.print_help(sys.stderr)
    return InputError.exit_code


def _render(arguments: argparse.Namespace) -> int:
    from . import api, report
    from .simulate import DEFAULT_CHUNK, Simulator, Summary

    summary = Summary()
    since = time.perf_counter()
    _check_outputs(arguments)
    scene = api.load_scene(arguments.scene)
    sensor = api.load_sensor(arguments.sensor or scene.sensor_name, overrides=arguments.overrides)
    _keep_inputs(arguments)
    since = summary.spent("load", since)
    simulator = Simulator(scene, sensor, pose=arguments.pose)
    summary.spent("build", since)
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

        # The scene's view belongs to the scene's own sensor, in the world.
        own = scene.view if arguments.pose is None and arguments.frame == "world" else None
        view = dataclasses.asdict(own) if own else {}
        frame_picture(cloud, arguments.picture, **view)
        summary.spent("picture", since)
    _print_summary(arguments, summary)
    return 0


def _outputs(arguments: argparse.Namespace) -> dict[str, Path]:
    """The files to write, by key of SUFFIXES."""
    return {key: getattr(arguments, key) for key in SUFFIXES if getattr(arguments, key) is not None}


def _option(key: str) -> str:
    return f"--{key.replace('_', '-')}"


def _check_outputs(arguments: argparse.Namespace) -> None:
    """Refuse what could not be written, before any work goes into it."""
    from .io.files import require_writable

    for key, path in _outputs(arguments).items():
        if path.suffix.lower() not in SUFFIXES[key]:
            expected = " or ".join(SUFFIXES[key])
            raise InputError(f"{_option(key)} {path}: a name that ends in {expected} was expected")
        require_writable(path)


def _keep_inputs(arguments: argparse.Namespace) -> None:
    """Refuse to write over a file that is read."""
    from .io.scene_file import files_of_scene

    inputs = [*files_of_scene(arguments.scene), *([Path(arguments.sensor)] if arguments.sensor else [])]
    for key, path in _outputs(arguments).items():
        if path.exists() and any(os.path.exists(one) and one.samefile(path) for one in inputs):
            raise InputError(f"{_option(key)} {path}: is an input of this run, another name was expected")


def _print_summary(arguments: argparse.Namespace, summary: Summary) -> None:
    from . import report

    written = {key: str(path) for key, path in _outputs(arguments).items()}
    as_json = json.dumps(report.as_dict(summary) | written) if arguments.json else ""
    _say(as_json or report.as_text(summary, written))


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

    if arguments.kind == "check":
        return _catalog_check(arguments)
    if arguments.json:
        raise InputError("--json goes with catalog check")
    if arguments.name:
        _say(catalog.path_of(arguments.kind, arguments.name).read_text(encoding="utf-8"))
        return 0
    _say("\n".join(report.catalog_text(k) for k in ([arguments.kind] if arguments.kind else catalog.KINDS)))
    return 0


def _catalog_check(arguments: argparse.Namespace) -> int:
    from . import catalog
    from .analysis import catalog_check

    names = [arguments.name] if arguments.name else catalog.names("sensors")
    checks = [catalog_check.check(name) for name in names]
    if arguments.json:
        _say(json.dumps([catalog_check.as_dict(one) for one in checks], indent=2))
    else:
        _say(catalog_check.as_text(checks))
    return 0


def _doctor(_: argparse.Namespace) -> int:
    from .doctor import run_doctor

    text, healthy = run_doctor()
    _say(text)
    return 0 if healthy else 1


def _schema(arguments: argparse.Namespace) -> int:
    from .io.material_file import MaterialFile
    from .io.scene_model import SceneFile
    from .io.sensor_file import SensorFile

    models: dict[str, Any] = {"scene": SceneFile, "sensor": SensorFile, "material": MaterialFile}
    dialect = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    _say(json.dumps(dialect | models[arguments.kind].model_json_schema(by_alias=True), indent=2))
    return 0


def _told(text: str) -> int:
    _say(text)
    return 0


def _say(text: str) -> None:
    """Print a text, whatever the terminal's encoding. A reader that has gone (`| head`) is no mistake."""
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    shown = text.rstrip("\n").encode(encoding, "backslashreplace").decode(encoding)
    try:
        sys.stdout.write(shown + "\n")
        sys.stdout.flush()
    except OSError as error:
        # Python writes what is left once more when it ends: to nowhere, then.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not isinstance(error, BrokenPipeError):
            raise OutputError(f"standard output: cannot be written: {error.strerror}") from None


def _complain(text: str) -> None:
    sys.stderr.write(f"lidarscene: error: {text}\n")


def _printable(text: str) -> str:
    """In one line, whatever a file's name or a value holds."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
