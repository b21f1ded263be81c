"""Turns of a simulated sensor at rest, listed point by point as cloud files have them."""

import numpy as np

from lidarscene.recordings.sweep import Sweep
from lidarscene.rendering.simulator import Simulator
from lidarscene.scene.scene import Scene
from lidarscene.sensor.sensor_model import Sensor


def turns_at_rest(scene: Scene, sensor: Sensor, *, frames: int, seed: int = 0, maker: str = "hesai") -> list[Sweep]:
    """Sweeps of a scene; strengths are reflectivities if ``maker`` is one whose intensities are."""
    simulator, sweeps = Simulator(scene, sensor), []
    for frame in range(frames):
        cloud = simulator.render(seed=1000 * seed + frame).in_sensor_frame()
        range_m = np.linalg.norm(cloud.xyz_m, axis=1)
        sweeps.append(
            Sweep(
                range_m=range_m,
                recorded=np.ones(len(range_m), bool),
                direction=cloud.xyz_m / range_m[:, None],
                intensity=cloud.intensity,
                ring=cloud.ring,
                metadata={"format": maker},
            )
        )
    return sweeps
