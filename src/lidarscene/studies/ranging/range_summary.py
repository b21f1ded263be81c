"""Summary of each sensor's range under given conditions: what the command `range` prints without a sweep."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from ...figures.report import text_table
from . import plane
from .curves import limit_word, with_haze
from .plane import RangeStatus, Target
from .subjects import Subject
from .sweep_report import air_text, window_note

_LIMITS = {RangeStatus.FOUND: "signal", RangeStatus.WINDOW: "window"}
"""What limits a range that is reported."""


def summary_of(subject: Subject, target: Target, *, distance_m: float, visibility_m: float | None) -> dict[str, Any]:
    """Farthest range that is reported and what limits it, closed form, window; SNR and P_d at ``distance_m``.

    The entry "note" is a line if the window ends before the range at which the signal does, else None.
    """
    sensor = subject.sensor()
    target = with_haze(sensor, target, visibility_m)
    limit, signal_status = plane.maximum_range_m(sensor, target)
    reported, status = plane.reported_range_m(sensor, target)
    signal_text = f"{limit:.6g} m" if math.isfinite(limit) else limit_word(signal_status)
    limit_text = f"the range that its signal allows ({signal_text})"
    fixed = sensor.tdc.threshold_to_noise is None
    bound = None if fixed else plane.closed_form_range_m(sensor, target)
    snr = float(plane.snr(sensor, target, distance_m)[0])
    return {
        "name": subject.name,
        "maximum_range_m": reported if math.isfinite(reported) else None,
        "limited_by": _LIMITS.get(status),
        "signal_range_m": limit if math.isfinite(limit) else None,
        "status": signal_status.name.lower(),
        "closed_form_m": bound if bound is not None and math.isfinite(bound) else None,
        "window_m": float(plane.window_m(sensor)),
        "distance_m": distance_m,
        "snr": snr if math.isfinite(snr) else None,
        "detection_probability": float(plane.detection_probability(sensor, target, distance_m)[0]),
        "note": window_note(subject.name, sensor, farthest_m=float(limit), limit_text=limit_text),
    }


def text_of(
    rows: Sequence[dict[str, Any]], target: Target, distance_m: float, sun_angle_deg: float, visibility_m: float | None
) -> str:
    """Text table of the rows, with the conditions above it."""
    incidence = math.degrees(math.acos(min(float(target.cos_incidence), 1.0)))
    distance_text = f"at {distance_m:g} m"
    columns = ["sensor", "maximum range", "limited by", "closed form", "window"]
    table = [[*columns, f"SNR {distance_text}", f"P_d {distance_text}"]]
    for row in rows:
        has_limit = row["limited_by"] is not None
        limit = f"{row['maximum_range_m']:.3f} m" if has_limit else limit_word(RangeStatus[row["status"].upper()])
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
    conditions = (
        f"{target.illuminance_klux:g} klux, sun {sun_angle_deg:g}° off the normal, reflectivity "
        f"{target.reflectivity:g}, incidence {incidence:g}°, {air_text(target, visibility_m)}"
    )
    return "\n".join(
        [conditions, text_table(table[0], table[1:], "<>"), *(row["note"] for row in rows if row["note"] is not None)]
    )
