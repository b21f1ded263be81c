"""`render` and `render_frames`: names or files in, point clouds out.

One call for one cloud of one scene. A `Simulator` is worth it for several frames of one scene.
"""

from __future__ import annotations

import os
from collections.abc import Generator
from dataclasses import replace
from functools import partial
from typing import Annotated, Literal, Unpack, overload

from ..cloud.device_cloud import DeviceCloud
from ..cloud.point_cloud import PointCloud
from ..files.arguments import checks_arguments
from ..files.overrides import Overrides
from ..scene.scene_file import SceneChoice, changed_scene
from ..sensor.sensor_file import load_sensor
from ..sensor.sensor_model import Sensor, warn_of_doubts
from .option_fields import Whole
from .render_options import NUMBERS, FrameOptions, FramesKeywords, Keywords, Observers, RenderKeywords, TraceOptions
from .simulator import Simulator
from .surroundings import simulator_surroundings, warn_of_surroundings

SensorOfScene = Annotated[
    str | os.PathLike[str] | Sensor | None, "a name, a file, a Sensor or None (record takes a Rig of several)"
]


@overload
def render_frames(
    scene: SceneChoice,
    sensor: SensorOfScene = None,
    *,
    frames: int,
    overrides: Overrides = (),
    scene_overrides: Overrides = (),
    on_device: Literal[False] = False,
    **options: Unpack[FramesKeywords],
) -> Generator[PointCloud, None, None]: ...


@overload
def render_frames(
    scene: SceneChoice,
    sensor: SensorOfScene = None,
    *,
    frames: int,
    overrides: Overrides = (),
    scene_overrides: Overrides = (),
    on_device: Literal[True],
    **options: Unpack[FramesKeywords],
) -> Generator[DeviceCloud, None, None]: ...


@checks_arguments
def render_frames(
    scene: SceneChoice,
    sensor: SensorOfScene = None,
    *,
    frames: int,
    overrides: Overrides = (),
    scene_overrides: Overrides = (),
    on_device: bool = False,
    **options: Unpack[FramesKeywords],
) -> Generator[PointCloud | DeviceCloud, None, None]:
    """Iterate over ``frames`` consecutive frames of a sensor; each is rendered when the iterator reaches it.

    ``close()`` of the iterator ends it and frees its world. The other parameters are those of `render`.
    """
    Whole(1, NUMBERS.high).check("frames", frames)
    keep_rays = options.pop("keep_rays", False)
    simulator, first, observers = _prepare(scene, sensor, overrides, scene_overrides, options, frames)
    numbers = range(first.number, first.number + int(frames))
    simulator.check_frames(numbers, begin_s=first.begin_s)

    def frame(number: int) -> PointCloud | DeviceCloud:
        # While the caller has this frame, the device computes the next ones.
        ahead, left = None, numbers.stop - number - 1
        if left:
            ahead = partial(simulator.begin, replace(first, number=number + 1), left)
        chosen = replace(first, number=number)
        if on_device:
            return simulator.render(chosen, observers, ahead=ahead, on_device=True, keep_rays=keep_rays)
        return simulator.render(chosen, observers, ahead=ahead, keep_rays=keep_rays)

    # Not a function that yields: so the call itself raises for mistakes, and not the first frame.
    return (frame(number) for number in numbers)


@overload
def render(
    scene: SceneChoice,
    sensor: SensorOfScene = None,
    *,
    overrides: Overrides = (),
    scene_overrides: Overrides = (),
    keep_rays: bool = False,
    on_device: Literal[False] = False,
    **options: Unpack[RenderKeywords],
) -> PointCloud: ...


@overload
def render(
    scene: SceneChoice,
    sensor: SensorOfScene = None,
    *,
    overrides: Overrides = (),
    scene_overrides: Overrides = (),
    keep_rays: bool = False,
    on_device: Literal[True],
    **options: Unpack[RenderKeywords],
) -> DeviceCloud: ...


@checks_arguments
def render(
    scene: SceneChoice,
    sensor: SensorOfScene = None,
    *,
    overrides: Overrides = (),
    scene_overrides: Overrides = (),
    keep_rays: bool = False,
    on_device: bool = False,
    **options: Unpack[RenderKeywords],
) -> PointCloud | DeviceCloud:
    """Render one frame of a sensor in a scene.

    Args:
        scene: a scene's name, such as "car", scene file, Mitsuba XML, mesh file or `Scene`
        sensor: catalogue name, sensor file or `Sensor`; the scene's own if None
        overrides: changes to the sensor file's values: "detector.gain=60", a list of these, or {"detector.gain": 60}
        scene_overrides: changes to the scene file's values, likewise
        keep_rays: keep the ray of every pulse too, with an echo or without, in `PointCloud.rays`
        on_device: leave the columns on the device, for libraries that compute there: a `DeviceCloud`
        options: `TraceOptions` as ``trace``, `FrameOptions` as ``frame`` and `Observers` as ``observers``, or the
            fields of any of them: ``seed=1, rays=3``

    Raises:
        InputError: for a mistake in a file or an option
        BackendError: without a usable Mitsuba back end
    """
    simulator, frame, observers = _prepare(scene, sensor, overrides, scene_overrides, options)
    if on_device:
        return simulator.render(frame, observers, on_device=True, keep_rays=keep_rays)
    return simulator.render(frame, observers, keep_rays=keep_rays)


def _prepare(
    scene: SceneChoice,
    sensor: SensorOfScene,
    overrides: Overrides,
    scene_overrides: Overrides,
    options: RenderKeywords,
    frames: int = 1,
) -> tuple[Simulator, FrameOptions, Observers]:
    """Load scene and sensor and compile them: the simulator, and the options and observers of the frame."""
    keywords = Keywords(options)
    trace, frame, observers = (keywords.take(TraceOptions), keywords.take(FrameOptions), keywords.take(Observers))
    keywords.end("scene", "sensor", "overrides", "scene_overrides", "on_device")
    described = changed_scene(scene, scene_overrides)
    equipped = load_sensor(described.sensor_name if sensor is None else sensor, overrides=overrides)
    simulator = Simulator(described, equipped, trace, pose=frame.pose)
    warn_of_doubts([equipped])
    warn_of_surroundings([simulator_surroundings(simulator, frame, frames)])
    return simulator, frame, observers
