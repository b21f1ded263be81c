"""The command line: parse, one public call, print.

Commands import what they need when they run, so that `--help` answers at once. All user errors end here as one line and
an exit code.
"""

from __future__ import annotations

import argparse
import atexit
import gc
import re
import signal
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

from .. import catalog
from .._version import __version__
from ..errors import InputError, LidarSceneError, did_you_mean
from ..files.json_text import json_text
from ..files.optional import import_optional
from .batch import add_batch
from .catalog_commands import add_catalogue
from .compare import add_compare
from .design import add_design
from .fov import add_fov
from .options import CommandOptions, add_options
from .ranging import add_commands
from .recordings.certify import add_certify
from .recordings.fit import add_fit
from .recordings.sensor import add_sensor
from .recordings.twin import add_twin
from .render import add_render
from .stream import add_stream
from .street import add_street
from .terminal import (
    Answer,
    end_cleanly,
    ended_by,
    error_text,
    mute_errors,
    notes,
    print_error,
    print_text,
    quietly,
    secure_streams,
    tell,
)
from .view import add_view
from .words import require_no_empty, with_joined_pose


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code: 0, 2 for usage, input and output mistakes, 3 without a back end."""
    if argv is None:
        secure_streams()
        end_cleanly()
        atexit.register(mute_errors)  # registered first, it runs last
        # Garbage collection of all imported modules at exit would take 0.15 s.
        atexit.register(gc.freeze)
    try:
        words = sys.argv[1:] if argv is None else argv
        require_no_empty(words)
        arguments = _parser().parse_args(with_joined_pose(words))
        quiet = bool(getattr(arguments, "quiet", False))
        with notes(), quietly(quiet):
            answer = arguments.run(arguments)
        if getattr(arguments, "json", False):
            print_text(json_text(answer.numbers, indent=1))
        elif answer.text and (not quiet or answer.code):
            print_text(answer.text)
        return int(answer.code)
    except (Exception, KeyboardInterrupt) as error:
        if isinstance(error, KeyboardInterrupt) or ended_by() == signal.SIGINT:
            tell("lidarscene: interrupted")
            return 128 + signal.SIGINT
        if (number := ended_by()) is not None:
            return 128 + number
        if isinstance(error, LidarSceneError):
            print_error(error_text(error))
            return error.exit_code
        if isinstance(error, MemoryError):
            print_error("out of memory; a smaller --chunk needs less")
            return 1
        raise


class _Once(argparse.Action):
    """Action of an argument that is given once: of two values one would be lost in silence."""

    def __call__(self, parser: Any, *arguments: Any) -> None:
        if self in parser.given:
            raise argparse.ArgumentError(self, "must be given once")
        parser.given.add(self)
        super().__call__(parser, *arguments)


class _StoreOnce(_Once, argparse._StoreAction):
    """Action `store` of an option that is given once."""


class _SwitchOnce(_Once, argparse.BooleanOptionalAction):
    """Switch with a --no- that is given once."""


class _Parser(argparse.ArgumentParser):
    """Parser that reports a mistake as InputError, in one line."""

    def __init__(self, *, epilog: str | None = None, **options: Any) -> None:
        if epilog:  # examples have lines of their own
            options["formatter_class"] = argparse.RawDescriptionHelpFormatter
        super().__init__(allow_abbrev=False, epilog=epilog, **options)
        self.option_first, self.words, self.given = "", list[str](), set[argparse.Action]()
        for name in (None, "store"):
            self.register("action", name, _StoreOnce)
        self.register("action", argparse.BooleanOptionalAction, _SwitchOnce)

    def parse_known_args(self, *arguments: Any, **options: Any) -> Any:
        """Report unknown arguments by the command's own parser, which can suggest its own options."""
        words = sys.argv[1:] if not arguments or arguments[0] is None else arguments[0]
        first = words[0] if words else ""
        self.words = list(words)
        self.option_first = first if first.startswith("--") and self._subparsers is not None else ""
        self.given.clear()
        parsed, unknown = super().parse_known_args(*arguments, **options)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}{self._suggestion(unknown[0])}")
        return parsed, unknown

    def error(self, message: str) -> NoReturn:
        if choice := _CHOICE.search(message):
            if self.option_first:
                raise InputError(
                    f"the command goes first: {self.prog} COMMAND {self.option_first} ...; see {self.prog} -h"
                )
            choices = re.findall(r"[\w-]+", choice[2])
            meant = FOREIGN_COMMANDS.get(choice[1].lower(), "") if self._subparsers is not None else ""
            if self.prog.endswith(" catalog"):
                kinds = [kind for kind in catalog.KINDS if choice[1] in catalog.names(kind)]
                meant = f"{self.prog} {kinds[0]} {choice[1]} prints it" if kinds else ""
            hint = meant or f"{did_you_mean(choice[1].lower(), choices)} choose from {', '.join(choices)}".strip()
            message = f"{message[: choice.end(1)]}'; {hint}"
        elif "are required" in message:
            message += self._about_words()
        raise InputError(f"{message}; see {self.prog} -h")

    def _print_message(self, message: str, file: Any = None) -> None:
        """Print help and version as all answers: argparse drops them where they cannot be written."""
        print_text(message)

    def _about_words(self) -> str:
        """Suggest the option of sensors where more words come first than the command takes."""
        leading = next((place for place, word in enumerate(self.words) if word.startswith("-")), len(self.words))
        taken = sum(not action.option_strings for action in self._actions)
        return self._suggestion(self.words[taken]) if leading > taken else ""

    def _suggestion(self, argument: str) -> str:
        """Suggest an option for an unknown argument."""
        options = [option for option in self._option_string_actions if option.startswith("--")]
        if not argument.startswith("-"):
            if {"--set", "--sensor"} <= {*options} and re.fullmatch(r"[-+\d.]+\w*|true|false", argument):
                return "; a value needs =: --set laser.peak_power_w=75"
            if "--sensors" in options:
                return "; sensors go behind --sensors, with commas: --sensors A,B"
            return f"; a sensor goes behind --sensor: --sensor {argument}" if "--sensor" in options else ""
        word = argument.partition("=")[0].lstrip("-")
        question = did_you_mean(word, [option[2:] for option in options], cutoff=0.7).replace(" mean ", " mean --")
        if not question and "--scene-set" in options:
            from ..rendering.render_options import key_like
            from ..scene.tables import SceneFile
            from ..sensor.sensor_file import SensorFile

            option, key = key_like(word.replace("-", "_"), set=SensorFile, scene_set=SceneFile)
            question = f"a key of the file is changed by --{option.replace('_', '-')} {key}=VALUE" if key else ""
        return f"; {question}" if question else ""


_VERSION = f"lidarscene {__version__}"

WITHOUT_FIGURES = ("view", "schema", "version", "help", "completion")
"""Commands that compute no numbers; all others take `--json` and `--quiet`. `view` takes `--quiet`."""

FOREIGN_COMMANDS = {
    **dict.fromkeys(
        ("list", "ls", "scenes", "sensors", "materials", "meshes", "examples"),
        "lists are lidarscene catalog, catalog sensors, catalog scenes, ...",
    ),
    **dict.fromkeys(("max-range", "max_range", "snr"), "lidarscene range SENSOR has range, SNR and P_d"),
    "sweep": "lidarscene range SENSOR --over AXIS --plot F.png sweeps",
    **dict.fromkeys(("sensitivities", "sensitivity"), "lidarscene range SENSOR --sensitivities"),
    **dict.fromkeys(("eye-safety", "eye_safety", "safety"), "lidarscene range SENSOR --eye-safety"),
    **dict.fromkeys(("budget", "show", "open"), "lidarscene view CLOUD SCENE shows a cloud, and the budget of a point"),
    **dict.fromkeys(("run", "simulate", "scan", "record"), "lidarscene render SCENE -o a.ply renders a frame"),
    **dict.fromkeys(("validate", "lint"), "lidarscene check FILE lists the mistakes of a file"),
}
"""Words that people try for a command, and the command that does it."""

_CHOICE = re.compile(r"invalid choice: '([^']*)' \(choose from (.*)\)$")


def _parser() -> argparse.ArgumentParser:
    """Parser of all commands. Each sets ``run``, a function of the arguments that returns an `Answer`."""
    parser = _Parser(
        prog="lidarscene", description="Simulate what an automotive direct-time-of-flight lidar would really report."
    )
    parser.add_argument("--version", action="version", version=_VERSION)
    parser.set_defaults(run=lambda _: _help(parser))
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    for add in (
        add_render,
        add_stream,
        add_batch,
        add_commands,
        add_fov,
        add_compare,
        add_design,
        add_view,
        add_catalogue,
        add_street,
        add_sensor,
        add_twin,
        add_fit,
        add_certify,
    ):
        add(commands)
    doctor = commands.add_parser(
        "doctor",
        help="show what this machine can run, and what is missing",
        description="Print versions and which back ends work, say why the others do not, and trace a ray as proof.",
    )
    doctor.set_defaults(run=_doctor)
    version = commands.add_parser("version", help="print the version, like --version")
    version.set_defaults(run=lambda _: Answer(_VERSION))
    help_of = commands.add_parser("help", help="print options and examples of a command, like -h after the command")
    help_of.add_argument(
        "command", metavar="COMMAND", nargs="?", choices=list(commands.choices), help="name of a command"
    )
    help_of.set_defaults(run=lambda arguments: Answer(commands.choices.get(arguments.command, parser).format_help()))
    completion = commands.add_parser(
        "completion",
        help="print a script that lets the shell complete commands and options",
        description='Print a script that lets the shell complete commands and options. In Bash: eval "$(lidarscene '
        "completion bash)\". Needs pip install 'lidarscene[completion]'.",
    )
    completion.add_argument("shell", metavar="SHELL", choices=("bash", "zsh", "tcsh"), help="bash, zsh or tcsh")
    completion.set_defaults(
        run=lambda arguments: Answer(import_optional("shtab", extra="completion").complete(parser, arguments.shell))
    )
    for name, command in commands.choices.items():
        options = ("quiet",) if name == "view" else () if name in WITHOUT_FIGURES else ("json", "quiet")
        if options:
            add_options(command.add_argument_group("messages"), CommandOptions, *options)
    return parser


def _help(parser: argparse.ArgumentParser) -> Answer:
    """Print the help for a call without a command, which is a usage mistake."""
    tell(parser.format_help().rstrip("\n"))
    return Answer("", InputError.exit_code)


def _doctor(_: argparse.Namespace) -> Answer:
    from .doctor import examine

    findings = examine()
    return Answer(findings.as_text(), 0 if findings.healthy else 1, findings.as_dict())
