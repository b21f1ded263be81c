"""Receivers against the plain comparator: points per second of each, from the same beams on the same scene."""

from pathlib import Path

import clock
import numpy as np
from table import Row, Section, verdict

from lidarscene import load_scene, load_sensor
from lidarscene.rendering.simulator import Simulator
from lidarscene.studies.compare.bench import with_beams_of

PLAIN = "table1-apd"
RECEIVERS = {
    "Gaussian response": ("receiver.response='gaussian'",),
    "single pole": ("receiver.response='single_pole'",),
    "constant fraction": ("tdc.timing='constant_fraction'",),
    "peak": ("tdc.timing='peak'",),
    "matched filter": ("tdc.timing='matched_filter'",),
    "peak of the strongest": ("tdc.timing='peak'", "tdc.keep='strongest'"),
}
HISTOGRAM = "histogram (os1-128)"
LEAST_RESPONSE, LEAST_HISTOGRAM = 0.9, 0.5

TEXT = """Points per second of frames that end at the first surface, over those of `table1-apd`, in the same round.
The histogram is that of `os1-128` with the beams of `table1-apd`. `peak of the strongest` looks for all peaks of the
waveform, as all that ranks pulses does."""


def measure(scene_file: Path, *, step_deg: float, rounds: int) -> Section:
    """The section of this file."""
    steps = [f"scanner.{axis}_step_deg={step_deg}" for axis in ("azimuth", "elevation")]
    scene, plain = load_scene(scene_file), load_sensor(PLAIN, overrides=steps)
    sensors = {PLAIN: plain}
    sensors |= {name: load_sensor(PLAIN, overrides=[*steps, *changes]) for name, changes in RECEIVERS.items()}
    sensors[HISTOGRAM] = with_beams_of(plain, load_sensor("os1-128"))
    worlds = {}
    simulators = {}
    for name, sensor in sensors.items():
        wavelength_m = sensor.laser.wavelength_m
        simulators[name] = Simulator(scene, sensor, world=worlds.get(wavelength_m), interactions=0)
        worlds[wavelength_m] = simulators[name].world
    points = {name: len(simulator.render()) for name, simulator in simulators.items()}
    seconds = clock.in_turns({name: simulator.render for name, simulator in simulators.items()}, rounds=rounds)
    rows = []
    for name in list(sensors)[1:]:
        rate = points[name] / seconds[name]
        share = rate / (points[PLAIN] / seconds[PLAIN])
        least = LEAST_HISTOGRAM if name == HISTOGRAM else LEAST_RESPONSE
        note = f"{points[name]:,} points, {float(np.median(rate)) / 1e6:.2f} million a second"
        goal = verdict(f"at least {least:g}", np.median(share) >= least)
        spread = f"{share.min():.2f} to {share.max():.2f}"
        rows.append(Row(f"{name} / {PLAIN}", f"{np.median(share):.2f}", spread, note, goal))
    return Section("Receivers", TEXT, rows)
