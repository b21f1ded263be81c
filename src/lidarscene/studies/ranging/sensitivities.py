"""Sensitivities of range and detection to every number of a sensor and its target.

They show a designer what to improve first. An elasticity is percent of range per percent of a parameter, d ln R /
d ln p; a parameter that is zero has a plain derivative instead. The range is implicit, P_d(R, p) = 0.9, so dR/dp =
-(dP_d / dp) / (dP_d / dR). The partial derivatives are exact, by Dr.Jit's reverse mode through the very stages that
render; without a back end they are sixth-order central differences, off by 1e-6. What is computed when a file is
loaded, the overlap of spot and field of view, is computed anew from the varied numbers.

Symbols: R range, p parameter, P_d detection probability.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ...errors import BackendError, InputError
from ...figures.report import PAGE, Figure, Report
from ...maths.arrays import Lanes
from ...maths.units import is_continuous, split_unit
from ...physics.optics import scintillation
from ...sensor.detectors import Apd
from ...sensor.overlap import SIXTH_ORDER
from ...sensor.sensor_model import Sensor, overlap_geometry
from . import gain, plane
from .conditions import PROBABILITY, Conditions
from .curves import with_haze
from .plane import RangeStatus, Target

Formula = Callable[[Mapping[str, Lanes]], Lanes]
"""Function of numbers by name, NumPy or Dr.Jit, with one number as result."""

Derivation = Callable[[Formula, Mapping[str, float]], tuple[float, dict[str, float]]]
"""Function of a formula and its arguments; returns its value and its derivative with respect to every argument."""

_RANGE = "range_m"
_DEVIATE = "deviate"
_ALIGNMENT = "optics.overlap"


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """Effect of one parameter on the range and, at one distance, on the detection probability.

    Attributes:
        parameter: dotted name, such as detector.gain or target.reflectivity
        value: as the sensor holds it, SI
        unit: unit of the value, SI
        range_slope: dR / dp, metres per unit
        range_elasticity: d ln R / d ln p; None if the value is zero
        detection_slope: dP_d / dp at the table's distance
        detection_points: percentage points of P_d per percent of p; None if the value is zero
    """

    parameter: str
    value: float
    unit: str
    range_slope: float
    range_elasticity: float | None
    detection_slope: float
    detection_points: float | None


@dataclass(frozen=True, slots=True)
class SensitivityTable:
    """Sensitivities of a sensor on a target, strongest first.

    Attributes:
        probability: P_d at the range
        distance_m: distance at which the detection probability is taken
        method: "drjit" (exact) or "differences" (sixth-order central differences)
    """

    sensor: str
    range_m: float
    probability: float
    distance_m: float
    detection_probability: float
    method: str
    rows: tuple[Sensitivity, ...]


def parameters(sensor: Sensor, target: Target) -> dict[str, float]:
    """Every continuous number of laser, optics, detector, electronics and target, by dotted name, in SI units.

    Counts (``tdc.stops``) and what else chooses code are left out; the number of cells counts as continuous.
    """
    parts = {name: getattr(sensor, name) for name in plane.PARTS} | {"target": target}
    if sensor.optics.overlap is not None:
        parts[_ALIGNMENT] = sensor.optics.overlap.geometry.alignment
    numbers = {}
    for prefix, part in parts.items():
        if part is None:
            continue
        for field in dataclasses.fields(part):
            value = getattr(part, field.name)
            is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
            if is_number and math.isfinite(value) and is_continuous(field):
                numbers[f"{prefix}.{field.name}"] = float(value)
    return numbers


def with_parameters(sensor: Sensor, target: Target, values: Mapping[str, Lanes]) -> tuple[Sensor, Target]:
    """Sensor and target with these values of `parameters`."""
    changes: dict[str, dict[str, Lanes]] = {}
    for name, value in values.items():
        part, _, field = name.rpartition(".")
        changes.setdefault(part, {})[field] = value
    target = dataclasses.replace(target, **changes.pop("target", {}))
    alignment_changes = changes.pop(_ALIGNMENT, {})
    parts = {part: dataclasses.replace(getattr(sensor, part), **fields) for part, fields in changes.items()}
    sensor = dataclasses.replace(sensor, **parts)
    overlap = sensor.optics.overlap
    if overlap is not None:
        alignment = dataclasses.replace(overlap.geometry.alignment, **alignment_changes)
        geometry = overlap_geometry(sensor.laser, sensor.optics, sensor.detector, alignment)
        sensor = dataclasses.replace(sensor, optics=dataclasses.replace(sensor.optics, overlap=overlap.move(geometry)))
    return sensor, target


def _detection(sensor: Sensor, target: Target, range_m: Lanes, *, deviate: Lanes) -> Lanes:
    """P_d at a range, by the stages that render; numpy or Dr.Jit numbers.

    Args:
        deviate: normal deviate of the power that it is of, if the echo fluctuates
    """
    light = plane.light_of_plane(sensor, target, range_m)
    point = sensor.working_point(light.background_power_w, range_m=light.range_m)
    variance = plane.fluctuation_variance(sensor, target, light.range_m)
    power_w = light.peak_power_w
    if variance is not None:
        power_w = power_w * scintillation.relative_power(deviate, variance)
    return plane.expected_probability(sensor, point, sensor.threshold(point), power_w, None, light.curvature)


def _snr(sensor: Sensor, target: Target, range_m: Lanes, *, deviate: Lanes) -> Lanes:
    """`plane.snr`, which is that of the mean power whatever the deviate."""
    light = plane.light_of_plane(sensor, target, range_m)
    point = sensor.working_point(light.background_power_w, range_m=light.range_m)
    return point.snr(point.response.signal(light.peak_power_w * sensor.height_gain(light.curvature)))


def sensitivities(
    sensor: Sensor,
    target: Target,
    *,
    distance_m: float | None = None,
    probability: float = PROBABILITY,
    method: str = "auto",
) -> SensitivityTable:
    """Compute all sensitivities.

    Args:
        distance_m: distance at which P_d is taken; None: the range
        probability: P_d at the range
        method: "drjit", "differences", or "auto": Dr.Jit if there is a back end

    Raises:
        InputError: if the sensor has no range
    """
    limit, status = plane.detection_range_m(sensor, target, probability)
    if status != RangeStatus.FOUND:
        raise InputError(f"'{sensor.name}' has no range here ({status.name.lower()}), so no sensitivities")
    limit = float(limit)
    distance = limit if distance_m is None else distance_m
    values = parameters(sensor, target)

    method, derive = choose_derivation(method)
    _, at_limit = detection_slopes(sensor, target, limit, derive, values)
    slopes = _implicit(sensor, limit, at_limit)
    detected, detection = probability, at_limit
    if distance != limit:
        detected, detection = detection_slopes(sensor, target, distance, derive, values)
    rows = []
    for name, value in values.items():
        slope = slopes[name]
        rows.append(
            Sensitivity(
                parameter=name,
                value=value,
                unit=_unit(name),
                range_slope=slope,
                range_elasticity=slope * value / limit if value else None,
                detection_slope=detection[name],
                detection_points=detection[name] * value if value else None,
            )
        )
    # Rounded before sorting: factors of the echo have equal elasticities, which rounding errors must not reorder.
    rows.sort(key=lambda row: (-round(abs(row.range_elasticity or 0.0), 6), row.parameter))
    return SensitivityTable(sensor.name, limit, probability, distance, detected, method, tuple(rows))


def _implicit(sensor: Sensor, range_m: float, detection: Mapping[str, float]) -> dict[str, float]:
    """dR/dp = -(dP_d/dp) / (dP_d/dR) of each number (T221).

    Raises:
        InputError: where P_d does not fall with range
    """
    if not detection[_RANGE] < 0.0:
        raise InputError(f"'{sensor.name}': P_d at {range_m:.6g} m does not fall with range")
    return {name: -slope / detection[_RANGE] for name, slope in detection.items() if name != _RANGE}


def _formula(sensor: Sensor, target: Target, quantity: Callable[..., Lanes]) -> Formula:
    """Formula of numbers by name for a quantity of sensor, target, range and normal deviate."""

    def evaluate(numbers: Mapping[str, Lanes]) -> Lanes:
        varied = {name: number for name, number in numbers.items() if name not in (_RANGE, _DEVIATE)}
        changed = with_parameters(sensor, target, varied)
        return quantity(*changed, numbers[_RANGE], deviate=numbers.get(_DEVIATE, 0.0))

    return evaluate


def detection_slopes(
    sensor: Sensor, target: Target, range_m: float, derive: Derivation, values: Mapping[str, float]
) -> tuple[float, dict[str, float]]:
    """P_d and its derivatives with respect to these of the `parameters` and "range_m".

    Of an echo that fluctuates, their means over all of its powers.
    """
    formula, values = _formula(sensor, target, _detection), {**values, _RANGE: range_m}
    if plane.fluctuation_variance(sensor, target, range_m) is None:
        return derive(formula, values)
    # One power after the other, by the same kernel: all of them in one would take LLVM many minutes.
    probability, slopes = 0.0, dict.fromkeys(values, 0.0)
    for deviate, weight in scintillation.NODES:
        part, part_slopes = derive(formula, {**values, _DEVIATE: deviate})
        probability += weight * part
        slopes = {name: slope + weight * part_slopes[name] for name, slope in slopes.items()}
    return probability, slopes


def range_slopes(
    sensor: Sensor, target: Target, range_m: float, derive: Derivation, values: Mapping[str, float]
) -> dict[str, float]:
    """Derivatives of `plane.range_at_probability_m`, which is ``range_m``, with respect to these of the `parameters`.

    Where the window ends it, of the window's end; else dR/dp = -(dP_d/dp) / (dP_d/dR) (T221).

    Raises:
        InputError: where P_d does not fall with range
    """
    if range_m <= 0.0:
        return dict.fromkeys(values, 0.0)
    if range_m >= float(plane.window_m(sensor)):
        ends = {"tdc.window_s": range_m / float(sensor.tdc.window_s)}
        return {name: ends.get(name, 0.0) for name in values}
    return _implicit(sensor, range_m, detection_slopes(sensor, target, range_m, derive, values)[1])


def snr_slopes(
    sensor: Sensor, target: Target, range_m: float, derive: Derivation, values: Mapping[str, float]
) -> dict[str, float]:
    """Derivatives of `plane.snr` with respect to these of the `parameters`."""
    return derive(_formula(sensor, target, _snr), {**values, _RANGE: range_m})[1]


def choose_derivation(method: str) -> tuple[str, Derivation]:
    """Choose the method of differentiation; "auto" is Dr.Jit if there is a back end.

    Returns:
        its name and function

    Raises:
        ValueError: for an unknown name
        BackendError: if "drjit" is asked for and not available
    """
    if method not in ("auto", "drjit", "differences"):
        raise ValueError(f"no method '{method}'; expected auto, drjit or differences")
    if method != "differences":
        from ...kernel.device import backend, gate, gradients

        try:
            gate.exclusive(backend.mitsuba)()
        except BackendError:
            if method == "drjit":
                raise
        else:
            return "drjit", gradients.gradient
    return "differences", differences


def differences(formula: Formula, values: Mapping[str, float]) -> tuple[float, dict[str, float]]:
    """Derivatives by sixth-order central differences, one parameter after the other."""

    def value_at(parameter: str, value_at_step: float) -> float:
        return float(formula({**values, parameter: np.float64(value_at_step)}))

    centre = float(formula(values))
    slopes = {}
    for name, value in values.items():
        step = 1e-3 * abs(value)
        if step == 0.0:  # without a scale, search for the step that changes the formula by some thousandths
            step = 1e-15
            while step < 1e-3 and abs(value_at(name, step) - centre) < 1e-3:
                step *= 10.0
        rise = sum(
            weight * (value_at(name, value + multiple * step) - value_at(name, value - multiple * step))
            for multiple, weight in SIXTH_ORDER
        )
        slopes[name] = rise / step
    return centre, slopes


def report_text(sensor: Sensor, target: Target, table: SensitivityTable) -> str:
    """Text of the elasticities, plain derivatives where a value is zero, and for an APD the best gain."""
    text = table_text(table) + steps_text(sensor)
    if isinstance(sensor.detector, Apd):  # the one detector with a gain
        best = gain.best_gain(sensor, target, range_m=table.distance_m)
        text += (
            f"\n\ngain of the best SNR: {best.searched:.1f} by search, {best.closed_form:.1f} in closed form; "
            f"the present {sensor.detector.gain:g} has {100 * best.snr_share:.1f} % of that SNR"
        )
    return text


def steps_text(sensor: Sensor) -> str:
    """Paragraph on derivatives of counts of whole cells, whose P_d has steps; empty for any other sensor."""
    if not sensor.detector.counts_whole_cells:
        return ""
    return (
        '\n\ndetector.counting = "binomial": P_d steps where the threshold passes a whole number of cells. '
        'Exact derivatives leave steps out, differences may span one; "gaussian" has none.'
    )


def table_text(table: SensitivityTable) -> str:
    """Text of a `SensitivityTable`."""
    method_text = {
        "drjit": "exact, by Dr.Jit's automatic differentiation",
        "differences": "sixth-order central differences (no back end)",
    }[table.method]
    lines = [
        f"{table.sensor}: range {table.range_m:.3f} m at P_d {table.probability:g}",
        f"P_d {100 * table.detection_probability:.2f} % at {table.distance_m:.3f} m",
        f"derivatives: {method_text}",
        "",
        f"{'parameter':32s} {'value':>12s} {'unit':5s} {'range':>10s} {'P_d':>10s}",
        f"{'':32s} {'':>12s} {'':5s} {'% per %':>10s} {'points/%':>10s}",
    ]
    moving = [row for row in table.rows if row.range_slope or row.detection_slope]
    for row in moving:
        if row.range_elasticity is not None and row.detection_points is not None:
            lines.append(
                f"{row.parameter:32s} {row.value:12.6g} {row.unit:5s} "
                f"{_signed_text(row.range_elasticity)} {_signed_text(row.detection_points)}"
            )
    zero = [row for row in moving if row.range_elasticity is None]
    if zero:
        lines += ["", "zero now, so for each unit instead of each percent:"]
        lines += [
            f"{row.parameter:32s} {row.range_slope:+.6g} m, {row.detection_slope:+.6g} of P_d per {row.unit or 'unit'}"
            for row in zero
        ]
    still = [row.parameter for row in table.rows if row not in moving]
    if still:
        lines += ["", "no effect on either: " + ", ".join(still)]
    return "\n".join(lines)


def sensitivity_report(
    sensors: Sequence[tuple[str, Sensor]], conditions: Conditions, *, distance_m: float | None = None
) -> Report:
    """Sensitivities of each sensor, by its name, with a chart of the strongest.

    Args:
        distance_m: distance of the detection probability; None: each sensor's range
    """
    report = Report(f"Sensitivities of the {conditions.range_words}", numbers={}, pages=(PAGE, "sensitivities.json"))
    texts, rows = [], []
    for name, sensor in sensors:
        target = with_haze(sensor, conditions.target(), conditions.visibility_m)
        table = sensitivities(sensor, target, distance_m=distance_m, probability=conditions.probability)
        entries = [dataclasses.asdict(row) for row in table.rows]
        report.numbers[name] = {**dataclasses.asdict(table), "rows": entries}
        del report.numbers[name]["sensor"]
        rows += [[name, *entry.values()] for entry in entries]
        columns = ("parameter", "value", "unit", "range_elasticity", "detection_points")
        cells = [["" if entry[key] is None else _cell(entry[key]) for key in columns] for entry in entries]
        report.add_heading(name)
        report.add_paragraph(
            f"Range {table.range_m:.3f} m at P_d {table.probability:g}; P_d {100 * table.detection_probability:.2f} % "
            f"at {table.distance_m:.3f} m.{steps_text(sensor)}"
        )
        caption = f"Change of the {conditions.range_words} for +1 % of each parameter."
        bars = [(entry["parameter"], entry["range_elasticity"]) for entry in entries]
        report.add_figure(
            Figure(f"tornado_{name}", partial(tornado, table=table), (("parameter", "range_elasticity"), bars), caption)
        )
        report.add_table(("parameter", "value", "unit", "range [% per %]", "P_d [points per %]"), cells)
        texts.append(report_text(sensor, target, table))
    names = [field.name for field in dataclasses.fields(Sensitivity)]
    report.main_table = (("sensor", *names), rows)
    report.summary = "\n\n".join(texts)
    return report


def _cell(value: float | str) -> str:
    return f"{value:.6g}" if isinstance(value, float) else value


def tornado(path: str | os.PathLike[str], table: SensitivityTable) -> None:
    """Chart of the elasticities of the range, strongest on top; PNG or SVG by the path's suffix."""
    from ...figures import lines as charts

    charts.tornado(
        [path],
        bars=[(row.parameter, size) for row in table.rows if abs(size := row.range_elasticity or 0.0) > 5e-4],
        title=f"{table.sensor}: range {table.range_m:.1f} m at P_d {table.probability:g}",
        label="change of the range for +1 % [%]",
    )


def _signed_text(value: float) -> str:
    """Signed number in ten characters: four decimals, or two digits if these would show as zero."""
    return f"{value:+10.4f}" if abs(value) >= 1e-3 or value == 0.0 else f"{value:+10.1e}"


def _unit(name: str) -> str:
    """Unit from the suffix of the name, in ASCII; empty for plain numbers."""
    return split_unit(name)[1].replace("²", "2").replace("Ω", "ohm")
