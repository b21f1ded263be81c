"""Report of a fit: checks, estimates, figures, correlations and undetermined directions, as page, JSON and text."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...figures.lines import Chart, Line
from ...figures.report import Figure, Report, count_text, require_writable_files
from ...files.atomic import require_writable
from ...maths.arrays import Numbers
from ..held import LIMITS, Held, held_table, passed, value_text, verdict
from .estimates import Estimate, Solution
from .near_field import NearField
from .products import Products
from .row_gains import RowGains
from .scatter import Scatter
from .threshold import Threshold

PAGE, NUMBERS, MARKDOWN = "index.html", "fit.json", "fit.md"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordingFit:
    """Result of a fit without a scene; None for laws whose fields were not recorded.

    spread  spread of the threshold, without what the sensor's filter adds to its width
    """

    recording: str
    sensor: str
    pulses: int
    frames: int
    near_field: NearField | None
    threshold: Threshold | None
    scatter: Scatter | None
    rows: RowGains | None
    spread: Estimate | None = None
    products: Products | None = None
    notes: tuple[str, ...] = ()

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """Estimates of all laws."""
        laws = (self.near_field, self.threshold, self.scatter)
        estimates = [estimate for law in laws if law is not None for estimate in law.estimates]
        return tuple(estimates if self.spread is None else [*estimates, self.spread])

    @property
    def checks(self) -> list[Held]:
        """Comparison of each law with the held-out blocks."""
        return law_rows(
            None if self.near_field is None else self.near_field.error,
            None if self.threshold is None else self.threshold.error,
            np.zeros((0, 4)) if self.scatter is None else self.scatter.octaves,
            missing="not recorded, or too few smooth surfaces",
        )


def law_rows(signal_error: float | None, kept_error: float | None, octaves: Numbers, *, missing: str) -> list[Held]:
    """Signal, share of returns and scatter of the held-out pulses beside the fitted laws.

    signal_error  mean relative error of the signal over the range; None: not known
    kept_error    mean difference of the share of returns; None: not known
    octaves       (k, 4) signal, recorded scatter [m], fitted scatter [m], relative sigma of their ratio
    missing       note where there is nothing to compare
    """
    rows = [
        Held(quantity="signal, mean error over the range", value=signal_error, limits=LIMITS["signal error"]),
        Held(quantity="kept and lost, mean difference", value=kept_error, limits=LIMITS["share of returns"]),
    ]
    # Of octaves whose true ratio is the limit one in 40 is beyond it by 2 sigma; if it is 1, fewer than one in 1000.
    rows += [
        Held(
            quantity="range, scatter",
            condition=f"signal {signal / math.sqrt(2.0):.0f} to {signal * math.sqrt(2.0):.0f}, within 2 sigma",
            reference=1e3 * recorded_m,
            simulated=1e3 * fitted_m,
            value=fitted_m / recorded_m,
            limits=LIMITS["scatter ratio"].widened(math.exp(2.0 * sigma)),
            unit="mm",
        )
        for signal, recorded_m, fitted_m, sigma in octaves.tolist()
    ] or [Held(quantity="range, scatter", limits=LIMITS["scatter ratio"])]
    return [replace(row, note=missing) if row.value is None else row for row in rows]


def check_as_dict(row: Held) -> dict[str, Any]:
    """Check as a dictionary for JSON."""
    name = f"{row.quantity}, {row.condition}" if row.condition else row.quantity
    return {"name": name, "found": value_text(row.value) or row.note, "wanted": str(row.limits), "held": row.verdict}


def uncertainty_as_dict(estimate: Estimate) -> dict[str, Any]:
    """Uncertainties of an estimate for JSON."""
    sigmas = {"sigma": estimate.sigma, "fisher": estimate.fisher, "bootstrap": estimate.bootstrap}
    return sigmas | {"known": estimate.is_known}


def as_dict(fit: RecordingFit) -> dict[str, Any]:
    """Result as a dictionary for JSON."""
    numbers: dict[str, Any] = {
        "recording": fit.recording,
        "sensor": fit.sensor,
        "pulses": fit.pulses,
        "frames": fit.frames,
        "passed": passed(fit.checks),
        "estimates": {
            estimate.key: {"value": estimate.value, "unit": estimate.unit, **uncertainty_as_dict(estimate)}
            for estimate in fit.estimates
        },
        "checks": [check_as_dict(check) for check in fit.checks],
        "correlations": {name: solved.correlation.tolist() for name, _, solved in _solved(fit)},
    }
    if fit.rows is not None:
        numbers["row_gains"] = {"gain": fit.rows.gain.tolist(), "sigma": fit.rows.sigma.tolist()}
    if fit.products is not None:
        products = fit.products
        numbers["products"] = {name: products.product(name) for name in products.quantities}
        numbers["not_identified"] = list(products.null)
        numbers["held"] = list(products.fixed)
    numbers["notes"] = list(fit.notes)
    return numbers


def add_results(report: Report, checks: Sequence[Held], estimates: Sequence[Estimate]) -> None:
    """Add whether the fit passed, and a table of the estimates."""
    report.heading("Pass or fail")
    report.paragraph(verdict(checks, "The fit"))
    report.table(*held_table(checks, reference="recorded", simulated="fitted"))
    report.heading("Estimates")
    report.table(
        ("number", "value", "sigma, Fisher", "sigma, bootstrap", ""),
        [
            (
                estimate.key,
                f"{estimate.value:.4g} {estimate.unit}".rstrip(),
                f"{estimate.fisher:.2g}",
                f"{estimate.bootstrap:.2g}",
                "" if estimate.is_known else "not known",
            )
            for estimate in estimates
        ],
    )


def add_notes(report: Report, notes: Sequence[str]) -> None:
    """Add each note as a sentence of its own, which begins with a capital or with the key of a sensor file."""
    for note in notes:
        report.paragraph((note if "." in note.split()[0] else note[:1].upper() + note[1:]) + ".")


def add_correlations(report: Report, parameters: Sequence[str], solved: Solution) -> None:
    """Add a table of the correlations of the parameters."""
    report.table(
        ("", *parameters),
        [
            (parameter, *(f"{value:.2f}" for value in row))
            for parameter, row in zip(parameters, solved.correlation, strict=True)
        ],
    )


def check_outputs(output: Path, report: Path) -> None:
    """Refuse a sensor file and a folder that cannot be written, before any work. Raises InputError, OutputError."""
    if output.suffix.lower() != ".toml":
        raise InputError(f"--output {output}: the name must end in .toml")
    require_writable(output)
    require_writable_files(report, (PAGE, NUMBERS))


def write_report(fit: RecordingFit, folder: Path) -> str:
    """Write page, Markdown, figures with their data, and JSON; returns the text to print. Raises OutputError."""
    report = Report(f"{fit.recording}: what it says of {fit.sensor}", folder)
    report.paragraph(
        f"{fit.recording}: {fit.pulses:,} pulses of {count_text(fit.frames, 'frame')}. Three of four blocks of columns "
        "were fitted, the fourth judges the fit. Sigma is that of the Fisher matrix, unless a bootstrap of the blocks "
        "says 1.3 times as much."
    )
    add_results(report, fit.checks, fit.estimates)
    add_notes(report, fit.notes)
    if fit.products is not None:
        report.heading("What cannot be told apart")
        report.paragraph(
            "Each known quantity is a product of numbers of the sensor file. Each line below changes none of them, so "
            "the first number of each line stays at the value of the file that the fit started from."
        )
        report.table(("not known",), [(direction,) for direction in fit.products.null])
    text = report.as_text()
    if fit.products is not None:
        report.table(("known", "product"), [(name, fit.products.product(name)) for name in fit.products.quantities])
    for number, figure in enumerate(_figures(fit), start=1):
        report.figure(figure._replace(number=str(number)))
    report.heading("Correlations")
    for name, parameters, solved in _solved(fit):
        report.paragraph(name)
        add_correlations(report, parameters, solved)
    report.write(PAGE, MARKDOWN, NUMBERS, numbers=as_dict(fit))
    return text


def _figures(fit: RecordingFit) -> list[Figure]:
    figures = []
    if fit.near_field is not None:
        figures += _near_field(fit.near_field)
    if fit.threshold is not None:
        figures.append(_threshold(fit.threshold))
    if fit.scatter is not None:
        figures.append(_scatter(fit.scatter))
    if fit.rows is not None:
        figures.append(_rows(fit.rows))
    return figures


def _near_field(near: NearField) -> list[Figure]:
    law = near.law(near.range_m)
    curve = Chart(
        lines=(
            Line(label="recorded", x=near.range_m, y=near.white_m2, colour=0),
            Line(label="not fitted", x=near.check_range_m, y=near.check_white_m2, colour=2, style="dotted"),
            Line(label="law", x=near.range_m, y=law, colour=1, style="dashed"),
        ),
        x_label="range [m]",
        y_label="SIGNAL R² 100 / REFLECTIVITY [photons m²]",
        x_log=True,
        y_log=True,
    )
    check = near.check_white_m2 / near.law(near.check_range_m)
    residuals = Chart(
        lines=(
            Line(label="recorded over law", x=near.range_m, y=near.white_m2 / law),
            Line(label="not fitted", x=near.check_range_m, y=check, colour=2, style="dotted"),
        ),
        x_label="range [m]",
        y_label="ratio",
        x_log=True,
    )
    rows = list(zip(near.range_m, near.white_m2, law, near.sigma, strict=True))
    head = ("range_m", "white_m2", "law", "sigma_of_ln")
    caption = f"Photons of a white target times the square of its range. The law misses {near.misfit:.1%} (deviation)."
    return [
        Figure("near-field", curve, (head, rows), caption),
        Figure("near-field-residuals", residuals, (head, rows), "The same over the law."),
    ]


def _threshold(threshold: Threshold) -> Figure:
    chart = Chart(
        lines=(
            Line(label="found", x=threshold.expected_share, y=threshold.kept_share),
            Line(label="expected", x=threshold.expected_share, y=threshold.expected_share, colour=1, style="dashed"),
        ),
        x_label="chance of a return, by the law",
        y_label="share with a return",
        x_limits=(0.0, 1.0),
        y_limits=(0.0, 1.0),
    )
    rows = list(zip(threshold.expected_share, threshold.kept_share, threshold.pulses.tolist(), strict=True))
    caption = "Kept pulses of the blocks that were not fitted, by the chance that the law gives them."
    return Figure("threshold", chart, (("expected", "found", "pulses"), rows), caption)


def _scatter(scatter: Scatter) -> Figure:
    law = scatter.law(scatter.signal)
    chart = Chart(
        lines=(
            Line(label="recorded", x=scatter.signal, y=1e3 * scatter.sigma_m),
            Line(label="not fitted", x=scatter.signal, y=1e3 * scatter.check_sigma_m, colour=2, style="dotted"),
            Line(label="law", x=scatter.signal, y=1e3 * law, colour=1, style="dashed"),
        ),
        x_label="SIGNAL [photons]",
        y_label="scatter of the range [mm]",
        x_log=True,
        y_log=True,
    )
    rows = list(zip(scatter.signal, 1e3 * scatter.sigma_m, 1e3 * scatter.check_sigma_m, 1e3 * law, strict=True))
    caption = "Scatter of every second pulse of a row about a parabola, on smooth surfaces."
    return Figure("scatter", chart, (("signal", "sigma_mm", "not_fitted_mm", "law_mm"), rows), caption)


def _rows(rows: RowGains) -> Figure:
    number = np.arange(len(rows.gain), dtype=float)
    chart = Chart(
        lines=(Line(label="", x=number, y=rows.gain),), x_label="row, from the top", y_label="gain of NEAR_IR"
    )
    caption = f"Gain of each row, +/- {rows.sigma[0]:.1%}; their spread is {rows.spread:.1%}."
    table = list(zip(number, rows.gain, rows.sigma, strict=True))
    return Figure("rows", chart, (("row", "gain", "sigma"), table), caption)


def _solved(fit: RecordingFit) -> list[tuple[str, tuple[str, ...], Solution]]:
    solutions: list[tuple[str, tuple[str, ...], Solution]] = []
    if fit.near_field is not None:
        solutions.append(
            (
                "near field",
                ("ln white_m2", "ln R0", "ln spot")[: len(fit.near_field.solved.value)],
                fit.near_field.solved,
            )
        )
    if fit.threshold is not None:
        solutions.append(("threshold", ("SIGNAL", "constant", "sqrt(NEAR_IR)"), fit.threshold.solved))
    if fit.scatter is not None:
        solutions.append(("scatter", ("c^2", "floor^2"), fit.scatter.solved))
    return solutions
