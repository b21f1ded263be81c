"""Sensors of a rig: where each stands on the vehicle."""

import dataclasses

import numpy as np

from lidarscene import load_sensor
from lidarscene.maths.pose import Pose
from lidarscene.sensor.rig_file import Mounted


def test_a_sensors_own_mounting_is_within_its_place_on_the_vehicle() -> None:
    """Half a metre ahead of a place that looks to the left is half a metre left of it."""
    mounting_pose = Pose.from_degrees(position_m=(0.5, 0.0, 0.0), pitch_deg=10.0)
    sensor = dataclasses.replace(load_sensor("table1-apd"), mounting=mounting_pose)
    place = Pose.from_degrees(position_m=(1.0, 2.0, 3.0), yaw_deg=90.0)
    mounting = Mounted(label="left", sensor=sensor, pose=place).placed.mounting
    np.testing.assert_allclose(mounting.position_m, (1.0, 2.5, 3.0), atol=1e-12)
    ahead = mounting.rotation @ np.array([1.0, 0.0, 0.0])
    np.testing.assert_allclose(ahead, (0.0, np.cos(np.radians(10.0)), np.sin(np.radians(10.0))), atol=1e-12)
