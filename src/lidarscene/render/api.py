"""What users call from Python: names or files in, point clouds out."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from .. import catalog
from ..cloud.points import PointCloud
from ..kernel.rays.trace import INTERACTIONS
from ..materials.material import Material
from ..maths.pose import Pose
from ..scene.file import read_scene
from ..scene.foreign import mitsuba_scene, trimesh_scene
from ..scene.model import Scene
from ..sensor.model import Sensor
from ..sensor.rig import Rig
from ..sensor.rig_file import read_rig
from .simulator import DEFAULT_CHUNK, Simulator


def load_scene(scene: str | os.PathLike[str] | Scene, *, overrides: Sequence[str] = ()) -> Scene:
    """A scene from a TOML file or a Mitsuba XML; a `Scene` stays.

    overrides  ``sun.illuminance_klux=1``-like changes to the values of a TOML file
    Raises InputError.
    """
    if isinstance(scene, Scene):
        return scene
    return read_scene(Path(scene), catalogue=catalog.material, overrides=overrides)


def scene_from_trimesh(
    mesh: Any,
    *,
    material: str | Material | None,
    materials: Mapping[str, str | Material],
    classes: Mapping[str, str],
    settings: Mapping[str, Any],
) -> Scene:
    """See `Scene.from_trimesh`."""
    return trimesh_scene(
        mesh,
        material=material,
        materials=materials,
        classes=classes,
        settings=settings,
        catalogue=catalog.material,
    )


def scene_from_mitsuba(
    path: str | os.PathLike[str], *, materials: Mapping[str, str | Material], settings: Mapping[str, Any]
) -> Scene:
    """See `Scene.from_mitsuba`."""
    return mitsuba_scene(Path(path), materials=materials, settings=settings, catalogue=catalog.material)


def load_sensor(sensor: str | os.PathLike[str] | Sensor, *, overrides: Sequence[str] = ()) -> Sensor:
    """A sensor by catalogue name or from a TOML file; a `Sensor` stays.

    overrides  ``detector.gain=60``-like changes to the file's values
    Raises InputError.
    """
    if isinstance(sensor, Sensor):
        return sensor
    return catalog.sensor(os.fspath(sensor), overrides=overrides)


def load_rig(rig: str | os.PathLike[str] | Rig, *, overrides: Sequence[str] = ()) -> Rig:
    """A rig from a TOML file; a `Rig` stays. ``overrides`` go to every sensor, or as LABEL:KEY=VALUE to one.

    Raises InputError.
    """
    if isinstance(rig, Rig):
        return rig
    return read_rig(
        Path(rig), sensor=lambda name, changes: load_sensor(name, overrides=changes), overrides=overrides
    )


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
