"""Simulators of a rig: each sensor where its vehicle carries it."""

import numpy as np
import pytest
from helpers import chain

from lidarscene.maths.pose import Pose
from lidarscene.maths.trajectory import pose_at
from lidarscene.rendering.rig_simulators import simulators
from lidarscene.sensor.rig_file import Mounted

pytestmark = pytest.mark.usefixtures("mi")


def test_a_vehicle_that_stands_aside_takes_its_sensors_along() -> None:
    """Turned to the left at (10, 20, 0), with sensors 2 m ahead and 1 m to the left: by hand."""
    sensor = chain.sensor("table1-apd", *chain.NARROW)
    rig = [
        Mounted(label="front", sensor=sensor, pose=Pose.from_degrees(position_m=(2, 0, 1.5), yaw_deg=30)),
        Mounted(label="left", sensor=sensor, pose=Pose.from_degrees(position_m=(0, 1, 1.0), yaw_deg=90)),
    ]
    vehicle = Pose.from_degrees(position_m=(10, 20, 0), yaw_deg=90)
    scene = chain.scene(chain.facing(range_m=50.0, size_m=200.0))
    places = {label: pose_at(simulator.motion, 0.0) for label, simulator in simulators(scene, rig, pose=vehicle)}
    mounted = sensor.mounting.position_m
    np.testing.assert_allclose(mounted, 0.0)
    np.testing.assert_allclose(places["front"].position_m, [10, 22, 1.5], atol=1e-12)
    np.testing.assert_allclose(places["left"].position_m, [9, 20, 1.0], atol=1e-12)
    for label, yaw_deg in (("front", 120.0), ("left", 180.0)):
        forward = places[label].rotation[:, 0]
        np.testing.assert_allclose(forward, [np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg)), 0], atol=1e-12)
