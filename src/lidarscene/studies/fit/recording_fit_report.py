"""Report of a fit: checks, estimates, figures, correlations and undetermined directions, as page, JSON and text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...figures import lines
from ...figures.lines import Chart, Line
from ...figures.report_page import Page, count_text, csv_text
from ...files.atomic import put_text, require_writable
from ...files.json_text import json_text
from .estimates import Estimate, Solution
from .near_field import NearField
from .products import Products
from .row_gains import RowGains
from .scatter import Scatter
from .threshold import Threshold

PAGE, NUMBERS, MARKDOWN = "index.html", "fit.json", "fit.md"

SIGNAL_ERROR = 0.15
"""Largest mean relative error of the signal over the range, the limit of `twin.judge`, too."""

KEPT_ERROR = 0.1
"""Largest mean difference between the recorded share of returns and the law, over the chances from 0 to 1.

This project's choice: held-out columns of three recorded Ousters came to 0.04, 0.05 and 0.14 (docs/fit.md)."""

SCATTER_RATIO = 1.25
"""Largest ratio of scatters in an octave of the signal, either way, as in `twin.judge`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LawCheck:
    """Comparison of a law with held-out blocks. The fields are keys of the JSON.

    found   measured error or ratio, as text
    wanted  limit, as text
    held    True if within the limit; None: too little was recorded
    """

    name: str
    found: str
    wanted: str
    held: bool | None

    def __str__(self) -> str:
        return f"{self.name}: {self.found} ({self.wanted}){'  FAILED' if self.held is False else ''}"


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
    def checks(self) -> tuple[LawCheck, ...]:
        """Comparison of each law with the held-out blocks."""
        near, threshold, scatter = self.near_field, self.threshold, self.scatter
        ratios = None if scatter is None or not len(scatter.ratios) else scatter.ratios
        return (
            LawCheck(
                name="signal over the range",
                wanted=f"mean error <= {SIGNAL_ERROR:.0%}",
                found="not recorded" if near is None else f"{near.error:.1%}",
                held=None if near is None else near.error <= SIGNAL_ERROR,
            ),
            LawCheck(
                name="kept and lost",
                wanted=f"mean difference <= {KEPT_ERROR:g}",
                found="not recorded" if threshold is None else f"{threshold.error:.3f}",
                held=None if threshold is None else threshold.error <= KEPT_ERROR,
            ),
            LawCheck(
                name="scatter by octave of the signal",
                wanted=f"{1 / SCATTER_RATIO:g} to {SCATTER_RATIO:g} of the law, within 2 sigma",
                found="too few smooth surfaces" if ratios is None else f"{ratios.min():.2f} to {ratios.max():.2f}",
                held=None if scatter is None or ratios is None else not scatter.beyond(SCATTER_RATIO),
            ),
        )

    @property
    def passed(self) -> bool:
        """True if no check failed."""
        return all(check.held is not False for check in self.checks)


def as_dict(fit: RecordingFit) -> dict[str, Any]:
    """Result as a dictionary for JSON."""
    report: dict[str, Any] = {
        "recording": fit.recording,
        "sensor": fit.sensor,
        "pulses": fit.pulses,
        "frames": fit.frames,
        "passed": fit.passed,
        "estimates": {
            estimate.key: {
                "value": estimate.value,
                "unit": estimate.unit,
                "sigma": _finite(estimate.sigma),
                "fisher": _finite(estimate.fisher),
                "bootstrap": _finite(estimate.bootstrap),
                "known": estimate.is_known,
            }
            for estimate in fit.estimates
        },
        "checks": [asdict(check) for check in fit.checks],
        "correlations": {name: solved.correlation.tolist() for name, _, solved in _solved(fit)},
    }
    if fit.rows is not None:
        report["row_gains"] = {"gain": fit.rows.gain.tolist(), "sigma": fit.rows.sigma.tolist()}
    if fit.products is not None:
        products = fit.products
        report["products"] = {name: products.product(name) for name in products.quantities}
        report["not_identified"] = list(products.null)
        report["held"] = list(products.fixed)
    report["notes"] = list(fit.notes)
    return report


def as_text(fit: RecordingFit) -> str:
    """Result as text for the terminal."""
    lines_ = [f"{fit.recording}: {fit.pulses:,} pulses, {fit.frames} frame{'s' if fit.frames > 1 else ''}"]
    lines_ += [f"  {estimate.key:<18} {_number(estimate)}" for estimate in fit.estimates]
    if fit.rows is not None:
        lines_.append(f"  {'row gains':<18} spread {fit.rows.spread:.1%}, each +/- {fit.rows.sigma[0]:.1%}")
    lines_ += [f"  {check}" for check in fit.checks]
    if fit.products is not None and fit.products.null:
        lines_.append("  cannot be told apart, held at the values of the file:")
        lines_ += [f"    {direction}" for direction in fit.products.null]
    lines_ += [f"  {note}" for note in fit.notes]
    return "\n".join(lines_)


Table = tuple[Sequence[str], Sequence[Sequence[Any]]]
Figure = tuple[str, str, Chart, Table]
"""Name of a figure's files, caption, chart, and its data as a table (head, rows)."""


def add_checks(page: Page, checks: Sequence[LawCheck]) -> None:
    """Add the table of checks to a page."""
    page.heading("Pass or fail")
    verdict = {None: "-", True: "pass", False: "FAIL"}
    rows = [(check.name, check.found, check.wanted, verdict[check.held]) for check in checks]
    page.table(("law", "found", "wanted", ""), rows)


def add_notes(page: Page, notes: Sequence[str]) -> None:
    """Add each note as a sentence of its own."""
    for note in notes:
        page.paragraph(note[:1].upper() + note[1:] + ".")


def add_figures(page: Page, folder: Path, figures: Sequence[Figure]) -> None:
    """Draw the figures beside the page, with their data. Raises OutputError."""
    for number, (name, caption, chart, table) in enumerate(figures, start=1):
        lines.save(chart, [folder / f"{name}.png", folder / f"{name}.svg"])
        put_text(folder / f"{name}.csv", csv_text(*table))
        page.figure(name=name, number=str(number), caption=caption)


def write_page(page: Page, folder: Path, numbers: Mapping[str, Any]) -> None:
    """Write the page, as HTML and as Markdown, and the numbers as JSON. Raises OutputError."""
    put_text(folder / PAGE, page.as_html())
    put_text(folder / MARKDOWN, page.as_markdown())
    put_text(folder / NUMBERS, json_text(numbers, indent=1) + "\n")


def check_outputs(output: Path, report: Path) -> None:
    """Refuse a sensor file and a folder that cannot be written, before any work. Raises InputError, OutputError."""
    if output.suffix.lower() != ".toml":
        raise InputError(f"--output {output}: the name must end in .toml")
    require_writable(output)
    for name in (PAGE, NUMBERS):
        require_writable(report / name)


def printed_text(numbers: Mapping[str, Any], text: str, output: Path, report: Path, *, as_json: bool) -> str:
    """Text to print: JSON, or the summary and where the files are."""
    return json_text(numbers) if as_json else f"{text}\nwrote {output} and {report / PAGE}"


def write_report(fit: RecordingFit, folder: Path) -> None:
    """Write page, Markdown, figures with their data, and JSON. Raises OutputError."""
    page = Page(f"{fit.recording}: what it says of {fit.sensor}", folder=folder)
    page.paragraph(
        f"{fit.pulses:,} pulses of {count_text(fit.frames, 'frame')}. Three of four blocks of columns were fitted, the "
        "fourth judges the fit. Sigma is that of the Fisher matrix, unless a bootstrap of the blocks says 1.3 times as "
        "much."
    )
    add_checks(page, fit.checks)
    page.heading("Estimates")
    page.table(
        ("quantity", "value", "sigma, Fisher", "sigma, bootstrap", ""),
        [
            (
                estimate.key,
                f"{estimate.value:.4g} {estimate.unit}",
                f"{estimate.fisher:.2g}",
                f"{estimate.bootstrap:.2g}",
                "" if estimate.is_known else "not known",
            )
            for estimate in fit.estimates
        ],
    )
    add_notes(page, fit.notes)
    add_figures(page, folder, _figures(fit))
    page.heading("Correlations")
    for name, parameters, solved in _solved(fit):
        page.paragraph(name)
        page.table(
            ("", *parameters),
            [
                (parameter, *(f"{value:.2f}" for value in row))
                for parameter, row in zip(parameters, solved.correlation, strict=True)
            ],
        )
    if fit.products is not None:
        page.heading("What cannot be told apart")
        page.paragraph(
            "Each known quantity is a product of numbers of the sensor file. Each line below changes none of them, so "
            "the first number of each line stays at the value of the file that the fit started from."
        )
        page.table(("known", "product"), [(name, fit.products.product(name)) for name in fit.products.quantities])
        page.table(("not known",), [(direction,) for direction in fit.products.null])
    write_page(page, folder, as_dict(fit))


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
        ("near-field", caption, curve, (head, rows)),
        ("near-field-residuals", "The same over the law.", residuals, (head, rows)),
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
    return "threshold", caption, chart, (("expected", "found", "pulses"), rows)


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
    return "scatter", caption, chart, (("signal", "sigma_mm", "not_fitted_mm", "law_mm"), rows)


def _rows(rows: RowGains) -> Figure:
    number = np.arange(len(rows.gain), dtype=float)
    chart = Chart(
        lines=(Line(label="", x=number, y=rows.gain),), x_label="row, from the top", y_label="gain of NEAR_IR"
    )
    caption = f"Gain of each row, +/- {rows.sigma[0]:.1%}; their spread is {rows.spread:.1%}."
    table = list(zip(number, rows.gain, rows.sigma, strict=True))
    return "rows", caption, chart, (("row", "gain", "sigma"), table)


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


def _number(estimate: Estimate) -> str:
    text = f"{estimate.value:.4g} +/- {estimate.sigma:.2g} {estimate.unit}".rstrip()
    return text if estimate.is_known else f"{text} (not known)"


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
