"""Shots of a sensor at a target, through the detection of `render`, on NumPy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lidarscene.detection.outcomes import Outcome, Status
from lidarscene.detection.receiver import detect
from lidarscene.light.fluctuations import fluctuate
from lidarscene.sensor.sensor_model import Sensor
from lidarscene.studies.ranging import plane
from lidarscene.studies.ranging.plane import Target


@dataclass(frozen=True, slots=True)
class ShotCounts:
    """Reported echoes and reported false alarms."""

    echoes: int
    false_alarms: int

    @property
    def correct_share(self) -> float:
        """Correct returns among all."""
        return self.echoes / (self.echoes + self.false_alarms)


def simulated_shots(sensor: Sensor, target: Target, range_m: float | None, *, shots: int, seed: int) -> ShotCounts:
    """Pulses at a target, or for a range of None into the sky."""
    ones = np.ones(shots)
    echoes = plane.echoes_of_plane(sensor, target, -ones if range_m is None else range_m * ones)
    pulse = np.arange(shots, dtype=np.uint32)
    variance = plane.fluctuation_variance(sensor, target, echoes.range_m)
    if variance is not None:
        echoes = fluctuate(echoes, variance, seed=seed, pulse=pulse)
    detection = detect(echoes, sensor, seed=seed, pulse=pulse)
    alarms = sum(
        int(np.sum(np.asarray(stop.reported & (stop.status == int(Status.FALSE_ALARM))))) for stop in detection.stops
    )
    return ShotCounts(int(np.sum(detection.outcome == int(Outcome.KEPT))), alarms)
