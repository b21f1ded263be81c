"""Sizes of bodies: their text, and doubts about a vehicle's unit and axis.

A van in millimetres is 4.8 km long, and one whose file has another axis up lies on its side or stands on its end. Both
render without complaint, and no sensor on such a vehicle stands clear of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..errors import OptionError, OptionWarning, warn
from ..maths.arrays import Numbers
from ..maths.pose import Pose
from .meshes.mesh_axes import UNITS, Axis, Unit, turn_upright
from .scene import Part

VEHICLES = ("bus", "car", "truck", "van")
"""Classes of road vehicles that are no longer than `LONGEST_M`, and longer than high."""

LONGEST_M = 30.0
"""Choice: length of a vehicle beyond which its unit is wrong: articulated buses have 25 m."""

NO_LONGER_M = 300.0
"""Choice: length of a vehicle that is refused, since no sensor on it would see anything else."""

USUAL_M = 5.0
"""Choice: length of a vehicle to which the unit that explains its size comes nearest."""

LOPSIDED = 0.02
"""Choice: shift of a surface's middle, over its extent, above which it is not its own mirror image: the catalogue's car
has 0.066 from top to bottom and 0.0002 from side to side."""

ALIKE = 0.25
"""Choice: the same shift along another axis, over that, below which it is the mirror image of itself there."""


def metres_text(length_m: float) -> str:
    """Text of a length to three digits."""
    return f"{length_m:,.0f}" if length_m >= 100.0 else f"{length_m:.3g}"


def size_text(edges_m: Sequence[float] | Numbers) -> str:
    """Text of the edge lengths of a box, without unit."""
    return " x ".join(map(metres_text, edges_m))


def check_vehicle(
    parts: Sequence[Part], turn: Pose, *, where: str, name: str, unit: Unit | None, scale: float, up: Axis
) -> None:
    """Warn of a vehicle that is too long, or that another axis of its mesh file would set upright.

    Args:
        parts: in the body's frame, metres
        turn: pitch and roll of the body
        where: file and body
        name: of the body
        unit: that its mesh file was taken to have; None if the file says it
        scale: of the body
        up: axis of its mesh file that was taken to point up

    Raises:
        OptionError: if the vehicle is longer than `NO_LONGER_M`
    """
    edges_m = _edges_m(parts, turn)
    length_m, size = float(edges_m[:2].max()), size_text(edges_m)
    if length_m > LONGEST_M:
        factors = {other: metres / UNITS[unit or "m"] for other, metres in UNITS.items()}
        likely = min(factors, key=lambda other: abs(math.log(length_m * factors[other] / USUAL_M)))
        change = f"scale={scale * factors[likely]:g}" if unit is None else f"unit={likely}"
        message = "{0}: a vehicle of {1} m is too long: {scene_overrides} bodies.{2}.{3} makes it {4} m"
        values = where, size, name, change, size_text(edges_m * factors[likely])
        if length_m > NO_LONGER_M:
            raise OptionError(message, *values)
        warn(OptionWarning(message, *values))
    elif not _is_upright(parts, turn):
        change, turned = "roll_deg or pitch_deg turns it upright", ""
        if unit is not None:
            others: dict[Axis, list[Part]] = {axis: _set_upright(parts, up, axis) for axis in _AXES if axis != up}
            likely_up = next((axis for axis in others if _is_upright(others[axis], turn)), min(others))
            change, turned = f"up={likely_up}", f" makes it {size_text(_edges_m(others[likely_up], turn))} m"
        warn(
            OptionWarning(
                "{0}: a vehicle of {1} m, with {2} up, lies on its side or stands on its end: {scene_overrides} "
                "bodies.{3}.{4}{5}",
                where,
                size,
                up,
                name,
                change,
                turned,
            )
        )


_AXES: tuple[Axis, ...] = ("z", "y", "x")


def _set_upright(parts: Sequence[Part], taken: Axis, up: Axis) -> list[Part]:
    """Parts as they are if the axis ``up`` of their file points up, and not the one that was taken to do so."""

    def turned(vertices_m: Numbers) -> Numbers:
        # A quarter turn is undone by three more.
        for axis in (taken, taken, taken, up):
            vertices_m = turn_upright(vertices_m, axis)
        return vertices_m

    return [Part(vertices_m=turned(part.vertices_m), faces=part.faces, material=part.material) for part in parts]


def _edges_m(parts: Sequence[Part], turn: Pose) -> Numbers:
    """(3,) edges of the box around parts, along the axes of a body's frame that only yaws."""
    edges_m: Numbers = np.ptp(np.concatenate([turn.apply(part.vertices_m) for part in parts]), axis=0)
    return edges_m


def _is_upright(parts: Sequence[Part], turn: Pose) -> bool:
    """Whether a vehicle is not higher than long, nor the mirror image of itself from top to bottom only."""
    edges_m = _edges_m(parts, turn)
    along = int(np.argmax(edges_m[:2]))
    if edges_m[2] > edges_m[along]:
        return False
    # Vehicles are the same on their left and right: the middle of their surface is in the middle between.
    corners = np.concatenate([turn.apply(part.vertices_m)[part.faces] for part in parts])
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    middle = np.average(corners.mean(axis=1), axis=0, weights=areas) if areas.any() else corners.mean(axis=(0, 1))
    box = corners.reshape(-1, 3)
    shift = np.abs(middle - (box.min(axis=0) + box.max(axis=0)) / 2.0) / np.maximum(edges_m, 1e-9)
    return not (shift[1 - along] > LOPSIDED and shift[2] < ALIKE * shift[1 - along])
