"""Simulated observations for a comparison: one scene, traced with each sensor.

The scene is compiled once for each wavelength. All sensors have the same seed and place, so that differences come from
the sensors.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...detection.outcomes import Outcome
from ...kernel.world.mitsuba_world import World
from ...maths.arrays import Numbers
from ...outputs.run_report import OUTCOME_TEXT
from ...rendering.render_options import FrameOptions
from ...rendering.simulator import Simulator, Summary
from ...rendering.stages import TracedPaths
from ...rendering.surroundings import warn_of_light
from ...scene.scene import Scene
from ...sensor.sensor_model import Sensor
from .observations import Observation, Surfaces

NamedSensor = tuple[str, Sensor]

_TRIPPED = (Outcome.KEPT, Outcome.OUT_OF_WINDOW, Outcome.HIDDEN)
_PULSES_AT_ONCE = 2**18  # compared together, which bounds the memory
_KEPT_PATHS = 8
"""Frames whose paths are kept: of the sensors of a design, and of those that a search goes back and forth between."""


class Bench:
    """A scene in which sensors are simulated one after the other, with the same seed and at the same place."""

    def __init__(self, scene: Scene, frame: FrameOptions | None = None, *, keeps_paths: bool = False) -> None:
        """Place the bench at the pose of ``frame``, to which each sensor adds its mounting.

        Args:
            keeps_paths: whether the rays of sensors that differ in light and electronics alone are traced once
        """
        self.scene, self.frame, self._keeps_paths = scene, frame or FrameOptions(), keeps_paths
        self._worlds: dict[float, World] = {}
        warn_of_light(scene)
        self._paths: dict[bytes, TracedPaths] = {}

    def observe(self, name: str, sensor: Sensor, *, illuminance_klux: float | None = None) -> Observation:
        """Trace one frame with this sensor.

        Args:
            illuminance_klux: replaces that of the scene's sun; None keeps it

        Raises:
            BackendError: if Mitsuba has no back end that works on this machine
        """
        scene = self.scene
        if illuminance_klux is not None:
            scene = replace(scene, sun=replace(scene.sun, illuminance_klux=illuminance_klux))
        wavelength_m = sensor.laser.wavelength_m
        simulator = Simulator(scene, sensor, world=self._worlds.get(wavelength_m), pose=self.frame.pose)
        self._worlds[wavelength_m] = simulator.world
        rays = _ray_key(sensor) if self._keeps_paths else None
        if rays is not None:
            traced = self._paths.pop(rays, None) or TracedPaths()
            self._paths[rays] = traced  # the latest at the end
            if len(self._paths) > _KEPT_PATHS:
                del self._paths[next(iter(self._paths))]
            simulator.share_paths(traced)
        collector, summary = _PulseCollector(), Summary()
        cloud = simulator.render(self.frame, points=collector, summary=summary)
        losses = {
            text: int(summary.outcomes[outcome])
            for outcome, text in OUTCOME_TEXT.items()
            if outcome != Outcome.NO_SURFACE
        }
        return Observation(
            name=name,
            cloud=cloud,
            pulse=collector.pulse(),
            surfaces=collector.surfaces(),
            pulses_fired=summary.beams,
            losses=losses,
        )


class _PulseCollector:
    """Observer of a frame's points that collects pulse numbers and truth chunk by chunk."""

    def __init__(self) -> None:
        self._pulse: list[Numbers] = [np.zeros(0, np.uint32)]
        self._chunks: list[Mapping[str, Numbers]] = []

    def __call__(self, pulse: Numbers, columns: Mapping[str, Numbers]) -> None:
        self._pulse.append(pulse)
        if columns:
            self._chunks.append(columns)

    def pulse(self) -> Numbers:
        """(n,) pulse numbers of the cloud's points."""
        return np.concatenate(self._pulse).astype(np.int64)

    def surfaces(self) -> Surfaces:
        """Pulses of the frame that met a surface, whether or not they gave a point."""

        def column(name: str) -> Numbers:
            # A frame that met no surface has no chunks: an empty array keeps the column's type.
            empty = np.zeros(0, np.int32 if name in _INTEGER_COLUMNS else np.float32)
            return np.concatenate([empty, *(chunk[name] for chunk in self._chunks)])

        outcome = column("outcome")
        return Surfaces(
            pulse=column("pulse").astype(np.int64),
            detected=outcome == Outcome.KEPT,
            snr=column("snr"),
            true_range_m=column("true_range_m"),
            incidence_angle_rad=column("incidence_angle_rad"),
            reflectivity=column("reflectivity"),
            body=column("body"),
            class_id=column("class_id"),
            probability=column("detection_probability"),
            tripped=np.isin(outcome, _TRIPPED),
        )


def _ray_key(sensor: Sensor) -> bytes | None:
    """Bytes that are equal for sensors with the same rays; None if the rays depend on the light.

    All of scanner, mounting and laser count, apart from the pulse's power and length, and of the optics what rays know.
    """
    if sensor.optics.stray is not None:
        return None
    laser = replace(sensor.laser, peak_power_w=1.0, pulse_fwhm_s=1e-9)
    optics = sensor.optics.halo, sensor.housing_m, sensor.sweep_rad
    knows_lean = sensor.histogram is not None and sensor.histogram.column_range_sigmas is not None
    known = sensor.scanner, sensor.mounting, laser, optics, sensor.wear, knows_lean
    return hashlib.sha256(pickle.dumps(known)).digest()


_INTEGER_COLUMNS = ("pulse", "outcome", "body", "class_id")


def fires_alike(first: Sensor, second: Sensor) -> bool:
    """True if two sensors fire the same pulses: equal number, times, origins, directions, jitter and mounting."""
    a, b = first.scanner, second.scanner
    if (a.pulses, a.frame_s, a.jitter_rad) != (b.pulses, b.frame_s, b.jitter_rad):
        return False
    if not all(
        np.array_equal(getattr(first.mounting, part), getattr(second.mounting, part))
        for part in ("position_m", "rotation")
    ):
        return False
    for start in range(0, a.pulses, _PULSES_AT_ONCE):
        pulse = np.arange(start, min(start + _PULSES_AT_ONCE, a.pulses), dtype=np.uint32)
        rays = [
            (*scanner.direction(pulse), scanner.time_s(pulse), *(scanner.offset_m(pulse) or (0.0, 0.0, 0.0)))
            for scanner in (a, b)
        ]
        if not all(np.array_equal(np.asarray(x), np.asarray(y)) for x, y in zip(*rays, strict=True)):
            return False
    return True


def with_beams_of(first: Sensor, sensor: Sensor) -> Sensor:
    """Copy of ``sensor`` with the scanner and the mounting of ``first``."""
    return replace(sensor, scanner=first.scanner, mounting=first.mounting)
