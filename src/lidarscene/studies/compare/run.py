"""Comparison of sensors, simulated: a scene and sensors in; what each made of it, also under other light, out.

The only part of a comparison that traces. The scene is compiled once for each wavelength, and all sensors have the
same seed and place, so that differences come from the sensors.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...detection.outcomes import Outcome
from ...kernel.world.build import World
from ...maths.arrays import Numbers
from ...maths.pose import Pose
from ...outputs.report import OUTCOME_TEXT
from ...rendering.options import DEFAULT_CHUNK
from ...rendering.simulator import Simulator, Summary
from ...scene.scene import Scene
from ...sensor.model import Sensor
from ..ranging.plane import Target, equal_range_illuminance_klux
from .data import Observation, Surfaces
from .numbers import Rate, range_errors, rate

Named = tuple[str, Sensor]

_TRIPPED = (Outcome.KEPT, Outcome.OUT_OF_WINDOW, Outcome.HIDDEN)
_HALVINGS = 14  # of a crossing's bracket: two decades to 0.03 %
_PULSES_AT_ONCE = 2**18


class Bench:
    """A scene and a way to observe it: same seed and place for any sensor and any illuminance."""

    def __init__(self, scene: Scene, *, seed: int = 0, pose: Pose | None = None, chunk: int = DEFAULT_CHUNK) -> None:
        """``pose`` is where the sensors stand, without their mountings; the scene's own if None."""
        self.scene, self.seed, self.pose, self.chunk = scene, seed, pose, chunk
        self._worlds: dict[float, World] = {}

    def observe(self, name: str, sensor: Sensor, *, illuminance_klux: float | None = None) -> Observation:
        """One frame; the scene's own illuminance if None."""
        scene = self.scene
        if illuminance_klux is not None:
            scene = replace(scene, sun=replace(scene.sun, illuminance_klux=illuminance_klux))
        wavelength_m = sensor.laser.wavelength_m
        simulator = Simulator(scene, sensor, world=self._worlds.get(wavelength_m), pose=self.pose)
        self._worlds[wavelength_m] = simulator.world
        collector, summary = _Seen(), Summary()
        cloud = simulator.render(seed=self.seed, chunk=self.chunk, points=collector, summary=summary)
        losses = {text: int(summary.outcomes[outcome]) for outcome, text in OUTCOME_TEXT.items() if outcome != Outcome.NO_SURFACE}
        return Observation(
            name=name, cloud=cloud, pulse=collector.pulse(), surfaces=collector.surfaces(), pulses_fired=summary.beams, losses=losses
        )


class _Seen:
    """An observer of points: gathers what it is told."""

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
        """Every pulse that met a surface."""

        def column(name: str) -> Numbers:
            return np.concatenate(
                [np.zeros(0, np.int32 if name in _WHOLE else np.float32), *(chunk[name] for chunk in self._chunks)]
            )

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


_WHOLE = ("pulse", "outcome", "body", "class_id")


def fires_alike(first: Sensor, second: Sensor) -> bool:
    """Whether two sensors fire the same pulses.

    Number, times, starts, directions, pointing jitter and mounting must be equal.
    """
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
        rays = [(*scanner.direction(pulse), scanner.time_s(pulse), scanner.offset_m(pulse) or (0.0, 0.0, 0.0)) for scanner in (a, b)]
        if not all(
            np.array_equal(np.asarray(x), np.asarray(y)) for x, y in zip(_flat(rays[0]), _flat(rays[1]), strict=True)
        ):
            return False
    return True


def _flat(values: tuple[Any, ...]) -> list[Any]:
    return [*values[:-1], *values[-1]]


def with_beams_of(first: Sensor, sensor: Sensor) -> Sensor:
    """The other sensor with the first one's scanner and mounting."""
    return replace(sensor, scanner=first.scanner, mounting=first.mounting)


@dataclass(frozen=True, slots=True, kw_only=True)
class Lit:
    """One sensor under one illuminance."""

    illuminance_klux: float
    rate: Rate
    false_alarms: int
    sigma_m: float | None

    @classmethod
    def from_observation(cls, observation: Observation, illuminance_klux: float) -> Lit:
        """The numbers of an observation."""
        errors = range_errors(observation)
        return cls(
            illuminance_klux=illuminance_klux,
            rate=rate(observation.rated_surfaces),
            false_alarms=observation.false_alarms,
            sigma_m=errors[0].sigma_m if errors else None,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Crossing:
    """Illuminance at which two sensors are expected to find equally many surfaces; ``ahead_below`` finds more below."""

    illuminance_klux: float
    expected: float
    ahead_below: str
    ahead_above: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """Sensors over illuminance.

    courses    by sensor, in order of illuminance
    crossings  of the first sensor with each other
    on_plane_klux  illuminance of equal maximum range on Table 1's plane; None if outside the sweep
    """

    illuminances_klux: tuple[float, ...]
    courses: dict[str, list[Lit]]
    crossings: dict[str, list[Crossing]]
    on_plane_klux: dict[str, float | None]


def sweep(
    bench: Bench,
    sensors: Sequence[Named],
    illuminances_klux: Sequence[float],
    *,
    progress: Callable[[int], object] = lambda done: None,
) -> Sweep:
    """Every sensor under every illuminance (rising, above 0), and where the others cross the first.

    told  how many frames are rendered, before crossings are looked for
    """
    courses: dict[str, list[Lit]] = {name: [] for name, _ in sensors}
    for rendered, ((name, s), lux) in enumerate(itertools.product(sensors, illuminances_klux), start=1):
        courses[name].append(Lit.from_observation(bench.observe(name, s, illuminance_klux=lux), lux))
        progress(rendered)
    first, other_sensors = sensors[0], sensors[1:]
    crossings = {other_sensor[0]: _crossings(bench, first, other_sensor, courses) for other_sensor in other_sensors}
    plane = {name: _on_plane(first[1], s, illuminances_klux) for name, s in other_sensors}
    return Sweep(illuminances_klux=tuple(illuminances_klux), courses=courses, crossings=crossings, on_plane_klux=plane)


def _crossings(bench: Bench, a: Named, b: Named, courses: Mapping[str, Sequence[Lit]]) -> list[Crossing]:
    """Crossings between two steps, by bisection in log illuminance.

    They use expected rates, the mean P_d, which have no noise of draws.
    """

    def expected(named_sensor: Named, lux: float) -> float:
        return _expected(Lit.from_observation(bench.observe(*named_sensor, illuminance_klux=lux), lux))

    crossings = []
    steps = list(zip(courses[a[0]], courses[b[0]], strict=True))
    for (low_a, low_b), (high_a, high_b) in itertools.pairwise(steps):
        at_low, at_high = _expected(low_a) - _expected(low_b), _expected(high_a) - _expected(high_b)
        if at_low * at_high >= 0.0:
            continue
        low, high = low_a.illuminance_klux, high_a.illuminance_klux
        for _ in range(_HALVINGS):
            middle = math.sqrt(low * high)
            if (expected(a, middle) - expected(b, middle)) * at_low > 0.0:
                low = middle
            else:
                high = middle
        lux = math.sqrt(low * high)
        names = (a[0], b[0]) if at_low > 0.0 else (b[0], a[0])
        crossings.append(
            Crossing(illuminance_klux=lux, expected=expected(a, lux), ahead_below=names[0], ahead_above=names[1])
        )
    return crossings


def _expected(lit: Lit) -> float:
    return lit.rate.expected or 0.0


def _on_plane(first: Sensor, second: Sensor, illuminances_klux: Sequence[float]) -> float | None:
    try:
        return equal_range_illuminance_klux(
            first, second, Target(), low_klux=min(illuminances_klux), high_klux=max(illuminances_klux)
        )
    except ValueError:
        return None
