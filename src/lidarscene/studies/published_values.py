"""Catalogue sensors compared with published values: range, repeatability, false points, points per second.

Sensor files hold estimates for numbers that makers do not publish. The published results check these estimates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..detection.outcomes import Status
from ..detection.receivers import detect_alone
from ..physics.constants import SPEED_OF_LIGHT_M_S
from ..sensor.readout import PublishedFile, RepeatabilityFile
from ..sensor.sensor_file import load_sensor, published_performance
from ..sensor.sensor_model import Sensor
from .ranging import statistics
from .ranging.plane import Target, echoes_of_plane, maximum_range_m

SHOTS = 20_000
"""Shots for one standard deviation, whose own error is then 0.5 %."""

_SEED = 1

NOTE = """\
* not published: assumed. Of several ranges the first is the one that the laser's power was fitted to, if it was.
The scatter is the standard deviation of one shot's range; false points are per pulse. "recorded" stands for what others
measured in recordings, with the roughness of the surface in it: an upper bound."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """Published and simulated value of one quantity; None is unknown.

    condition  conditions under which it was published, in words
    """

    published: float | None
    simulated: float | None
    condition: str = ""

    @property
    def deviation(self) -> float | None:
        """Simulated over published, minus one."""
        if self.published is None or self.simulated is None:
            return None
        return self.simulated / self.published - 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedComparison:
    """Comparison of one catalogue sensor.

    also  ranges on further targets, to which no value was fitted
    """

    name: str
    range_m: Compared
    also: tuple[Compared, ...]
    repeatability_m: tuple[Compared, ...]
    false_points: Compared
    points_per_second: Compared
    source: str


def points_per_second(sensor: Sensor) -> float:
    """Pulses per second, averaged over a frame."""
    return sensor.scanner.pulses / sensor.scanner.frame_s


def scatter_m(sensor: Sensor, target: Target, *, range_m: float, snr: float | None = None) -> float | None:
    """Standard deviation of one shot's reported range, by the stages of `render`; None if few echoes are found.

    snr  SNR (11) of the echo in place of that of the target; None: the target's
    """
    # Ranges are spread over 1 m, so that echoes fall anywhere between the steps of a sampler or converter.
    ranges = range_m + np.random.default_rng(_SEED).uniform(-0.5, 0.5, SHOTS)
    light = echoes_of_plane(sensor, target, ranges)
    if snr is not None:
        point = sensor.working_point(light.background_power_w)
        level = snr * point.noise
        if point.largest is not None and np.any(level > point.largest):
            return None  # more than the cells can show
        light = replace(light, peak_power_w=point.power_w(level))
    stop = detect_alone(light, sensor, seed=_SEED, pulse=np.arange(SHOTS, dtype=np.uint32)).stops[0]
    echo = stop.reported & (stop.status == int(Status.ECHO))
    errors = (np.asarray(stop.range_m) - ranges)[np.asarray(echo)]
    return float(np.std(errors)) if errors.size > SHOTS // 100 else None


def check(name: str) -> PublishedComparison:
    """Compare a catalogue sensor with its `[published]` values. Raises InputError."""
    published = published_performance(name) or PublishedFile(source="unknown")
    sensor = load_sensor(name, overrides=published.settings)
    return PublishedComparison(
        name=name,
        range_m=_range(sensor, published, published.reflectivity, published.range_m),
        also=tuple(_range(sensor, published, *pair) for pair in published.also),
        repeatability_m=tuple(repeatability(sensor, published, entry) for entry in published.repeatability),
        false_points=_false_points(sensor, published),
        points_per_second=Compared(
            published=published.points_per_second, simulated=points_per_second(load_sensor(name))
        ),
        source=published.source,
    )


def _range(sensor: Sensor, published: PublishedFile, reflectivity: float | None, range_m: float | None) -> Compared:
    """Compare the range under the published condition, or at 10 % and 100 klux if there is none."""
    is_given = reflectivity is not None
    share = reflectivity if reflectivity is not None else 0.1
    klux = 100.0 if published.illuminance_klux is None else published.illuminance_klux
    limit, _ = maximum_range_m(sensor, Target(reflectivity=share, illuminance_klux=klux))
    stated = is_given and not (share == published.reflectivity and "reflectivity" in published.assumed)
    words = f"{share:.0%}{'' if stated else '*'}, {_words(published, ('illuminance_klux', f'{klux:g} klux'))}"
    return Compared(published=range_m, simulated=float(limit), condition=words)


def repeatability(sensor: Sensor, published: PublishedFile, entry: RepeatabilityFile) -> Compared:
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
    return Compared(
        published=entry.sigma_m,
        simulated=scatter_m(sensor, target, range_m=entry.at_m or 20.0, snr=entry.snr),
        condition=", ".join(words),
    )


def _false_points(sensor: Sensor, published: PublishedFile) -> Compared:
    """Compare the false points of a pulse without echo, under the light of a 10 % target."""
    klux = 100.0 if published.illuminance_klux is None else published.illuminance_klux
    target = Target(reflectivity=0.1, illuminance_klux=klux)
    beyond_m = float(sensor.tdc.window_s) * SPEED_OF_LIGHT_M_S
    return Compared(
        published=published.false_points,
        simulated=statistics.false_points(sensor, target, beyond_m).per_pulse,
        condition=_words(published, ("illuminance_klux", f"{klux:g} klux")),
    )


def _words(published: PublishedFile, *conditions: tuple[str, str]) -> str:
    """Join conditions in one line; a star marks an assumed one."""
    return ", ".join(
        text + ("" if getattr(published, key) is not None and key not in published.assumed else "*")
        for key, text in conditions
    )


def as_dict(comparison: PublishedComparison) -> dict[str, Any]:
    """Fields for JSON; null is unknown."""
    return {
        "name": comparison.name,
        "range_m": _as_dict(comparison.range_m),
        "also_range_m": [_as_dict(further) for further in comparison.also],
        "repeatability_m": [_as_dict(scatter) for scatter in comparison.repeatability_m],
        "false_points": _as_dict(comparison.false_points),
        "points_per_second": _as_dict(comparison.points_per_second),
        "source": comparison.source,
    }


def _as_dict(compared: Compared) -> dict[str, Any]:
    values = {"published": compared.published, "simulated": compared.simulated, "deviation": compared.deviation}
    return values | ({"condition": compared.condition} if compared.condition else {})


def as_text(checks: list[PublishedComparison]) -> str:
    """Text table of the comparisons."""
    rows = [("sensor", "", "published", "simulated", "deviation", "condition")]
    for comparison in checks:
        name = comparison.name
        for label, digits, c in (
            ("range, m", ".1f", comparison.range_m),
            *(("range, m", ".1f", further) for further in comparison.also),
            *(("scatter, m", ".4f", c) for c in comparison.repeatability_m),
            ("false points", ".2e", comparison.false_points),
            ("points/s", ",.0f", comparison.points_per_second),
        ):
            shift = None if c.deviation is None else round(c.deviation, 3) + 0.0  # no minus before zero
            cells = ((c.published, digits), (c.simulated, digits), (shift, "+.1%"))
            texts = ["unknown" if value is None else format(value, spec) for value, spec in cells]
            rows.append((name, label, texts[0], texts[1], texts[2], c.condition))
            name = ""
    widths = [max(len(row[column]) for row in rows) for column in range(5)]
    lines = []
    for row in rows:
        cells_text = [f"{row[column]:{'<' if column < 2 else '>'}{widths[column]}}" for column in range(5)]
        lines.append("  ".join([*cells_text, row[5]]).rstrip())
    return "\n".join([*lines, NOTE])
