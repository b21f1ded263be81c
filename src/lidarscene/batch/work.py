"""Work: render frames in a worker process. Compiled worlds are kept from frame to frame."""

from __future__ import annotations

import signal
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from .._version import __version__
from ..cloud.point_cloud import PointCloud
from ..errors import InputError, LidarSceneError, shorten
from ..kernel.device import blocks, gpus
from ..kernel.device.gate import exclusive
from ..labels.point_rows import DeviceRows, PointRows
from ..maths.trajectory import pose_at
from ..outputs import run_report
from ..rendering.frame import sensor_motion
from ..rendering.simulator import Simulator, Summary
from ..scene.scene import Scene
from ..scene.scene_file import load_scene
from ..sensor.rig_file import Mounted, load_rig
from ..sensor.sensor_file import load_sensor
from ..sensor.sensor_model import Sensor
from .drives import DriveTask
from .store import Store
from .tasks import FrameTask, SceneChoice, SensorChoice, rig_content, scene_content, sensor_content

ELSEWHERE, REUSED = "(elsewhere)", "(there)"
"""Values in place of a cause: another run is rendering this frame now, or has rendered it."""

CACHED = 4
"""Worlds, scenes and sensors of each process: few, since each shape that is alive costs time in every trace."""


def render_frames(
    tasks: Sequence[FrameTask | DriveTask], folder: str, threads: int | None, claiming: bool = True
) -> tuple[list[str], float]:
    """Render frames into the job's folder, or write drives of frames, unless they are there.

    Args:
        threads: threads of Dr.Jit; None: those of the Dask worker
        claiming: whether frames that another process has claimed are left to it; it may hang

    Returns:
        for each frame "", REUSED, ELSEWHERE or the cause of a failure in one line; and the seconds for all
    """
    since = time.monotonic()
    store, thread_count = Store(Path(folder)), threads or _threads_of_worker()
    causes = [
        _try_render(task, store, thread_count, claiming, _frames_following(tasks[number:]))
        for number, task in enumerate(tasks)
    ]
    return causes, time.monotonic() - since


def _frames_following(tasks: Sequence[FrameTask | DriveTask]) -> int:
    """Number of tasks behind the first that are the next frames of its run, one after the other."""
    count, first = 0, tasks[0]
    for number, task in enumerate(tasks[1:], start=1):
        if isinstance(first, DriveTask) or isinstance(task, DriveTask):
            break
        settings = (task.scene, task.sensor, task.trace) == (first.scene, first.sensor, first.trace)
        if not settings or not task.frame.differs_in_number(first.frame):
            break
        if task.frame.number != first.frame.number + number:
            break
        count = number
    return count


def dask_setup(worker: Any) -> None:
    """Begin a process of a local cluster, as Dask asks: Ctrl-C is for the client, and of several GPUs it sees one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    gpus.see_one_gpu(worker.name)


def _threads_of_worker() -> int:
    from distributed import get_worker

    return int(get_worker().state.nthreads)


@exclusive
def _try_render(
    task: FrameTask | DriveTask, store: Store, threads: int, claiming: bool = True, following: int = 0
) -> str:
    """Render one frame; any failure becomes one line of text, so that the other frames go on.

    Args:
        following: `_frames_following`
    """
    try:
        blocks.use_threads(threads)
        return _render(task, store, claiming, following)
    except LidarSceneError as error:
        return " ".join(str(error).split())
    except Exception as error:
        return " ".join(shorten(f"{type(error).__name__}: {error}").split())


def _render(task: FrameTask | DriveTask, store: Store, claiming: bool = True, following: int = 0) -> str:
    if task.version != __version__:
        raise InputError(f"lidarscene {task.version} gave this frame out, the worker has {__version__}")
    with store.claim(task.key) as is_ours:
        if claiming and not is_ours:
            return ELSEWHERE
        if store.row(task.key) is not None:  # another worker was faster
            return REUSED
        if isinstance(task, DriveTask):
            task.write(store, _scene_of(task.frames[0].scene))
        else:
            _save(task, store, following)
    return ""


def _save(task: FrameTask, store: Store, following: int) -> None:
    simulator = _simulator(task)
    summary, ahead = Summary(), None
    if following:  # the device computes them while the files of this one are written
        ahead = partial(simulator.begin, replace(task.frame, number=task.frame.number + 1), following)
    scene = _scene_of(task.scene)
    pieces: list[PointCloud | PointRows] = []
    if task.place is not None and task.place.dataset == "semantickitti":
        deskewing = simulator.deskewing(task.frame) if task.deskew else None
        read = DeviceRows(simulator.empty(task.frame), scene, deskewing, own_car=task.own_car)
        simulator.stream(pieces.append, task.frame, summary=summary, ahead=ahead, read=read)
    else:
        cloud = simulator.render(task.frame, summary=summary, ahead=ahead)
        if not task.own_car:
            cloud = cloud.without_bodies(scene.own_bodies)
        if task.deskew:
            cloud = simulator.without_motion(cloud, task.frame)
        pieces.append(cloud)
    if task.place is not None and not task.place.is_whole_drive:
        truth = task.place.write(store.folder, pieces, simulator, scene, all_around=task.all_around)
        files = [store.folder / file for file in task.place.files]
        store.finish(task.key, files, run_report.as_dict(summary) | {"truth": truth})
        return
    path, row = store.cloud(task.key, task.format), run_report.as_dict(summary)
    if task.place is not None:
        # Boxes are made of the truth when the drive is written, which leaves it out if it is not wanted.
        end_s = cloud.frame_start_s + simulator.sensor.scanner.frame_s
        row |= {"truth": {"start_s": cloud.frame_start_s, "end_s": end_s}}
    elif not task.truth:
        cloud = cloud.without_truth()
    cloud.save(path, format=task.format)
    store.finish(task.key, [path], row)


class _Cache:
    """Cache of the entries used last, at most CACHED."""

    def __init__(self) -> None:
        self._entries: OrderedDict[Hashable, Any] = OrderedDict()

    def get(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """Get the entry of a key, made if missing; the oldest is dropped first, so that memory never holds more."""
        if key not in self._entries:
            while len(self._entries) >= CACHED:
                self._entries.popitem(last=False)
            self._entries[key] = make()
        self._entries.move_to_end(key)
        return self._entries[key]


_scenes, _sensors, _worlds = _Cache(), _Cache(), _Cache()


def _simulator(task: FrameTask) -> Simulator:
    """Simulator as `lidarscene render` makes it: sensors of a rig with one wavelength share the world of the first.

    Cached with its world, and with it the recorded stages and the order of pulses.
    """
    choice, sensor = task.scene, task.sensor
    scene = _scene_of(choice)
    mounted, first = _sensors.get((sensor.digest, choice.digest), lambda: _load_mounted(sensor, scene))
    centre_m = pose_at(sensor_motion(scene, first.sensor, first.pose)).position_m
    world, simulators = _worlds.get(
        (choice.world, _wavelength(mounted.sensor), centre_m.tobytes(), task.trace.interactions > 0),
        lambda: (Simulator(scene, first.sensor, task.trace, pose=first.pose).world, _Cache()),
    )
    simulator: Simulator = simulators.get(
        (choice.digest, sensor.digest, task.trace),
        lambda: Simulator(scene, mounted.sensor, task.trace, pose=mounted.pose, world=world),
    )
    return simulator


def _scene_of(choice: SceneChoice) -> Scene:
    """Scene of a choice, loaded once."""
    scene: Scene = _scenes.get(choice.digest, lambda: _scene(choice))
    return scene


def _scene(choice: SceneChoice) -> Scene:
    path = Path(choice.path)
    scene = load_scene(path, overrides=choice.overrides)
    if scene_content(path, choice.overrides) != choice.content:
        raise _changed_error(choice.path)
    return scene


def _load_mounted(choice: SensorChoice, scene: Scene) -> tuple[Mounted, Mounted]:
    """Load the sensor with its pose on the vehicle, and the sensor around which its world is compiled."""
    if not choice.rig:
        sensor = load_sensor(choice.name, overrides=choice.overrides)
        if sensor_content(choice.name, choice.overrides) != choice.content:
            raise _changed_error(choice.name)
        alone = Mounted(label="", sensor=sensor, pose=scene.sensor_pose)
        return alone, alone
    rig = load_rig(choice.rig, overrides=choice.overrides)
    if rig_content(choice.rig, choice.overrides) != choice.content:
        raise _changed_error(choice.rig)
    chosen = next(mounted for mounted in rig.sensors if mounted.label == choice.label)
    first = next(mounted for mounted in rig.sensors if _wavelength(mounted.sensor) == _wavelength(chosen.sensor))
    return chosen, first


def _wavelength(sensor: Sensor) -> float:
    return sensor.laser.wavelength_m


def _changed_error(path: str) -> InputError:
    return InputError(
        f"{path}: it, or a file that it names, is not the one of which this frame was asked; run it again"
    )
