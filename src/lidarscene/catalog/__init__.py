"""The catalogue: sensors, IMUs, materials, scenes and design studies as data files; the first three with sources.

Each is a TOML file in a folder of its kind, named after the file; a new one needs no code. This module handles names
and paths only; `sensor.sensor_file`, `materials.material_file` and `scene.scene_file` read the files.
"""

from __future__ import annotations

import functools
import os
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

from ..errors import InputError, did_you_mean, question

KINDS = ("sensors", "materials", "scenes", "imus", "designs")

BESIDE_SCENES = ("job", "rig")
"""Stems of files in the folder of scenes that are no scenes: a job for `batch`, a rig of sensors."""


def folder(kind: str) -> Path:
    """Folder of the catalogue's files of one kind. Scenes lie in the package only if it was installed from a wheel."""
    package = Path(str(resources.files(__package__)))
    inside = package / kind
    return package.parents[2] / kind if kind == "scenes" and not inside.is_dir() else inside


@functools.cache
def shipped_meshes() -> dict[str, Any]:
    """Name of a shipped mesh -> ``class`` of what it shows, and ``materials`` by its parts."""
    text = resources.files(__package__).joinpath("meshes.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def names(kind: str) -> list[str]:
    """Names of all entries of one kind, sorted."""
    stems = sorted(path.stem for path in folder(kind).glob("*.toml"))
    return [name for name in stems if name not in BESIDE_SCENES] if kind == "scenes" else stems


def path_of(kind: str, name: str) -> Path:
    """File of an entry; case, dashes and underscores do not matter. Raises InputError with the names that fit."""
    path = folder(kind) / f"{name}.toml"
    if Path(name).name == name and os.path.isfile(path):
        return path
    if os.path.isfile(name):
        raise InputError(f"{name}: the name of a {kind.removesuffix('s')} file ends in .toml")
    spelled = {_letters(entry): entry for entry in names(kind)}
    if _letters(name) in spelled:
        return folder(kind) / f"{spelled[_letters(name)]}.toml"
    noun = kind.removesuffix("s")
    parts = name.split(",")
    if len(parts) > 1 and all(_letters(part.strip()) in spelled for part in parts):
        raise InputError(f"'{name}': must be one {noun}; several go with spaces between them")
    for other_kind in KINDS:
        if entry := {_letters(entry): entry for entry in names(other_kind)}.get(_letters(name)):
            raise InputError(f"no {noun} '{name}' in the catalogue; {entry} is a {other_kind.removesuffix('s')}")
    names_or_folder = ", ".join(spelled.values()) or f"no {kind}, for there are none in {folder(kind)}"
    hint = _suggestion(kind, name) or f"it has {names_or_folder}"
    raise InputError(f"no {noun} '{name}' in the catalogue; {hint}")


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
        return did_you_mean(name.lower(), letters_of, most=3, cutoff=0.4)
    shared = {entry: _shared_beginning(word, letters) for entry, letters in letters_of.items()}
    longest = max([SHORTEST_WORD, *shared.values()])
    return (
        question(entry for entry, letters in letters_of.items() if word in letters)
        or question(entry for entry, length in shared.items() if length == longest)
        or question(entry for entry in letters_of if word in _letters(_description(kind, entry)))
        or did_you_mean(name.lower(), letters_of, most=3, cutoff=0.4)
    )


def _shared_beginning(a: str, b: str) -> int:
    """Number of letters with which both words begin."""
    return next((n for n, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))


SHORTEST_WORD = 3
"""Fewest letters by which entries are searched: two are in too many."""


def _description(kind: str, name: str) -> str:
    """Description of an entry, in its file."""
    tables = tomllib.loads((folder(kind) / f"{name}.toml").read_text(encoding="utf-8"))
    return str(tables.get("description", ""))
