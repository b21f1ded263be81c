"""The catalogue: sensors, IMUs, materials and scenes as data files, all but scenes with a source for every number.

Each is a TOML file in a folder of its kind, named after the file; a new one needs no code. This module handles names
and paths only; `sensor.sensor_file`, `materials.material_file` and `scene.scene_file` read the files.
"""

from __future__ import annotations

import os
from importlib import resources
from pathlib import Path

from ..errors import InputError, did_you_mean

KINDS = ("sensors", "materials", "scenes", "imus")

BESIDE_SCENES = ("job", "rig")
"""Stems of files in the folder of scenes that are no scenes: a job for `batch`, a rig of sensors."""


def folder(kind: str) -> Path:
    """Folder of the catalogue's files of one kind. Scenes lie in the package only if it was installed from a wheel."""
    package = Path(str(resources.files(__package__)))
    inside = package / kind
    return package.parents[2] / kind if kind == "scenes" and not inside.is_dir() else inside


def names(kind: str) -> list[str]:
    """Names of all entries of one kind, sorted."""
    stems = sorted(path.stem for path in folder(kind).glob("*.toml"))
    return [name for name in stems if name not in BESIDE_SCENES] if kind == "scenes" else stems


def path_of(kind: str, name: str) -> Path:
    """File of an entry. Raises InputError with the nearest names."""
    path = folder(kind) / f"{name}.toml"
    if Path(name).name == name and os.path.isfile(path):
        return path
    if os.path.isfile(name):
        raise InputError(f"{name}: the name of a {kind.removesuffix('s')} file ends in .toml")
    noun = kind.removesuffix("s")
    parts = name.split(",")
    if len(parts) > 1 and all(part.strip() in names(kind) for part in parts):
        raise InputError(f"'{name}': must be one {noun}; several go with spaces between them")
    for other_kind in KINDS:
        if name in names(other_kind):
            raise InputError(f"no {noun} '{name}' in the catalogue; {name} is a {other_kind.removesuffix('s')}")
    hint = did_you_mean(name, names(kind), most=3, cutoff=0.4) or f"it has {', '.join(names(kind))}"
    raise InputError(f"no {noun} '{name}' in the catalogue; {hint}")
