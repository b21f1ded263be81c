"""Fit of a recording: its laws, the sensor file of the unit, the report."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...figures.lines import Chart, Line
from ...figures.report import Figure, Report, count_text
from ...physics.optics.radiometry import range_from_time_of_flight_m
from ...recordings.opening import open_recording
from ...recordings.pcap_reader import metadata_of
from ...recordings.sweep import Sweep
from ...recordings.units.unit_file import with_second_returns
from ...sensor.sensor_model import Sensor
from ..held import Held
from ..recorded import scatter_mm
from ..twin.apparent_reflectivity import ReflectivityGauge
from ..twin.daylight import illuminance_klux
from ..twin.sensor_grid import on_grid
from .at_rest import COLUMNS, CONVERTER, Boards, FitAtRest, checks_at_rest, fit_at_rest
from .estimates import Estimate, Solution
from .fit_report import FITTED, FitReport, law_figure, law_rows, share_figure
from .near_field import LENSES, NearField, fit_near_field
from .pixels_at_rest import pixels_at_rest
from .products import QUANTITIES, Products, at_pulses, find_products, white_over_range_m2
from .recorded_pulses import RecordedPulses, gather_pulses
from .row_gains import RowGains, fit_rows
from .scatter import Scatter, fit_column_photons, fit_scatter
from .sensor_text import base_text, fitted_text, parse_sensor, with_background_gain
from .threshold import Threshold, fit_threshold
from .threshold_ends import fit_least, fit_lone_factor
from .tuning import MOST_REFLECTIVITY

REFLECTIVITY_NOTE = (
    "SIGNAL is not recorded: photons are REFLECTIVITY by the power and optics that its noise tells; if it tells none, "
    "by the file's, and then only scatter_c squared over the power is known"
)

SCALE_NOTE = (
    "The scale of the intensities is not known, and a median reflectivity of 0.2 is assumed: jitter, beam, chatter and "
    "light over the noise depend on it, energy spread and the coefficients of (T185) do not"
)

LEAST_JUDGED = 50
"""Least number of patches in an octave whose scatter is held to limits: three of its sigmas from 1 (`scatter`)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordingFit:
    """Result of a fit without a scene; None for laws whose fields were not recorded.

    Attributes:
        ends: spread of the threshold, without what the sensor's filter adds to its width, its least value, and its
            factor for lone echoes, as far as they are known
        column_photons: photons below which columns share more, of sensors whose columns do
        products: known quantities as products of numbers of the sensor file
        at_rest: numbers by frames of a sensor at rest; None: it moved, or one frame was recorded
        boards: pixels at rest that were not fitted
    """

    near_field: NearField | None = None
    threshold: Threshold | None = None
    scatter: Scatter | None = None
    rows: RowGains | None = None
    ends: tuple[Estimate, ...] = ()
    column_photons: Estimate | None = None
    products: Products | None = None
    at_rest: FitAtRest | None = None
    boards: Boards | None = None

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """Estimates of all laws."""
        laws = (self.near_field, self.threshold, self.scatter)
        at_rest = () if self.at_rest is None else self.at_rest.estimates
        shared = () if self.column_photons is None else (self.column_photons,)
        of_laws = (estimate for law in laws if law is not None for estimate in law.estimates)
        return (*of_laws, *self.ends, *shared, *at_rest)

    def checks(self, sensor: Sensor, near_ir: float = 0.0) -> list[Held]:
        """Compare a sensor, such as that of the written file, with the held-out blocks.

        Args:
            near_ir: background of the scatter
        """
        near_field, threshold, scatter = self.near_field, self.threshold, self.scatter
        if sensor.histogram is None:
            near_field = threshold = scatter = None
        octaves = []
        for signal, recorded_m, patches in [] if scatter is None else scatter.held_out.tolist():
            if patches >= LEAST_JUDGED:
                mm = scatter_mm(sensor, signal, near_ir, at_rest=True)
                octaves.append((signal, recorded_m, math.nan if mm is None else 1e-3 * mm))
        rows = [] if self.boards is None else list(checks_at_rest(self.boards, sensor))
        if sensor.histogram is None:
            return rows
        return rows + law_rows(
            None if near_field is None else near_field.error_of(sensor),
            None if threshold is None else threshold.error_of(sensor),
            octaves,
            missing="not recorded, or too few smooth surfaces",
        )


LAWS = {
    "signal, mean error over the range": ("white_m2", "near_field_m", "spot_over_field", *LENSES),
    "kept and lost, mean difference": ("threshold_slope", "threshold_pedestal", "threshold_spread", "threshold_least"),
    "range, scatter": ("scatter_c", "column_photons"),
    "range, scatter at rest": (*CONVERTER, COLUMNS),
    "share kept at rest": CONVERTER,
}
"""Quantity of the checks -> estimates that set it."""


def misses_of(checks: Sequence[Held]) -> dict[str, tuple[int, float]]:
    """How many rows of each quantity of `LAWS` fail, and its largest error, of ratios that of the logarithm.

    Quantities that were not compared are left out; what cannot be simulated is endless.
    """
    misses: dict[str, tuple[int, float]] = {}
    for row in checks:
        if row.value is not None:
            is_ratio = row.limits.low is not None and row.limits.low > 0.0
            miss = abs(math.log(row.value)) if is_ratio and row.value > 0.0 else abs(row.value)
            failed, largest = misses.get(row.quantity, (0, 0.0))
            miss = math.inf if math.isnan(miss) else max(miss, largest)
            misses[row.quantity] = failed + (row.verdict is False), miss
    return misses


def _miss_text(failed: int, largest: float) -> str:
    """Words for a quantity's number of rows outside of their limits, and its largest error."""
    return f"misses {count_text(failed, 'limit')}, by {largest:.2g} at most"


def fit_recordings(
    recordings: Sequence[Path],
    sensor: str,
    *,
    metadata: Path | None = None,
    sensor_index: int = 0,
    frames: Sequence[int] | None = None,
) -> tuple[str, Report]:
    """Fit recordings of one unit; returns the text of its sensor file, and the report.

    Args:
        sensor: catalogue sensor of its kind, or a sensor file: the source of all numbers that the recording leaves open
        metadata: the maker's description of the unit; None: the json beside the recording or in the OSF, if any
        sensor_index: which sensor of an OSF, from 0
        frames: indices of the frames of each recording; None: all

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    base = base_text(sensor, metadata_of(recordings[0], metadata), sensor_index=sensor_index)
    where = f"sensor {sensor}"
    base_sensor = parse_sensor(base, where)
    scale = base_sensor.intensity
    if base_sensor.histogram is None and scale is not None and scale.exponent is not None:
        raise InputError(
            f"{where}: intensity.exponent: must be none, as fits of frames at rest take intensities for "
            f"reflectivities; got {float(scale.exponent):g}"
        )
    recording = ", ".join(path.name for path in recordings)
    try:
        scanner = base_sensor.scanner
        sweeps = [on_grid(sweep, scanner) for sweep in _read_sweeps(recordings, metadata, sensor_index, frames)]
        pulses = gather_pulses(sweeps)
        pixels = pixels_at_rest(sweeps, base_sensor)
        at_rest = None if pixels is None else fit_at_rest(pixels, base, where)
        fit = fit_pulses(pulses, base_sensor, at_rest=at_rest)
    except ValueError as error:
        raise InputError(f"{recording}: {error}") from None
    if pixels is not None:
        fit = replace(fit, boards=Boards.of(pixels.select(~pixels.fitted), base_sensor))
    estimates = {estimate.key: estimate for estimate in fit.estimates}
    if any(sweep.second is not None for sweep in sweeps):
        base = with_second_returns(base)
    near_ir = 0.0 if pulses.near_ir is None else float(np.nanmedian(pulses.near_ir[pulses.has_return]))
    before = misses_of(fit.checks(base_sensor, near_ir))
    held: dict[str, str] = {}
    while True:  # without a number, others that depend on it may miss more: what is written is held to its checks
        text, notes = fitted_text(
            base,
            estimates,
            recording,
            where,
            rows=fit.rows,
            at_rest={} if at_rest is None else at_rest.by_key,
            held=held,
        )
        after = misses_of(fit.checks(parse_sensor(text, FITTED), near_ir))
        worse = {
            key: f"fitted, but with it '{quantity}' of what was not fitted {_miss_text(*after[quantity])}, else "
            f"{_miss_text(*before[quantity])}"
            for quantity in after
            if after[quantity][0] and after[quantity] > before[quantity]
            for key in LAWS[quantity]
            if key not in held
        }
        if not worse:
            break
        held |= worse
    if at_rest is not None:
        for key, reason in at_rest.unknown.items():
            notes = (*notes, f"{key} is left as it was: {reason}" if "." in key else f"no {key}: {reason}")
        gauge = ReflectivityGauge.from_sweep(sweeps[0], base_sensor)
        if base_sensor.histogram is None and gauge is not None and gauge.assumed:
            notes = (*notes, SCALE_NOTE)
    klux = _illuminance_klux(sweeps, parse_sensor(text, FITTED))
    text, gain_note = with_background_gain(text, klux, recording)
    notes = (*notes, gain_note) if gain_note else notes
    if pulses.signal is None and fit.scatter is not None:
        notes = (*notes, REFLECTIVITY_NOTE)
    fitted = parse_sensor(text, FITTED)
    return text, _report(fit, pulses, recording, sensor, notes, fitted, near_ir).report()


def _illuminance_klux(sweeps: Sequence[Sweep], sensor: Sensor) -> float:
    """Median illuminance of the frames that explains their NEAR_IR; 0 if none is known."""
    klux = [illuminance_klux(sweep, ReflectivityGauge.from_sweep(sweep), sensor) for sweep in sweeps]
    recorded_klux = [value for value in klux if value is not None]
    return float(np.median(recorded_klux)) if recorded_klux else 0.0


def _read_sweeps(
    recordings: Sequence[Path], metadata: Path | None, sensor_index: int, frames: Sequence[int] | None
) -> list[Sweep]:
    """Read the chosen frames of each recording.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    sweeps: list[Sweep] = []
    for path in recordings:
        with open_recording(path, metadata, sensor_index=sensor_index) as recording:
            sweeps += list(recording) if frames is None else [recording[number] for number in frames]
    return sweeps


def fit_pulses(
    pulses: RecordedPulses, sensor: Sensor | None = None, *, at_rest: FitAtRest | None = None
) -> RecordingFit:
    """Fit all laws to these pulses.

    Args:
        sensor: sensor whose own near field is stretched, unless it has one lens; None: law of one lens
        at_rest: numbers by frames at rest, which may be all that there are

    Raises:
        ValueError: if none can be fitted
    """
    near_field = fit_near_field(pulses, sensor)
    counted = pulses if sensor is None else with_photons(pulses, sensor, near_field)
    fit = RecordingFit(
        near_field=near_field,
        threshold=fit_threshold(pulses),
        scatter=fit_scatter(counted, None if sensor is None else sensor.histogram),
        rows=fit_rows(pulses),
        at_rest=at_rest,
    )
    if not fit.estimates and fit.rows is None:
        raise ValueError(
            "must have SIGNAL, NEAR_IR or REFLECTIVITY of enough pulses, as Ousters record, or intensities of two "
            "frames at rest; got none. Without them only threshold over power could be had, and not apart from the "
            "reflectivities"
        )
    if sensor is None or sensor.histogram is None:
        return fit
    if sensor.histogram.column_photons is not None:
        step_m = float(range_from_time_of_flight_m(time_of_flight_s=sensor.tdc.least_significant_bit_s))
        fit = replace(fit, column_photons=fit_column_photons(counted, sensor.histogram, step_m))
    if fit.threshold is not None:
        fit = replace(fit, ends=_threshold_ends(pulses, fit.threshold, sensor))
    known_keys = [estimate.key for estimate in fit.estimates if estimate.is_known and estimate.key in QUANTITIES]
    return replace(fit, products=find_products(sensor, known_keys) if known_keys else None)


def with_photons(pulses: RecordedPulses, sensor: Sensor, near_field: NearField | None = None) -> RecordedPulses:
    """Pulses with SIGNAL: where it is not recorded, the photons of REFLECTIVITY by a near field, or the sensor's own.

    That is REFLECTIVITY / 100 of a white surface at the pulse's range, up to white; lost pulses have none. Unchanged
    without REFLECTIVITY, or of a sensor that counts no photons.
    """
    if pulses.signal is not None or pulses.reflectivity is None or sensor.histogram is None:
        return pulses
    measured_m = np.where(pulses.reflectivity <= MOST_REFLECTIVITY, pulses.range_m, np.nan)
    law = partial(white_over_range_m2, sensor) if near_field is None else near_field.law
    return replace(pulses, signal=pulses.reflectivity / MOST_REFLECTIVITY * at_pulses(law, measured_m) / measured_m**2)


def _threshold_ends(pulses: RecordedPulses, threshold: Threshold, sensor: Sensor) -> tuple[Estimate, ...]:
    """Spread, least value and factor for lone echoes of the threshold, as far as the recording has them."""
    spread = threshold.spread(sensor)
    least = None if spread is None else fit_least(pulses, threshold, sensor, spread.value)
    ends = (spread, least, fit_lone_factor(pulses, threshold))
    return tuple(estimate for estimate in ends if estimate is not None)


def _report(
    fit: RecordingFit,
    pulses: RecordedPulses,
    recording: str,
    sensor: str,
    notes: Sequence[str],
    fitted: Sensor,
    near_ir: float,
) -> FitReport:
    count = int(pulses.recorded.sum())
    numbers: dict[str, Any] = {"recording": recording, "sensor": sensor, "pulses": count, "frames": pulses.frames}
    if fit.rows is not None:
        numbers["row_gains"] = {"gain": fit.rows.gain.tolist(), "sigma": fit.rows.sigma.tolist()}
    solutions: dict[str, tuple[Sequence[str], Solution]] = {}
    if fit.near_field is not None:
        solutions["near field"] = fit.near_field.parameters, fit.near_field.solved
    if fit.threshold is not None:
        solutions["threshold"] = ("ln slope", "pedestal", "ln width"), fit.threshold.solved
    if fit.scatter is not None:
        numbers["scatter_correlation"] = fit.scatter.correlation
        if fit.scatter.correlation > 1.0:
            share = fit.scatter.correlation**-0.5
            shared = f"columns share noise: every second pulse scatters by {share:.0%} of what pulses far apart do"
            notes = (*notes, shared)
        solutions["scatter"] = ("c^2", "floor^2"), fit.scatter.solved
    if fit.at_rest is not None:
        solutions |= fit.at_rest.solutions
    products = fit.products
    return FitReport(
        title=f"{recording}: what it says of {sensor}",
        summary=f"{recording}: {count:,} pulses of {count_text(pulses.frames, 'frame')}. Three of four blocks of "
        "columns were fitted, the fourth judges the fit. Sigma is that of the Fisher matrix, unless a bootstrap of the "
        "blocks says 1.3 times as much.",
        checks=fit.checks(fitted, near_ir),
        estimates=fit.estimates,
        notes=notes,
        null=() if products is None else products.null,
        held=() if products is None else products.fixed,
        products={} if products is None else {name: products.product(name) for name in products.quantities},
        solutions=solutions,
        figures=_figures(fit, fitted),
        numbers=numbers,
    )


def _figures(fit: RecordingFit, fitted: Sensor) -> list[Figure]:
    figures = []
    if fit.near_field is not None:
        figures += _near_field(fit.near_field)
    if fit.threshold is not None and fitted.histogram is not None:
        figures.append(share_figure("threshold", fit.threshold.shares(fitted)))
    if fit.scatter is not None:
        figures.append(_scatter(fit.scatter))
    if fit.rows is not None:
        figures.append(_rows(fit.rows))
    return figures


def _near_field(near: NearField) -> list[Figure]:
    law, check_law = near.law(near.range_m), near.law(near.check_range_m)
    table = {"range_m": near.range_m, "white_m2": near.white_m2, "law": law, "sigma_of_ln": near.sigma}
    curves = {
        "recorded": (near.range_m, near.white_m2),
        "not fitted": (near.check_range_m, near.check_white_m2),
        "law": (near.range_m, law),
    }
    ratios = {
        "recorded": (near.range_m, near.white_m2 / law),
        "not fitted": (near.check_range_m, near.check_white_m2 / check_law),
    }
    caption = f"Photons of a white target times the square of its range. The law misses {near.misfit:.1%} (deviation)."
    y_label = "SIGNAL R² 100 / REFLECTIVITY [photons m²]"
    return [
        law_figure("near-field", caption, ("range [m]", y_label), curves, table),
        law_figure("near-field-residuals", "The same over the law.", ("range [m]", "ratio to the law"), ratios, table),
    ]


def _scatter(scatter: Scatter) -> Figure:
    (signal, sigma_m, _), (held_out_signal, held_out_m, _) = scatter.fitted.T, scatter.held_out.T
    held_out_mm = dict(zip(held_out_signal, 1e3 * held_out_m, strict=True))
    columns = {
        "signal": signal,
        "sigma_mm": 1e3 * sigma_m,
        "not_fitted_mm": np.array([held_out_mm.get(value, np.nan) for value in signal]),
        "law_mm": 1e3 * scatter.law(signal),
    }
    curves = dict(zip(("recorded", "not fitted", "law"), list(columns.values())[1:], strict=True))
    return law_figure(
        "scatter",
        "Scatter of every second pulse of a row about a parabola, on smooth surfaces.",
        ("SIGNAL [photons]", "scatter of the range [mm]"),
        {label: (signal, sigma_mm) for label, sigma_mm in curves.items()},
        columns,
    )


def _rows(rows: RowGains) -> Figure:
    number = np.arange(len(rows.gain), dtype=float)
    chart = Chart(
        lines=(Line(label="", x=number, y=rows.gain),), x_label="row, from the top", y_label="gain of NEAR_IR"
    )
    caption = f"Gain of each row, +/- {rows.sigma[0]:.1%}; their spread is {rows.spread:.1%}."
    table = list(zip(number, rows.gain, rows.sigma, strict=True))
    return Figure("rows", chart, (("row", "gain", "sigma"), table), caption)
