"""The command `street`: a scene file of a street that is made from a seed."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..rendering.render_options import SEEDS
from .terminal import Answer
from .words import number, whole_number

STREET_HELP = """\
examples:
  lidarscene street -o out/street
  lidarscene street --length-m 2000 --seed 3 -o out/street
  lidarscene street -o out/avenue --set lanes=2 --set "parked_share=[0.5, 0.9]" --set stop_share=0
  lidarscene render out/street/street.toml -o out/frames --frames 1200
"""


def add_street(commands: Any) -> None:
    """Add `street`."""
    command = commands.add_parser(
        "street",
        help="a street with traffic from a seed, as a scene file",
        epilog=STREET_HELP,
        description="Write the scene file street.toml of a street with houses, trees, parked cars, traffic that keeps "
        "its lanes and distances, and people who cross, with its meshes and motions beside it. A scene file with "
        "[street] gives the same scene without writing it.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = command.add_argument
    add("-o", "--output", metavar="DIR", type=Path, required=True, help="folder to write to")
    add("--length-m", metavar="M", type=number, help="way of the vehicle that carries the sensor (default: 1000)")
    add("--seed", metavar="N", type=whole_number(SEEDS), help="of all random choices (default: 1)")
    add(
        "--set",
        dest="overrides",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help='another key of [street], such as lanes=2 or "speed_m_s=[8, 11]"; may be repeated',
    )
    command.set_defaults(run=run_street)


def run_street(arguments: argparse.Namespace) -> Answer:
    """Run `street`."""
    from ..files.overrides import with_overrides
    from ..files.toml import validate
    from ..scene.street.street_file import StreetFile
    from ..scene.street.street_tables import street_summary, write_street

    named = {key: getattr(arguments, key) for key in ("length_m", "seed")}
    tables = {key: value for key, value in named.items() if value is not None}
    file = validate(StreetFile, with_overrides(tables, arguments.overrides), "[street]", overrides=arguments.overrides)
    path = write_street(file, arguments.output)
    summary = street_summary(file)
    return Answer(f"wrote {path}: {summary.as_text()}", numbers={"scene": str(path), **summary._asdict()})
