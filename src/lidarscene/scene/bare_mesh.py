"""A mesh file as a scene: the tables that a scene file of it would hold.

A user with a mesh wants a point cloud of it first and a scene file later. So the missing facts are assumed, and a
warning lists them: the mesh stands on asphalt, in full sun, before a sensor at the height of a car's roof that sees
all of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import OptionError, OptionWarning, warn
from ..files.overrides import with_overrides
from ..maths.arrays import Numbers
from ..maths.pose import Pose
from ..maths.vectors import box_around
from .meshes import reading, usd
from .meshes.mesh_axes import UNITS, Axis, Unit, axis_of, turn_upright
from .scene import Part, Scene
from .sizes import size_text
from .tables import USUAL_HEIGHT_M

MESHES = (".glb", ".gltf", ".obj", ".off", ".ply", ".stl", *usd.SUFFIXES)
"""Suffixes of mesh files that are accepted in place of a scene file."""

SMALLEST_M, LARGEST_M = 0.05, 2000.0
"""Choice: smallest and largest plausible extent of a mesh, from a bottle to a city quarter; beyond, its unit is
wrong."""

NAMES: dict[str, Unit] = {"millimetres": "mm", "centimetres": "cm", "inches": "in", "kilometres": "km"}
"""Units that may explain an implausible size, likeliest first: name in messages -> key in the file."""

PLAIN = "concrete"
"""Material of pieces without a colour of their own."""

CLEAR_M = 5.0
"""Choice: distance from the sensor to the near side of a small mesh."""

ACROSS_DEG, HIGH_DEG = 60.0, 18.0
"""Choice: largest angles that the near side of the mesh subtends: a little less than the field of view of Table 1."""


def is_mesh(path: Path) -> bool:
    """Return True for the name of a mesh file."""
    return path.suffix.lower() in MESHES


def mesh_description(path: Path) -> str:
    """Length, width and height of a mesh, upright."""
    corners = np.concatenate([piece.vertices_m for piece in reading.read_mesh(path)])
    return f"{size_text(np.ptp(turn_upright(corners, axis_of(path) or 'z'), axis=0))} m"


def mesh_tables(path: Path, overrides: Sequence[str], *, option: str) -> dict[str, Any]:
    """Tables of a scene file for this mesh, with the overrides in it.

    The body is called "mesh": `bodies.mesh.unit=mm` says that its unit is the millimetre.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    pieces = reading.read_mesh(path)
    corners = np.concatenate([piece.vertices_m for piece in pieces])
    plain = {key: PLAIN for piece in pieces if piece.grey is None for key in piece.keys[:1]}
    tables = with_overrides(_tables(path, corners, plain, _Placement()), overrides, option=option)
    # Unit and axis from the overrides decide where the mesh and the sensor stand, so the tables are built twice.
    body = tables["bodies"][1]
    placement = _Placement(**{key: body[key] for key in ("up", "unit", "scale", "roll_deg") if key in body})
    if not placement.is_valid:
        return tables  # the check of the tables reports the mistake
    _check_unit(path, float(np.ptp(corners, axis=0).max()), placement, option)
    return with_overrides(_tables(path, corners, plain, placement), overrides, option=option)


@dataclass(frozen=True, slots=True)
class _Placement:
    """Keys of the scene file that scale and turn the mesh, not checked yet."""

    up: Any = None
    unit: Any = "m"
    scale: Any = 1.0
    roll_deg: Any = 0.0

    @property
    def is_valid(self) -> bool:
        """True if unit, scale, axis and roll are all valid, so that the mesh can be placed."""
        numbers = isinstance(self.scale, int | float) and isinstance(self.roll_deg, int | float)
        return numbers and self.scale > 0.0 and self.unit in UNITS and self.up in (None, "x", "y", "z")

    @property
    def metres(self) -> float:
        """Metres of a length of 1 in the file."""
        return float(self.scale * UNITS[self.unit])


def _tables(path: Path, corners: Numbers, plain: dict[str, str], placement: _Placement) -> dict[str, Any]:
    """Build the tables: ground at z = 0, the mesh on it at the origin, a sensor that looks along x at its middle."""
    up = placement.up or axis_of(path) or "z"
    turned = Pose.from_degrees(roll_deg=placement.roll_deg).apply(turn_upright(corners, up)) * placement.metres
    low, high = box_around(turned)
    middle, size = (low + high) / 2.0, high - low
    # Distance of the near side at which it fills these angles. An angle of 180 degrees along x, the viewing direction,
    # makes the depth of the mesh irrelevant.
    side_m = float((size / 2.0 / np.tan(np.radians([180.0, ACROSS_DEG, HIGH_DEG]) / 2.0)).max())
    distance_m = max(CLEAR_M, side_m) + float(size[0]) / 2.0
    pitch_deg = math.degrees(math.atan2(size[2] / 2.0 - USUAL_HEIGHT_M, distance_m))
    return {
        "name": path.stem,
        "description": f"the mesh {path.name} on a plain",
        "sun": {"azimuth_deg": 140.0, "elevation_deg": 40.0, "illuminance_klux": 100.0},
        "sky": {"diffuse_share": 0.1},
        "sensor": {"name": "table1-apd", "position_m": [-distance_m, 0.0, USUAL_HEIGHT_M], "pitch_deg": pitch_deg},
        "bodies": [
            {
                "name": "ground",
                "class": "terrain",
                "primitive": "plane",
                "material": "asphalt",
                "size_m": [float(4.0 * (distance_m + size.max()))] * 2,
            },
            {
                "name": "mesh",
                "class": "object",
                "mesh": path.name,
                "materials": plain,
                "unit": placement.unit,
                "up": up,
                "scale": placement.scale,
                "roll_deg": placement.roll_deg,
                "position_m": [-float(middle[0]), -float(middle[1]), -float(low[2])],
            },
        ],
    }


def _check_unit(path: Path, across: float, placement: _Placement, option: str) -> None:
    """Refuse a size that a wrong unit explains better.

    Args:
        across: largest extent in the file's own unit

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    across_m = across * placement.metres
    if SMALLEST_M <= across_m <= LARGEST_M:
        return
    sizes = {unit: across * placement.scale * UNITS[unit] for unit in NAMES.values()}
    fits = [name for name, unit in NAMES.items() if SMALLEST_M * 4 <= sizes[unit] <= LARGEST_M / 4]
    hint = f"; if its unit is {fits[0]}, add {{{option}}} bodies.mesh.unit={NAMES[fits[0]]}" if fits else ""
    must = f"a mesh must be {SMALLEST_M:g} to {LARGEST_M:g} m across, got {across_m:.4g} m"
    raise OptionError(f"{{0}}: {must}{hint}", path)


def warn_of_assumptions(path: Path, scene: Scene, *, up: Axis, option: str) -> None:
    """Warn of everything that was assumed about the mesh: size, axis, material, light and place of the sensor."""
    body = next(body for body in scene.bodies if body.name == "mesh")
    corners = np.concatenate([part.vertices_m for part in body.parts if isinstance(part, Part)])
    uses = {part.material for part in body.parts}
    warn(
        OptionWarning(
            "{0}: a mesh alone is taken as {1} m with {6} up, {2}on asphalt in {3:g} klux of sun, {4:.3g} m before the "
            f"sensor, which is {{5:.3g}} m high; {{{option}}} bodies.mesh.unit and bodies.mesh.up change size and "
            "axis, and a scene file says what is really there",
            path,
            size_text(np.ptp(corners, axis=0)),
            f"of {PLAIN} where it has no colour, " if PLAIN in uses else "",
            scene.sun.illuminance_klux,
            float(np.hypot(*scene.sensor_pose.position_m[:2])),
            float(scene.sensor_pose.position_m[2]),
            up,
        )
    )
