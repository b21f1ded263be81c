"""Many rays to a pulse against one: the rate of rays, and what the waveform stage takes."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import chain
import clock
import numpy as np
from table import Row, Section

from lidarscene import api, beams, echoes, multi_echo, train
from lidarscene.footprint import footprint, spread
from lidarscene.kernel import device
from lidarscene.kernel.trace import trace
from lidarscene.simulate import Simulator, ambient_of

GOAL = 1.0

TEXT = """Frames of `table1-apd` with as many rays in all: one to each pulse, and many to each of fewer pulses. The rate
is that of rays, in the same round; 1 means that a ray of many costs what a single one does. The waveform is the stage
that puts the rays of a pulse together and finds the crossings: its share of the device's time for such a frame."""


def measure(scene_file: Path, *, single_deg: float, many_deg: float, rays: int, rounds: int) -> Section:
    """``single_deg`` and ``many_deg``: steps of the raster with one ray and with ``rays``."""
    scene = api.load_scene(scene_file)
    one = Simulator(scene, _sensor(single_deg), interactions=0)
    many = Simulator(scene, _sensor(many_deg), world=one.world, rays=rays, interactions=0)
    counts = {"one": one.sensor.scanner.pulses, "many": many.sensor.scanner.pulses * rays}
    seconds = clock.in_turns({"one": one.render, "many": many.render}, rounds=rounds)
    rates = (counts["many"] / seconds["many"]) / (counts["one"] / seconds["one"])
    median = float(np.median(rates))
    verdict = f"at least {GOAL:g}: {'met' if median >= GOAL else 'NOT met'}"
    parts = clock.in_turns({name: _up_to(many, name) for name in ("trace", "waveform")}, rounds=rounds)
    share = 1.0 - parts["trace"] / parts["waveform"]
    note = f"{counts['many'] / float(np.median(seconds['many'])) / 1e6:.2f} million rays a second"
    return Section(
        "Many rays to a pulse",
        TEXT,
        [
            Row(f"rate of {rays} rays a pulse / one", f"{median:.2f}", _spread(rates, ".2f"), note, verdict),
            Row(
                "share of the waveform",
                f"{np.median(share):.0%}",
                _spread(share, ".0%"),
                "of the device's time",
            ),
        ],
    )


def _spread(values: np.ndarray, form: str) -> str:
    return f"{values.min():{form}} to {values.max():{form}}"


def _sensor(step_deg: float) -> Any:
    return api.load_sensor(
        "table1-apd", overrides=[f"scanner.{axis}_step_deg={step_deg}" for axis in ("azimuth", "elevation")]
    )


def _up_to(simulator: Simulator, last: str) -> Callable[[], None]:
    """The device's work on a frame, up to the light of each ray or to the end."""
    sensor = device.opaque(simulator.sensor)
    ambient = device.opaque(ambient_of(simulator.scene, simulator.sensor))
    shape = device.opaque(footprint(simulator.sensor.laser, simulator.rays))
    sun = device.opaque(tuple(float(x) for x in simulator.scene.sun.direction))
    origin = device.opaque(chain.origin(simulator))
    rotation = device.opaque(tuple(float(x) for x in simulator.pose.rotation.ravel()))
    seed, count = device.opaque_uint32(0), simulator.rays

    def task() -> None:
        pulse = device.counter(0, simulator.sensor.scanner.pulses)
        of_ray, ray = device.repeated(pulse, count)
        axes = beams.fire(sensor, pulse=of_ray, origin_m=origin, rotation=rotation)
        rays = spread(axes, shape, ray=ray, rotation=rotation)
        paths = trace(simulator.world, rays, sun=sun)
        light = echoes.with_all_background([echoes.receive(rays, one, sensor, ambient) for one in paths])
        for one, hits in zip(light, paths, strict=True):
            device.start([one.found, one.range_m, one.peak_power_w, one.background_power_w, hits.face])
        if last == "waveform":
            whole = train.together(light, rays, sensor, ambient, rays=count, air=None, seed=seed, pulse=pulse)
            found = multi_echo.detect(whole, sensor, seed=seed, pulse=pulse)
            stops = [array for stop in found.stops for array in (stop.reported, stop.range_m, stop.intensity)]
            device.start([found.outcome, found.snr, *stops])
        device.wait()

    return task
