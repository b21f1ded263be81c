"""Report of a sweep: notes, table, CSV, JSON and chart of its curves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...figures.lines import Chart, Level, Line, Mark
from ...figures.report import PAGE, Data, Figure, Report, text_table
from ...physics.optics import radiometry
from ...sensor.sensor_model import Sensor
from .aperture_laws import LAWS, field_of_view_deg, of_scanner
from .conditions import CONDITIONS, PROBABILITY, QUANTITIES, Conditions, SweepOptions
from .curves import CurveCrossing, Curves, Question, SweepCurve, curves, is_flat, limit_word
from .plane import RangeStatus, Target, window_m
from .subjects import Subject
from .sweep_axes import Axis, condition_axis, parameter_axis, require_within_law

DIGITS = 10
"""Significant digits of the curves' CSV."""

_ROWS = 12
_SYMBOL = {"snr": "SNR", "pd": "P_d"}


def sweep_report(subjects: Sequence[Subject], sweep: SweepOptions, conditions: Conditions) -> Report:
    """Curves of several sensors over an axis, with their crossings and limits.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    swept = curves(subjects, _question(subjects, sweep, conditions))
    sensors = {subject.name: subject.sensor() for subject in subjects}
    conditions_line = conditions_text(swept, sun_angle_deg=conditions.sun_angle)
    lines = notes(swept, sensors)
    quantity = conditions.range_words if sweep.quantity_name == "range" else QUANTITIES[sweep.quantity_name]
    numbers = as_dict(swept) | {"conditions": conditions_line, "notes": lines}
    report = Report(f"{quantity} over {sweep.over}", numbers=numbers, pages=(PAGE, "sweep.json"), digits=DIGITS)
    report.main_table = _columns(swept, conditions)
    report.add_paragraph(f"{quantity}: {conditions_line}")
    thresholds = {name: sensor.tdc.threshold_to_noise for name, sensor in sensors.items()}
    chart = chart_of(swept, conditions_line, quantity, thresholds=thresholds)
    report.add_figure(Figure("curves", chart, report.main_table, f"{quantity} over {sweep.over}."))
    for line in lines:
        report.add_paragraph(line)
    report.summary = "\n".join([f"{quantity}: {conditions_line}", table_text(swept), *lines])
    return report


def _question(subjects: Sequence[Subject], sweep: SweepOptions, conditions: Conditions) -> Question:
    axis = _axis(subjects, sweep)
    law = sweep.aperture_law or "scanner"
    if law in ("cosine", "mirror"):
        require_within_law(axis)
    return Question(
        quantity=sweep.quantity_name,
        axis=axis,
        target=conditions.target(),
        law=law,
        distance_m=conditions.distance,
        probability=conditions.probability,
        visibility_m=conditions.visibility_m,
    )


def _axis(subjects: Sequence[Subject], sweep: SweepOptions) -> Axis:
    name, start, stop = sweep.over or "", sweep.start, sweep.stop
    if name not in CONDITIONS:
        files = [(subject.where, subject.changed) for subject in subjects]
        return parameter_axis(name, files, start=start, stop=stop, count=sweep.points, log=sweep.log)
    if name in ("elevation", "azimuth"):
        fields = [field_of_view_deg(subject.sensor().scanner, name) for subject in subjects]
        start = max(low for low, _ in fields) if start is None else start
        stop = min(high for _, high in fields) if stop is None else stop
    return condition_axis(name, start=start, stop=stop, count=sweep.points, log=sweep.log)


def _columns(swept: Curves, conditions: Conditions) -> Data:
    """Axis with its unit, and one column for each sensor; 0: never detected, inf: no limit.

    A range at another P_d than usual is named after the sensor.
    """
    columns = [swept.question.axis.values, *(curve.values for curve in swept.curves)]
    rows = [[float(value) for value in row] for row in zip(*columns, strict=True)]
    is_usual = swept.question.quantity != "range" or conditions.probability == PROBABILITY
    of_range = "" if is_usual else f" {conditions.range_column}"
    return [swept.question.axis.column, *(f"{curve.name}{of_range}" for curve in swept.curves)], rows


def conditions_text(swept: Curves, *, sun_angle_deg: float) -> str:
    """Fixed conditions of a sweep in one line."""
    question, target = swept.question, swept.question.target
    key = question.axis.key
    incidence = math.degrees(math.acos(min(float(target.cos_incidence), 1.0)))
    parts = [
        "" if key == "distance" or question.quantity == "range" else f"{question.distance_m:g} m",
        "" if key == "illuminance_klux" else f"{target.illuminance_klux:g} klux",
        f"sun {sun_angle_deg:g}° off the normal",
        "" if key == "reflectivity" else f"reflectivity {target.reflectivity:g}",
        "" if key == "incidence" else f"incidence {incidence:g}°",
        air_text(target, question.visibility_m),
    ]
    if key in ("elevation", "azimuth"):
        parts.append("the scanner's aperture" if question.law == "scanner" else f"{question.law} aperture law")
    return ", ".join(part for part in parts if part)


def air_text(target: Target, visibility_m: float | None) -> str:
    """Visibility, extinction or transmittance of the air, in words."""
    if visibility_m is not None:
        return f"visibility {visibility_m / 1000.0:g} km"
    if target.extinction_per_m > 0.0:
        return f"extinction {target.extinction_per_m:g} per metre"
    return f"transmittance {target.transmittance:g}"


def _cell(curve: SweepCurve, index: int) -> str:
    if curve.status is not None and curve.status[index] != RangeStatus.FOUND:
        return limit_word(int(curve.status[index]))
    return f"{curve.values[index]:.6g}"


def table_text(swept: Curves) -> str:
    """Text table of about a dozen rows of the curves; the CSV has all."""
    axis = swept.question.axis
    rows = np.unique(np.rint(np.linspace(0, len(axis.values) - 1, min(_ROWS, len(axis.values)))).astype(int))
    cells = [[f"{axis.values[row]:.6g}", *(_cell(curve, row) for curve in swept.curves)] for row in rows]
    return text_table([axis.column, *(curve.name for curve in swept.curves)], cells, ">")


def unambiguous_m(sensor: Sensor) -> float:
    """Range in metres from which light returns after the next pulse has left; inf for one pulse to a point."""
    if sensor.histogram is None or sensor.histogram.period_s is None:
        return math.inf
    period_s = float(sensor.histogram.period_s)
    return float(radiometry.range_from_time_of_flight_m(time_of_flight_s=period_s))


def window_note(name: str, sensor: Sensor, *, farthest_m: float, limit_text: str) -> str | None:
    """Note that the window ends before the farthest detection, named by ``limit_text``; None if it does not."""
    end_m = float(window_m(sensor))
    if farthest_m <= end_m:
        return None
    line = f"{name}: its window ends at {end_m:.1f} m, before {limit_text}"
    folds_m = unambiguous_m(sensor)
    if folds_m == math.inf:
        return line
    return f"{line}; echoes from beyond {folds_m:.1f} m are reported too near by that range"


def notes(swept: Curves, sensors: Mapping[str, Sensor]) -> list[str]:
    """Notes on crossings, ranges and warnings, one line each.

    Args:
        sensors: sensor by name
    """
    question = swept.question
    unit = f" {question.axis.unit}" if question.axis.unit else ""
    notes_so_far = []
    detected = f"P_d {question.probability:g}"
    for crossing in swept.detection_limits:
        value = "" if question.quantity == "pd" else f", where {_value(question.quantity, crossing)}"
        if question.axis.key == "distance" and crossing.falls:
            notes_so_far.append(f"{crossing.first}: range {crossing.place:.6g} m at {detected}{value}")
        else:
            verb = "falls to" if crossing.falls else "rises to"
            notes_so_far.append(f"{crossing.first}: {verb} {detected} at {crossing.place:.6g}{unit}{value}")
    for crossing in swept.crossings:
        verb = "falls below" if crossing.falls else "rises above"
        value = _value(question.quantity, crossing)
        notes_so_far.append(
            f"crossing at {crossing.place:.6g}{unit}: {crossing.first} {verb} {crossing.second}, {value}"
        )
    for curve in swept.curves:
        farthest = curve.values if curve.status is not None else np.zeros(1)
        farthest = farthest[np.isfinite(farthest)] if len(farthest) else farthest
        limits = [
            limit.place
            for limit in swept.detection_limits
            if limit.first == curve.name and question.axis.key == "distance"
        ]
        reach = max([*limits, *farthest.tolist()], default=0.0)
        line = window_note(curve.name, sensors[curve.name], farthest_m=reach, limit_text="the farthest of these")
        notes_so_far += [] if line is None else [line]
        if is_flat(curve) and len(curve.values) > 1:
            notes_so_far.append(f"{curve.name}: the same everywhere, {question.axis.key} does not matter")
    if question.axis.key in ("elevation", "azimuth"):
        notes_so_far.append(f"aperture law: {law_text(question.law)}")
    return notes_so_far


def law_text(law: str) -> str:
    """First paragraph of an aperture law's docstring, in one line."""
    return " ".join(((of_scanner if law == "scanner" else LAWS[law]).__doc__ or "").split("\n\n")[0].split())


def _value(quantity: str, crossing: CurveCrossing) -> str:
    return f"{crossing.value:.6g} m" if quantity == "range" else f"{_SYMBOL[quantity]} {crossing.value:.6g}"


def as_dict(swept: Curves) -> dict[str, Any]:
    """Fields for JSON; inf and NaN are null, and the status gives the reason."""

    def numbers(values: Any) -> list[float | None]:
        return [float(value) if math.isfinite(value) else None for value in values]

    question = swept.question
    sensors = {}
    for curve in swept.curves:
        entry: dict[str, Any] = {"values": numbers(curve.values)}
        if curve.status is not None:
            entry["status"] = [RangeStatus(int(status)).name.lower() for status in curve.status]
        entry["detection_limits"] = [
            {"at": limit.place, "value": limit.value, "falls": limit.falls}
            for limit in swept.detection_limits
            if limit.first == curve.name
        ]
        sensors[curve.name] = entry
    return {
        "over": question.axis.column,
        "unit": question.axis.unit,
        "quantity": question.quantity,
        "probability": question.probability,
        "x": numbers(question.axis.values),
        "sensors": sensors,
        "crossings": [
            {
                "first": crossing.first,
                "second": crossing.second,
                "at": crossing.place,
                "value": numbers([crossing.value])[0],
                "falls": crossing.falls,
            }
            for crossing in swept.crossings
        ],
    }


def chart_of(swept: Curves, title: str, words: str, *, thresholds: Mapping[str, Any]) -> Chart:
    """Chart of the curves, with crossings and limits marked.

    Args:
        words: for the quantity
        thresholds: ratio to noise at which each comparator trips; None if it is fixed in another way
    """
    question = swept.question
    axis, quantity = question.axis, question.quantity
    lines = []
    for number, curve in enumerate(swept.curves):
        drawn = np.where(curve.values > 0.0, curve.values, np.nan) if quantity != "pd" else curve.values
        lines.append(Line(label=curve.name, x=axis.values, y=drawn, colour=number))
    finite = np.concatenate([line.y[np.isfinite(line.y)] for line in lines])
    log = quantity == "snr" or (quantity == "range" and len(finite) > 0 and finite.max() > 30.0 * finite.min())
    unit = f" {axis.unit}" if axis.unit else ""
    colour = {curve.name: number for number, curve in enumerate(swept.curves)}
    marks = [
        Mark(
            x=limit.place,
            y=limit.value,
            text=f"{limit.place:.4g}{unit}",
            colour=colour[limit.first],
            offset=(8.0 if limit.falls else -8.0, 8.0),
        )
        for limit in swept.detection_limits
    ]
    marks += [
        Mark(x=crossing.place, y=crossing.value, text=f"{crossing.place:.4g}{unit}", offset=(10.0, 10.0))
        for crossing in swept.crossings
        if math.isfinite(crossing.value)
    ]
    levels: tuple[Level, ...] = ()
    if quantity == "snr":
        levels = tuple(
            Level(y=threshold, text=f"threshold {threshold:g}", side=("left", "right")[number % 2])
            for number, threshold in enumerate(sorted({ratio for ratio in thresholds.values() if ratio}))
        )
    limits = {"pd": (0.0, 1.03), "snr": None, "range": None if log else (0.0, None)}[quantity]
    if quantity == "range" and not log and len(finite) and finite.min() > 0.6 * finite.max():
        limits = None
    return Chart(
        lines=tuple(lines),
        x_label=axis.label,
        y_label=f"{words} [m]" if quantity == "range" else words,
        title=title,
        x_log=axis.log,
        y_log=log,
        y_limits=limits,
        marks=tuple(marks),
        levels=levels,
    )
