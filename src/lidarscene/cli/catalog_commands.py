"""The commands `catalog`, `schema` and `check`: entries of the catalogue, JSON Schemas of files, mistakes in a file.

All three read the program's own catalogue and file models, so that they cannot be out of date.
"""

from __future__ import annotations

import argparse
import json
import tomllib
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from .terminal import Answer

if TYPE_CHECKING:
    from ..rendering.import_report import ImportReport

KINDS = ("scene", "sensor", "imu", "rig", "material", "job", "design")


def add_catalogue(commands: Any) -> None:
    """Add `catalog`, `schema` and `check`."""
    catalog = commands.add_parser(
        "catalog",
        help="list sensors, IMUs, materials, scenes, design studies, meshes and examples",
        description="List the catalogue, print the file of an entry (for a mesh or a recording, its path), or compare "
        "sensors with what their makers publish.",
    )
    catalog.add_argument(
        "kind",
        nargs="?",
        choices=("sensors", "imus", "materials", "scenes", "designs", "meshes", "examples", "check"),
        help="list only this kind, or check sensors",
    )
    catalog.add_argument("name", metavar="NAME", nargs="?", help="entry to print or check")
    catalog.add_argument(
        "--real",
        action="store_true",
        help="compare sensors with recordings of real ones; exit code 1 if one misses a limit",
    )
    catalog.add_argument(
        "--copy",
        metavar="DIR",
        type=Path,
        help="copy this scene and its meshes into a folder, so that you can edit them",
    )
    catalog.set_defaults(run=run_catalog)

    schema = commands.add_parser(
        "schema",
        help="print the JSON Schema of a kind of file, for editors",
        description="Print the JSON Schema of scene, sensor, IMU, material, rig, job or design files. Editors use it "
        "to complete and check a file.",
    )
    schema.add_argument("kind", choices=KINDS)
    schema.set_defaults(run=run_schema)

    check = commands.add_parser(
        "check",
        help="print all mistakes in a file",
        description="Read a scene, sensor, rig, material, job or design file and print every mistake in it, one per "
        "line. For a mesh file, a USD stage or a Mitsuba scene, also print its contents. The exit code is "
        "2 if there is a mistake.",
    )
    check.add_argument("files", metavar="FILE", nargs="+", type=Path, help="file, or name of an entry")
    check.set_defaults(run=run_check)


def run_catalog(arguments: argparse.Namespace) -> Answer:
    """Run `catalog`."""
    from .. import catalog
    from ..outputs.catalog_list import catalog_entries, catalog_text
    from ..scene.derived import copy_scene

    if arguments.copy is not None:
        if arguments.kind != "scenes" or not arguments.name:
            raise InputError("--copy needs the name of a scene: catalog scenes drive --copy DIR")
        copy = str(copy_scene(arguments.name, arguments.copy))
        return Answer(f"wrote {copy}", numbers={"scene": copy})
    if arguments.kind == "check":
        return _check_answer(arguments)
    if arguments.real:
        raise InputError("--real needs catalog check")
    if arguments.name:
        path = catalog.path_of(arguments.kind, arguments.name)
        text = path.read_text(encoding="utf-8") if path.suffix == ".toml" else str(path)
        return Answer(text, numbers=tomllib.loads(text) if path.suffix == ".toml" else {"file": text})
    entries = {kind: catalog_entries(kind) for kind in ([arguments.kind] if arguments.kind else catalog.KINDS)}
    return Answer("\n".join(catalog_text(kind, entries[kind]) for kind in entries), numbers=entries)


def _check_answer(arguments: argparse.Namespace) -> Answer:
    from .. import catalog
    from ..studies import published_values, recorded
    from ..studies.held import passed

    study = recorded if arguments.real else published_values
    names = [catalog.path_of("sensors", arguments.name).stem] if arguments.name else catalog.names("sensors")
    rows = [row for name in names for row in study.compare(name)]
    if not rows:
        raise InputError(f"{arguments.name}: no recording of such a sensor is known")
    if arguments.real:
        with_rows = {row.subject for row in rows}
        text = recorded.as_text(rows, without=[name for name in names if name not in with_rows])
    else:
        text = published_values.as_text(rows)
    return Answer(text, 0 if passed(rows) else 1, study.as_dicts(rows))


def run_schema(arguments: argparse.Namespace) -> Answer:
    """Run `schema`."""
    from ..checking.file_check import FILE_MODELS

    dialect = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return Answer(json.dumps(dialect | FILE_MODELS[arguments.kind].model_json_schema(by_alias=True), indent=2))


def run_check(arguments: argparse.Namespace) -> Answer:
    """Run `check`; one line for each mistake, one for each file without any, and what mesh files hold."""
    from ..checking.file_check import mistakes_of

    mistakes = {str(path): list(mistakes_of(path)) for path in arguments.files}
    imports = {str(path): report for path in arguments.files if (report := _import_report(path)) is not None}
    lines = []
    for path, messages in mistakes.items():
        lines += messages or [f"{path}: no mistake found"]
        lines += [imports[path].text()] if path in imports else []
    code = InputError.exit_code if any(mistakes.values()) else 0
    reports = {path: report.as_dict() for path, report in imports.items()}
    return Answer("\n".join(lines), code, {"mistakes": mistakes} | ({"imports": reports} if reports else {}))


def _import_report(path: Path) -> ImportReport | None:
    """What a mesh, a stage or a Mitsuba scene holds; None for another file, and for one that cannot be read."""
    from ..checking.file_check import checked_path
    from ..rendering.import_report import import_report
    from ..scene.bare_mesh import is_mesh
    from ..scene.foreign import is_xml

    # What is wrong with the file is told as its mistake.
    with suppress(InputError):
        file = checked_path(path)
        if is_mesh(file) or is_xml(file):
            return import_report(file)
    return None
