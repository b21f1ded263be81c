"""A piece of a mesh file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

Matrix = np.ndarray[Any, Any]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SubMesh:
    """One piece of a mesh file, placed by the file's own node transforms.

    vertices_m  (v, 3) float64; faces (f, 3) integers
    keys        names it may be called by: its material's, geometry's and node's
    grey        mean of its base colour if the file gives one, else None
    """

    vertices_m: Matrix
    faces: Matrix
    keys: tuple[str, ...]
    grey: float | None = None
