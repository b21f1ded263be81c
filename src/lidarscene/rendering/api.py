"""What users call from Python: names or files in, point clouds out."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from typing import Any

from ..cloud.points import PointCloud
from ..kernel.rays.trace import INTERACTIONS
from ..maths.pose import Pose
from ..scene.file import load_scene
from ..scene.model import Scene
from ..sensor.catalogue import load_sensor
from ..sensor.model import Sensor
from .simulator import DEFAULT_CHUNK, Simulator


def render_frames(
    scene: str | os.PathLike[str] | Scene,
    sensor: str | os.PathLike[str] | Sensor | None = None,
    *,
    frames: int,
    begin_s: float = 0.0,
    seed: int = 0,
    pose: Pose | None = None,
    frame: str = "world",
    chunk: int = DEFAULT_CHUNK,
    interactions: int = INTERACTIONS,
    rays: int = 1,
    background_rays: int | None = None,
    overrides: Sequence[str] = (),
) -> Iterator[PointCloud]:
    """Frames of a sensor one after the other, each when it is asked for; arguments as of `render`.

    begin_s  when the first begins, by the clock of the scene's motions
    """
    simulator = _simulator(
        scene, sensor, overrides,
        pose=pose, rays=rays, interactions=interactions, background_rays=background_rays,
    )  # fmt: skip
    simulator.check_frames(frames, begin_s=begin_s)
    for number in range(frames):
        yield simulator.render(seed=seed, number=number, begin_s=begin_s, frame=frame, chunk=chunk)


def render(
    scene: str | os.PathLike[str] | Scene,
    sensor: str | os.PathLike[str] | Sensor | None = None,
    *,
    seed: int = 0,
    pose: Pose | None = None,
    frame: str = "world",
    chunk: int = DEFAULT_CHUNK,
    interactions: int = INTERACTIONS,
    rays: int = 1,
    background_rays: int | None = None,
    overrides: Sequence[str] = (),
) -> PointCloud:
    """One frame of a sensor in a scene.

    scene      scene file, Mitsuba XML or `Scene`
    sensor     catalogue name, sensor file or `Sensor`; the scene's own if None
    seed       32 bits; the same seed gives the same cloud
    pose       where the sensor stands, in the world or on the scene's ego vehicle; the scene's own if None
    frame      "world", "vehicle" or "sensor": frame of the points
    chunk      rays traced at a time; bounds the memory, changes nothing else
    rays       of each pulse, over the footprint of its beam; a single one is its axis
    interactions  panes, mirrors and gaps that a beam may meet
    background_rays  of each pulse, over the receiver's field of view, for its background; None: what its rays see
    overrides  changes to the sensor file's values, ``detector.gain=60``
    Raises InputError for a mistake in a file, BackendError without a usable Mitsuba back end.
    """
    simulator = _simulator(
        scene, sensor, overrides,
        pose=pose, rays=rays, interactions=interactions, background_rays=background_rays,
    )  # fmt: skip
    return simulator.render(seed=seed, frame=frame, chunk=chunk)


def _simulator(
    scene: str | os.PathLike[str] | Scene,
    sensor: str | os.PathLike[str] | Sensor | None,
    overrides: Sequence[str],
    **options: Any,
) -> Simulator:
    """A simulator of what is named, ready to render."""
    described = load_scene(scene)
    equipped = load_sensor(described.sensor_name if sensor is None else sensor, overrides=overrides)
    return Simulator(described, equipped, **options)
