"""Catalogue sensors compared with recordings of real ones, by statistics that do not depend on the scene.

A recording of an Ouster has SIGNAL, NEAR_IR, reflectivity and range of each point, kept or lost. Four curves follow
from them (docs/sensors.md); `catalog/recorded` holds those of one frame of each sensor. For other sensors the scatter
at some ranges is known (`[[published.repeatability]]` with `recording = true`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from .. import catalog
from ..files.toml import FileModel, read_toml, validate
from ..maths.arrays import Numbers
from ..sensor.sensor_file import load_sensor, published_performance
from ..sensor.sensor_model import Sensor
from .published_values import repeatability, scatter_m
from .ranging.plane import Target, echoes_of_plane

SIGNAL_ERROR = 0.15
"""Largest mean deviation of the signal over the range, limited by the uncertainty of a recording's reflectivities."""

THRESHOLD_ERROR = 0.2
"""Largest deviation of the threshold and the highest noise: uncertainty of a recording's floor, steps of a photon."""

SCATTER_RATIO = 1.25
"""Largest ratio of two scatters at one signal, in either direction."""

ASSUMED_RATIO = 1.5
"""Largest ratio of two scatters if signal and light are not recorded, so that the target is assumed."""

PositiveNumbers = Annotated[tuple[Annotated[float, Field(gt=0)], ...], Field(min_length=1)]


class _Curves(FileModel):
    @model_validator(mode="after")
    def _check_lengths(self) -> _Curves:
        lengths = {key: len(getattr(self, key)) for key in type(self).model_fields}
        if len(set(lengths.values())) > 1:
            lengths_text = ", ".join(f"{key} {length}" for key, length in lengths.items())
            raise ValueError(f"lists must be equally long, got {lengths_text}")
        return self


class SignalFile(_Curves):
    """[signal]: photons of a white target times the square of its range, over the range."""

    range_m: PositiveNumbers
    white_m2: PositiveNumbers


class NoiseFile(_Curves):
    """[threshold], where half of the points are kept, and [noise], the median of the highest peak without a return."""

    near_ir: PositiveNumbers
    photons: PositiveNumbers


class ScatterFile(_Curves):
    """[scatter]: of the range on smooth surfaces, over the photons of the return."""

    signal: PositiveNumbers
    near_ir: PositiveNumbers
    sigma_mm: PositiveNumbers


class RecordedFile(FileModel):
    """Curves of a recording, in catalog/recorded."""

    recording: Annotated[str, Field(min_length=1)]
    settings: tuple[str, ...] = Field(default=(), description="the sensor's mode, as for --set")
    signal: SignalFile
    threshold: NoiseFile
    noise: NoiseFile
    scatter: ScatterFile


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedComparison:
    """Recorded and simulated value of one quantity.

    most  largest accepted ratio of the two, in either direction
    """

    sensor: str
    quantity: str
    condition: str
    recorded: float
    simulated: float | None
    most: float

    @property
    def ratio(self) -> float | None:
        """Simulated over recorded."""
        return None if self.simulated is None else self.simulated / self.recorded

    @property
    def held(self) -> bool:
        """True if the ratio is within bounds."""
        return self.ratio is not None and 1.0 / self.most <= self.ratio <= self.most


def recorded_curves(name: str) -> RecordedFile | None:
    """Read the curves of a recording of this catalogue sensor; None without one. Raises InputError."""
    path = catalog.folder("recorded") / f"{name}.toml"
    return read_recorded(path) if path.is_file() else None


def read_recorded(path: Path) -> RecordedFile:
    """Read a file of curves. Raises InputError."""
    return validate(RecordedFile, read_toml(path), str(path))


def compare(name: str) -> list[RecordedComparison]:
    """Compare a catalogue sensor with all that is recorded of it. Raises InputError."""
    curves = recorded_curves(name)
    rows = [] if curves is None else list(compare_curves(name, curves, load_sensor(name, overrides=curves.settings)))
    published = published_performance(name)
    if published is None:
        return rows
    for entry in published.repeatability:
        if entry.recording:
            scatter = repeatability(load_sensor(name), published, entry)
            rows.append(
                RecordedComparison(
                    sensor=name,
                    quantity="scatter, mm",
                    condition=f"{entry.at_m:g} m",
                    recorded=1e3 * entry.sigma_m,
                    simulated=None if scatter.simulated is None else 1e3 * scatter.simulated,
                    most=ASSUMED_RATIO,
                )
            )
    return rows


def compare_curves(name: str, curves: RecordedFile, sensor: Sensor) -> Iterator[RecordedComparison]:
    """Compare the four curves of a sensor that counts photons, in its recorded mode."""
    range_m = np.asarray(curves.signal.range_m)
    white = white_m2(sensor, range_m)
    error = np.log(white / np.asarray(curves.signal.white_m2))
    span = f"{range_m[0]:g} to {range_m[-1]:g} m"
    yield RecordedComparison(
        sensor=name,
        quantity="signal",
        condition=f"mean of {span}",
        recorded=1.0,
        simulated=float(np.exp(np.mean(error))),
        most=1.0 + SIGNAL_ERROR,
    )
    yield RecordedComparison(
        sensor=name,
        quantity="signal, spread",
        condition=f"over {span}",
        recorded=1.0,
        simulated=float(np.exp(np.mean(np.abs(error - np.mean(error))))),
        most=1.0 + SIGNAL_ERROR,
    )
    for near_ir, photons in zip(curves.threshold.near_ir, curves.threshold.photons, strict=True):
        point = sensor.working_point(background_w(sensor, near_ir))
        yield RecordedComparison(
            sensor=name,
            quantity="threshold, photons",
            condition=f"NEAR_IR {near_ir:g}",
            recorded=photons,
            simulated=float(np.ravel(sensor.threshold(point))[0]),
            most=1.0 + THRESHOLD_ERROR,
        )
    for near_ir, photons in zip(curves.noise.near_ir, curves.noise.photons, strict=True):
        yield RecordedComparison(
            sensor=name,
            quantity="highest noise, photons",
            condition=f"NEAR_IR {near_ir:g}",
            recorded=photons,
            simulated=highest_noise(sensor, near_ir),
            most=1.0 + THRESHOLD_ERROR,
        )
    scatter = curves.scatter
    for index, signal in enumerate(scatter.signal):
        yield RecordedComparison(
            sensor=name,
            quantity="scatter, mm",
            condition=f"SIGNAL {signal:g}",
            recorded=scatter.sigma_mm[index],
            simulated=scatter_mm(sensor, signal, scatter.near_ir[index]),
            most=SCATTER_RATIO,
        )


def white_m2(sensor: Sensor, range_m: Numbers) -> Numbers:
    """(n,) photons of a white target times the square of its range, m2."""
    reflectivity = 0.2  # scaled to white: an echo this weak does not saturate the detector
    light = echoes_of_plane(sensor, Target(reflectivity=reflectivity, illuminance_klux=0.0), range_m)
    photons = np.asarray(sensor.working_point(light.background_power_w).signal(light.peak_power_w))
    return photons * range_m * range_m / reflectivity


def background_w(sensor: Sensor, near_ir: float) -> Numbers:
    """(1,) background in W at which a point counts this NEAR_IR; 0 if the dark counts alone exceed it. By bisection."""
    low, high = 0.0, 1e-6
    for _ in range(60):
        middle = 0.5 * (low + high)
        rate, _ = sensor.background_counts(np.array([middle]))
        few = float(np.ravel(rate)[0]) * float(sensor.tdc.ambient_s) < near_ir
        low, high = (middle, high) if few else (low, middle)
    return np.array([low])


def highest_noise(sensor: Sensor, near_ir: float) -> float:
    """Median of the highest filter value in a window without an echo, in photons, whether it becomes a return or not.

    Crossings of a level are Poisson, so the median is the level that a window crosses ln 2 times in the mean.
    """
    assert sensor.histogram is not None
    sensor = replace(sensor, histogram=replace(sensor.histogram, lone_photons=0.0))
    point = sensor.working_point(background_w(sensor, near_ir))
    low, high = 0.0, 1e3
    for _ in range(50):
        middle = 0.5 * (low + high)
        rate = float(np.ravel(sensor.false_alarm_rate_hz(point, np.array([middle])))[0])
        often = rate * float(sensor.tdc.window_s) > math.log(2.0)
        low, high = (middle, high) if often else (low, middle)
    return low


def scatter_mm(sensor: Sensor, signal: float, near_ir: float) -> float | None:
    """Standard deviation of the reported range in mm at this number of photons; None if few echoes are found."""
    power = background_w(sensor, near_ir)
    light = echoes_of_plane(sensor, Target(illuminance_klux=100.0), 20.0 * np.ones(1))
    # The background power is proportional to the illuminance.
    klux = 100.0 * float(np.ravel(power / light.background_power_w)[0])
    noise = float(np.ravel(sensor.working_point(power).noise)[0])
    sigma_m = scatter_m(sensor, Target(illuminance_klux=klux), range_m=20.0, snr=signal / noise)
    return None if sigma_m is None else 1e3 * sigma_m


def as_dict(row: RecordedComparison) -> dict[str, Any]:
    """Fields for JSON."""
    keys = ("sensor", "quantity", "condition", "recorded", "simulated", "ratio", "most", "held")
    return {key: getattr(row, key) for key in keys}


def as_text(rows: Sequence[RecordedComparison]) -> str:
    """Text table of the comparisons, with a verdict."""
    heads = f"{'recorded':>9} {'simulated':>9} {'ratio':>6} {'at most':>7}"
    lines, before = [f"{'sensor':<10} {'quantity':<23} {'condition':<22} {heads}"], ""
    for row in rows:
        name, before = ("" if row.sensor == before else row.sensor), row.sensor
        simulated, ratio = ("none", "") if row.simulated is None else (f"{row.simulated:.3g}", f"{row.ratio:.2f}")
        lines.append(
            f"{name:<10} {row.quantity:<23} {row.condition:<22} {row.recorded:>9.3g} {simulated:>9} {ratio:>6} "
            f"{row.most:>7g}{'' if row.held else '  FAILED'}"
        )
    failed = sum(not row.held for row in rows)
    lines.append(f"{failed} of {len(rows)} failed" if failed else f"all {len(rows)} held")
    return "\n".join(lines)
