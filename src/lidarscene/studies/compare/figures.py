"""The figures of a comparison: name, drawing, table and caption of each.

A figure and its CSV come from one place, so that they cannot disagree.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...figures import intervals
from ...figures import lines as charts
from ...figures.intervals import Series
from ...maths.arrays import Numbers
from ...sensor.model import Sensor
from .data import Grouping, Observation
from .numbers import RangeError, paired_snr, range_errors, rates
from .run import Sweep

Figure = tuple[str, Callable[[Path], None], tuple[Sequence[str], Any], str]
"""File name without suffix, drawing to a path, CSV header and rows, explanation."""

RATE_HEADER = ("sensor", "group", "low", "high", "surfaces", "found", "rate", "rate_low", "rate_high", "expected")
ERROR_HEADER = ("sensor", "group", "points", "bias_m", "bias_interval_m", "sigma_m", "sigma_interval_m")
_WORDS = {"range": "true range", "incidence": "angle of incidence", "reflectivity": "reflectivity", "class": "class"}
_SHOWN_SNR = 12_000  # rows of the scatter plot's table
_MOST_CLASSES = 30


def rate_rows(everything: Sequence[Observation], grouping: Grouping) -> list[tuple[Any, ...]]:
    """Rows by sensor and group, without groups that have no surface; edges in metres, degrees or shares."""
    rows: list[tuple[Any, ...]] = []
    for one in everything:
        for number, each in enumerate(rates(one.counted, grouping)):
            if each.surfaces:
                ends: tuple[Any, ...] = ("", "")
                if grouping.edges is not None:
                    ends = tuple(float(end) for end in grouping.labels[number].split(" to "))
                expected = "" if each.expected is None else each.expected
                rows.append(
                    (one.name, each.group, *ends, each.surfaces, each.found, each.rate, *each.interval, expected)
                )
    return rows


def rate(everything: Sequence[Observation], grouping: Grouping, of: str) -> Figure:
    """Detection rate over the bins of a truth column."""
    series = []
    for one in everything:
        full = [(x, r) for x, r in zip(grouping.middles, rates(one.counted, grouping), strict=True) if r.surfaces]
        series.append(_series(one.name, [x for x, _ in full], [r for _, r in full]))
    what = _WORDS[grouping.key]
    unit = f" [{grouping.unit}]" if grouping.unit else ""
    caption = (
        f"Share of {of} from which an echo is a point, by {what}; bars are 95 % intervals (Wilson)"
        + ("" if series[0].expected is None else ", lines the mean of the computed detection probabilities")
        + ". Bins without a pulse are left out. Other properties of the surfaces differ from bin to bin too."
    )
    lowest = min((float(one.low.min()) for one in series if len(one.low)), default=0.0)
    draw = partial(
        intervals.save_series,
        series=series,
        x_label=f"{what}{unit}",
        y_label="found [%]",
        y_limits=(10.0 * math.floor(0.1 * lowest) - 1.0, 101.0),
        title=f"Share of {of} that was found",
    )
    return f"rate-{grouping.key}", draw, (RATE_HEADER, rate_rows(everything, grouping)), caption


def rate_by_class(everything: Sequence[Observation], grouping: Grouping, of: str) -> Figure:
    """Detection rate of each class."""
    every = []
    for one in everything:
        every.append(rates(one.counted, grouping))
    pulses = np.array([[each.surfaces for each in one] for one in every]).max(axis=0)
    kept = [int(n) for n in np.argsort(-pulses, kind="stable")[:_MOST_CLASSES] if pulses[n] > 0]
    series = []
    for one, groups in zip(everything, every, strict=True):
        shown = [(place, groups[n]) for place, n in enumerate(kept) if groups[n].surfaces]
        series.append(_series(one.name, [p for p, _ in shown], [r for _, r in shown]))
    caption = f"The same by class, the most frequent first{' (the first 30)' if len(kept) == _MOST_CLASSES else ''}."
    draw = partial(
        intervals.save_named,
        series=series,
        names=[grouping.labels[n] or "unlabelled" for n in kept],
        x_label="found [%]",
        title=f"Share of {of} that was found",
    )
    return "rate-class", draw, (RATE_HEADER, rate_rows(everything, grouping)), caption


def _series(name: str, x: Sequence[float], groups: Sequence[Any]) -> Series:
    has_expected = all(each.expected is not None for each in groups)
    return Series(
        label=name,
        x=np.array(x, dtype=np.float64),
        y=np.array([100.0 * r.rate for r in groups]),
        low=np.array([100.0 * r.interval[0] for r in groups]),
        high=np.array([100.0 * r.interval[1] for r in groups]),
        expected=np.array([100.0 * r.expected for r in groups]) if has_expected else None,
    )


def error_rows(everything: Sequence[Observation], grouping: Grouping) -> list[tuple[Any, ...]]:
    """By sensor and bin."""
    return [
        (one.name, e.group, e.points, e.bias_m, e.bias_interval_m, e.sigma_m, e.sigma_interval_m)
        for one in everything
        for e in range_errors(one, grouping)
    ]


def errors(everything: Sequence[Observation], grouping: Grouping) -> Figure:
    """Bias and standard deviation of the range over the range."""
    middle = dict(zip(grouping.labels, grouping.middles, strict=True))
    bias, sigma = [], []
    for one in everything:
        found = [e for e in range_errors(one, grouping) if e.points > 1]  # one point has no deviation
        x = np.array([middle[e.group] for e in found], dtype=np.float64)
        bias.append(_millimetres(one.name, x, found, "bias"))
        sigma.append(_millimetres(one.name, x, found, "sigma"))
    caption = (
        "Reported less true range of the echoes, by true range: mean (above) and standard deviation (below), with 95 % "
        "intervals that take the errors for independent and Gaussian; bins with two echoes or more."
    )
    draw = partial(
        intervals.save_panels,
        panels=(("mean error [mm]", bias), ("deviation [mm]", sigma)),
        x_label="true range [m]",
        title="Error of the reported range",
    )
    return "error-range", draw, (ERROR_HEADER, error_rows(everything, grouping)), caption


def _millimetres(name: str, x: Numbers, found: Sequence[RangeError], what: str) -> Series:
    y = np.array([1e3 * getattr(e, f"{what}_m") for e in found])
    half = np.array([1e3 * getattr(e, f"{what}_interval_m") for e in found])
    return Series(label=name, x=x, y=y, low=y - half, high=y + half)


def snr(a: Observation, b: Observation, slug: str, sensors: tuple[Sensor | None, Sensor | None]) -> Figure | None:
    """SNR of B over SNR of A, pulse by pulse; None if no pulse has both."""
    of_a, of_b, kind = paired_snr(a.counted, b.counted)
    if not len(kind):
        return None
    kinds = ("found by both", f"only by {a.name}", f"only by {b.name}", "by neither")
    levels = tuple(
        None if one is None or one.tdc.threshold_to_noise is None else float(one.tdc.threshold_to_noise)
        for one in sensors
    )
    caption = (
        f"Signal-to-noise ratio for {b.name} over that for {a.name}, of each pulse whose echo has one for both. The "
        "dashed line is equality" + (", dotted lines are the thresholds." if any(levels) else ".")
    )
    draw = partial(
        intervals.save_snr,
        pairs=intervals.Pairs(a=of_a, b=of_b, kind=kind, kinds=kinds, levels=(levels[0], levels[1])),
        x_label=f"SNR, {a.name}",
        y_label=f"SNR, {b.name}",
        title="Each point is a pulse",
    )
    step = max(len(kind) // _SHOWN_SNR, 1)
    rows = [(float(x), float(y), kinds[k]) for x, y, k in zip(of_a[::step], of_b[::step], kind[::step], strict=True)]
    return f"snr-{slug}", draw, (("snr_a", "snr_b", "found"), rows), caption


def illuminance(swept: Sweep) -> Figure:
    """Detection rate over illuminance, and where sensors change places."""
    lines, rows = [], []
    for number, (name, course) in enumerate(swept.courses.items()):
        computed = {lit.illuminance_klux: lit.rate.expected or 0.0 for lit in course}
        # The lines meet where they cross.
        every = [c for crossed in swept.crossings.values() for c in crossed]
        computed |= {c.illuminance_klux: c.expected for c in every if name in (c.ahead_below, c.ahead_above)}
        x = np.array(sorted(computed))
        lines.append(charts.Line(label=name, x=x, y=100.0 * np.array([computed[e] for e in x]), colour=number))
        for lit in course:
            sigma = "" if lit.sigma_m is None else lit.sigma_m
            rows.append(
                (
                    name,
                    lit.illuminance_klux,
                    lit.rate.surfaces,
                    lit.rate.found,
                    lit.rate.rate,
                    *lit.rate.interval,
                    lit.rate.expected,
                    lit.false_alarms,
                    sigma,
                )
            )
    marks = tuple(
        charts.Mark(x=c.illuminance_klux, y=100.0 * c.expected, text=f"{c.illuminance_klux:.3g} klux")
        for crossed in swept.crossings.values()
        for c in crossed
    )
    chart = charts.Chart(
        lines=tuple(lines),
        x_label="illuminance [klux]",
        y_label="found, expected [%]",
        x_log=True,
        marks=marks,
        title="Mean detection probability of all pulses that met a surface",
    )
    caption = (
        "Mean of the computed detection probabilities over the scene's illuminance. Where the curves of the first "
        "sensor and another change places the crossing is marked: found by bisection, with the scene traced each time."
    )
    header = (
        "sensor",
        "illuminance_klux",
        "surfaces",
        "found",
        "rate",
        "rate_low",
        "rate_high",
        "expected",
        "false_alarms",
        "sigma_m",
    )
    return "illuminance", lambda path: charts.save(chart, [path]), (header, rows), caption
