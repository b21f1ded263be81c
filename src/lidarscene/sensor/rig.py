"""A rig: several sensors on one vehicle, described; and their clouds as one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..cloud.points import PointCloud
from ..errors import InputError
from ..kernel.rays.trace import INTERACTIONS
from ..kernel.world.build import World
from ..maths.pose import Pose
from ..render.simulator import Simulator
from ..scene.model import Scene
from .model import Sensor

JOINED = {"sensor": ", ", "frame_start_s": " ", "sensor_position_m": " ", "sensor_rotation": " "}
"""Metadata of which a merged cloud has one for each sensor, and what stands between them."""


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
    background_rays: int | None = None,
) -> Iterator[tuple[str, Simulator]]:
    """Label and simulator of each sensor; those of one wavelength share one compiled world.

    pose  of the vehicle, in the world or, of a scene in which it moves, in the ego frame
    rays, interactions, background_rays  as of `Simulator`
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
            background_rays=background_rays,
        )
        worlds.setdefault(wavelength, simulator.world)
        yield one.label, simulator


def require_common_frames(sensors: Sequence[Mounted], frames: int) -> None:
    """Raises InputError where the n-th frames of these sensors are of different times, so that none can be merged.

    Turns of 99.99 and 100 ms are no mistake: the last of the frames may begin half a frame apart.
    """
    lengths = {one.label: one.sensor.scanner.frame_s for one in sensors}
    short, long = (
        min(lengths, key=lambda label: lengths[label]),
        max(lengths, key=lambda label: lengths[label]),
    )
    if (frames - 1) * (lengths[long] - lengths[short]) > lengths[short] / 2.0:
        raise InputError(
            f"{frames} merged frames: frames that begin together were expected, '{short}' has them of "
            f"{lengths[short]:g} s and '{long}' of {lengths[long]:g} s"
        )


def merged(clouds: Sequence[PointCloud], labels: Sequence[str]) -> PointCloud:
    """Clouds of several sensors, in one frame that is not the sensor's, as one.

    `sensor_index` says of which each point is, `sensor_names` are the labels, and the metadata's `frame_start_s`,
    `sensor_position_m` and `sensor_rotation` hold those of all sensors, one after the other. Times stay since the
    start of each sensor's own frame. Raises ValueError for clouds whose points are in the sensor's frame, or in two.
    """
    frames = {cloud.metadata.get("frame", "sensor") for cloud in clouds}
    if len(frames) != 1 or "sensor" in frames:
        raise ValueError(
            f"merged: clouds in one frame, world or vehicle, were expected, {sorted(frames)} came"
        )
    numbered = [
        replace(cloud, sensor_names=tuple(labels), sensor_index=_constant(number, len(cloud)))
        for number, cloud in enumerate(clouds)
    ]
    together = PointCloud.concatenate(numbered)
    joined = {
        key: separator.join(cloud.metadata[key] for cloud in clouds)
        for key, separator in JOINED.items()
        if all(key in cloud.metadata for cloud in clouds)
    }
    units = list(dict.fromkeys(cloud.metadata.get("intensity_unit", "") for cloud in clouds))
    if len(units) > 1:
        joined["intensity_unit"] = " or ".join(units)
    return replace(together, metadata={**clouds[0].metadata, **joined})


class Merging:
    """`merged` for clouds that come in pieces, those of the first sensor first."""

    def __init__(self, clouds: Sequence[PointCloud], labels: Sequence[str]) -> None:
        """``clouds`` have the names and metadata of each sensor's, and no points."""
        self._whole = merged(clouds, labels)
        self._dtype: Any = None

    def piece(self, number: int, cloud: PointCloud) -> PointCloud:
        """Some points of sensor ``number`` as points of the merged cloud."""
        self._dtype = self._dtype or cloud.xyz_m.dtype  # the first one's, as of arrays that are joined
        return replace(
            cloud,
            xyz_m=cloud.xyz_m.astype(self._dtype, copy=False),
            sensor_names=self._whole.sensor_names,
            sensor_index=_constant(number, len(cloud)),
            metadata=self._whole.metadata,
        )


def _constant(number: int, points: int) -> np.ndarray[Any, Any]:
    return np.broadcast_to(np.uint8(number), points)
