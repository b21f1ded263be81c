"""The materials of the catalogue, by name."""

from __future__ import annotations

from functools import cache

from ..catalog import path_of
from .file import read_material
from .material import Material


@cache
def material(name: str) -> Material:
    """A catalogue material. Raises InputError."""
    return read_material(path_of("materials", name))
