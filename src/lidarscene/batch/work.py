"""Work: render frames in a worker process. Compiled worlds are kept from frame to frame."""

from __future__ import annotations

import signal
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from .._version import __version__
from ..cloud.point_cloud import PointCloud
from ..errors import InputError, LidarSceneError, shorten
from ..kernel.device import blocks, gpus
from ..kernel.device.gate import exclusive
from ..labels.point_rows import PointRows
from ..maths.trajectory import pose_at
from ..outputs import run_report
from ..outputs.closing import Closing, frames_at_once
from ..outputs.streams import row_reader
from ..rendering.frame import sensor_motion
from ..rendering.simulator import Simulator, Summary
from ..scene.scene import Scene
from ..scene.scene_file import changed_scene
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

    The files of a frame are written on a thread while the next one is traced.

    Args:
        threads: threads of Dr.Jit; None: those of the Dask worker
        claiming: whether frames that another process has claimed are left to it; it may hang

    Returns:
        for each frame "", REUSED, ELSEWHERE or the cause of a failure in one line; and the seconds for all
    """
    since = time.monotonic()
    store, thread_count = Store(Path(folder)), threads or _threads_of_worker()
    causes = [""] * len(tasks)
    with Closing() as closing:
        for number, task in enumerate(tasks):
            with ExitStack() as frame:
                frame.enter_context(_told(causes, number))
                rendered = _rendered(task, store, thread_count, claiming, _frames_following(tasks[number:]))
                causes[number] = frame.enter_context(rendered)
                closing(frame)
    return causes, time.monotonic() - since


@contextmanager
def _told(causes: list[str], number: int) -> Iterator[None]:
    """Make any failure within the block one line of text, entry ``number``, so that the other frames go on."""
    try:
        yield
    except LidarSceneError as error:
        causes[number] = " ".join(str(error).split())
    except Exception as error:
        causes[number] = " ".join(shorten(f"{type(error).__name__}: {error}").split())


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


@contextmanager
def _rendered(
    task: FrameTask | DriveTask, store: Store, threads: int, claiming: bool = True, following: int = 0
) -> Iterator[str]:
    """Render one frame; its files are written as the block ends.

    Args:
        following: `_frames_following`

    Yields:
        "", or REUSED or ELSEWHERE
    """
    if task.version != __version__:
        raise InputError(f"lidarscene {task.version} gave this frame out, the worker has {__version__}")
    with store.claim(task.key) as is_ours:
        if claiming and not is_ours:
            yield ELSEWHERE
        elif store.row(task.key) is not None:  # another worker was faster
            yield REUSED
        elif isinstance(task, DriveTask):
            yield ""
            task.write(store, _scene_of(task.frames[0].scene))
        else:
            write = _render(task, store, threads, following)
            yield ""
            if write is not None:
                write()


@exclusive
def _render(task: FrameTask, store: Store, threads: int, following: int) -> Callable[[], None] | None:
    """Render one frame; returns what writes it, or None: a frame that would fill the memory is written here."""
    blocks.use_threads(threads)
    simulator = _simulator(task)
    summary, ahead = Summary(), None
    if following:  # the device computes them while the files of this one are written
        ahead = partial(simulator.begin, replace(task.frame, number=task.frame.number + 1), following)
    scene, dataset = _scene_of(task.scene), None if task.place is None else task.place.dataset
    pieces: list[PointCloud | PointRows] = []
    read = row_reader(simulator, task.frame, dataset, deskew=task.deskew, own_car=task.own_car)
    if read is not None:
        simulator.stream(pieces.append, task.frame, summary=summary, ahead=ahead, read=read)
    else:
        pieces.append(simulator.render(task.frame, summary=summary, ahead=ahead))
    write = partial(_write, task, store, pieces, run_report.as_dict(summary), simulator, scene)
    if frames_at_once(simulator.sensor.scanner.pulses, task.frame.chunk):
        return write
    write()
    return None


def _write(
    task: FrameTask,
    store: Store,
    pieces: Sequence[PointCloud | PointRows],
    row: dict[str, Any],
    simulator: Simulator,
    scene: Scene,
) -> None:
    """Write the files of a frame and its row.

    Args:
        pieces: as of `Place.write`, but a cloud as it was rendered
        row: the frame's summary
    """
    # Here, since the device goes on meanwhile: NumPy takes 0.1 s to free a large cloud from motion.
    pieces = [piece if isinstance(piece, PointRows) else _asked(task, piece, simulator, scene) for piece in pieces]
    if task.place is not None and not task.place.is_whole_drive:
        truth = task.place.write(store.folder, pieces, simulator, scene, all_around=task.all_around)
        files = [store.folder / file for file in task.place.files]
        store.finish(task.key, files, row | {"truth": truth})
        return
    (cloud,) = pieces
    assert isinstance(cloud, PointCloud)
    path = store.cloud(task.key, task.format)
    if task.place is not None:
        # Boxes are made of the truth when the drive is written, which leaves it out if it is not wanted.
        end_s = cloud.frame_start_s + simulator.sensor.scanner.frame_s
        row |= {"truth": {"start_s": cloud.frame_start_s, "end_s": end_s}}
    elif not task.truth:
        cloud = cloud.without_truth()
    cloud.save(path, format=task.format)
    store.finish(task.key, [path], row)


def _asked(task: FrameTask, cloud: PointCloud, simulator: Simulator, scene: Scene) -> PointCloud:
    """Cloud as the task asks for it."""
    if not task.own_car:
        cloud = cloud.without_bodies(scene.own_bodies)
    return simulator.without_motion(cloud, task.frame) if task.deskew else cloud


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
    number, mounted, first = _sensors.get((sensor.digest, choice.digest), lambda: _load_mounted(sensor, scene))
    centre_m = pose_at(sensor_motion(scene, first.sensor, first.pose)).position_m
    world, simulators = _worlds.get(
        (choice.world, _wavelength(mounted.sensor), centre_m.tobytes(), task.trace.interactions > 0),
        lambda: (Simulator(scene, first.sensor, task.trace, pose=first.pose).world, _Cache()),
    )
    simulator: Simulator = simulators.get(
        (choice.digest, sensor.digest, task.trace),
        lambda: Simulator(scene, mounted.sensor, task.trace, pose=mounted.pose, world=world, rig_number=number),
    )
    return simulator


def _scene_of(choice: SceneChoice) -> Scene:
    """Scene of a choice, loaded once."""
    scene: Scene = _scenes.get(choice.digest, lambda: _scene(choice))
    return scene


def _scene(choice: SceneChoice) -> Scene:
    path = Path(choice.path)
    scene = changed_scene(path, choice.overrides)
    if scene_content(path, choice.overrides) != choice.content:
        raise _changed_error(choice.path)
    return scene


def _load_mounted(choice: SensorChoice, scene: Scene) -> tuple[int, Mounted, Mounted]:
    """Load the sensor with its pose on the vehicle: its number in the rig, it, and the one whose world it shares."""
    if not choice.rig:
        sensor = load_sensor(choice.name, overrides=choice.overrides)
        if sensor_content(choice.name, choice.overrides) != choice.content:
            raise _changed_error(choice.name)
        alone = Mounted(label="", sensor=sensor, pose=scene.sensor_pose)
        return 0, alone, alone
    rig = load_rig(choice.rig, overrides=choice.overrides)
    if rig_content(choice.rig, choice.overrides) != choice.content:
        raise _changed_error(choice.rig)
    number, chosen = next(pair for pair in enumerate(rig.sensors) if pair[1].label == choice.label)
    first = next(mounted for mounted in rig.sensors if _wavelength(mounted.sensor) == _wavelength(chosen.sensor))
    return number, chosen, first


def _wavelength(sensor: Sensor) -> float:
    return sensor.laser.wavelength_m


def _changed_error(path: str) -> InputError:
    return InputError(
        f"{path}: it, or a file that it names, is not the one of which this frame was asked; run it again"
    )
