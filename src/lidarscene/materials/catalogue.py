"""The materials of the catalogue, by name.

Scenes name a material, and its numbers with their sources stand in one place for all of them.
"""

from __future__ import annotations

from functools import cache

from ..catalog import path_of
from .file import read_material
from .material import Material


@cache
def material(name: str) -> Material:
    """A catalogue material. Raises InputError."""
    return read_material(path_of("materials", name))
