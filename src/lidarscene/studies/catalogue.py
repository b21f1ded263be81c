"""Catalogue sensors compared with what their makers publish: range, precision, points per second.

Sensor files hold estimates where makers say nothing. The published results are the check on them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..detection.outcomes import Status
from ..detection.photon_counting.receiver import detect_alone
from ..sensor.catalogue import load_sensor
from ..sensor.catalogue import published as catalogue_published
from ..sensor.model import Sensor
from ..sensor.readout import PublishedFile
from .ranging.plane import Target, echoes_of_plane, maximum_range_m

SHOTS = 20_000
"""Shots for one precision: its own error is 0.5 %."""

_SEED = 1

NOTE = """\
* not published: assumed. Of several ranges the first is the one that the laser's power was fitted to, if it was.
Precision is the standard deviation of one shot."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """One quantity; None is unknown.

    condition  under which it was published, in words
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
class Check:
    """One catalogue sensor. ``also``: ranges on further targets, to which no value was fitted."""

    name: str
    range_m: Compared
    also: tuple[Compared, ...]
    precision_m: Compared
    points_per_second: Compared
    source: str


def points_per_second(sensor: Sensor) -> float:
    """Pulses per second, averaged over a frame."""
    return sensor.scanner.pulses / sensor.scanner.frame_s


def precision_m(sensor: Sensor, target: Target, range_m: float) -> float | None:
    """Standard deviation of one shot's reported range, by `detect_alone`; None if hardly any echo is found."""
    light = echoes_of_plane(sensor, target, np.full(SHOTS, range_m))
    numbers = np.arange(SHOTS, dtype=np.uint32)
    seen = detect_alone(light, sensor, seed=_SEED, pulse=numbers).stops[0]
    echo = seen.reported & (seen.status == int(Status.ECHO))
    ranges = np.asarray(seen.range_m)[np.asarray(echo)]
    return float(np.std(ranges)) if ranges.size > SHOTS // 100 else None


def check(name: str) -> Check:
    """Compare a catalogue sensor with its `[published]` values. Raises InputError."""
    sensor = load_sensor(name)
    published = catalogue_published(name) or PublishedFile(source="unknown")
    return Check(
        name=name,
        range_m=_range(sensor, published, published.reflectivity, published.range_m),
        also=tuple(_range(sensor, published, *pair) for pair in published.also),
        precision_m=_precision(sensor, published),
        points_per_second=Compared(
            published=published.points_per_second, simulated=points_per_second(sensor)
        ),
        source=published.source,
    )


def _range(
    sensor: Sensor, published: PublishedFile, reflectivity: float | None, range_m: float | None
) -> Compared:
    """Range under the published condition, or at 10 % and 100 klux if there is none."""
    known = reflectivity is not None
    share = reflectivity if reflectivity is not None else 0.1
    klux = 100.0 if published.illuminance_klux is None else published.illuminance_klux
    limit, _ = maximum_range_m(sensor, Target(reflectivity=share, illuminance_klux=klux))
    stated = known and not (share == published.reflectivity and "reflectivity" in published.assumed)
    words = f"{share:.0%}{'' if stated else '*'}, {_words(published, ('illuminance_klux', f'{klux:g} klux'))}"
    return Compared(published=range_m, simulated=float(limit), condition=words)


def _precision(sensor: Sensor, published: PublishedFile) -> Compared:
    if published.precision_m is None:
        return Compared(published=None, simulated=None)
    # The model demands the conditions of a precision.
    at, reflectivity, klux = (
        published.precision_at_m, published.precision_reflectivity, published.illuminance_klux,
    )  # fmt: skip
    assert at is not None
    assert reflectivity is not None
    assert klux is not None
    return Compared(
        published=published.precision_m,
        simulated=precision_m(sensor, Target(reflectivity=reflectivity, illuminance_klux=klux), at),
        condition=_words(
            published, ("precision_at_m", f"{at:g} m"), ("precision_reflectivity", f"{reflectivity:.0%}"),
            ("illuminance_klux", f"{klux:g} klux"),
        ),
    )  # fmt: skip


def _words(published: PublishedFile, *conditions: tuple[str, str]) -> str:
    """Conditions in a line; a star marks an assumed one."""
    return ", ".join(
        text + ("" if getattr(published, key) is not None and key not in published.assumed else "*")
        for key, text in conditions
    )


def as_dict(one: Check) -> dict[str, Any]:
    """For JSON; null is unknown."""
    return {
        "name": one.name,
        "range_m": _as_dict(one.range_m),
        "also_range_m": [_as_dict(c) for c in one.also],
        "precision_m": _as_dict(one.precision_m),
        "points_per_second": _as_dict(one.points_per_second),
        "source": one.source,
    }


def _as_dict(c: Compared) -> dict[str, Any]:
    values = {"published": c.published, "simulated": c.simulated, "deviation": c.deviation}
    return values | ({"condition": c.condition} if c.condition else {})


def as_text(checks: list[Check]) -> str:
    """A table for people."""
    rows = [("sensor", "", "published", "simulated", "deviation", "condition")]
    for one in checks:
        name = one.name
        for label, digits, c in (
            ("range, m", ".1f", one.range_m),
            *(("range, m", ".1f", further) for further in one.also),
            ("precision, m", ".4f", one.precision_m),
            ("points/s", ",.0f", one.points_per_second),
        ):
            shift = None if c.deviation is None else round(c.deviation, 3) + 0.0  # no minus before zero
            cells = ((c.published, digits), (c.simulated, digits), (shift, "+.1%"))
            shown = ["unknown" if value is None else format(value, spec) for value, spec in cells]
            rows.append((name, label, shown[0], shown[1], shown[2], c.condition))
            name = ""
    widths = [max(len(row[k]) for row in rows) for k in range(5)]
    lines = []
    for row in rows:
        cells_text = [f"{row[k]:{'<' if k < 2 else '>'}{widths[k]}}" for k in range(5)]
        lines.append("  ".join([*cells_text, row[5]]).rstrip())
    return "\n".join([*lines, NOTE])
