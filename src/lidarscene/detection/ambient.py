"""Ambient counts: background power to the number of background events that each pulse's channel counts.

Some sensors report the background as a near-infrared image. It is a count over a fixed time, so it has Poisson noise;
in a SiPM the dead time of its cells makes this noise narrower (docs/theory_light.md 3).
"""

from __future__ import annotations

from ..maths import random
from ..maths.arrays import Array, Lanes
from ..maths.random import Seed
from ..physics.electronics import counting
from ..sensor.sensor_model import Sensor


def counts(background_power_w: Lanes, sensor: Sensor, *, seed: Seed, pulse: Array) -> Lanes:
    """Noisy counts of detected photons and dark events in the sensor's ambient window, (n,) whole numbers.

    Echoes are not counted (docs/theory_light.md 3).

    Args:
        background_power_w: (n,) optical power on the detector
        seed: 32-bit frame seed
        pulse: (n,) uint32 pulse numbers
    """
    rate, narrowing = sensor.background_counts(background_power_w)
    words = random.words(seed=seed, stage=random.Stage.AMBIENT, pulse=pulse)
    return counting.poisson_count(
        mean=rate * sensor.tdc.ambient_s,
        uniform=random.open_uniform(words[0]),
        deviate=random.normal_pair(words)[0],
        narrowing=narrowing,
    )
