"""The catalogue: sensors, IMUs, materials, scenes, design studies, meshes and examples of other files.

Each is a file in a folder of its kind, named after the file; a new one needs no code. Sensors, IMUs and materials have
sources. This module handles names and paths only; `sensor.sensor_file`, `materials.material_file` and
`scene.scene_file` read the files.
"""

from __future__ import annotations

import functools
import os
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

from ..errors import InputError, did_you_mean, question

KINDS = ("sensors", "materials", "scenes", "imus", "designs", "meshes", "examples")

SUFFIXES = {"meshes": (".glb",), "examples": (".toml", ".pcap")}
"""Suffixes of the files of a kind; of the others ".toml". Examples are a rig, a job, a sensor file and a recording."""

IN_REPOSITORY = {"scenes": "scenes", "meshes": "assets/meshes"}
"""Kinds that lie in the package only if it was installed from a wheel -> their folder in a clone."""


def folder(kind: str) -> Path:
    """Folder of the catalogue's files of one kind."""
    package = Path(str(resources.files(__package__)))
    inside = package / IN_REPOSITORY.get(kind, kind)
    return inside if inside.is_dir() else package.parents[2] / IN_REPOSITORY.get(kind, kind)


def files(kind: str) -> dict[str, Path]:
    """Name -> file of all entries of one kind, sorted."""
    suffixes = SUFFIXES.get(kind, (".toml",))
    return {
        path.stem: path
        for path in sorted(folder(kind).glob("*"), key=lambda path: path.stem)
        if path.suffix in suffixes
    }


def _table(name: str) -> dict[str, Any]:
    """Tables of a file of this folder."""
    return tomllib.loads(resources.files(__package__).joinpath(name).read_text(encoding="utf-8"))


@functools.cache
def shipped_meshes() -> dict[str, Any]:
    """Name of a shipped mesh -> ``class`` of what it shows, ``materials`` by its parts, and what else is known.

    Wheels of vehicles turn by the ``animation`` of their meshes, as people walk by theirs.
    """
    table, materials = _table("meshes.toml"), _table("vehicles.toml")["materials"]
    for name, entry in table.items():
        base = table.get(entry.get("like"), {})
        table[name] = base | entry | {"materials": base.get("materials", {}) | entry.get("materials", {})}
    for name, body in vehicles().items():
        groups = (materials[group] for group in PARTS_OF_CLASS[body.class_name])
        parts = {part: group[part] for group in groups for part in group}
        table[name] = {"class": body.class_name, "materials": parts, "animation": "roll"}
    return table


PARTS_OF_CLASS = {
    **dict.fromkeys(("car", "van", "truck", "bus"), ("motor",)),
    **{name: (name,) for name in ("trailer", "motorcycle", "bicycle")},
    "motorcyclist": ("motorcycle", "rider"),
    "cyclist": ("bicycle", "rider"),
}
"""Class of a vehicle -> groups of parts that its body has, in ``[materials]`` of vehicles.toml."""


class VehicleBody(NamedTuple):
    """Body of a road vehicle among the shipped meshes.

    Attributes:
        name: of its mesh, whose origin is on the ground under the middle of the box
        family: such as "saloon"
        class_name: class of labels
        size_m: length, width and height, without mirrors
    """

    name: str
    family: str
    class_name: str
    size_m: tuple[float, float, float]


@functools.cache
def vehicles() -> dict[str, VehicleBody]:
    """Name -> body of all road vehicles of the catalogue, by vehicles.toml, where the sources are."""
    return {
        name: VehicleBody(name, body["family"], body["class"], tuple(body["size_m"]))
        for name, body in _table("vehicles.toml")["bodies"].items()
    }


@functools.cache
def paint_shares() -> dict[str, float]:
    """Material of a car's paint -> its share of the cars on the road; together 1."""
    return dict(_table("vehicles.toml")["paints"])


@functools.cache
def street_parts() -> dict[str, Any]:
    """What stands and drives along streets that are made, by streets.toml; see there."""
    return _table("streets.toml")


def names(kind: str) -> list[str]:
    """Names of all entries of one kind, sorted."""
    return list(files(kind))


def path_of(kind: str, name: str) -> Path:
    """File of an entry; case, dashes and underscores do not matter.

    Raises:
        InputError: with the names that fit
    """
    path = folder(kind) / f"{name}{SUFFIXES.get(kind, ('.toml',))[0]}"
    if Path(name).name == name and os.path.isfile(path):
        return path
    if os.path.isfile(name):
        raise InputError(f"{name}: the name of a {singular(kind)} file ends in {SUFFIXES.get(kind, ('.toml',))[0]}")
    spelled = {_letters(entry): entry for entry in names(kind)}
    if _letters(name) in spelled:
        return files(kind)[spelled[_letters(name)]]
    noun = singular(kind)
    if os.path.isdir(name):
        raise InputError(f"{name}: must be a {noun} of the catalogue or a file, got a folder")
    parts = name.split(",")
    if len(parts) > 1 and all(_letters(part.strip()) in spelled for part in parts):
        raise InputError(f"'{name}': must be one {noun}; separate several by spaces")
    for other_kind in KINDS:
        if entry := {_letters(entry): entry for entry in names(other_kind)}.get(_letters(name)):
            raise InputError(f"no {noun} '{name}' in the catalogue; {entry} is {with_article(other_kind)}")
    names_or_folder = ", ".join(spelled.values()) or f"no {kind}, for there are none in {folder(kind)}"
    hint = _suggestion(kind, name) or f"it has {names_or_folder}"
    raise InputError(f"no {noun} '{name}' in the catalogue; {hint}")


def singular(kind: str) -> str:
    """Noun of one entry of a kind."""
    return kind.removesuffix("es" if kind == "meshes" else "s")


def with_article(kind: str) -> str:
    """The same with its article."""
    return f"{'an' if kind[0] in 'aei' else 'a'} {singular(kind)}"


def file_or_example(path: str | os.PathLike[str], folder: Path = Path()) -> Path:
    """Path in a folder, or the example of this bare name if no file there has it; a folder hides no example."""
    name, file = os.fspath(path), folder / path
    return files("examples").get(name, file) if is_bare(name) and not os.path.isfile(file) else file


def sensor_path(name: str, folder: Path = Path()) -> Path:
    """File of a sensor: in a folder if the name ends in .toml, else of the catalogue or an example.

    Raises:
        InputError: with the names that fit, or the command that copies a shipped sensor
    """
    if not name.endswith(".toml"):
        example = {_letters(entry): path for entry, path in files("examples").items()}.get(_letters(name))
        return example if example is not None and _is_sensor(example) else path_of("sensors", name)
    file = folder / name
    if is_bare(file.stem) and not os.path.lexists(file):
        for kind in ("sensors", "examples"):
            shipped = files(kind).get(file.stem)
            if shipped is not None and _is_sensor(shipped):
                raise InputError(f"{file}: no such file; lidarscene catalog {kind} {file.stem} > {file} makes it")
    return file


def located_sensor(name: str, folder: Path) -> str:
    """Name of a sensor that a file in this folder has: a file's with the folder, one of the catalogue as it is."""
    return str(folder / name) if name.endswith(".toml") else name


def _is_sensor(path: Path) -> bool:
    """Whether an entry is a sensor file: sensors alone have a detector."""
    return path.suffix == ".toml" and "detector" in tomllib.loads(path.read_text(encoding="utf-8"))


def is_bare(name: str) -> bool:
    """Whether a text is a name without folder and suffix, as entries of the catalogue have it."""
    return Path(name).name == name and not Path(name).suffix


def _letters(text: str) -> str:
    """Letters of a name as people type it: "VLP16" and "vlp_16" are "vlp-16"."""
    return text.lower().replace("-", "").replace("_", "").replace(" ", "")


def _suggestion(kind: str, name: str) -> str:
    """Question for the entries that a name fits, by the first of these that fits any; "" without.

    A part of the name ("table1"), the same beginning ("OS1-64"), a word of the description ("velodyne"), likeness.
    """
    word = _letters(name)
    letters_of = {entry: _letters(entry) for entry in names(kind)}
    if len(word) < SHORTEST_WORD:
        return did_you_mean(name.lower(), letters_of, most=3)
    shared = {entry: _shared_beginning(word, letters) for entry, letters in letters_of.items()}
    longest = max([SHORTEST_WORD, *shared.values()])
    return (
        question(entry for entry, letters in letters_of.items() if word in letters)
        or question(entry for entry, length in shared.items() if length == longest)
        or question(entry for entry in letters_of if word in _letters(_description(kind, entry)))
        or did_you_mean(name.lower(), letters_of, most=3)
    )


def _shared_beginning(a: str, b: str) -> int:
    """Number of letters with which both words begin."""
    return next((n for n, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))


SHORTEST_WORD = 3
"""Fewest letters by which entries are searched: two are in too many."""


def _description(kind: str, name: str) -> str:
    """Description of an entry, in its file."""
    path = files(kind)[name]
    tables = tomllib.loads(path.read_text(encoding="utf-8")) if path.suffix == ".toml" else {}
    return str(tables.get("description", ""))
