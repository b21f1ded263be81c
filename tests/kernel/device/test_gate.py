"""One thread at a time behind the gate; nothing of the device is freed while something is traced or recorded."""

import dataclasses
import gc
import itertools
import os
import threading
import weakref
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from typing import Any

import drjit as dr
import numpy as np
import pytest
from helpers.run_seed import chosen

from lidarscene import (
    FrameOptions,
    LiveSimulator,
    Outputs,
    PointCloud,
    Simulator,
    load_scene,
    load_sensor,
    record,
    render_frames,
)
from lidarscene.errors import InputError
from lidarscene.kernel.device import backend, gate, gradients, transfer
from lidarscene.kernel.device.replay import Replay
from lidarscene.kernel.rays.camera_distances import distances_m
from lidarscene.maths import arrays
from lidarscene.maths.arrays import LookupTable
from lidarscene.rendering import api
from lidarscene.studies.api import compare

pytestmark = pytest.mark.usefixtures("mi")

COARSE = ("scanner.azimuth_step_deg=4", "scanner.elevation_step_deg=4")
THREADS = f"""
import sys
from concurrent.futures import ThreadPoolExecutor
from lidarscene import Simulator, load_sensor, render

CLOUDS = [("range", "table1-apd", {COARSE}), ("range", "table1-sipm", {COARSE}), ("retro", "table1-apd", {COARSE})]

def bits(cloud):
    return [getattr(cloud, name).tobytes() for name in ("range_m", "time_s", "intensity", "snr", "status")]

def frame(number):
    if simulators:
        return bits(simulators[number % 2].render(number=number, seed=number))
    scene, sensor, overrides = CLOUDS[number % len(CLOUDS)]
    return bits(render(scene, sensor, overrides=overrides, seed=number, rays=1 + number % 2))

simulators = []
for _ in range(2):
    with ThreadPoolExecutor(4) as pool:
        clouds = list(pool.map(frame, range(12)))
    assert clouds == [frame(number) for number in range(12)]
    coarse = [load_sensor(name, overrides={COARSE}) for name in ("table1-apd", "table1-sipm")]
    simulators = [*map(Simulator, ("range", "retro"), coarse)]
"""


def test_threads_render_the_clouds_of_one(run_python: Callable) -> None:
    """Sensors and scenes of their own, then simulators that they share."""
    finished = run_python(THREADS)
    assert finished.returncode == 0, finished.stderr


class Watch:
    """Functions of Dr.Jit and Mitsuba that note whether they were called behind the gate."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.outside: set[str] = set()
        self.calls = 0
        mi = backend.mitsuba()
        for module, names in ((dr, ("eval", "opaque", "sync_thread", "arange", "gather")), (mi, ("load_dict",))):
            for name in names:
                monkeypatch.setattr(module, name, self._noting(name, getattr(module, name)))

    def _noting(self, name: str, function: Callable) -> Callable:
        def call(*arguments: object, **keywords: object) -> object:
            self.calls += 1
            if not gate._gate.occupied:
                self.outside.add(name)
            return function(*arguments, **keywords)

        return call


def _simulator_methods(scene: object, sensor: object) -> None:
    simulator = Simulator(scene, sensor)
    simulator.stream(lambda _: None)
    frame = FrameOptions(seed=3)
    simulator.begin(frame)
    simulator.render(frame)
    simulator.waveforms([0])
    simulator.light()
    simulator.to_world(frame)
    simulator.start_s(frame)
    simulator.empty()
    distances_m(simulator.world, np.zeros(3), np.eye(3), time_s=0.0)


def _live(scene: object, sensor: object) -> None:
    live = LiveSimulator(scene, sensor, movable=[load_scene(scene).bodies[0].name])
    live.place(load_scene(scene).bodies[0].name, (0, 0, -1))
    live.move_ego((0, 0, 0.1))
    live.advance(0.3)


DOORS = {
    "simulator": _simulator_methods,
    "live simulator": _live,
    "record": lambda scene, sensor: record(scene, sensor, outputs=Outputs("cloud.ply", range_image="range.png")),
    "frames": lambda scene, sensor: list(render_frames(scene, sensor, frames=2)),
    "compare": lambda scene, sensor: compare(scene, [sensor, load_sensor("table1-sipm", overrides=COARSE)]),
    "gradients": lambda scene, sensor: gradients.gradient(lambda values: values["a"] * 2.0, {"a": 1.0}),
}


@pytest.mark.parametrize("door", chosen(3, [*DOORS]))
def test_all_of_the_device_is_behind_the_gate(door: str, tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    sensor = load_sensor("table1-apd", overrides=COARSE)
    watch = Watch(monkeypatch)
    DOORS[door]("range", sensor)
    assert watch.calls > 0
    assert watch.outside == set()


def passes() -> bool:
    """Whether another thread gets through the gate within a second or so."""
    through = threading.Event()
    thread = threading.Thread(target=gate.exclusive(through.set), daemon=True)
    thread.start()
    return through.wait(5.0)


def small() -> Simulator:
    return Simulator("range", load_sensor("table1-apd", overrides=COARSE))


def raising(error: BaseException) -> Callable[..., None]:
    def call(*_: object) -> None:
        raise error

    return call


def test_errors_and_ctrl_c_open_the_gate() -> None:
    simulator = small()
    for error in (KeyboardInterrupt(), InputError("no")):
        with pytest.raises(type(error)):
            simulator.render(progress=raising(error))
        assert passes()
        with pytest.raises(type(error)):
            simulator.render(ahead=raising(error))
        assert passes()


def test_frames_that_are_not_taken_leave_the_gate_open(monkeypatch: pytest.MonkeyPatch) -> None:
    """Closed, they leave no world behind either."""
    made: list[weakref.ref[Simulator]] = []
    prepare = api._prepare

    def note(*arguments: Any) -> Any:
        simulator, *others = prepare(*arguments)
        made.append(weakref.ref(simulator))
        return simulator, *others

    monkeypatch.setattr(api, "_prepare", note)
    with closing(render_frames("range", "table1-apd", frames=3, overrides=COARSE)) as frames:
        next(frames)
        assert passes()
        assert made[0]() is not None
    gc.collect()
    assert made[0]() is None
    assert next(frames, None) is None


def test_a_callback_may_render() -> None:
    clouds: list[PointCloud] = []
    cloud = small().render(seed=1, ahead=lambda: clouds.append(small().render(seed=1)))
    assert clouds[0].range_m.tobytes() == cloud.range_m.tobytes()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_fork_waits_for_the_frame_of_another_thread() -> None:
    if backend.is_cuda():
        pytest.skip("for LLVM: CUDA cannot be used behind a fork")
    inside, goes_on = threading.Event(), threading.Event()

    @gate.exclusive
    def occupy() -> None:
        inside.set()
        goes_on.wait(0.3)

    thread = threading.Thread(target=occupy)
    thread.start()
    inside.wait()
    child = os.fork()
    if not child:
        gate.exclusive(os._exit)(7)  # the child passes
    goes_on.set()
    thread.join()
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
    assert passes()


DROPPED = """
from functools import lru_cache
import numpy as np
from lidarscene.kernel.device import backend, gate, transfer
from lidarscene.kernel.device.replay import Replay
from lidarscene.maths.arrays import LookupTable

@lru_cache(maxsize=2)
def table(number):
    return LookupTable(np.arange(64.0) + number)

def replayed(number, lanes):
    replay = gate.exclusive(Replay(lambda x: (table(number).at(x),), list, captured=()))
    return [replay(lanes)[0].numpy().tolist() for _ in range(2)]

backend.mitsuba()
lanes = transfer.from_numpy(np.linspace(0.0, 1.0, 100))
for number in range(6):
    expected = table.__wrapped__(number).at(np.linspace(0.0, 1.0, 100))
    assert np.allclose(replayed(number, lanes), expected)
"""


def test_a_table_dropped_while_recorded_is_freed_later(run_python: Callable) -> None:
    """A bounded cache drops its oldest table at a lookup: the seventeenth photon counter aborted the process."""
    finished = run_python(DROPPED)
    assert finished.returncode == 0, finished.stderr


def test_a_function_with_new_tables_at_each_call_is_not_recorded() -> None:
    made = itertools.count()
    replay = gate.exclusive(Replay(lambda x: (LookupTable(np.full(4, next(made))).at(x),), list, captured=()))
    lanes = transfer.from_numpy(np.linspace(0.0, 1.0, 100))
    assert replay(lanes)[0].numpy()[0] < replay(lanes)[0].numpy()[0]


def test_what_owners_leave_is_freed_as_the_gate_is_left() -> None:
    """A world that goes while another thread is behind the gate stays until that one has left."""

    class Thing:
        pass

    thing, owner = Thing(), Thing()
    alive = weakref.ref(thing)
    arrays.retire_with(owner, thing, then=gate.retire)
    del thing
    inside, goes_on = threading.Event(), threading.Event()

    @gate.exclusive
    def trace() -> bool:
        inside.set()
        goes_on.wait()
        return alive() is not None

    with ThreadPoolExecutor(1) as pool:
        traced = pool.submit(trace)
        inside.wait()
        del owner
        gc.collect()
        goes_on.set()
        assert traced.result()
    assert alive() is None
    assert not arrays.retired


def test_a_world_out_of_scope_is_freed_at_once() -> None:
    """Its scene is its own: worlds of others are kept (`kept_scenes`). What earlier tests left goes as it is built."""
    gc.collect()
    simulator = Simulator(dataclasses.replace(load_scene("range")), load_sensor("table1-apd", overrides=COARSE))
    assert not arrays.retired
    scene = simulator.world.scene
    before = len(gc.get_referrers(scene))
    del simulator
    gc.collect()
    assert len(gc.get_referrers(scene)) < before
    assert not arrays.retired
