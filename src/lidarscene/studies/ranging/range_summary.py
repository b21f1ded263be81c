"""Range of each sensor under given conditions: what the command `range` prints without a sweep."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...figures.lines import Chart, Line, Mark
from ...figures.report import PAGE, Figure, Report, text_table
from ...sensor.sensor_model import Sensor
from . import plane
from .conditions import Conditions
from .curves import limit_word, with_haze
from .equal_terms import ILLUMINANCES_KLUX, Terms, equal_terms, verdict
from .plane import RangeStatus, Target
from .sweep_report import air_text, window_note

NUMBERS = "range.json"
POINTS = 200
"""Points of the chart's curves, which are smooth."""

_DARK_AND_WHITE = (0.1, 0.8)
"""Source: reflectivities of makers' range tables."""

_LIMITS = {RangeStatus.FOUND: "signal", RangeStatus.WINDOW: "window"}
"""What limits a range that is reported."""


def range_report(sensors: Sequence[tuple[str, Sensor]], conditions: Conditions) -> Report:
    """Range of each sensor, its closed form, and SNR and P_d at one distance; several also on equal terms.

    Args:
        sensors: names, which differ, and sensors
    """
    target, visibility_m = conditions.target(), conditions.visibility_m
    rows = [summary_of(name, sensor, conditions) for name, sensor in sensors]
    numbers = {row["name"]: {key: value for key, value in row.items() if key != "name"} for row in rows}
    report = Report(_capital(conditions.range_words), numbers=numbers, pages=(PAGE, NUMBERS), columns=True)
    sentences: tuple[str, ...] = ()
    terms: list[Terms] = []
    if len(sensors) > 1:
        terms = equal_terms(sensors, target, visibility_m=visibility_m, probability=conditions.probability)
        sentences = verdict(terms, target, visibility_m=visibility_m)
        for entry in terms:
            numbers[entry.name]["equal_terms"] = {
                conditions.range_column: entry.range_m,
                "range_interval_m": entry.interval_m,
                "ranges_m": dict(zip(map("{:g} klux".format, ILLUMINANCES_KLUX), entry.course_m, strict=True)),
                f"file_{conditions.range_column}": entry.file_range_m,
                "changes": entry.changes,
            }
    saturated = [text for name, sensor in sensors if (text := saturation_text(name, sensor, conditions))]
    columns = [key for key in rows[0] if key != "note"]
    report.main_table = (columns, [[row[key] for key in columns] for row in rows])
    conditions_line, table, notes = _summary_table(rows, conditions)
    report.add_paragraph(f"{_capital(conditions.range_words)} on a plane: {conditions_line}.", "Question")
    for lead, sentence in zip(_LEADS, sentences, strict=False):  # without sentences for one sensor
        report.add_paragraph(sentence, lead)
    for sentence in saturated:
        report.add_paragraph(sentence)
    report.add_table(table[0], table[1:])
    for note in notes:
        report.add_paragraph(note)
    report.add_figure(_snr_figure(sensors, rows, conditions))
    if terms:
        report.add_figure(_light_figure(terms, conditions))
    text = "\n".join([conditions_line, text_table(table[0], table[1:], "<>"), *notes])
    said = [*saturated, *sentences]
    report.summary = "\n".join([*said, "", text]) if said else text
    return report


def _target(sensor: Sensor, conditions: Conditions) -> Target:
    """Plane target, with the extinction of the air at the sensor's wavelength."""
    return with_haze(sensor, conditions.target(), conditions.visibility_m)


_LEADS = ("Verdict", "What differs", "What would change it", "As the files are")
"""What the sentences of a `verdict` answer."""


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]


def saturation_text(name: str, sensor: Sensor, conditions: Conditions) -> str:
    """Sentence on a sensor that sees a white plane less far than a dark one in the same light; "" for others."""
    target = _target(sensor, conditions)
    dark_m, white_m = (
        float(plane.detection_range_m(sensor, replace(target, reflectivity=share), conditions.probability)[0])
        for share in _DARK_AND_WHITE
    )
    if not white_m < dark_m:
        return ""
    dark, white = _DARK_AND_WHITE
    reached = f"{white_m:.4g} m" if white_m > 0.0 else "never"
    return (
        f"{name} sees white planes less far than dark ones under {target.illuminance_klux:g} klux: {dark_m:.4g} m at "
        f"{dark:.0%}, {reached} at {white:.0%}: sunlight on the white one keeps its cells busy."
    )


def _snr_figure(
    sensors: Sequence[tuple[str, Sensor]], rows: Sequence[dict[str, Any]], conditions: Conditions
) -> Figure:
    """SNR over the distance, with each range marked."""
    ranges_m = [row[conditions.range_column] for row in rows]
    longest_m = max(row[f"signal_{conditions.range_column}"] or row["window_m"] for row in rows)
    distance_m = np.geomspace(0.02 * longest_m, 1.5 * longest_m, POINTS)
    curves = [
        (name, np.asarray(plane.snr(sensor, _target(sensor, conditions), distance_m))) for name, sensor in sensors
    ]
    chart = Chart(
        lines=tuple(Line(label=name, x=distance_m, y=snr, colour=number) for number, (name, snr) in enumerate(curves)),
        x_label="distance [m]",
        y_label="signal-to-noise ratio",
        x_log=True,
        y_log=True,
        marks=tuple(
            Mark(x=range_m, y=float(np.interp(range_m, distance_m, snr)), text=f"{range_m:.4g} m", colour=number)
            for number, (range_m, (_, snr)) in enumerate(zip(ranges_m, curves, strict=True))
            if range_m is not None
        ),
    )
    table = (
        ("distance_m", *(name for name, _ in curves)),
        list(zip(distance_m, *(snr for _, snr in curves), strict=True)),
    )
    caption = f"Signal-to-noise ratio over the distance; each {conditions.range_words} is marked."
    return Figure("snr", chart, table, caption)


def _light_figure(terms: Sequence[Terms], conditions: Conditions) -> Figure:
    """Range on equal terms over the illuminance."""
    klux = np.array(ILLUMINANCES_KLUX)
    chart = Chart(
        lines=tuple(
            Line(label=entry.name, x=klux, y=np.array(entry.course_m), colour=number)
            for number, entry in enumerate(terms)
        ),
        x_label="illuminance of the sun [klux]",
        y_label=f"{conditions.range_words} on equal terms [m]",
        x_log=True,
    )
    table = (
        ("illuminance_klux", *(f"{entry.name} {conditions.range_column}" for entry in terms)),
        list(zip(klux.tolist(), *(entry.course_m for entry in terms), strict=True)),
    )
    return Figure("light", chart, table, f"{_capital(conditions.range_words)} on equal terms over the illuminance.")


def summary_of(name: str, sensor: Sensor, conditions: Conditions) -> dict[str, Any]:
    """Farthest range that is reported and what limits it, closed form, window; SNR and P_d at the distance.

    The entry "note" is a line if the window ends before the range at which the signal does, else None.
    """
    target, column = _target(sensor, conditions), conditions.range_column
    limit, signal_status = plane.detection_range_m(sensor, target, conditions.probability)
    reported, status = plane.reported_range_m(sensor, target, conditions.probability)
    signal_text = f"{limit:.6g} m" if math.isfinite(limit) else limit_word(signal_status)
    limit_text = f"the range that its signal allows ({signal_text})"
    fixed = sensor.tdc.threshold_to_noise is None
    bound = None if fixed else plane.closed_form_range_m(sensor, target)
    snr = float(plane.snr(sensor, target, conditions.distance)[0])
    return {
        "name": name,
        column: reported if math.isfinite(reported) else None,
        "limited_by": _LIMITS.get(status),
        f"signal_{column}": limit if math.isfinite(limit) else None,
        "status": signal_status.name.lower(),
        "closed_form_m": bound if bound is not None and math.isfinite(bound) else None,
        "window_m": float(plane.window_m(sensor)),
        "distance_m": conditions.distance,
        "snr": snr if math.isfinite(snr) else None,
        "detection_probability": float(plane.detection_probability(sensor, target, conditions.distance)[0]),
        "note": window_note(name, sensor, farthest_m=float(limit), limit_text=limit_text),
    }


def _summary_table(rows: Sequence[dict[str, Any]], conditions: Conditions) -> tuple[str, list[list[str]], list[str]]:
    """Line of the conditions, header and rows of the table, and notes."""
    distance_text = f"at {conditions.distance:g} m"
    columns = ["sensor", conditions.range_words, "limited by", "closed form", "window"]
    table = [[*columns, f"SNR {distance_text}", f"P_d {distance_text}"]]
    for row in rows:
        has_limit = row["limited_by"] is not None
        limit = f"{row[conditions.range_column]:.3f} m" if has_limit else limit_word(RangeStatus[row["status"].upper()])
        bound = "-" if row["closed_form_m"] is None else f"{row['closed_form_m']:.3f} m"
        snr = "inf" if row["snr"] is None else f"{row['snr']:.6g}"
        table.append(
            [
                row["name"],
                limit,
                row["limited_by"] or "-",
                bound,
                f"{row['window_m']:.1f} m",
                snr,
                f"{row['detection_probability']:.6g}",
            ]
        )
    line = (
        f"{conditions.illuminance_klux:g} klux, sun {conditions.sun_angle:g}° off the normal, reflectivity "
        f"{conditions.reflectivity:g}, incidence {conditions.incidence:g}°, "
        f"{air_text(conditions.target(), conditions.visibility_m)}"
    )
    return line, table, [row["note"] for row in rows if row["note"] is not None]
