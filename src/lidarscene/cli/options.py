"""Options of the commands: arguments made of the dataclass fields that declare them, and the objects made of arguments.

A command names the options that it takes: ``add_options(group, TraceOptions, "rays", "interactions")``.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from ..files.overrides import toml_text
from ..outputs.output_options import FRAMES, Outputs
from ..rendering.option_fields import OneOf, Whole, declared, option, options_of
from ..rendering.render_options import FrameOptions, TraceOptions
from ..studies.field_of_view.study_options import FieldOfViewStudy
from ..studies.ranging.conditions import Conditions, SweepOptions
from .words import number, pose, pulses, rising_numbers, whole_number

Kind = TypeVar("Kind")

PARSERS = {
    "float": number,
    "float | None": number,
    "Pose | None": pose,
    "Sequence[int] | None": pulses,
    "tuple[float, ...]": rising_numbers("seconds", "0.1,0.5,1"),
    "File | None": Path,
    "Path | None": Path,
}
"""Type of a field -> function that parses it, unless the option is one of some names or numbers; else it is text."""


@dataclass(init=False, repr=False, eq=False, kw_only=True)
class CommandOptions:
    """Options of several commands that are no option of the library."""

    sensor: str | None = option(None, help="catalogue name or sensor file (default: the scene's)", metavar="NAME|FILE")
    rig: Path | None = option(
        None, help="rig with several sensors on one vehicle: a file, or the name of an example", metavar="RIG"
    )
    overrides: Sequence[str] = option(
        (),
        help="change a value of the sensor file, such as detector.gain=60, or use a part of another sensor, "
        "such as detector=sipm-905; may be repeated",
        metavar="KEY=VALUE",
        flags=("--set",),
    )
    scene_overrides: Sequence[str] = option(
        (),
        help="change a value of the scene file, such as sun.illuminance_klux=1 or bodies.car.yaw_deg=30; may be "
        "repeated",
        metavar="KEY=VALUE",
        flags=("--scene-set",),
    )
    ego_mesh: Path | None = option(
        None, help="mesh of the vehicle that carries the sensor (default: the scene's)", metavar="F"
    )
    frames: int | None = option(None, FRAMES, help="number of consecutive frames", metavar="N")
    output: Path = field(metadata=declared("folder to write to", metavar="DIR", flags=("-o", "--output")))
    metadata: Path | None = option(
        None,
        help="the maker's metadata of the unit: json of an Ouster (default: beside the recording), YAML of a "
        "Velodyne, CSV of a Hesai (.dat of an AT128); an OSF contains its metadata",
        metavar="F",
    )
    sensor_index: int = option(
        0, Whole(0, 255), help="number of the sensor in an OSF with several sensors, from 0", metavar="K"
    )
    json: bool = option(False, help="print JSON instead of text")
    quiet: bool = option(
        False,
        help="print neither progress nor, if all went well, a summary; still print errors, notes and JSON",
        flags=("-q", "--quiet"),
    )


@dataclass(init=False, repr=False, eq=False, kw_only=True)
class StudyOptions(CommandOptions):
    """Options of commands that take several sensors."""

    overrides: Sequence[str] = option(
        (),
        help="change a value of all sensors, or of one, such as detector.gain=60, or use a part of another "
        "sensor, such as detector=sipm-905; may be repeated",
        metavar="[SENSOR:]KEY=VALUE",
        flags=("--set",),
    )


def scene_changes(arguments: argparse.Namespace) -> tuple[str, ...]:
    """Overrides of the scene file, the ego vehicle's mesh among them."""
    mesh = [] if arguments.ego_mesh is None else [f"ego.mesh={toml_text(str(arguments.ego_mesh.absolute()))}"]
    return (*mesh, *arguments.scene_overrides)


FLAGS = {
    name: next(flag for flag in entry.flags if flag.startswith("--"))
    for kind in (TraceOptions, FrameOptions, Outputs, FieldOfViewStudy, Conditions, SweepOptions, CommandOptions)
    for name, (_, entry) in options_of(kind).items()
    if entry.flags
}
"""Name of a field -> its name on the command line, unless that is the same with dashes."""
FLAGS["changes"] = FLAGS["overrides"]  # of a sensor that was loaded before


def flag_of(name: str) -> str:
    """Name on the command line of an option of the library."""
    return FLAGS.get(name, f"--{name.replace('_', '-')}")


def add_options(group: argparse._ActionsContainer, kind: type[Any], *names: str, **remarks: str) -> None:
    """Add an argument for each of these options of a dataclass; ``remarks`` end the help of an option."""
    declarations = options_of(kind)
    for name in (*names, *remarks):
        entry, declaration = declarations[name]
        settings: dict[str, Any] = {"default": entry.default, "metavar": declaration.metavar}
        about = declaration.help
        if isinstance(entry.default, bool):
            settings = {"action": f"store_{not entry.default}".lower()}
            about = f"without {about}" if entry.default else about
        elif entry.type == "bool | None":
            settings = {"action": argparse.BooleanOptionalAction, "default": None}
        elif entry.default == ():
            settings |= {"action": "append", "default": []}
        elif entry.default is MISSING:
            settings |= {"required": True, "type": Path, "default": None}
        elif isinstance(declaration.values, OneOf):
            settings["choices"] = declaration.values.names
        elif isinstance(declaration.values, Whole):
            settings["type"] = whole_number(declaration.values)
        else:
            settings["type"] = PARSERS.get(str(entry.type), str)
        about = "; ".join(filter(None, (about, remarks.get(name))))
        group.add_argument(*(declaration.flags or (flag_of(name),)), dest=name, help=about, **settings)


def options_from(kind: type[Kind], arguments: argparse.Namespace) -> Kind:
    """Make the options of a command from its arguments; those that it does not take have their defaults."""
    values = {name: getattr(arguments, name, None) for name in options_of(kind)}
    return kind(**{name: value for name, value in values.items() if value is not None})
