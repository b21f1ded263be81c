"""The commands `catalog` and `schema`: what sensors and materials there are, and what may stand in files.

What can be named, and what can be written, is asked from the program itself: it cannot be out of date.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

from ..errors import InputError
from .terminal import Answer


def add_catalogue(commands: Any) -> None:
    """Add `catalog` and `schema`."""
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
    catalog.add_argument(
        "--real", action="store_true",
        help="check sensors against recordings of real ones; exit 1 if one is out of bounds",
    )  # fmt: skip
    catalog.set_defaults(run=catalog_text)

    schema = commands.add_parser(
        "schema", help="JSON Schema of a file, for editors",
        description="Print the JSON Schema of scene, sensor, material, rig or job files; editors complete and check "
        "with it.",
    )  # fmt: skip
    schema.add_argument("kind", choices=("scene", "sensor", "material", "rig", "job"))
    schema.set_defaults(run=schema_text)


def catalog_text(arguments: argparse.Namespace) -> str | Answer:
    """Run `catalog`; returns what is printed."""
    from .. import catalog
    from ..outputs import report

    if arguments.kind == "check":
        return _real_answer(arguments) if arguments.real else _check_text(arguments)
    for option in ("json", "real"):
        if getattr(arguments, option):
            raise InputError(f"--{option} goes with catalog check")
    if arguments.name:
        return catalog.path_of(arguments.kind, arguments.name).read_text(encoding="utf-8")
    return "\n".join(
        report.catalog_text(kind) for kind in ([arguments.kind] if arguments.kind else catalog.KINDS)
    )


def _check_text(arguments: argparse.Namespace) -> str:
    from .. import catalog
    from ..studies import catalogue

    names = [arguments.name] if arguments.name else catalog.names("sensors")
    checks = [catalogue.check(name) for name in names]
    if arguments.json:
        return json.dumps([catalogue.as_dict(one) for one in checks], indent=2)
    return catalogue.as_text(checks)


def _real_answer(arguments: argparse.Namespace) -> Answer:
    from .. import catalog
    from ..studies import recorded

    names = [arguments.name] if arguments.name else catalog.names("sensors")
    rows = [row for name in names for row in recorded.compared(name)]
    if not rows:
        raise InputError(f"{arguments.name}: no recording of such a sensor is known")
    text = json.dumps([recorded.as_dict(row) for row in rows], indent=2) if arguments.json else ""
    return Answer(text or recorded.as_text(rows), 0 if all(row.held for row in rows) else 1)


def schema_text(arguments: argparse.Namespace) -> str:
    """Run `schema`; returns what is printed."""
    from ..batch.file import JobFile
    from ..materials.file import MaterialFile
    from ..scene.tables import SceneFile
    from ..sensor.file import SensorFile
    from ..sensor.rig_file import RigFile

    models: dict[str, Any] = {
        "scene": SceneFile, "sensor": SensorFile, "material": MaterialFile, "rig": RigFile, "job": JobFile,
    }  # fmt: skip
    dialect = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return json.dumps(dialect | models[arguments.kind].model_json_schema(by_alias=True), indent=2)
