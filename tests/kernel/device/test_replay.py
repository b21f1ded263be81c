"""Stages that are launched again rather than written down again: the same answers, bit by bit."""

import dataclasses
import gc
import sys
import weakref
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from helpers import drops, launches
from helpers.clouds import assert_same_columns
from helpers.panes import MATERIALS, pane
from helpers.run_seed import chosen
from helpers.traffic import traffic

from lidarscene import load_scene, load_sensor
from lidarscene.errors import InputError
from lidarscene.kernel.device import replay, transfer
from lidarscene.kernel.world.mitsuba_world import World
from lidarscene.maths.arrays import is_drjit
from lidarscene.maths.pose import Pose
from lidarscene.rendering.simulator import Simulator
from lidarscene.rendering.stages import Chain
from lidarscene.scene.scene import Air, Body
from lidarscene.scene.weather import Weather

pytestmark = pytest.mark.usefixtures("mi")

SCENES = Path(__file__).parents[3] / "scenes"
COARSE = ("scanner.azimuth_step_deg=1.5", "scanner.elevation_step_deg=1")
ADC = ("sampler.type='adc'", "sampler.rate_mhz=800", "sampler.bits=10", "sampler.full_scale=1e-4")
CASES = {
    "on the move": ("traffic", "table1-apd", ()),
    "several rays on the move": ("traffic", "table1-apd", (), {"rays": 3, "interactions": 0}),
    "glass": ("glass", "table1-apd", ()),
    "several rays": ("glass", "table1-apd", ("tdc.stops=2",), {"rays": 2}),
    "leaves": ("foliage", "table1-apd", ()),
    "drops": ("rain", "biaxial-905", ()),
    "fog": ("fog", "table1-sipm", ("tdc.stops=3", "tdc.keep='strongest'")),
    "other lidars": ("interference", "table1-apd", ("tdc.stops=2",)),
    "both edges of a table of cells": (
        "retro",
        "table1-sipm",
        ("tdc.edges='both'", "detector.statistics='time_domain'"),
    ),
    "histograms": ("car", "os1-128", ()),
    "jitter and ADC": ("car", "table1-apd", (*ADC, "scanner.jitter_mrad=1.0")),
    "rays of the background": ("car", "table1-apd", (), {"background_rays": 4, "interactions": 0}),
}
"""Those of one scene follow each other."""


def with_pane(scene):
    """The scene with a pane before the sensor that drives along."""
    glass = pane(6.0, 30.0)
    moving = dataclasses.replace(glass, motion=dataclasses.replace(scene.ego, start=glass.pose))
    materials = {**scene.materials, **{material.name: material for material in MATERIALS}}
    return dataclasses.replace(scene, bodies=(*scene.bodies, moving), materials=materials)


@lru_cache(maxsize=1)
def compiled_scene(name):
    """A scene and its world, which is kept for the next case."""
    scene = with_pane(traffic()) if name == "traffic" else load_scene(SCENES / f"{name}.toml")
    # In clear air: to tabulate the light of fog or rain takes longer than to compile the world.
    return scene, Simulator(dataclasses.replace(scene, air=Air()), load_sensor("table1-apd")).world


@pytest.fixture(autouse=True, scope="module")
def _no_world_stays():
    yield
    compiled_scene.cache_clear()


def frames(simulator, **chunks):
    """Other seeds, places and numbers of the frame; the last in chunks."""
    moved = simulator.pose @ Pose.from_degrees(position_m=(0.4, 0.3, 0.1), yaw_deg=3.0)
    for seed, arguments in enumerate(({}, {"pose": moved, "number": 3}, {"coordinates": "sensor", **chunks})):
        yield simulator.render(seed=seed, **arguments)


@pytest.mark.parametrize("case", chosen(2, list(CASES)))
def test_frames_are_those_of_stages_that_python_writes_down_and_compile_nothing(case, monkeypatch):
    """Frames of one simulator, the last in chunks, against one that does without either. No tolerance: they are the
    same.

    Dr.Jit records once more where a number of lanes happens to be that of some array, as in these small scenes; it then
    launches the kernels that it has.
    """
    scene_name, sensor_name, overrides, *options = CASES[case]
    drops.as_bright_as_their_faces(monkeypatch)
    scene, world = compiled_scene(scene_name)
    coarse = ("scanner.columns_per_turn=64",) if sensor_name == "os1-128" else COARSE
    sensor = load_sensor(sensor_name, overrides=[*coarse, *overrides])
    how = dict(*options)
    simulator = Simulator(scene, sensor, world=world, **how)
    rendered = frames(simulator, chunk=700)
    with launches.launched() as before:
        clouds = [next(rendered)]
    recordings = simulator._chain.recordings
    with launches.launched(after=before) as ran:
        clouds += rendered
    assert recordings
    later = simulator._chain.recordings
    assert all(
        0 < earlier_count <= count <= earlier_count + 2 for count, earlier_count in zip(later, recordings, strict=True)
    ), later
    assert len(ran) > 8
    monkeypatch.setattr(Chain, "repeats", False)
    plain = Simulator(scene, sensor, world=world, **how)
    for replayed, by_python in zip(clouds, frames(plain), strict=True):
        assert len(replayed) > 100
        assert_same_columns(replayed, by_python)
    assert not plain._chain.recordings


@pytest.mark.parametrize(
    ("name", "options"),
    chosen(1, [("vlp-16", {"vectors": True}), ("table1-apd", {"vectors": True, "rays": 2, "interactions": 0})]),
)
def test_no_option_loses_a_recording(name, options):
    """Frames of other numbers of lanes, in a scene in which nothing moves; one recording of each variant of the stages.

    Velocities that are zero everywhere had the length that they were recorded with, and each frame was written down.
    """
    scene, world = compiled_scene("glass")
    overrides = () if name == "vlp-16" else COARSE
    simulator = Simulator(scene, load_sensor(name, overrides=overrides), world=world, **options)
    for number, chunk in enumerate((2**20, 3000, 2000)):
        cloud = simulator.render(seed=number, chunk=chunk)
        assert not cloud.velocity_x_m_s.any()
        assert cloud.normal_x.any()
    assert set(simulator._chain.recordings) == {1}


def test_sensors_that_alternate_record_nothing_after_their_first_frames(monkeypatch):
    """Sensors alternate as on a rig, two of four kinds of receivers, on the move, in rain, with vectors or the last of
    two returns.
    """
    drops.as_bright_as_their_faces(monkeypatch)
    scene, world = compiled_scene("traffic")
    rain = dataclasses.replace(scene, air=Air(weather=Weather(rain_mm_h=5.0)))
    sensors = {
        "os1-128": (rain, {"vectors": True}, ["scanner.columns_per_turn=64"]),
        "vlp-16": (scene, {"vectors": True}, ["tdc.stops=2", "tdc.keep='last'"]),
        "table1-sipm": (scene, {"vectors": True}, [*COARSE, "detector.statistics='time_domain'"]),
        "table1-apd": (rain, {"interactions": 0}, COARSE),
    }
    simulators = [
        Simulator(air, load_sensor(name, overrides=list(overrides)), world=world, **options)
        for name, (air, options, overrides) in chosen(2, [*sensors.items()])
    ]
    recordings = []
    for number in range(2):
        clouds = [simulator.render(number=number, seed=number) for simulator in simulators]
        assert min(map(len, clouds)) > 300
        recordings.append([simulator._chain.recordings for simulator in simulators])
    assert recordings[0] == recordings[1]
    assert all(min(counts) > 0 for counts in recordings[0]), recordings[0]


def test_only_what_is_wanted_comes_out():
    import drjit as dr
    import mitsuba as mi

    from lidarscene.kernel.device.replay import LEFT_OUT, Replay

    @dataclasses.dataclass(frozen=True)
    class Pair:
        first: object
        second: object
        name: str

    held = (mi.Float([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]),)
    calls = []

    def function(x, place):
        calls.append(dr.width(x))
        return Pair(dr.gather(mi.Float, held[0], mi.UInt32(x)) + place[0], x * 2.0, "pair")

    replay = Replay(function, lambda pair: [pair.first], captured=held)
    for call, size in enumerate((3, 3, 5, 2)):
        x = transfer.from_numpy(np.arange(size) % 3)
        pair = replay(x, (dr.opaque(mi.Float, float(call)),))
        np.testing.assert_array_equal(pair.first.numpy(), np.arange(size) % 3 + 1.0 + call)
        assert pair.name == "pair"
        assert pair.second is LEFT_OUT
    assert len(calls) == replay.recordings <= 2


def test_what_cannot_be_recorded_is_called():
    """An array that it hides; and numbers that are all the same, of which Dr.Jit keeps the first length."""
    import drjit as dr
    import mitsuba as mi

    from lidarscene.kernel.device.replay import Replay

    hidden = dr.opaque(mi.Float, 2.0)
    hiding = Replay(lambda x: (x * hidden,), list, captured=())
    even = Replay(lambda x: (dr.full(mi.Float, 7.0, dr.width(x)),), list, captured=())
    for size in (9, 4, 5):
        x = transfer.from_numpy(np.arange(size))
        np.testing.assert_array_equal(hiding(x)[0].numpy(), 2.0 * np.arange(size))
        np.testing.assert_array_equal(even(x)[0].numpy(), np.full(size, 7.0))
    assert hiding.recordings == even.recordings == 0


@pytest.mark.parametrize("error", [KeyboardInterrupt, InputError])
def test_what_the_function_raises_comes_out(error):
    """Ctrl-C above all; and the next call is recorded as if nothing had been."""
    import mitsuba as mi

    from lidarscene.kernel.device.replay import Replay

    errors = [error("of its own")]

    def function(x):
        if errors:
            raise errors.pop()
        return (mi.Float(x) + 1.0,)

    replay = Replay(function, list, captured=())
    with pytest.raises(error, match="of its own"):
        replay(transfer.from_numpy(np.arange(5)))
    for size in (5, 7):
        np.testing.assert_array_equal(replay(transfer.from_numpy(np.arange(size)))[0].numpy(), np.arange(size) + 1.0)
    assert replay.recordings >= 1


def test_tables_that_are_uploaded_while_it_is_recorded():
    """They are not among what it is handed: it is recorded once more. Tables of another function change nothing."""
    import mitsuba as mi

    from lidarscene.kernel.device.replay import Replay
    from lidarscene.maths.arrays import LookupTable

    table = LookupTable(np.linspace(0.0, 1.0, 11) ** 2)
    replay = Replay(lambda x: (table.at(mi.Float(x)),), list, captured=())
    first_count = 0
    for size in (5, 5, 8, 3):
        x = np.linspace(0.0, 1.0, size)
        expected = np.interp(x, np.linspace(0.0, 1.0, 11), table.values)
        np.testing.assert_allclose(replay(transfer.from_numpy(x))[0].numpy(), expected, atol=1e-6)
        first_count = first_count or replay.recordings
        other = LookupTable(np.linspace(0.0, 1.0, 40 + size))
        others = Replay(lambda x, other=other: (other.at(mi.Float(x)) + table.at(x),), list, captured=())
        assert others(transfer.from_numpy(x))[0].numpy().shape == (size,)
        assert 1 <= others.recordings <= 2
    assert 1 <= replay.recordings == first_count <= 2


def test_no_array_is_looked_for_in_the_bodies_of_a_scene(monkeypatch):
    """Rationale: going through all parts and poses of a town took 0.3 s."""
    seen = set()
    monkeypatch.setattr(replay, "is_drjit", lambda value: seen.add(type(value)) or is_drjit(value))
    Simulator(load_scene(SCENES / "glass.toml"), load_sensor("table1-apd", overrides=list(COARSE))).render()
    assert World in seen
    assert Body not in seen


def test_a_simulator_goes_when_nobody_holds_it():
    """A world is large: it must not wait for the garbage collector. Of another scene than `kept_scenes` keeps."""
    scene = dataclasses.replace(load_scene(SCENES / "glass.toml"))
    simulator = Simulator(scene, load_sensor("table1-apd", overrides=list(COARSE)))
    for seed in range(2):
        simulator.render(seed=seed)
    reference, world = weakref.ref(simulator), simulator.world
    gc.collect()
    gc.disable()
    del simulator
    gc.enable()
    assert reference() is None
    assert sys.getrefcount(world) == 2  # our name, and what asks
