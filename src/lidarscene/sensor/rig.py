"""A rig: several sensors on one vehicle.

Each sensor simulates on its own: a rig adds only names and places.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

from ..maths.pose import Pose
from .model import Sensor


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mounted:
    """A sensor of a rig, and where it is: ``pose`` on the vehicle, to which its own mounting is added."""

    label: str
    sensor: Sensor
    pose: Pose = field(default_factory=Pose)

    @property
    def placed(self) -> Sensor:
        """The sensor with its whole place on the vehicle as its mounting."""
        return replace(self.sensor, mounting=self.pose @ self.sensor.mounting)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rig:
    """The sensors of a vehicle, each with a label of its own; ``files`` are those that it was read from."""

    name: str
    sensors: tuple[Mounted, ...]
    files: tuple[Path, ...] = ()
