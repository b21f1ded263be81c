"""The figures of a comparison: name, drawing, table and caption of each.

A figure and its CSV come from one place, so that they cannot disagree.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from ...figures import intervals
from ...figures import lines as charts
from ...figures.intervals import Series
from ...figures.report import Figure
from ...maths.arrays import Numbers
from ...sensor.sensor_model import Sensor
from .comparison_statistics import DetectionRate, RangeError, paired_snr, range_errors, rates_by_group
from .illuminance_sweep import IlluminanceSweep
from .observations import Grouping, Observation

RATE_HEADER = ("sensor", "group", "low", "high", "surfaces", "found", "rate", "rate_low", "rate_high", "expected")
ERROR_HEADER = ("sensor", "group", "points", "bias_m", "bias_interval_m", "sigma_m", "sigma_interval_m")
_AXIS_WORDS = {
    "range": "true range",
    "incidence": "angle of incidence",
    "reflectivity": "reflectivity",
    "class": "class",
}
_MOST_SNR_ROWS = 12_000  # rows of the scatter plot's table
_MOST_CLASSES = 30


def rate_rows(observations: Sequence[Observation], grouping: Grouping) -> list[tuple[Any, ...]]:
    """CSV rows of the detection rates by sensor and group, without empty groups; edges in metres, degrees or shares."""
    rows: list[tuple[Any, ...]] = []
    for observation in observations:
        for number, group_rate in enumerate(rates_by_group(observation.rated_surfaces, grouping)):
            if group_rate.surfaces:
                ends: tuple[Any, ...] = ("", "")
                if grouping.edges is not None:
                    ends = tuple(float(end) for end in grouping.labels[number].split(" to "))
                expected = "" if group_rate.expected is None else group_rate.expected
                rows.append((observation.name, group_rate.group, *ends, *group_rate.cells, expected))
    return rows


def rate_figure(observations: Sequence[Observation], grouping: Grouping, population: str) -> Figure:
    """Detection rate over the bins of a truth column; ``population`` says in words what rates are shares of."""
    series = []
    for observation in observations:
        group_rates = rates_by_group(observation.rated_surfaces, grouping)
        series.append(_rate_series(observation.name, list(zip(grouping.middles, group_rates, strict=True))))
    quantity = _AXIS_WORDS[grouping.key]
    unit = f" [{grouping.unit}]" if grouping.unit else ""
    caption = (
        f"Fraction of {population} with an echo among the points, over {quantity}; bars are 95 % intervals (Wilson)"
        + ("" if series[0].expected is None else ", and lines the mean of the computed detection probabilities")
        + ". Bins without pulses are left out. Other properties of the surfaces also differ between bins."
    )
    lowest = min((float(curve.low.min()) for curve in series if len(curve.low)), default=0.0)
    draw = partial(
        intervals.save_series,
        series=series,
        x_label=f"{quantity}{unit}",
        y_label="detected [%]",
        y_limits=(10.0 * math.floor(0.1 * lowest) - 1.0, 101.0),
        title=f"Detected fraction of {population}",
    )
    return Figure(f"rate-{grouping.key}", draw, (RATE_HEADER, rate_rows(observations, grouping)), caption)


def class_rate_figure(observations: Sequence[Observation], grouping: Grouping, population: str) -> Figure:
    """Detection rate of each class."""
    rates_by_sensor = [rates_by_group(observation.rated_surfaces, grouping) for observation in observations]
    pulses = np.array([[rate.surfaces for rate in class_rates] for class_rates in rates_by_sensor]).max(axis=0)
    classes = [int(number) for number in np.argsort(-pulses, kind="stable")[:_MOST_CLASSES] if pulses[number] > 0]
    series = [
        _rate_series(observation.name, list(enumerate(class_rates[number] for number in classes)))
        for observation, class_rates in zip(observations, rates_by_sensor, strict=True)
    ]
    caption = (
        f"The same by class, with the most frequent first{' (the first 30)' if len(classes) == _MOST_CLASSES else ''}."
    )
    draw = partial(
        intervals.save_named,
        series=series,
        names=[grouping.labels[number] or "unlabelled" for number in classes],
        x_label="detected [%]",
        title=f"Detected fraction of {population}",
    )
    return Figure("rate-class", draw, (RATE_HEADER, rate_rows(observations, grouping)), caption)


def _rate_series(name: str, points: Sequence[tuple[float, DetectionRate]]) -> Series:
    """Curve of rates in per cent over x, without empty groups."""
    x = [x for x, rate in points if rate.surfaces]
    rates = [rate for _, rate in points if rate.surfaces]
    expected = [100.0 * rate.expected for rate in rates if rate.expected is not None]
    return Series(
        label=name,
        x=np.array(x, dtype=np.float64),
        y=np.array([100.0 * rate.rate for rate in rates]),
        low=np.array([100.0 * rate.interval[0] for rate in rates]),
        high=np.array([100.0 * rate.interval[1] for rate in rates]),
        expected=np.array(expected) if len(expected) == len(rates) else None,
    )


def error_rows(observations: Sequence[Observation], grouping: Grouping) -> list[tuple[Any, ...]]:
    """CSV rows of the range errors by sensor and bin."""
    return [
        (observation.name, *(getattr(error, name) for name in ERROR_HEADER[1:]))
        for observation in observations
        for error in range_errors(observation, grouping)
    ]


def range_error_figure(observations: Sequence[Observation], grouping: Grouping) -> Figure:
    """Bias and standard deviation of the reported range over the true range."""
    middle = dict(zip(grouping.labels, grouping.middles, strict=True))
    bias, sigma = [], []
    for observation in observations:
        # A single point has no deviation.
        bin_errors = [error for error in range_errors(observation, grouping) if error.points > 1]
        x = np.array([middle[error.group] for error in bin_errors], dtype=np.float64)
        bias.append(_error_series(observation.name, x, bin_errors, "bias"))
        sigma.append(_error_series(observation.name, x, bin_errors, "sigma"))
    caption = (
        "Reported minus true range of the echoes, over true range: mean (above) and standard deviation (below), with "
        "95 % intervals for independent Gaussian errors; bins with at least two echoes."
    )
    draw = partial(
        intervals.save_panels,
        panels=(("mean error [mm]", bias), ("deviation [mm]", sigma)),
        x_label="true range [m]",
        title="Error of the reported range",
    )
    return Figure("error-range", draw, (ERROR_HEADER, error_rows(observations, grouping)), caption)


def _error_series(name: str, x: Numbers, bin_errors: Sequence[RangeError], quantity: str) -> Series:
    """Curve of ``quantity``, "bias" or "sigma", in millimetres over x, with its 95 % interval."""
    y = np.array([1e3 * getattr(error, f"{quantity}_m") for error in bin_errors])
    half = np.array([1e3 * getattr(error, f"{quantity}_interval_m") for error in bin_errors])
    return Series(label=name, x=x, y=y, low=y - half, high=y + half)


def snr_figure(
    a: Observation, b: Observation, slug: str, sensors: tuple[Sensor | None, Sensor | None]
) -> Figure | None:
    """SNR of B over SNR of A, pulse by pulse; None if no pulse has both."""
    snr_a, snr_b, kind = paired_snr(a.rated_surfaces, b.rated_surfaces)
    if not len(kind):
        return None
    kinds = ("detected by both", f"only by {a.name}", f"only by {b.name}", "by neither")
    levels = tuple(
        None if sensor is None or sensor.tdc.threshold_to_noise is None else float(sensor.tdc.threshold_to_noise)
        for sensor in sensors
    )
    caption = (
        f"Signal-to-noise ratio of {b.name} over that of {a.name}, for each pulse whose echo has one for both. The "
        "dashed line marks equality" + (", and dotted lines the thresholds." if any(levels) else ".")
    )
    draw = partial(
        intervals.save_snr,
        pairs=intervals.Pairs(a=snr_a, b=snr_b, kind=kind, kinds=kinds, levels=(levels[0], levels[1])),
        x_label=f"SNR, {a.name}",
        y_label=f"SNR, {b.name}",
        title="Each point is a pulse",
    )
    step = max(len(kind) // _MOST_SNR_ROWS, 1)
    rows = [
        (float(x), float(y), kinds[number])
        for x, y, number in zip(snr_a[::step], snr_b[::step], kind[::step], strict=True)
    ]
    return Figure(f"snr-{slug}", draw, (("snr_a", "snr_b", "found"), rows), caption)


def illuminance_figure(sweep: IlluminanceSweep) -> Figure:
    """Expected detection rate over illuminance, with a mark where sensors change places."""
    lines, rows = [], []
    for number, (name, course) in enumerate(sweep.courses.items()):
        computed = {step.illuminance_klux: step.rate.expected or 0.0 for step in course}
        # Both curves get the crossing as a point, so that they meet exactly under its mark.
        crossings = [crossing for sensor_crossings in sweep.crossings.values() for crossing in sensor_crossings]
        computed |= {
            crossing.illuminance_klux: crossing.expected
            for crossing in crossings
            if name in (crossing.ahead_below, crossing.ahead_above)
        }
        x = np.array(sorted(computed))
        lines.append(charts.Line(label=name, x=x, y=100.0 * np.array([computed[lux] for lux in x]), colour=number))
        for step in course:
            sigma = "" if step.sigma_m is None else step.sigma_m
            expected = step.rate.expected
            rows.append((name, step.illuminance_klux, *step.rate.cells, expected, step.false_alarms, sigma))
    marks = tuple(
        charts.Mark(
            x=crossing.illuminance_klux, y=100.0 * crossing.expected, text=f"{crossing.illuminance_klux:.3g} klux"
        )
        for sensor_crossings in sweep.crossings.values()
        for crossing in sensor_crossings
    )
    chart = charts.Chart(
        lines=tuple(lines),
        x_label="illuminance [klux]",
        y_label="detected, expected [%]",
        x_log=True,
        marks=marks,
        title="Mean detection probability of all pulses that hit a surface",
    )
    caption = (
        "Mean of the computed detection probabilities over the illuminance of the scene. A mark shows where the "
        "ranking of the first sensor and another flips, found by bisection with a trace of the scene in each step."
    )
    header = ("sensor", "illuminance_klux", *RATE_HEADER[4:], "false_alarms", "sigma_m")
    return Figure("illuminance", lambda path: charts.save(chart, [path]), (header, rows), caption)
