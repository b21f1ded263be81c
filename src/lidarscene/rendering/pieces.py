"""Pieces of a long scene: of what stands still a world holds only what is near the vehicle.

The plane is cut into squares as wide as the scene's reach. While the vehicle is in one of them, the world has all
bodies within reach of that square. Which square it is follows from the frame's start alone, so that a frame is the same
whatever was rendered before.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from weakref import WeakValueDictionary

import numpy as np

from ..kernel.world.mitsuba_world import World, build_world
from ..maths.trajectory import pose_at, poses_over
from ..scene.clearance import Clearance
from ..scene.scene import Scene

Piece = tuple[int, int]
"""Number of a square along x and along y."""

_worlds: WeakValueDictionary[tuple[object, ...], World] = WeakValueDictionary()


def pieces_of(scene: Scene, times_s: Sequence[float]) -> Sequence[Piece | None]:
    """Pieces in which the ego vehicle is at these times; None for a scene that is not cut."""
    if scene.ego is None or math.isinf(scene.reach_m) or not times_s:
        return [None] * len(times_s)
    places_m = [pose.position_m for pose in poses_over(scene.ego, np.array(times_s))]
    return [(math.floor(x_m / scene.reach_m), math.floor(y_m / scene.reach_m)) for x_m, y_m, _ in places_m]


def world_of_piece(
    scene: Scene, piece: Piece, clearance: Clearance, *, wavelength_m: float, see_through: bool
) -> World:
    """Compile a piece of a scene; sensors of one wavelength that are there together share it.

    Args:
        clearance: of the scene, with the boxes of its bodies
    """
    key = (id(scene), piece, wavelength_m, see_through)
    world = _worlds.get(key)
    # Numbers of objects are used again: only a world of this very scene will do.
    if world is None or world.scene_of is not scene:
        assert scene.ego is not None
        corner_m = scene.reach_m * np.array(piece)
        low_m, high_m = corner_m - scene.reach_m, corner_m + 2.0 * scene.reach_m
        boxes_m = clearance.around[:, :, :2]
        near = np.flatnonzero(((boxes_m[:, 1] >= low_m) & (boxes_m[:, 0] <= high_m)).all(axis=1))
        names = {clearance.bodies[index].name for index in near.tolist()}
        worlds = [*_worlds.items()]  # another thread may add one
        others = (own for (*_, wave_m, _), own in worlds if own.scene_of is scene and wave_m == wavelength_m)
        bsdf_of_material = next((other.bsdf_of_material for other in others), None)
        centre_m = np.append(corner_m + 0.5 * scene.reach_m, pose_at(scene.ego).position_m[2])
        world = build_world(
            scene,
            wavelength_m=wavelength_m,
            centre_m=centre_m,
            see_through=see_through,
            standing=names,
            bsdf_of_material=bsdf_of_material,
        )
        _worlds[key] = world
    return world
