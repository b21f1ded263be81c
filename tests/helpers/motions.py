"""Motions of every kind."""

import numpy as np

from lidarscene.maths.pose import Pose
from lidarscene.maths.trajectory import Course, Motion, Riding, Spline


def pose(x: float, y: float, z: float, yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> Pose:
    return Pose.from_degrees(position_m=(x, y, z), yaw_deg=yaw, pitch_deg=pitch, roll_deg=roll)


START = pose(3, -2, 1, yaw=50, pitch=8, roll=-4)

TIMES = np.array([0.0, 0.3, 1.0, 1.2, 2.5])

WAY = (pose(0, 0, 0), pose(3, 1, 0.2, 30, 5), pose(8, 6, 0, 80, -3, 10), pose(9, 8, 0.1, 120), pose(7, 20, 1, 200))

SPLINE = Spline(time_s=TIMES, poses=WAY)

BEND = Course(start=START, speed_m_s=12.0, yaw_rate_rad_s=0.7, velocity_m_s=(0.5, -0.25, 0.125))

MOTIONS: dict[str, Motion] = {
    "course": BEND,
    "spline": SPLINE,
    "riding": Riding(carrier=SPLINE, pose=START),
    "riding on a bend": Riding(carrier=BEND, pose=START),
}
