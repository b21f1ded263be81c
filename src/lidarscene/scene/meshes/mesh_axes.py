"""Units and axes of mesh files: the length of one unit, the axis that points up, and the turn to z up.

Of the formats other than USD only glTF defines both: metres, y up (glTF 2.0, 3.4). OBJ, STL, PLY and OFF define
neither: the scene file gives them (`unit`, `up`), and the defaults are metres and z up.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from ...maths.arrays import Numbers

Axis = Literal["x", "y", "z"]
Unit = Literal["m", "mm", "cm", "km", "in", "ft"]

UNITS: dict[Unit, float] = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "in": 0.0254, "ft": 0.3048}
"""Source: SI prefixes, and the international yard of 1959; metres of each unit."""

GLTF = (".glb", ".gltf")
"""Suffixes of glTF files."""


def axis_of(path: Path) -> Axis | None:
    """Axis that points up by the standard of the file's format; None if the format has no such standard."""
    return "y" if path.suffix.lower() in GLTF else None


def turn_upright(vertices: Numbers, up: Axis) -> Numbers:
    """Turn (v, 3) vertices so that the axis ``up`` becomes z. The turn is exact: it only swaps and negates columns.

    From y the turn is by 90 degrees around x, so that x stays x: Blender's export of a z-up model and this are each
    other's inverse. From x it is by -90 degrees around y.
    """
    x, y, z = vertices.T
    if up == "y":
        return np.stack([x, -z, y], axis=1)
    if up == "x":
        return np.stack([-z, y, x], axis=1)
    return vertices
