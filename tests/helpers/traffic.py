"""A scene in which everything moves, and how it stands at a moment."""

import dataclasses

import numpy as np

from helpers import chain
from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.maths.pose import Pose, direction_from_angles
from lidarscene.maths.trajectory import Course, Motion, Spline, pose_at
from lidarscene.scene.scene import Body, Scene

EGO = Course(start=Pose.from_degrees(position_m=(3.0, 2.0, 0.5), yaw_deg=2.0), speed_m_s=25.0, yaw_rate_rad_s=0.3)

SENSOR = ("scanner.azimuth_step_deg=0.4", "scanner.elevation_step_deg=0.4", "tdc.threshold_to_noise=4")


def moving(body: Body, name: str, motion: Motion) -> Body:
    return dataclasses.replace(body, name=name, motion=motion)


def traffic() -> Scene:
    """A wall, two boxes that share a shape and move differently, a ball that flies; the sensor drives a curve."""
    box = chain.box(at=(20.0, 0.0, 0.0), yaw_deg=20.0)
    turning = moving(box, "turning", Course(start=box.pose, speed_m_s=12.0, yaw_rate_rad_s=0.9))
    sliding = moving(
        box, "sliding", Course(start=Pose.from_degrees(position_m=(15, 6, 0)), velocity_m_s=(0.0, -8.0, 0.0))
    )
    way = [Pose.from_degrees(position_m=p) for p in ((10, -5, 1), (12, -4, 1.5), (13, -5.5, 0.5))]
    flying = moving(chain.ball(at=(0, 0, 0)), "flying", Spline(time_s=np.array([0.0, 0.4, 1.0]), poses=tuple(way)))
    scene = chain.scene(chain.facing(range_m=50.0, size_m=120.0), turning, sliding, flying)
    return dataclasses.replace(scene, ego=EGO)


def frozen(scene: Scene, time_s: float) -> Scene:
    """The scene as it stands at a moment, with nothing that moves."""
    bodies = tuple(
        body if body.motion is None else dataclasses.replace(body, motion=None, pose=pose_at(body.motion, time_s))
        for body in scene.bodies
    )
    return dataclasses.replace(scene, bodies=bodies, ego=None)


def direction(cloud: PointCloud) -> np.ndarray:
    """(n, 3) beams in the sensor's frame."""
    angles = {"azimuth_rad": cloud.azimuth_rad.astype(float), "elevation_rad": cloud.elevation_rad.astype(float)}
    return np.stack(direction_from_angles(**angles), axis=1)
