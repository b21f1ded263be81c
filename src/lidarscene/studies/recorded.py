"""Catalogue sensors compared with recordings of real ones, by statistics that do not depend on the scene.

A recording of an Ouster has SIGNAL, NEAR_IR, reflectivity and range of each point, kept or lost. Four curves follow
from them (docs/recorded.md). One of another maker has ranges and perhaps reflectivities: its beams, steps, scatter and
the least distance of two returns follow. `catalog/recorded` holds either for one recording of each sensor. For others
the scatter at some ranges is known (`[[published.repeatability]]` with `recording = true`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from .. import catalog
from ..detection.outcomes import Status
from ..detection.receiver import detect
from ..figures.report import text_table
from ..files.toml import FileModel, read_toml, validate
from ..light.echoes import EchoTrain, SubEchoes
from ..light.stray_light import Crosstalk, add_stray_light, channel_light
from ..maths.arrays import Numbers
from ..physics.constants import SPEED_OF_LIGHT_M_S
from ..physics.photon_counting.shared_shots import scatter_share
from ..sensor.sensor_file import load_sensor, published_performance
from ..sensor.sensor_model import Sensor
from .fit.scatter import COLUMN_STEP, PATCH
from .held import LIMITS, Held, held_table, verdict
from .published_values import repeatability, scatter_m
from .ranging.plane import Target, echoes_of_plane
from .twin.tuning import ASSUMED_KLUX

GLARE_STEPS = 20
"""Steps in which the strength and the reach of a glaring return are searched, each of 7.6 %."""

WEAK_PHOTONS = 200.0
"""Choice: photons of the returns beside a glaring one: surely found, and with a scatter of the range below a tenth of
the reach."""

SHOTS_OF_PAIRS = 20
"""Pulses with two echoes at each separation."""

TWO_RETURNS = ("tdc.stops=2", 'tdc.keep="strongest_and_last"')
"""The mode in which least separations were recorded, as for --set."""

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


class GlareFile(FileModel):
    """[glare]: where half of the pixels beside a strong return of their column are withheld."""

    photons: Annotated[float, Field(gt=0)] = Field(description="of that return, at its range")
    reach_m: Annotated[float, Field(gt=0)] = Field(description="from its range, if it has many more")


class ScatterByTargetFile(_Curves):
    """[scatter] of points: deviation of the range on targets of known reflectivity and range."""

    reflectivity: PositiveNumbers
    range_m: PositiveNumbers
    sigma_mm: PositiveNumbers


class RecordedPointsFile(FileModel):
    """Statistics of recorded points, in catalog/recorded."""

    recording: Annotated[str, Field(min_length=1)]
    elevation_deg: Annotated[tuple[float, ...], Field(min_length=1)] = Field(description="of each channel")
    azimuth_step_deg: Annotated[float, Field(gt=0)] = Field(description="between firings of a channel")
    range_step_mm: Annotated[float, Field(gt=0)] = Field(description="least significant bit of the range")
    least_separation_m: Annotated[float, Field(gt=0)] | None = Field(
        default=None, description="between two returns of a pulse, 1st percentile; None: single returns were recorded"
    )
    scatter: ScatterByTargetFile


class RecordedFile(FileModel):
    """Curves of a recording of a sensor that counts photons, in catalog/recorded."""

    recording: Annotated[str, Field(min_length=1)]
    settings: tuple[str, ...] = Field(default=(), description="the sensor's mode, as for --set")
    at_rest: bool = Field(
        default=False, description="scatter is that between two frames of a sensor at rest, not along rows of one"
    )
    signal: SignalFile
    threshold: NoiseFile
    noise: NoiseFile
    scatter: ScatterFile
    glare: GlareFile | None = Field(default=None, description="None: too few strong returns were recorded")


def recorded_curves(name: str) -> RecordedFile | RecordedPointsFile | None:
    """Read what is recorded of this catalogue sensor; None without a recording.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    path = catalog.folder("recorded") / f"{name}.toml"
    return read_recorded(path) if path.is_file() else None


def read_recorded(path: Path) -> RecordedFile | RecordedPointsFile:
    """Read a file of curves, or of statistics of points.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    tables = read_toml(path)
    if "signal" in tables:
        return validate(RecordedFile, tables, str(path))
    return validate(RecordedPointsFile, tables, str(path))


def compare(name: str) -> list[Held]:
    """Compare a catalogue sensor with all that is recorded of it.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    recorded = recorded_curves(name)
    if isinstance(recorded, RecordedFile):
        rows = list(compare_curves(recorded, load_sensor(name, overrides=recorded.settings)))
    else:
        rows = [] if recorded is None else list(compare_points(recorded, name))
    published = published_performance(name)
    if published is not None:
        for entry in (entry for entry in published.repeatability if entry.recording):
            sigma_m = repeatability(load_sensor(name), published, entry).simulated
            sigma_mm = None if sigma_m is None else 1e3 * sigma_m
            where, limits = f"{entry.at_m:g} m, target assumed", "scatter ratio, target assumed"
            rows.append(_row(limits, "scatter", where, 1e3 * entry.sigma_m, sigma_mm, "mm"))
    return [replace(row, subject=name) for row in rows]


def compare_points(recorded: RecordedPointsFile, name: str) -> Iterator[Held]:
    """Compare beams, steps, scatter and least separation of returns of a sensor with rows.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    sensor = load_sensor(name)
    elevation_deg, azimuth_step_deg = _beams_deg(sensor)
    error_deg = np.sort(elevation_deg) - np.sort(recorded.elevation_deg)
    yield Held(
        quantity="elevations",
        condition=f"{len(elevation_deg)} channels, rms",
        value=float(np.sqrt(np.mean(error_deg**2))),
        limits=LIMITS["elevations"],
        unit="degrees",
    )
    yield _row("step ratio", "azimuth step", "", recorded.azimuth_step_deg, azimuth_step_deg, "degrees")
    range_step_mm = 0.5e3 * SPEED_OF_LIGHT_M_S * float(np.ravel(sensor.tdc.least_significant_bit_s)[0])
    yield _row("step ratio", "range step", "", recorded.range_step_mm, range_step_mm, "mm")
    for reflectivity, range_m, sigma_mm in zip(
        recorded.scatter.reflectivity, recorded.scatter.range_m, recorded.scatter.sigma_mm, strict=True
    ):
        target = Target(reflectivity=reflectivity, illuminance_klux=ASSUMED_KLUX)
        sigma_m = scatter_m(sensor, target, range_m=range_m)
        simulated_mm = None if sigma_m is None else 1e3 * sigma_m
        yield _row("scatter ratio", "scatter", f"{reflectivity:.0%} at {range_m:g} m", sigma_mm, simulated_mm, "mm")
    if recorded.least_separation_m is not None:
        separation_m = least_separation_m(load_sensor(name, overrides=TWO_RETURNS))
        yield Held(
            quantity="second returns, least separation",
            reference=recorded.least_separation_m,
            simulated=separation_m,
            value=math.nan if separation_m is None else separation_m / recorded.least_separation_m - 1.0,
            limits=LIMITS["second separation"],
            unit="m",
        )


def _beams_deg(sensor: Sensor) -> tuple[Numbers, float]:
    """(channels,) elevations ahead [degrees], and a busiest channel's mean step of the azimuth [degrees].

    The channel of the step is the one nearest to the level, where rows of a lens are straight.
    """
    pulse = np.arange(sensor.scanner.pulses, dtype=np.uint32)
    channel = np.asarray(sensor.scanner.channel(pulse))
    azimuth, elevation = (np.asarray(angle, dtype=np.float64) for angle in sensor.scanner.angles(pulse))
    ahead_first = np.argsort(np.abs(azimuth), kind="stable")
    numbers, first, firings = np.unique(channel[ahead_first], return_index=True, return_counts=True)
    elevation_deg = np.degrees(elevation[ahead_first[first]])
    busiest = numbers[np.lexsort((np.abs(elevation_deg), -firings))[0]]
    turned = np.unwrap(azimuth[channel == busiest])
    return elevation_deg, math.degrees(abs(turned[-1] - turned[0])) / (turned.size - 1)


def least_separation_m(sensor: Sensor) -> float | None:
    """Least distance of two equal echoes from which on both are reported in half of the pulses; None: nowhere."""
    separations_m = np.arange(0.05, 6.0, 0.05)
    shape = (len(separations_m), SHOTS_OF_PAIRS)
    apart_m = np.repeat(separations_m, SHOTS_OF_PAIRS)
    near_m = 10.0 + np.random.default_rng(1).uniform(-0.5, 0.5, apart_m.size)
    light = echoes_of_plane(sensor, Target(reflectivity=0.3, illuminance_klux=ASSUMED_KLUX), near_m)
    half_w = 0.5 * light.peak_power_w
    train = EchoTrain(
        parts=tuple(SubEchoes(range_m=range_m, peak_power_w=half_w, count=1) for range_m in (near_m, near_m + apart_m)),
        surfaces=2,
        has_surface=light.has_surface,
        background_power_w=light.background_power_w,
        interference=light.interference,
        white_w_m2=light.white_w_m2,
        fluctuation=light.fluctuation,
    )
    detection = detect(train, sensor, seed=1, pulse=np.arange(apart_m.size, dtype=np.uint32))
    is_echo = [np.asarray(stop.reported & (stop.status == int(Status.ECHO))) for stop in detection.stops]
    both = np.mean(np.sum(is_echo, axis=0).reshape(shape) > 1, axis=1) > 0.5
    merged = np.flatnonzero(~both)
    first = merged[-1] + 1 if merged.size else 0
    return float(separations_m[first]) if first < len(separations_m) else None


def compare_curves(curves: RecordedFile, sensor: Sensor) -> Iterator[Held]:
    """Compare the four curves of a sensor that counts photons, in its recorded mode."""
    range_m = np.asarray(curves.signal.range_m)
    error = np.log(white_m2(sensor, range_m) / np.asarray(curves.signal.white_m2))
    span = f"{range_m[0]:g} to {range_m[-1]:g} m"
    yield _row("signal ratio", "signal", f"mean of {span}", 1.0, float(np.exp(np.mean(error))))
    yield _row(
        "signal ratio", "signal, spread", f"over {span}", 1.0, float(np.exp(np.mean(np.abs(error - np.mean(error)))))
    )
    for near_ir, photons in zip(curves.threshold.near_ir, curves.threshold.photons, strict=True):
        point = sensor.working_point(background_w(sensor, near_ir))
        threshold = float(np.ravel(sensor.threshold(point))[0])
        yield _row("threshold ratio", "threshold", f"NEAR_IR {near_ir:g}", photons, threshold, "photons")
    for near_ir, photons in zip(curves.noise.near_ir, curves.noise.photons, strict=True):
        yield _row(
            "threshold ratio",
            "highest noise",
            f"NEAR_IR {near_ir:g}",
            photons,
            highest_noise(sensor, near_ir),
            "photons",
        )
    scatter = curves.scatter
    for signal, near_ir, sigma_mm in zip(scatter.signal, scatter.near_ir, scatter.sigma_mm, strict=True):
        simulated_mm = scatter_mm(sensor, signal, near_ir, at_rest=curves.at_rest)
        yield _row("scatter ratio", "scatter", f"SIGNAL {signal:g}", sigma_mm, simulated_mm, "mm")
    if curves.glare is not None:
        strengths = np.geomspace(0.5, 2.0, GLARE_STEPS) * curves.glare.photons
        apart_m = np.geomspace(0.5, 2.0, GLARE_STEPS) * curves.glare.reach_m
        least = _first(strengths, withheld_beside(sensor, strengths, np.zeros(GLARE_STEPS)))
        most_m = _first(apart_m, ~withheld_beside(sensor, np.full(GLARE_STEPS, strengths[-1]), apart_m))
        yield _row("threshold ratio", "withheld beside glare", "from photons", curves.glare.photons, least, "photons")
        yield _row("threshold ratio", "withheld beside glare", "within", curves.glare.reach_m, most_m, "m")


def _first(values: Numbers, mask: Numbers) -> float | None:
    """First value of a mask; None without one."""
    return float(values[np.argmax(mask)]) if mask.any() else None


def withheld_beside(sensor: Sensor, photons: Numbers, apart_m: Numbers) -> Numbers:
    """(n,) whether most weak returns so far behind a return of so many photons of the same column are withheld.

    The weak ones have `WEAK_PHOTONS` and are those of all other channels.
    """
    crosstalk, line = Crosstalk.from_sensor(sensor), sensor.scanner.line_pulses
    assert line is not None
    if crosstalk is None:
        return np.zeros(len(photons), bool)
    background_w = np.zeros(len(photons) * line)
    power_w = sensor.working_point(np.zeros(1)).response.power_w
    is_strong = np.broadcast_to(np.arange(line) == line // 2, (len(photons), line))
    level_w = np.where(is_strong, np.asarray(power_w(photons))[:, None], power_w(np.full(1, WEAK_PHOTONS)))
    range_m = np.where(is_strong, 30.0, 30.0 + apart_m[:, None])
    train = EchoTrain(
        parts=(SubEchoes(range_m=range_m.ravel(), peak_power_w=level_w.ravel(), count=1),),
        surfaces=1,
        has_surface=background_w == 0.0,
        background_power_w=background_w,
    )
    pulse = np.arange(background_w.size, dtype=np.uint32)
    light = channel_light(train, crosstalk)
    whole = add_stray_light(train, light, crosstalk, pulse=pulse)
    detection = detect(whole, sensor, seed=1, pulse=pulse, channels=light, crosstalk=crosstalk)
    reported = np.asarray(detection.stops[0].reported).reshape(is_strong.shape)
    return np.asarray(np.mean(reported & ~is_strong, axis=1) < 0.5)


def _row(limits: str, quantity: str, condition: str, recorded: float, simulated: float | None, unit: str = "") -> Held:
    """Row whose value is simulated over recorded; one that cannot be simulated fails."""
    return Held(
        quantity=quantity,
        condition=condition,
        reference=recorded,
        simulated=simulated,
        value=math.nan if simulated is None else simulated / recorded,
        limits=LIMITS[limits],
        unit=unit,
    )


def white_m2(sensor: Sensor, range_m: Numbers) -> Numbers:
    """(n,) photons of a white target times the square of its range, m2."""
    reflectivity = 0.2  # scaled to white: an echo this weak does not saturate the detector
    light = echoes_of_plane(sensor, Target(reflectivity=reflectivity, illuminance_klux=0.0), range_m)
    photons = np.asarray(sensor.working_point(light.background_power_w).response.signal(light.peak_power_w))
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
    point = sensor.working_point(background_w(sensor, near_ir))
    low, high = 0.0, 1e3
    for _ in range(50):
        middle = 0.5 * (low + high)
        rate = float(np.ravel(sensor.false_alarm_rate_hz(point, np.array([middle])))[0])
        often = rate * float(sensor.tdc.window_s) > math.log(2.0)
        low, high = (middle, high) if often else (low, middle)
    return low


def scatter_mm(sensor: Sensor, signal: float, near_ir: float, *, at_rest: bool = False) -> float | None:
    """Scatter of the reported range in mm at this number of photons, as it is read; None if few echoes are found.

    It is read from every second column, about a parabola, and columns may share their noise; or, of a sensor at rest,
    from the same pixels of two frames, which share none.
    """
    power = background_w(sensor, near_ir)
    light = echoes_of_plane(sensor, Target(illuminance_klux=100.0), 20.0 * np.ones(1))
    # The background power is proportional to the illuminance.
    klux = 100.0 * float(np.ravel(power / light.background_power_w)[0])
    noise = float(np.ravel(sensor.working_point(power).noise.deviation)[0])
    sigma_m = scatter_m(sensor, Target(illuminance_klux=klux), range_m=20.0, snr=signal / noise)
    if sigma_m is None:
        return None
    if at_rest or sensor.histogram is None or sensor.histogram.column_weights is None:
        return 1e3 * sigma_m
    weights = [float(weight) for weight in sensor.histogram.window.values()]
    return 1e3 * sigma_m * scatter_share(weights, points=PATCH, step=COLUMN_STEP)


def as_dicts(rows: Sequence[Held]) -> list[dict[str, Any]]:
    """Each row for JSON."""
    words = {"subject": "sensor", "reference": "recorded", "value": "ratio", "met": "held"}
    return [row.as_dict(**words) | {"most": row.limits.high} for row in rows]


def as_text(rows: Sequence[Held], without: Sequence[str] = ()) -> str:
    """Text table of the comparisons, with a verdict.

    Args:
        without: names of sensors of which there is no recording
    """
    table = held_table(rows, subject="sensor", reference="recorded", value="ratio")
    text = f"{text_table(*table)}\n{verdict(rows, 'The catalogue')}"
    return f"{text}\nNot held to a recording: {', '.join(without)}." if without else text
