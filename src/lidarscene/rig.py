"""A rig: several sensors on one vehicle, described; and their clouds as one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from .cloud import PointCloud
from .geometry import Pose
from .kernel.trace import INTERACTIONS
from .kernel.world import World
from .scene import Scene
from .sensor import Sensor
from .simulate import Simulator


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mounted:
    """A sensor of a rig, and where it is: ``pose`` on the vehicle, to which its own mounting is added."""

    label: str
    sensor: Sensor
    pose: Pose = field(default_factory=Pose)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rig:
    """The sensors of a vehicle, each with a label of its own."""

    name: str
    sensors: tuple[Mounted, ...]


def simulators(
    scene: Scene,
    sensors: Sequence[Mounted],
    *,
    pose: Pose | None = None,
    rays: int = 1,
    interactions: int = INTERACTIONS,
) -> Iterator[tuple[str, Simulator]]:
    """Label and simulator of each sensor; those of one wavelength share one compiled world.

    pose          of the vehicle, in the world or, of a scene in which it moves, in the ego frame
    rays          of each pulse
    interactions  panes and mirrors that a beam may meet
    """
    worlds: dict[float, World] = {}
    vehicle = pose or Pose()
    for one in sensors:
        wavelength = one.sensor.laser.wavelength_m
        simulator = Simulator(
            scene,
            one.sensor,
            pose=vehicle @ one.pose,
            world=worlds.get(wavelength),
            rays=rays,
            interactions=interactions,
        )
        worlds.setdefault(wavelength, simulator.world)
        yield one.label, simulator


def merged(clouds: Sequence[PointCloud], labels: Sequence[str]) -> PointCloud:
    """Clouds of several sensors, in one frame that is not the sensor's, as one.

    `sensor_index` says of which each point is, `sensor_names` are the labels, and the metadata's `sensor_position_m`
    and `sensor_rotation` hold those of all sensors, one after the other. Raises ValueError for clouds of other frames.
    """
    frames = {cloud.metadata.get("frame", "sensor") for cloud in clouds}
    if len(frames) != 1 or "sensor" in frames:
        raise ValueError(
            f"merged: clouds in one frame, world or vehicle, were expected, {sorted(frames)} came"
        )
    numbered = [
        replace(cloud, sensor_names=tuple(labels), sensor_index=np.full(len(cloud), number, dtype=np.uint8))
        for number, cloud in enumerate(clouds)
    ]
    together = PointCloud.concatenate(numbered)
    joined = {
        key: separator.join(cloud.metadata[key] for cloud in clouds)
        for key, separator in (("sensor", ", "), ("sensor_position_m", " "), ("sensor_rotation", " "))
        if all(key in cloud.metadata for cloud in clouds)
    }
    return replace(together, metadata={**clouds[0].metadata, **joined})
