"""Work: what a worker process does with one frame. Compiled worlds are kept from frame to frame."""

from __future__ import annotations

import functools
import signal
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from .._version import __version__
from ..errors import InputError, LidarSceneError, shortened
from ..kernel.device import transfer
from ..maths.trajectory import pose_at
from ..outputs import report
from ..rendering.frame import motion_of
from ..rendering.simulator import Simulator, Summary
from ..scene.scene import Scene
from ..scene.scene_file import load_scene
from ..sensor.catalogue import load_sensor
from ..sensor.model import Sensor
from ..sensor.rig import Mounted
from ..sensor.rig_file import load_rig
from .store import Store
from .tasks import FrameTask, SceneChoice, SensorChoice, rig_content, scene_content, sensor_content

ELSEWHERE, THERE = "(elsewhere)", "(there)"
"""In place of a cause: another run is at this frame now, or has done it."""

KEPT = 4
"""Worlds, scenes and sensors of each process: few, since each shape that is alive costs time in every trace."""


def render_frames(tasks: Sequence[FrameTask], folder: str, threads: int | None) -> tuple[list[str], float]:
    """Render frames into the job's folder unless they are there.

    threads  of Dr.Jit; as many as the Dask worker has if None
    Returns "" for each, THERE, ELSEWHERE, or what went wrong in one line; and the seconds that it took.
    """
    since = time.monotonic()
    store, used = Store(Path(folder)), threads or _threads_of_worker()
    causes = [_thread().submit(_told, task, store, used).result() for task in tasks]
    return causes, time.monotonic() - since


def dask_setup(_: Any) -> None:
    """Dask calls it when a process of a local cluster starts: Ctrl-C is for the client, who ends them all."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@functools.cache
def _thread() -> ThreadPoolExecutor:
    """The one thread of this process that renders: Mitsuba's variant is set for it alone, and a frame has the process
    for itself.
    """
    return ThreadPoolExecutor(1, thread_name_prefix="lidarscene")


def _threads_of_worker() -> int:
    from distributed import get_worker

    return int(get_worker().state.nthreads)


def _told(task: FrameTask, store: Store, threads: int) -> str:
    """A failure of one frame is a line in a list: whatever it is, the others go on."""
    try:
        transfer.use_threads(threads)
        return _render(task, store)
    except LidarSceneError as error:
        return " ".join(str(error).split())
    except Exception as error:
        return " ".join(shortened(f"{type(error).__name__}: {error}").split())


def _render(task: FrameTask, store: Store) -> str:
    if task.version != __version__:
        raise InputError(f"lidarscene {task.version} gave this frame out, the worker has {__version__}")
    with store.claimed(task.key) as is_ours:
        if not is_ours:
            return ELSEWHERE
        if store.row(task.key) is not None:  # another worker was faster
            return THERE
        _save(task, store)
    return ""


def _save(task: FrameTask, store: Store) -> None:
    simulator = _simulator(task)
    summary = Summary()
    cloud = simulator.render(task.frame, summary=summary)
    path = store.cloud(task.key, task.format)
    (cloud if task.truth else cloud.without_truth()).save(path, format=task.format)
    store.finish(task.key, path, report.as_dict(summary))


class _Kept:
    """The things used last, by key; no more than KEPT."""

    def __init__(self) -> None:
        self._things: OrderedDict[Hashable, Any] = OrderedDict()

    def get(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """The thing of this key, made if it is not there; the oldest goes before, so that memory never holds more."""
        if key not in self._things:
            while len(self._things) >= KEPT:
                self._things.popitem(last=False)
            self._things[key] = make()
        self._things.move_to_end(key)
        return self._things[key]


_scenes, _sensors, _worlds = _Kept(), _Kept(), _Kept()


def _simulator(task: FrameTask) -> Simulator:
    """As `lidarscene render` would make it: of a rig, sensors of one wavelength share the world of the first.

    Kept with its world: it knows how to repeat its stages, and in which order to trace its pulses.
    """
    choice, sensor = task.scene, task.sensor
    scene: Scene = _scenes.get(choice.digest, lambda: _scene(choice))
    own, first = _sensors.get((sensor.digest, choice.digest), lambda: _mounted(sensor, scene))
    centre_m = pose_at(motion_of(scene, first.sensor, first.pose)).position_m
    world, simulators = _worlds.get(
        (choice.world, _wavelength(own.sensor), centre_m.tobytes(), task.trace.interactions > 0),
        lambda: (Simulator(scene, first.sensor, task.trace, pose=first.pose).world, _Kept()),
    )
    simulator: Simulator = simulators.get(
        (choice.digest, sensor.digest, task.trace),
        lambda: Simulator(scene, own.sensor, task.trace, pose=own.pose, world=world),
    )
    return simulator


def _scene(choice: SceneChoice) -> Scene:
    path = Path(choice.path)
    scene = load_scene(path, overrides=choice.overrides)
    if scene_content(path, choice.overrides) != choice.content:
        raise _changed(choice.path)
    return scene


def _mounted(choice: SensorChoice, scene: Scene) -> tuple[Mounted, Mounted]:
    """The sensor where it is on the vehicle, and the one around which its world is compiled."""
    if not choice.rig:
        sensor = load_sensor(choice.name, overrides=choice.overrides)
        if sensor_content(choice.name, choice.overrides) != choice.content:
            raise _changed(choice.name)
        alone = Mounted(label="", sensor=sensor, pose=scene.sensor_pose)
        return alone, alone
    rig = load_rig(choice.rig, overrides=choice.overrides)
    if rig_content(choice.rig, choice.overrides) != choice.content:
        raise _changed(choice.rig)
    own = next(one for one in rig.sensors if one.label == choice.label)
    first = next(one for one in rig.sensors if _wavelength(one.sensor) == _wavelength(own.sensor))
    return own, first


def _wavelength(sensor: Sensor) -> float:
    return sensor.laser.wavelength_m


def _changed(path: str) -> InputError:
    return InputError(
        f"{path}: it, or a file that it names, is not the one of which this frame was asked; run it again"
    )
