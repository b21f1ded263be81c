"""Ambient: background power in, the photons that each pulse's channel counts while it listens out."""

from __future__ import annotations

from ..maths import random
from ..maths.arrays import Array, Lanes
from ..physics.electronics import counting
from ..sensor.model import Sensor


def counts(background_power_w: Lanes, sensor: Sensor, *, seed: Lanes, pulse: Array) -> Lanes:
    """(n,) whole numbers: detected photons and dark counts in the sensor's ambient window, with their noise.

    A near-infrared picture of the scene, as some sensors give it with every frame. Echoes are not in it.

    seed   32-bit frame seed
    pulse  (n,) uint32 pulse numbers
    """
    rate, narrowing = sensor.detector.background_counts(
        background_power_w=background_power_w, photon_energy_j=sensor.laser.photon_energy_j
    )
    words = random.words(seed=seed, stage=random.Stage.AMBIENT, pulse=pulse)
    return counting.poisson_count(
        mean=rate * sensor.tdc.ambient_s,
        uniform=random.open_uniform(words[0]),
        deviate=random.normal_pair(words)[0],
        narrowing=narrowing,
    )
