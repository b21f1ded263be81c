"""The command `street`: a scene file of a street that is made from a seed."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import OptionError
from ..rendering.option_fields import Whole
from ..rendering.render_options import SEEDS
from ..scene.street import TOWN_STREETS
from .terminal import Answer
from .words import number, whole_number

if TYPE_CHECKING:
    from ..scene.street.network_tables import NetworkKind

STREET_HELP = """\
examples:
  lidarscene street -o out/street
  lidarscene street --length-m 2000 --seed 3 -o out/street
  lidarscene street -o out/avenue --set lanes=2 --set "parked_share=[0.5, 0.9]" --set stop_share=0
  lidarscene street --opendrive town.xodr --seed 3 -o out/town
  lidarscene street --town 4 --seed 3 --set "slope_percent=[0, 6]" -o out/town
  lidarscene street --sumo scenario.sumocfg --ego bus.7 -o out/scenario
  lidarscene render out/street/street.toml -o out/frames --frames 1200
"""


def add_street(commands: Any) -> None:
    """Add `street`."""
    command = commands.add_parser(
        "street",
        help="write the scene of a street with traffic, from a seed or a map",
        epilog=STREET_HELP,
        description="Write a street with houses, trees, parked cars, traffic and people: the scene file street.toml, "
        "with meshes and motions beside it. A scene file with [street] gives the same scene without these "
        "files. With a map, the roads are those of the map, and SUMO simulates vehicles and people.",
    )
    add = command.add_argument
    add("-o", "--output", metavar="DIR", type=Path, required=True, help="folder to write to")
    source = command.add_mutually_exclusive_group()
    source.add_argument("--opendrive", metavar="FILE", type=Path, help="take the roads from an OpenDRIVE file")
    source.add_argument("--osm", metavar="FILE", type=Path, help="take the roads from an OpenStreetMap file")
    source.add_argument("--sumo", metavar="FILE", type=Path, help="take roads and traffic from a SUMO configuration")
    source.add_argument(
        "--town",
        metavar="N",
        type=whole_number(Whole(*TOWN_STREETS)),
        help="generate a town of N by N streets with junctions and a roundabout",
    )
    add(
        "--ego",
        metavar="NAME",
        help="vehicle of --sumo that carries the sensor (default: the one with the longest drive)",
    )
    add("--left-hand", action="store_true", help="let the traffic of --osm keep to the left, which maps do not say")
    add(
        "--length-m",
        metavar="M",
        type=number,
        help="distance that the vehicle with the sensor drives, in metres (default: 1000)",
    )
    add("--seed", metavar="N", type=whole_number(SEEDS), help="seed of all random choices (default: 1)")
    add(
        "--set",
        dest="overrides",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help='set another key of [street], such as lanes=2 or "speed_m_s=[8, 11]"; may be repeated',
    )
    command.set_defaults(run=run_street)


def run_street(arguments: argparse.Namespace) -> Answer:
    """Run `street`."""
    from ..files.overrides import key_path, with_overrides
    from ..files.toml import validate
    from ..scene.made_street import made_tables
    from ..scene.saving import write_street
    from ..scene.street.street_file import StreetFile
    from ..scene.street.street_tables import street_summary

    if arguments.output.suffix.lower() == ".toml":
        raise OptionError("{output} {0}: must be a folder, which gets street.toml, got a file's name", arguments.output)
    named = {key: getattr(arguments, key) for key in ("length_m", "seed")}
    keys = {key: value for key, value in named.items() if value is not None}
    for assignment in arguments.overrides:
        key, *inner = key_path(assignment)
        if key in keys:
            raise OptionError(f"{{{key}}} and --set {{0}}: must be only one of them, got both", assignment)
        if key == "street" and inner:
            raise OptionError("--set {0}: did you mean {1}? Keys are those of [street]", assignment, ".".join(inner))
    file = validate(StreetFile, with_overrides(keys, arguments.overrides), "[street]", overrides=arguments.overrides)
    networks: dict[NetworkKind, Any] = {"opendrive": arguments.opendrive, "osm": arguments.osm, "sumo": arguments.sumo}
    networks["town"] = arguments.town
    tables, origin = made_tables(file, networks, ego=arguments.ego, left_hand=arguments.left_hand)
    path = write_street(tables, arguments.output, origin=origin)
    summary = street_summary(tables)
    return Answer(f"wrote {path}: {summary.as_text()}", numbers={"scene": str(path), **summary._asdict()})
