"""Distances of the surfaces that a camera sees, for the faint background of a picture; panes are left out."""

from __future__ import annotations

import numpy as np

from ...maths.arrays import Numbers
from ...maths.trajectory import motion_in_frame, pose_at
from ..device import transfer
from ..device.backend import mitsuba
from ..device.gate import exclusive
from ..world.mitsuba_world import World, placed_movers
from .gaps import Draws
from .meeting import Moment


@exclusive
def distances_m(world: World, eye_m: Numbers, directions: Numbers, *, time_s: float) -> Numbers:
    """Return (n,) float32 distance of the first surface along each ray; infinite where there is none.

    Args:
        eye_m: (3,) in the world
        directions: (3, n) unit vectors, world; neighbours should be neighbours in the picture
        time_s: by the clock of the scene's motions
    """
    import drjit as dr

    mi = mitsuba()
    movers = [mover.in_frame(time_s) for mover in world.movers]
    poses = [
        pose_at(motion_in_frame(mover.motion, time_s), time_s) if mover.body.is_present(time_s) else mover.body.pose
        for mover in movers
    ]
    moving = placed_movers(movers, poses, centre_m=world.centre_m, time_s=time_s) if movers else None
    moment = Moment(world=world, sun=(0.0, 0.0, 1.0), coherent=True, draws=Draws(seed=0, pulse=0), moving=moving)
    start = mi.Point3f(*(transfer.opaque(float(coordinate)) for coordinate in eye_m - world.centre_m))
    way = mi.Vector3f(*(transfer.from_numpy(np.ascontiguousarray(axis, np.float32)) for axis in directions))
    meeting = moment.meet(mi.Ray3f(start, way))
    return np.array(dr.select(meeting.valid, meeting.t, dr.inf).numpy(), np.float32)
