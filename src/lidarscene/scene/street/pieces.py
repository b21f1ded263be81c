"""Pieces of a scene file's tables: poses, sheets of ground, soil around roads, light."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ...maths.arrays import Numbers

Tables = dict[str, Any]

RAISED_M = 0.12
"""Choice: height of pavements and kerbs over the road."""

PAINT_M = 0.003
"""Choice: thickness of lane markings."""

OVER_ROOF_M = 0.27
"""Choice: height of the sensor over the roof."""

FOOT_M = 0.3
"""Choice: depth of the faces down from the edges of roads, below soil that is lower than they are."""

SOIL_M, SOIL_REACH_M = 50.0, 130.0
"""Choice: size of a square sheet of soil, and distance of its middle from that of the street: beyond the houses."""

SOIL_BELOW_M = -0.05
"""Choice: height of soil against the road."""

SURROUNDINGS: Tables = {
    "sun": {"azimuth_deg": 215.0, "elevation_deg": 48.0, "illuminance_klux": 80.0},
    "sky": {"diffuse_share": 0.15},
    "air": {"visibility_km": 15.0, "model": "kruse"},
    "ground": {"roughness": "B"},
    "sensor": {"name": "os1-128"},
    "picture": {"eye_m": [-9.0, 0.0, 7.0], "target_m": [14.0, 0.6, 0.5], "fov_deg": 70.0},
}
"""Choice: tables that a scene with a street has unless it says otherwise."""


def placed(
    x_m: float, y_m: float, z_m: float = 0.0, yaw_deg: float = 0.0, pitch_deg: float = 0.0, roll_deg: float = 0.0
) -> Tables:
    """Pose, to a millimetre and a hundredth of a degree."""
    pose: Tables = {"position_m": [round(float(number), 3) + 0.0 for number in (x_m, y_m, z_m)]}
    yaw_deg = round((float(yaw_deg) + 180.0) % 360.0 - 180.0, 2)
    angles = {"yaw_deg": yaw_deg, "pitch_deg": round(float(pitch_deg), 2), "roll_deg": round(float(roll_deg), 2)}
    return pose | {name: angle_deg for name, angle_deg in angles.items() if angle_deg}


def timed_poses(rows: Numbers) -> list[Tables]:
    """Poses at times: rows of time [s], x, y, z [m], yaw and pitch [degrees]."""
    return [{"time_s": round(time_s, 3)} | placed(*pose) for time_s, *pose in rows.tolist()]


def rounded(points_m: Numbers, digits: int = 3) -> list[list[float]]:
    """Points to a millimetre or to fewer or more digits, as a file has them."""
    return [[round(number, digits) + 0.0 for number in point] for point in points_m.tolist()]


def box_places_m(box: tuple[float, float, float, float, float], step_m: float) -> Numbers:
    """(n, 2) places of a rectangle, its corners too: x, y, yaw [rad], half lengths along it and across.

    Args:
        step_m: from place to place, at most
    """
    x_m, y_m, yaw, *half_m = box
    ticks = [np.linspace(-each, each, 2 + int(2.0 * each / step_m)) for each in half_m]
    cos, sin = math.cos(yaw), math.sin(yaw)
    from_middle_m = np.stack(np.meshgrid(*ticks), axis=-1).reshape(-1, 2) @ np.array([[cos, sin], [-sin, cos]])
    return np.asarray(from_middle_m + np.array([x_m, y_m]))


def street_scene(shown_m: float, *, roof_m: float, ego: Tables, bodies: Sequence[Tables]) -> Tables:
    """Tables of a scene with a vehicle that rides among bodies, of which those that move show up to a distance.

    Args:
        roof_m: height of that vehicle
    """
    ego = {"on_ground": True, **ego, "ride": {}}
    sensor = SURROUNDINGS["sensor"] | {"position_m": [0.0, 0.0, round(roof_m + OVER_ROOF_M, 2)]}
    return SURROUNDINGS | {"reach_m": shown_m + 20.0, "sensor": sensor, "ego": ego, "bodies": list(bodies)}


def sheet(
    name: str, class_name: str, material: str, size_m: Sequence[float], places: Sequence[Tables], **keys: Any
) -> Tables:
    """Ground at one place or at several."""
    sizes = {"size_m": [round(float(length_m), 3) for length_m in size_m]}
    return ground(name, class_name, material, **sizes, **keys, instances=list(places))


def ground(name: str, class_name: str, material: str, **keys: Any) -> Tables:
    """Ground of some shape."""
    return {"name": name, "primitive": "ground", "class": class_name, "material": material, **keys}


def soil_tiles(middle_m: Numbers) -> Numbers:
    """(t, 2) middles of squares around (n, 2) places of roads, no more than some tens of metres apart."""
    reach = math.ceil(SOIL_REACH_M / SOIL_M)
    around = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 2), axis=-1).reshape(-1, 2)
    # One place of those in the same square is enough.
    square = np.unique(np.round(middle_m / SOIL_M), axis=0)
    tiles = np.unique((square[:, None] + around).reshape(-1, 2), axis=0) * SOIL_M
    near = np.hypot(*(tiles[:, None] - square * SOIL_M).transpose(2, 0, 1)).min(axis=1) < SOIL_REACH_M
    return np.asarray(tiles[near])


def soil(middle_m: Numbers) -> Tables:
    """Level squares of soil around places of roads."""
    places = [placed(x_m, y_m, SOIL_BELOW_M) for x_m, y_m in soil_tiles(middle_m).tolist()]
    return sheet("soil", "terrain", "soil", [SOIL_M, SOIL_M], places, spacing_m=2.0)
