"""The command `sensor`: a sensor file of one unit, from its maker's metadata."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..options import CommandOptions, add_options
from ..terminal import Answer

SENSOR_HELP = """\
examples:
  lidarscene sensor --from os1.json -o my-os1.toml
  lidarscene sensor --from os1.json --mode 2048x10 -o my-os1-2048.toml
  lidarscene sensor --from drive.osf --sensor-index 1 -o my-os0.toml
  lidarscene sensor --from db.xml -o my-hdl64.toml
  lidarscene sensor --from angles.csv --like pandar64 -o my-pandar.toml
"""


def add_sensor(commands: Any) -> None:
    """Add `sensor`."""
    command = commands.add_parser(
        "sensor",
        help="write a sensor file of your unit, from the maker's metadata",
        epilog=SENSOR_HELP,
        description="Write a sensor file with the beams of one unit, from the metadata of an Ouster (json or OSF), the "
        "calibration of a Velodyne (YAML, XML) or the table of angles of a Hesai (CSV). Laser, optics and "
        "detector are those of the catalogue.",
    )
    add = command.add_argument
    add("--from", metavar="F", type=Path, required=True, dest="source", help="the maker's metadata of the unit")
    add("-o", "--output", metavar="F.toml", type=Path, required=True, help="sensor file to write")
    add("--like", metavar="NAME", help="sensor of the catalogue of the same kind (default: by maker and beams)")
    add(
        "--mode",
        metavar="COLUMNSxHZ",
        help="mode of an Ouster's firmware, such as 1024x10 (default: the mode in its metadata)",
    )
    add_options(command, CommandOptions, "sensor_index")
    command.set_defaults(run=run_sensor)


def run_sensor(arguments: argparse.Namespace) -> Answer:
    """Run `sensor`."""
    from ...files.atomic import require_writable
    from ...recordings.units.unit_file import read_unit, write_unit

    unit = read_unit(arguments.source, arguments.mode, sensor_index=arguments.sensor_index)
    require_writable(arguments.output)
    text = write_unit(unit, arguments.source, arguments.output, like=arguments.like)
    numbers = {
        "sensor": str(arguments.output),
        "name": unit.name,
        "beams": len(unit.lists["elevation_deg"]),
        "like": arguments.like or unit.model,
        "notes": text.splitlines()[1:],
    }
    return Answer(text, numbers=numbers)
