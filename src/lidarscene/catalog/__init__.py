"""The catalogue: sensors and materials as data files, with a source for every number.

A sensor or material is a TOML file in a folder of its kind, and its name is the file's. To add one takes no code. This
module knows names and paths only; `sensor.catalogue` and `materials.catalogue` read the files.
"""

from __future__ import annotations

import difflib
import os
from importlib import resources
from pathlib import Path

from ..errors import InputError

KINDS = ("sensors", "materials")


def folder(kind: str) -> Path:
    """Where the catalogue's files of one kind lie."""
    return Path(str(resources.files(__package__))) / kind


def names(kind: str) -> list[str]:
    """Names of all entries of one kind, sorted."""
    return sorted(path.stem for path in folder(kind).glob("*.toml"))


def path_of(kind: str, name: str) -> Path:
    """File of an entry. Raises InputError with the nearest names."""
    path = folder(kind) / f"{name}.toml"
    if Path(name).name == name and os.path.isfile(path):
        return path
    if os.path.isfile(name):
        raise InputError(f"{name}: the name of a {kind.removesuffix('s')} file ends in .toml")
    near = difflib.get_close_matches(name, names(kind), n=3, cutoff=0.4)
    hint = f"did you mean {' or '.join(near)}?" if near else f"it has {', '.join(names(kind))}"
    raise InputError(f"no {kind.removesuffix('s')} '{name}' in the catalogue; {hint}")
