"""The command line: parse, one public call, print.

Commands import what they need when they run, so that `--help` answers at once. All errors of users end here as one
line and an exit code.
"""

from __future__ import annotations

import argparse
import atexit
import gc
import re
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

from .._version import __version__
from ..errors import InputError, LidarSceneError, did_you_mean
from .batch import add_batch
from .catalogue import add_catalogue
from .compare import add_compare
from .field_of_view import add_fov
from .live.stream import add_stream
from .ranging import add_commands
from .recordings.fit import add_fit
from .recordings.sensor import add_sensor
from .recordings.twin import add_twin
from .render import add_render
from .terminal import Answer, complain, end_cleanly, ended_by, notes, say, told
from .view import add_view
from .words import with_joined_pose


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; the exit code is 0, 2 for usage, input and output mistakes, 3 without a back end."""
    if argv is None:
        end_cleanly()
        # The end of a process need not look for garbage among all that was ever imported: 0.15 s.
        atexit.register(gc.freeze)
    try:
        arguments = _parser().parse_args(with_joined_pose(sys.argv[1:] if argv is None else argv))
        with notes():
            answer = arguments.run(arguments)
        # Most commands return a text; those that may fail in part also their code.
        text, code = (answer, 0) if isinstance(answer, str) else answer
        if text:
            say(text)
        return int(code)
    except Exception as error:
        # Libraries make errors of their own of what a signal raises within them.
        if (number := ended_by()) is not None:
            return 128 + number
        if isinstance(error, LidarSceneError):
            complain(told(error))
            return error.exit_code
        if isinstance(error, MemoryError):
            complain("out of memory; a smaller --chunk needs less")
            return 1
        raise
    except KeyboardInterrupt:
        complain("interrupted")
        return 130


class _Parser(argparse.ArgumentParser):
    """Tells a mistake in one line, as everything else here does."""

    def __init__(self, **options: Any) -> None:
        super().__init__(allow_abbrev=False, **options)
        self.option_first = ""

    def parse_known_args(self, *arguments: Any, **options: Any) -> Any:
        """What a command does not know is told by the command itself, which knows its own options."""
        words = sys.argv[1:] if not arguments or arguments[0] is None else arguments[0]
        first = words[0] if words else ""
        self.option_first = first if first.startswith("--") and self._subparsers is not None else ""
        known, left = super().parse_known_args(*arguments, **options)
        if left:
            self.error(f"unrecognized arguments: {' '.join(left)}{self._meant(left[0])}")
        return known, left

    def error(self, message: str) -> NoReturn:
        if choice := _CHOICE.search(message):
            if self.option_first:
                raise InputError(
                    f"the command goes first: {self.prog} COMMAND {self.option_first} ...; see {self.prog} -h"
                )
            choices = re.findall(r"[\w-]+", choice[2])
            hint = f"{did_you_mean(choice[1].lower(), choices)} choose from {', '.join(choices)}".strip()
            message = f"{message[: choice.end(1)]}'; {hint}"
        raise InputError(f"{message}; see {self.prog} -h")

    def _meant(self, left: str) -> str:
        """What an argument that is left over was perhaps meant to be."""
        options = [option for option in self._option_string_actions if option.startswith("--")]
        if not left.startswith("-"):
            if "--set" in options and re.fullmatch(r"[-+\d.]+\w*|true|false", left):
                return "; a value goes with =: --set laser.peak_power_w=75"
            return "; sensors go with commas: --sensors A,B" if "--sensors" in options else ""
        question = did_you_mean(left.split("=")[0], options, cutoff=0.75)
        return f"; {question}" if question else ""


_CHOICE = re.compile(r"invalid choice: '([^']*)' \(choose from (.*)\)$")


def _parser() -> argparse.ArgumentParser:
    """All commands. Each sets ``run``, which returns its text, or an `Answer` if it may end with a code of its own."""
    parser = _Parser(
        prog="lidarscene", description="What an automotive direct-time-of-flight lidar would really report."
    )
    parser.add_argument("--version", action="version", version=f"lidarscene {__version__}")
    parser.set_defaults(run=lambda _: _help(parser))
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    for add in (
        add_render,
        add_stream,
        add_batch,
        add_commands,
        add_fov,
        add_compare,
        add_view,
        add_catalogue,
        add_sensor,
        add_twin,
        add_fit,
    ):
        add(commands)
    doctor = commands.add_parser(
        "doctor",
        help="what this machine can run, and why not more",
        description="Versions, which back ends work and why the others do not, and one ray traced as proof.",
    )
    doctor.set_defaults(run=_doctor)
    return parser


def _help(parser: argparse.ArgumentParser) -> Answer:
    """No command: say what there is, as a usage mistake."""
    parser.print_help(sys.stderr)
    return Answer("", InputError.exit_code)


def _doctor(_: argparse.Namespace) -> Answer:
    from .doctor import run_doctor

    text, healthy = run_doctor()
    return Answer(text, 0 if healthy else 1)
