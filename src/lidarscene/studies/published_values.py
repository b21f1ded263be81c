"""Catalogue sensors compared with published values: range, its laws and modes, repeatability, false points, points/s.

Sensor files hold estimates for numbers that makers do not publish. The published results check these estimates.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..detection.outcomes import Status
from ..detection.receiver import detect
from ..figures.report import text_table
from ..light.fluctuations import fluctuate
from ..maths.units import key_in_si
from ..physics.constants import SPEED_OF_LIGHT_M_S
from ..sensor.readout import PublishedFile, RepeatabilityFile
from ..sensor.sensor_file import load_sensor, published_performance
from ..sensor.sensor_model import Sensor
from .fit.published_fit import PublishedRanges, exponents, fit_published, nights_over_days, reached_m
from .held import LIMITS, Held, Limits, held_table, relative
from .ranging import statistics
from .ranging.conditions import PROBABILITY
from .ranging.plane import (
    Target,
    detection_probability,
    detection_range_m,
    echoes_of_plane,
    fluctuation_variance,
    maximum_range_m,
)
from .ranging.sensitivities import parameters

SHOTS = 20_000
"""Shots for one standard deviation, whose own error is then 0.5 %."""

MODE_REFLECTIVITIES = (0.1, 0.8)
"""Choice: reflectivities of the targets on which modes are compared."""

GREYS = np.geomspace(0.05, 0.95, 9)
"""Choice: reflectivities, from asphalt to white, over which a range must not fall."""

LAW_SIGMAS = 2.0
"""Choice: standard deviations of what is published beyond which a sensor contradicts its maker."""

_SEED = 1

NOTE = """\
A range is that at which the peak is as high as the threshold, so half of the echoes are found: few
makers say at which P_d theirs are, 0.5 to 0.9 where they do. Powers are fitted to it. The note has the range at P_d
0.9, as `range` gives it.
* not published: assumed. Of an exponent the deviation is the difference. Numbers that are fitted to all published
ranges together have the fitted value as "published", the file's as simulated, and one standard deviation as limits.
Of a mode's range over that of the published mode, the target and light are those that are farthest off.
The scatter is the standard deviation of one shot's range; false points are per pulse. "recorded" stands for what others
measured in recordings, with the roughness of the surface in it: an upper bound."""


def points_per_second(sensor: Sensor) -> float:
    """Pulses per second, averaged over a frame."""
    return sensor.scanner.pulses / sensor.scanner.frame_s


def scatter_m(sensor: Sensor, target: Target, *, range_m: float, snr: float | None = None) -> float | None:
    """Standard deviation of one shot's reported range, by the stages of `render`; None if few echoes are found.

    Args:
        snr: SNR (11) of the echo in place of that of the target; None: the target's
    """
    # Ranges are spread over 1 m, so that echoes fall anywhere between the steps of a sampler or converter.
    ranges = range_m + np.random.default_rng(_SEED).uniform(-0.5, 0.5, SHOTS)
    light = echoes_of_plane(sensor, target, ranges)
    if snr is not None:
        point = sensor.working_point(light.background_power_w)
        level = snr * point.noise.deviation
        if point.response.largest is not None and np.any(level > point.response.largest):
            return None  # more than the cells can show
        light = replace(light, peak_power_w=point.response.power_w(level))
    pulse = np.arange(SHOTS, dtype=np.uint32)
    variance = fluctuation_variance(sensor, target, light.range_m)
    if variance is not None:
        light = fluctuate(light, variance, seed=_SEED, pulse=pulse)
    stop = detect(light, sensor, seed=_SEED, pulse=pulse).stops[0]
    echo = stop.reported & (stop.status == int(Status.ECHO))
    errors = (np.asarray(stop.range_m) - ranges)[np.asarray(echo)]
    return float(np.std(errors)) if errors.size > SHOTS // 100 else None


def compare(name: str) -> list[Held]:
    """Compare a catalogue sensor with its `[published]` values: ranges, the fitted one first, modes, scatters, points.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    published = published_performance(name) or PublishedFile(source="unknown")
    sensor = load_sensor(name, overrides=published.settings)
    as_delivered = load_sensor(name) if published.settings else sensor
    rows = (
        *_ranges(sensor, published),
        *laws(sensor, published),
        *_fitted(name, sensor),
        _twice_the_range(sensor, published),
        *_modes(name, sensor, published),
        *(repeatability(sensor, published, entry) for entry in published.repeatability),
        _false_points(sensor, published),
        _row("points/s", "", published.points_per_second, points_per_second(as_delivered)),
    )
    return [replace(row, subject=name) for row in rows]


def compare_ranges(name: str) -> list[Held]:
    """Compare only the published ranges of a catalogue sensor, the fitted one first.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    published = published_performance(name) or PublishedFile(source="unknown")
    rows = _ranges(load_sensor(name, overrides=published.settings), published)
    return [replace(row, subject=name) for row in rows]


def _ranges(sensor: Sensor, published: PublishedFile) -> list[Held]:
    pairs = ((published.reflectivity, published.range_m), *published.also)
    lit = [_range(sensor, published, *pair) for pair in pairs]
    dark = published.model_copy(update={"illuminance_klux": 0.0})
    return lit + [_range(sensor, dark, *pair) for pair in published.dark]


def _row(quantity: str, condition: str, published: float | None, simulated: float | None, unit: str = "") -> Held:
    """Row whose value is simulated over published, minus one; no limits, since most values were fitted to."""
    return Held(
        quantity=quantity,
        condition=condition,
        reference=published,
        simulated=simulated,
        value=relative(simulated, published),
        unit=unit,
    )


def _range(sensor: Sensor, published: PublishedFile, reflectivity: float | None, range_m: float | None) -> Held:
    """Compare the range under the published condition, or at 10 % and 100 klux if there is none."""
    is_given = reflectivity is not None
    share = reflectivity if reflectivity is not None else 0.1
    klux = published.daylight_klux
    target = Target(reflectivity=share, illuminance_klux=klux)
    limit, _ = maximum_range_m(sensor, target)
    surely, _ = detection_range_m(sensor, target, PROBABILITY)
    stated = is_given and not (share == published.reflectivity and "reflectivity" in published.assumed)
    words = f"{share:.0%}{'' if stated else '*'}, {_words(published, ('illuminance_klux', f'{klux:g} klux'))}"
    row = _row("range", words, range_m, float(limit), "m")
    return replace(row, note=f"{surely:.4g} m at P_d {PROBABILITY:g}")


def laws(sensor: Sensor, published: PublishedFile) -> list[Held]:
    """Compare how the range goes with reflectivity and from day to night with what is published.

    A range that falls with reflectivity misses its limit, whatever is published.
    """
    ranges = PublishedRanges.of(published)
    if ranges is None:
        return []
    grey_m = reached_m(sensor, Target(reflectivity=GREYS, illuminance_klux=published.illuminance_klux or 0.0))
    least = float(np.min(grey_m[1:] / grey_m[:-1]))
    row = _row(
        "range, brighter over darker", f"least of {len(GREYS)} from {GREYS[0]:.0%} to {GREYS[-1]:.0%}", None, least
    )
    rows = [replace(row, value=least - 1.0, limits=LIMITS["brighter over darker"])]
    source = f"{LAW_SIGMAS:g} standard deviations of published ranges, `fit.tuning.RANGE_SIGMA` each"
    for law in exponents(ranges, sensor):
        row = _row("range exponent", law.condition, law.published, law.simulated)
        limits = Limits(-LAW_SIGMAS * law.sigma, LAW_SIGMAS * law.sigma, source)
        rows.append(replace(row, value=law.simulated - law.published, limits=limits))
    for law in nights_over_days(ranges, sensor):
        low, high = (math.expm1(sign * LAW_SIGMAS * law.sigma) for sign in (-1.0, 1.0))
        row = _row("range, night over day", law.condition, law.published, law.simulated)
        rows.append(replace(row, limits=Limits(low, high, source)))
    return rows


def _fitted(name: str, sensor: Sensor) -> list[Held]:
    """Compare numbers of the file with those that are fitted to all published ranges."""
    rows = []
    for number in fit_published(name):
        field, factor = key_in_si(number.key)
        value = parameters(sensor, Target())[field] / factor
        low, high = (end / number.value - 1.0 for end in number.interval)
        row = _row(number.key, "fitted", number.value, value)
        limits = Limits(low, high, "one standard deviation of the fit")
        rows.append(replace(row, limits=limits, note=str(number)))
    return rows


def _twice_the_range(sensor: Sensor, published: PublishedFile) -> Held:
    """P_d at twice the range under the published condition: how often a sensor finds what it should not."""
    klux = published.daylight_klux
    target = Target(reflectivity=published.reflectivity or 0.1, illuminance_klux=klux)
    limit, _ = maximum_range_m(sensor, target)
    has_limit = 0.0 < limit < np.inf
    probability = float(detection_probability(sensor, target, 2.0 * limit)[0]) if has_limit else None
    return _row("P_d", f"{target.reflectivity:.0%}, {klux:g} klux, at twice that range", None, probability)


def _modes(name: str, sensor: Sensor, published: PublishedFile) -> list[Held]:
    """Compare the range in each mode over that in the published mode, on the target and in the light farthest off.

    The light is the published one and none.
    """
    modes = published.modes
    if modes is None:
        return []
    klux = published.daylight_klux
    pairs = np.array(list(itertools.product(MODE_REFLECTIVITIES, (klux, 0.0))))
    targets = Target(reflectivity=pairs[:, 0], illuminance_klux=pairs[:, 1])
    base_m = maximum_range_m(sensor, targets)[0]
    rows = []
    for settings, factors in zip(modes.settings, modes.range_factors, strict=True):
        for multiplier, factor in zip(modes.multiplier, factors, strict=True):
            mode = load_sensor(name, overrides=(*settings, f"histogram.multiplier={multiplier:g}"))
            ratio = maximum_range_m(mode, targets)[0] / base_m
            farthest = int(np.argmax(np.abs(ratio / factor - 1.0)))
            words = ", ".join(assignment.split(".")[-1] for assignment in settings)
            share, light = pairs[farthest]
            condition = f"{words}, x{multiplier:g}; {share:.0%}, {light:g} klux"
            rows.append(_row("range factor", condition, factor, float(ratio[farthest])))
    return rows


def repeatability(sensor: Sensor, published: PublishedFile, entry: RepeatabilityFile) -> Held:
    """Compare a published scatter, at its SNR (on 10 % at 20 m, which sets the background) or on its target."""
    klux = entry.illuminance_klux if entry.illuminance_klux is not None else published.illuminance_klux
    target = Target(reflectivity=entry.reflectivity or 0.1, illuminance_klux=100.0 if klux is None else klux)
    sunlit = "*" if "illuminance_klux" in (*published.assumed, *entry.assumed) or klux is None else ""
    if entry.snr is not None:
        words = [f"SNR {entry.snr:g}{'*' if 'snr' in entry.assumed else ''}"]
    else:
        words = [f"{entry.at_m:g} m", f"{entry.reflectivity:.0%}{'*' if 'reflectivity' in entry.assumed else ''}"]
    words += [f"{target.illuminance_klux:g} klux{sunlit}"]
    words += ["at most"] * entry.at_most + ["recorded"] * entry.recording
    simulated_m = scatter_m(sensor, target, range_m=entry.at_m or 20.0, snr=entry.snr)
    return _row("scatter", ", ".join(words), entry.sigma_m, simulated_m, "m")


def _false_points(sensor: Sensor, published: PublishedFile) -> Held:
    """Compare the false points of a pulse without echo, under the light of a 10 % target."""
    klux = published.daylight_klux
    target = Target(reflectivity=0.1, illuminance_klux=klux)
    beyond_m = float(sensor.tdc.window_s) * SPEED_OF_LIGHT_M_S
    per_pulse = statistics.false_points(sensor, target, beyond_m).per_pulse
    words = _words(published, ("illuminance_klux", f"{klux:g} klux"))
    return _row("false points", words, published.false_points, per_pulse)


def _words(published: PublishedFile, *conditions: tuple[str, str]) -> str:
    """Join conditions in one line; a star marks an assumed one."""
    return ", ".join(
        text + ("" if getattr(published, key) is not None and key not in published.assumed else "*")
        for key, text in conditions
    )


def as_dicts(rows: Sequence[Held]) -> list[dict[str, Any]]:
    """Each sensor's rows for JSON, by quantity; null is unknown."""
    sensors = []
    for name, group in itertools.groupby(rows, key=lambda row: row.subject):
        quantities: dict[str, list[dict[str, Any]]] = {}
        group_rows = list(group)
        for row in group_rows:
            quantities.setdefault(row.quantity, []).append(row.as_dict(reference="published", value="deviation"))
        published = published_performance(name)
        sensors.append(
            {
                "name": name,
                "range_m": quantities["range"][0],
                "also_range_m": quantities["range"][1:],
                "brighter_over_darker": quantities.get("range, brighter over darker", [None])[0],
                "range_exponents": quantities.get("range exponent", []),
                "nights_over_days": quantities.get("range, night over day", []),
                "fitted": {
                    row.quantity: row.as_dict(reference="fitted", value="deviation", note="interval")
                    for row in group_rows
                    if row.condition == "fitted"
                },
                "twice_the_range": quantities["P_d"][0],
                "range_factors": quantities.get("range factor", []),
                "repeatability_m": quantities.get("scatter", []),
                "false_points": quantities["false points"][0],
                "points_per_second": quantities["points/s"][0],
                "source": "unknown" if published is None else published.source,
            }
        )
    return sensors


def as_text(rows: Sequence[Held]) -> str:
    """Text table of the comparisons."""
    table = held_table(rows, percent=True, subject="sensor", reference="published", value="deviation")
    return f"{text_table(*table)}\n{NOTE}"
