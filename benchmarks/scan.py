"""Patterns on the device: seconds for the directions of ten million pulses against those for tracing them.

Run alone: python benchmarks/scan.py [--pulses N]. Each scanner's directions, apertures and starts are computed for
N pulses, chunk by chunk as a frame is; tracing is the same and the two ray queries after them.
"""

import argparse
import dataclasses
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import clock
import numpy as np

from lidarscene import load_scene, load_sensor
from lidarscene.kernel.device import blocks, transfer
from lidarscene.kernel.rays.trace import trace
from lidarscene.light import beams
from lidarscene.rendering.simulator import Simulator

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))
GOAL = 0.2


def measure(scene_file: Path, *, pulses: int, rounds: int = 3) -> dict[str, tuple[float, float, float]]:
    """Figures by scanner: median, lowest and highest of (seconds of the pattern) / (seconds of tracing it).

    Tracing is what pattern and rays take together less the pattern alone, in the same round.
    """
    from helpers import scanners

    scene, sensor = load_scene(scene_file), load_sensor("table1-apd")
    world = Simulator(scene, sensor)
    place = tuple(float(x) for x in world.pose.position_m - world.world.centre_m)
    origin, turn = (transfer.opaque(place), transfer.opaque(tuple(float(x) for x in world.pose.rotation.ravel())))
    sun = transfer.opaque(tuple(float(x) for x in scene.sun.direction))
    seed = transfer.opaque_uint32(1)
    makers = {name: make() for name, make in scanners.ALL.items() if not name.startswith("flash_")}
    makers["mid40 with jitter"] = scanners.mid40(jitter_rad=1e-3)
    shares = {}
    for name, scanner in makers.items():
        equipped = transfer.opaque(dataclasses.replace(sensor, scanner=scanner))

        def run(traced: bool, equipped: Any = equipped) -> None:
            for first in range(0, pulses, blocks.LANES_PER_CHUNK):
                pulse = transfer.counter(first, min(blocks.LANES_PER_CHUNK, pulses - first))
                rays = beams.fire(equipped, pulse=pulse, origin_m=origin, rotation=turn, seed=seed)
                if traced:
                    hits, *_ = trace(world.world, rays, sun=sun)
                    transfer.start([hits.range_m, hits.backscatter_per_sr, hits.sun_scatter_per_sr, rays.aperture_m2])
                else:
                    transfer.start([*rays.origin_m, *rays.direction, rays.aperture_m2])
            transfer.wait()

        tasks: dict[str, Callable[[], Any]] = {"pattern": lambda: run(False), "both": lambda: run(True)}
        seconds = clock.in_turns(tasks, rounds=rounds, warm_up=1)
        ratio = seconds["pattern"] / (seconds["both"] - seconds["pattern"])
        shares[name] = float(np.median(ratio)), float(ratio.min()), float(ratio.max())
    return shares


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pulses", type=int, default=10_000_000)
    parser.add_argument("--scene", type=Path, default=ROOT / "scenes" / "car.toml")
    arguments = parser.parse_args()
    print(f"pattern over tracing, {arguments.pulses:,} pulses on {arguments.scene.name}; goal below {GOAL}")
    for scanner, (median, low, high) in measure(arguments.scene, pulses=arguments.pulses).items():
        print(f"  {scanner:<24} {median:6.3f}   ({low:.3f} to {high:.3f})")
