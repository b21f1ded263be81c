"""Many rays to a pulse against one: the rate of rays, what tracing them costs, and what the waveform stage takes."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import chain
import clock
import numpy as np
from table import Row, Section, verdict

from lidarscene import load_scene, load_sensor
from lidarscene.detection import receiver
from lidarscene.kernel.device import transfer
from lidarscene.kernel.device.profile import kernel_history
from lidarscene.kernel.rays.trace import trace
from lidarscene.light import beams, echoes, pulse_train
from lidarscene.light.footprint import footprint, spread
from lidarscene.rendering.simulator import Simulator
from lidarscene.rendering.stages import ambient_of
from lidarscene.rendering.tiles import PACKET, Order, Tiling

LEAST_RATE = 1.0
MOST_OF_A_RAY = 0.9
MOST_OF_THE_TRACE = 0.25

SAMPLERS = {
    "TDC": (),
    "multi-level TDC": ("sampler.type='multi_level_tdc'", "sampler.levels=[2, 4, 8]"),
    "ADC": ("sampler.type='adc'", "sampler.rate_mhz=1000", "sampler.bits=16", "sampler.full_scale=1e-3"),
    "TDC that keeps 16 returns": ("tdc.keep='all'",),
}

TEXT = """Frames of `table1-apd` that end at the first surface. The first row has as many rays in all: one to each
pulse, and many to each of fewer pulses; 1 means that a ray of many costs what a single one does. The other rows are
the device's time, by its own clock, for the frame of fewer pulses. The trace is beams, hits and the light of each ray;
the waveform is the stage that puts the rays of a pulse together, finds the crossings and measures them."""


def measure(scene_file: Path, *, single_deg: float, many_deg: float, rays: int, rounds: int) -> Section:
    """``single_deg`` and ``many_deg``: steps of the raster with one ray and with ``rays``."""
    scene = load_scene(scene_file)
    single = Simulator(scene, _sensor(single_deg), interactions=0)
    many = {
        name: Simulator(scene, _sensor(many_deg, *changes), world=single.world, rays=rays, interactions=0)
        for name, changes in SAMPLERS.items()
    }
    one_ray = Simulator(scene, _sensor(many_deg), world=single.world, interactions=0)
    rows = [_rate_row(single, many["TDC"], rounds)]
    traces, waveforms = _device_seconds({"one": one_ray, **many}, rounds)
    cost = traces["TDC"] / traces["one"]
    most = MOST_OF_A_RAY * rays
    rows.append(
        Row(
            f"trace of {rays} rays to each pulse / of one",
            f"{np.median(cost):.1f}",
            _spread(cost, ".1f"),
            f"{one_ray.sensor.scanner.pulses:,} pulses",
            verdict(f"at most {most:g}", np.median(cost) <= most),
        )
    )
    for name in SAMPLERS:
        share = waveforms[name] / traces[name]
        goal_text = verdict(f"at most {MOST_OF_THE_TRACE:g}", np.median(share) <= MOST_OF_THE_TRACE)
        rows.append(Row(f"waveform / trace, {name}", f"{np.median(share):.2f}", _spread(share, ".2f"), "", goal_text))
    return Section("Many rays to a pulse", TEXT, rows)


def _rate_row(single: Simulator, many: Simulator, rounds: int) -> Row:
    counts = {"one": single.sensor.scanner.pulses, "many": many.sensor.scanner.pulses * many.trace.rays}
    seconds = clock.in_turns({"one": single.render, "many": many.render}, rounds=rounds)
    rates = (counts["many"] / seconds["many"]) / (counts["one"] / seconds["one"])
    note = f"{counts['many'] / float(np.median(seconds['many'])) / 1e6:.2f} million rays a second"
    goal = verdict(f"at least {LEAST_RATE:g}", np.median(rates) >= LEAST_RATE)
    return Row(
        f"rate of {many.trace.rays} rays a pulse / one", f"{np.median(rates):.2f}", _spread(rates, ".2f"), note, goal
    )


def _spread(values: np.ndarray, form: str) -> str:
    return f"{values.min():{form}} to {values.max():{form}}"


def _sensor(step_deg: float, *changes: str) -> Any:
    steps = [f"scanner.{axis}_step_deg={step_deg}" for axis in ("azimuth", "elevation")]
    return load_sensor("table1-apd", overrides=[*steps, *changes])


def _device_seconds(simulators: dict[str, Simulator], rounds: int) -> tuple[clock.Seconds, clock.Seconds]:
    """Seconds of the trace and of the waveform of each simulator's frame in each round, in turns."""
    tasks = {name: _frame(simulator) for name, simulator in simulators.items()}
    measured: dict[str, list[tuple[float, float]]] = {name: [] for name in tasks}
    for number in range(2 + rounds):
        for name, task in tasks.items():
            seconds = task()
            if number >= 2:  # the first ones compile
                measured[name].append(seconds)
    parts = {name: np.array(values) for name, values in measured.items()}
    return (
        {name: values[:, 0] for name, values in parts.items()},
        {name: values[:, 1] for name, values in parts.items()},
    )


def _frame(simulator: Simulator) -> Callable[[], tuple[float, float]]:
    """A frame on the device, its points left there."""
    sensor = transfer.opaque(simulator.sensor)
    ambient = transfer.opaque(ambient_of(simulator.scene, simulator.sensor))
    shape = transfer.opaque(footprint(simulator.sensor.laser, simulator.trace.rays))
    sun = transfer.opaque(tuple(float(x) for x in simulator.scene.sun.direction))
    origin = transfer.opaque(chain.origin(simulator))
    rotation = transfer.opaque(tuple(float(x) for x in simulator.pose.rotation.ravel()))
    seed, count, pulses = transfer.opaque_uint32(0), simulator.trace.rays, simulator.sensor.scanner.pulses
    tiling = Tiling.from_scanner(simulator.sensor.scanner) if count < PACKET else None
    order = None if tiling is None else Order.from_pulses(tiling.order(pulses))

    def task() -> tuple[float, float]:
        with kernel_history() as history:
            pulse = transfer.counter(0, pulses) if order is None else order.on_device(0)
            of_ray, ray = (pulse, None) if count == 1 else transfer.repeat_lanes(pulse, count)
            axes = beams.fire(sensor, pulse=of_ray, origin_m=origin, rotation=rotation)
            rays = axes if ray is None else spread(axes, shape, ray=ray, rotation=rotation)
            paths = trace(simulator.world, rays, sun=sun, interactions=0)
            light = echoes.gather_background([echoes.receive(rays, path, sensor, ambient) for path in paths])
            for received, hits in zip(light, paths, strict=True):
                transfer.start(
                    [
                        received.has_surface,
                        received.range_m,
                        received.peak_power_w,
                        received.background_power_w,
                        hits.face,
                    ]
                )
            history.take()
            traced_s = history.device_s
            joined = pulse_train.join_echoes(light, rays, rays=count)
            detection = receiver.detect(joined, sensor, seed=seed, pulse=pulse)
            outputs = [
                array
                for stop in detection.stops
                for array in (
                    stop.reported,
                    stop.status,
                    stop.range_m,
                    stop.intensity,
                    stop.snr,
                    stop.detection_probability,
                    stop.source,
                    stop.true_range_m,
                )
            ]
            transfer.start(
                [detection.outcome, detection.snr, detection.detection_probability, detection.ambient, *outputs]
            )
            history.take()
            return traced_s, history.device_s - traced_s

    return task
