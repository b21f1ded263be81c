"""The command line: parse, one public call, write."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

from .._version import __version__
from ..errors import BackendError, InputError, LidarSceneError, OutputError
from .batch import add_batch
from .compare import add_compare
from .field_of_view import add_fov
from .ranging import add_commands
from .render import add_render
from .view import add_view
from .words import with_joined_pose


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
    for add in (add_render, add_batch, add_commands, add_fov, add_compare, add_view):
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
        description="Print the JSON Schema of scene, sensor, material, rig or job files; editors complete and check "
        "with it.",
    )  # fmt: skip
    schema.add_argument("kind", choices=("scene", "sensor", "material", "rig", "job"))
    schema.set_defaults(run=_schema)
    return parser


def _help(parser: argparse.ArgumentParser) -> int:
    """No command: say what there is, as a usage mistake."""
    parser.print_help(sys.stderr)
    return InputError.exit_code


def _catalog(arguments: argparse.Namespace) -> int:
    from .. import catalog
    from ..outputs import report

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
    from .. import catalog
    from ..studies import catalogue

    names = [arguments.name] if arguments.name else catalog.names("sensors")
    checks = [catalogue.check(name) for name in names]
    if arguments.json:
        _say(json.dumps([catalogue.as_dict(one) for one in checks], indent=2))
    else:
        _say(catalogue.as_text(checks))
    return 0


def _doctor(_: argparse.Namespace) -> int:
    from .doctor import run_doctor

    text, healthy = run_doctor()
    _say(text)
    return 0 if healthy else 1


def _schema(arguments: argparse.Namespace) -> int:
    from ..batch.file import JobFile
    from ..materials.file import MaterialFile
    from ..scene.tables import SceneFile
    from ..sensor.file import SensorFile
    from ..sensor.rig_file import RigFile

    models: dict[str, Any] = {
        "scene": SceneFile, "sensor": SensorFile, "material": MaterialFile, "rig": RigFile, "job": JobFile,
    }  # fmt: skip
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
