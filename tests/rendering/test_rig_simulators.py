"""Simulators of a rig: each sensor where its vehicle carries it."""

import itertools

import numpy as np
import pytest
from helpers import chain
from helpers.run_seed import run_seed

from lidarscene.maths.pose import Pose
from lidarscene.maths.trajectory import pose_at
from lidarscene.rendering.rig_simulators import simulators
from lidarscene.rendering.simulator import Simulator
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


def test_like_sensors_of_a_rig_have_noise_of_their_own() -> None:
    """Rationale: two of a kind had the errors of one, pulse by pulse, and all their false alarms in common.

    At one place before one wall nothing but noise differs. The first has the seed of the run, each the noise that it
    has alone with the seed in its cloud's metadata.
    """
    sensor, scene = (
        chain.sensor("table1-apd", *chain.raster(1.0, 1.0, 0.02)),
        chain.scene(chain.facing(range_m=50.0, size_m=200.0)),
    )
    rig = [Mounted(label=label, sensor=sensor) for label in ("left", "right", "rear")]
    clouds = [simulator.render(seed=run_seed()) for _, simulator in simulators(scene, rig)]
    seeds = [int(cloud.metadata["seed"]) for cloud in clouds]
    assert seeds[0] == run_seed()
    assert len({*seeds}) == 3
    for seed, cloud in zip(seeds, clouds, strict=True):
        assert cloud.range_m.tobytes() == Simulator(scene, sensor, pose=Pose()).render(seed=seed).range_m.tobytes()
    for first, second in itertools.combinations(clouds, 2):
        _, of_first, of_second = np.intersect1d(first.time_s, second.time_s, return_indices=True)
        errors = [cloud.range_m[of] - cloud.true_range_m[of] for cloud, of in ((first, of_first), (second, of_second))]
        echoes = np.isfinite(errors).all(axis=0) & (np.abs(errors) < 1.0).all(axis=0)
        assert echoes.sum() > 500
        # Five standard errors of a correlation of independent numbers.
        assert abs(np.corrcoef(*np.array(errors)[:, echoes])[0, 1]) < 5.0 / np.sqrt(echoes.sum())
