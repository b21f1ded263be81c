"""Distances of the surfaces that a camera sees, for the faint background of a picture; panes are left out."""

from __future__ import annotations

import numpy as np

from ...maths.arrays import Numbers
from ...maths.trajectory import motion_in_frame, pose_at
from ..device import transfer
from ..device.backend import mitsuba
from ..device.gate import exclusive
from ..device.types import TracedScene
from ..world.mitsuba_world import World


@exclusive
def distances_m(world: World, eye_m: Numbers, directions: Numbers, *, time_s: float) -> Numbers:
    """Return (n,) float32 distance of the first surface along each ray; infinite where there is none.

    Args:
        eye_m: (3,) in the world
        directions: (3, n) unit vectors, world; neighbours should be neighbours in the picture
        time_s: by the clock of the scene's motions
    """
    distance_m = np.full(directions.shape[1], np.inf, np.float32)
    if world.scene is not None:
        distance_m = _distances_in_scene(world.scene, eye_m - world.centre_m, directions)
    for mover in (mover.in_frame(time_s) for mover in world.movers):
        if mover.scene is None or not mover.body.is_present(time_s):
            continue
        pose = pose_at(motion_in_frame(mover.motion, time_s), time_s)
        low, high = mover.box_m
        to_centre_m, radius = pose.apply((low + high) / 2.0) - eye_m, float(np.linalg.norm(high - low)) / 2.0
        along = to_centre_m.astype(np.float32) @ directions
        # Few rays pass the sphere around a body.
        near = np.flatnonzero((to_centre_m @ to_centre_m - along * along <= radius * radius) & (along > -radius))
        if len(near):
            mover_distance_m = _distances_in_scene(
                mover.scene, pose.inverse_apply(eye_m), pose.rotation.T @ directions[:, near]
            )
            distance_m[near] = np.minimum(distance_m[near], mover_distance_m)
    return distance_m


def _distances_in_scene(scene: TracedScene, eye_m: Numbers, directions: Numbers) -> Numbers:
    import drjit as dr

    mi = mitsuba()
    start = mi.Point3f(*(transfer.opaque(float(coordinate)) for coordinate in eye_m))
    way = mi.Vector3f(*(transfer.from_numpy(np.ascontiguousarray(axis, np.float32)) for axis in directions))
    hit = scene.ray_intersect_preliminary(mi.Ray3f(start, way), coherent=True, active=True)
    return np.array(dr.select(hit.is_valid(), hit.t, dr.inf).numpy(), np.float32)
