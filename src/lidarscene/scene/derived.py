"""Scene files made of others: `extends`, an ego vehicle's own mesh, and copies of shipped scenes to edit."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from .. import catalog
from ..errors import InputError
from ..files.atomic import atomic_folder
from ..files.overrides import key_path, toml_text
from ..files.toml import read_toml
from .meshes import reading

Tables = dict[str, Any]

DEEPEST = 8
"""Most scene files that extend each other in a chain."""

EGO_CAR, EGO_CLASS, EGO_PAINT = "own_car", "car", "car_paint_white"
"""Name, class and material of an ego vehicle's mesh if nothing else says them."""

_OF_SHAPE = (
    *("mesh", "primitive", "size_m", "radius_m", "height_m", "material", "materials", "pattern", "unit", "up", "scale"),
    *("crown_m", "kerb_m", "spacing_m", "animation", "standing"),
)
"""Keys of a body that belong to its shape: another shape has none of them."""


_WAYS: dict[str, tuple[set[str], ...]] = {
    "sun": ({"azimuth_deg", "elevation_deg"}, {"place", "time", "north_deg"}),
    "air": ({"transmittance"}, {"extinction_per_m"}, {"visibility_km"}),
    "ego": ({"poses", "at_end"}, {"poses_file", "at_end"}, {"speed_m_s", "yaw_rate_deg_s", "velocity_m_s"}),
}
"""Keys of a table that say the same in different ways: one way replaces the others."""


def is_early(change: str) -> bool:
    """Return whether an override decides which bodies there are: it is made before they are gathered."""
    path = key_path(change)
    return path[0] in ("street", "extends", "without") or path in (["ego"], ["ego", "mesh"])


def from_current_folder(change: str) -> str:
    """Return an override whose value, if it is a file of the current folder, is an absolute path."""
    path, (_, _, text) = key_path(change), change.partition("=")
    is_file_key = path[-1] in ("mesh", "poses_file", "base", "extends") or path == ["sensor", "name"]
    name = text.strip().strip("\"'")
    if is_file_key and name and Path(name).suffix and os.path.isfile(name):
        return f"{'.'.join(path)}={toml_text(str(Path(name).absolute()))}"
    return change


def extended(tables: Tables, path: Path, find: Callable[[str | Path], Path]) -> Tables:
    """Return the tables of a scene file together with those that it extends.

    Tables go over tables key by key, bodies over bodies of the same name; other bodies come behind. Paths of extended
    files become absolute.

    Args:
        find: gives the file of a scene's name or path

    Raises:
        InputError: for a file that extends itself, a body in ``without`` that is not there, or another value in the
            place of a list
    """
    chain = [path.absolute()]
    layers = [_checked(tables, path)]
    while "extends" in layers[-1]:
        name = layers[-1]["extends"]
        if not isinstance(name, str) or len(chain) > DEEPEST:
            raise InputError(f"{chain[-1]}: extends: must be the name or file of a scene, {DEEPEST} deep at most")
        base = find(chain[-1].parent / name if Path(name).suffix else name).absolute()
        if base in chain:
            raise InputError(f"{chain[-1]}: extends: {base.name} extends this file in turn")
        if base.suffix != ".toml":
            raise InputError(f"{chain[-1]}: extends: must be a TOML scene file, got {base.name}")
        chain.append(base)
        layers.append(with_absolute_paths(_checked(read_toml(base), base), base.parent))
    result: Tables = {}
    for file, layer in zip(reversed(chain), reversed(layers), strict=True):
        result = merged(result, layer)
        without = result.pop("without", ())
        names = {body.get("name") for body in result.get("bodies", ())}
        if missing := [name for name in without if name not in names]:
            raise InputError(f"{file}: without: no body '{missing[0]}' in what it extends")
        if without:
            result["bodies"] = [body for body in result["bodies"] if body.get("name") not in without]
    return result


def _checked(tables: Tables, file: Path) -> Tables:
    """Return the tables of a file, whose lists can be joined with those of others.

    Everything else is checked when all files are joined.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """

    def check(key: str, value: object, kind: type, expected: str) -> None:
        if not isinstance(value, kind):
            raise InputError(f"{file}: {key}: must be {expected}, got {toml_text(value)}")

    for key, kind, expected in (("bodies", dict, "a table"), ("without", str, "text")):
        items = tables.get(key, [])
        check(key, items, list, "a list")
        for number, item in enumerate(items):
            check(f"{key}[{number}]", item, kind, expected)
    for number, body in enumerate(tables.get("bodies", ())):
        check(f"bodies[{number}].name", body.get("name", ""), str, "text")
        check(f"bodies[{number}].instances", body.get("instances", []), list, "a list")
    check("sensor", tables.get("sensor", {}), dict, "a table")
    return tables


def files_extended(path: Path, find: Callable[[str | Path], Path]) -> Iterator[Path]:
    """Yield the scene files that a scene file extends, one after the other.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    tables, depth = read_toml(path), 0
    while isinstance(name := tables.get("extends"), str) and depth <= DEEPEST:
        path = find(path.parent / name if Path(name).suffix else name)
        yield path
        tables, depth = read_toml(path), depth + 1


def with_ego_mesh(tables: Tables, folder: Path, where: str) -> Tables:
    """Return tables in which `ego.mesh` is the body that rides with the vehicle, in place of the scene's own.

    Its parts have their own colours, and without one car paint.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    ego = tables.get("ego")
    if not isinstance(ego, dict) or "mesh" not in ego:
        return tables
    mesh = ego["mesh"]
    if not isinstance(mesh, str):
        return tables  # the check of the tables reports it
    bodies = list(tables.get("bodies", ()))
    riding = [number for number, body in enumerate(bodies) if body.get("motion") == {"with_ego": True}]
    cars = [number for number in riding if "mesh" in bodies[number]]
    replaced = bodies[cars[0]] if cars else {}
    try:
        pieces = reading.read_mesh(folder / mesh)
    except InputError as error:
        raise InputError(f"{where}: ego.mesh: {error}") from None
    body = {
        "name": replaced.get("name", EGO_CAR),
        "class": replaced.get("class", EGO_CLASS),
        "mesh": mesh,
        "materials": {piece.keys[0]: EGO_PAINT for piece in pieces if piece.grey is None},
        "motion": {"with_ego": True},
    }
    rest = [body for number, body in enumerate(bodies) if number not in cars]
    return {**tables, "bodies": [*rest, body]}


def copy_scene(name: str, folder: Path) -> Path:
    """Copy a scene of the catalogue with its meshes, to be edited; return the path of the scene file.

    Raises:
        InputError: for an unknown name
        OutputError: if a result cannot be written
    """
    path = catalog.path_of("scenes", name)
    text = path.read_text(encoding="utf-8")
    meshes = sorted({body["mesh"] for body in read_toml(path).get("bodies", ()) if "mesh" in body})
    with atomic_folder(folder) as temporary:
        for mesh in meshes:
            (temporary / "meshes").mkdir(exist_ok=True)
            shutil.copyfile(path.parent / mesh, temporary / "meshes" / Path(mesh).name)
            text = text.replace(f'"{mesh}"', f'"meshes/{Path(mesh).name}"')
        heading = f"# A copy of lidarscene's scene {path.stem}, to be edited.\n"
        lines = [line for line in text.splitlines(keepends=True) if not line.startswith("# Made by tools/scenes/")]
        (temporary / path.name).write_text(heading + "".join(lines), encoding="utf-8", newline="\n")
    return folder / path.name


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> Tables:
    """Return tables with others over them."""
    inherited = {key: value for key, value in base.items() if key not in ("name", "description")}
    result = {**inherited, **{key: value for key, value in over.items() if key not in ("extends", "bodies")}}
    for key, table in over.items():
        if isinstance(table, dict) and isinstance(base.get(key), dict):
            ways = _WAYS.get(key, ())
            ways_taken = [way for way in ways if way & set(table)]
            replaced = set().union(*ways) - set().union(*ways_taken) if ways_taken else set()
            result[key] = {name: value for name, value in base[key].items() if name not in replaced} | table
    if "bodies" in base or "bodies" in over:
        result["bodies"] = _merged_bodies(base.get("bodies", ()), over.get("bodies", ()))
    return result


def _merged_bodies(base: Sequence[Any], over: Sequence[Any]) -> list[Any]:
    """Return bodies with others over those of the same name; the rest follows."""
    changes = {body["name"]: body for body in over if isinstance(body, dict) and "name" in body}
    names = {body.get("name") for body in base}
    bodies = []
    for body in base:
        change = changes.get(body.get("name"), {})
        takes_shape = {"mesh", "primitive"} & set(change)
        inherited = {key: value for key, value in body.items() if not (takes_shape and key in _OF_SHAPE)}
        bodies.append({**inherited, **change})
    return [*bodies, *(body for body in over if not isinstance(body, dict) or body.get("name") not in names)]


def with_absolute_paths(tables: Tables, folder: Path) -> Tables:
    """Return the tables of a scene file with absolute paths of all files that they name."""

    def absolute(table: Any, *keys: str) -> Any:
        if not isinstance(table, dict):
            return table
        paths = {key: str(folder / table[key]) for key in keys if isinstance(table.get(key), str)}
        return {**table, **paths}

    def moving(table: Any) -> Any:
        if isinstance(table, dict) and "motion" in table:
            table = {**table, "motion": absolute(table["motion"], "poses_file")}
        if isinstance(table, dict) and "instances" in table:
            table = {**table, "instances": [moving(instance) for instance in table["instances"]]}
        return table

    result: Tables = absolute(tables, "base")
    if "ego" in result:
        result["ego"] = absolute(result["ego"], "poses_file", "mesh")
    if str(result.get("sensor", {}).get("name", "")).endswith(".toml"):
        result["sensor"] = absolute(result["sensor"], "name")
    if "bodies" in result:
        result["bodies"] = [moving(absolute(body, "mesh")) for body in result["bodies"]]
    return result
