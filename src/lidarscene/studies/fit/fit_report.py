"""Report of a fit: checks, estimates, figures, correlations and undetermined directions, as page, JSON and text."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ...figures.lines import Chart, Line
from ...figures.report import PAGE, Figure, Report
from ...maths.arrays import Numbers
from ..held import LIMITS, Held, held_table, passed, value_text, verdict
from .estimates import Estimate, Solution

NUMBERS, MARKDOWN = "fit.json", "fit.md"

FITTED = "fitted sensor"
"""Name of the fitted sensor's file in messages."""

STYLES: dict[str, dict[str, Any]] = {
    "recorded": {"colour": 0},
    "not fitted": {"colour": 2, "style": "dotted"},
    "law": {"colour": 1, "style": "dashed"},
}
"""Label of a curve -> its look."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FitReport:
    """Contents of a fit's report.

    Attributes:
        notes: notes for the reader, without full stop: which numbers of the file stay, with the reason
        null: a line for each direction that the recording does not determine
        held: keys that keep the values of the file
        products: quantity -> product of numbers of the file that it is
        solutions: name -> parameters, and solution
        numbers: entries of the JSON that only this kind of fit has
    """

    title: str
    summary: str
    checks: Sequence[Held]
    estimates: Sequence[Estimate]
    notes: Sequence[str]
    null: Sequence[str]
    held: Sequence[str]
    products: Mapping[str, str]
    solutions: Mapping[str, tuple[Sequence[str], Solution]]
    figures: Sequence[Figure]
    numbers: Mapping[str, Any]

    def _as_dict(self) -> dict[str, Any]:
        """Results as a dictionary for JSON."""
        return {
            **self.numbers,
            "passed": passed(self.checks),
            "estimates": {estimate.key: _estimate_as_dict(estimate) for estimate in self.estimates},
            "checks": [check_as_dict(check) for check in self.checks],
            "correlations": {
                name: {"names": list(names), "matrix": solved.correlation.tolist()}
                for name, (names, solved) in self.solutions.items()
            },
            "products": dict(self.products),
            "misfit": self._misfits(),
            "not_identified": list(self.null),
            "held": list(self.held),
            "notes": list(self.notes),
        }

    def report(self) -> Report:
        """Page, figures with their data, and numbers."""
        estimates = [
            (estimate.key, estimate.value, estimate.unit, estimate.sigma, estimate.is_known)
            for estimate in self.estimates
        ]
        report = Report(
            self.title,
            numbers=self._as_dict(),
            main_table=(("key", "value", "unit", "sigma", "known"), estimates),
            passed=passed(self.checks),
            pages=(PAGE, MARKDOWN, NUMBERS),
        )
        report.add_paragraph(self.summary)
        report.add_heading("Pass or fail")
        report.add_paragraph(verdict(self.checks, "The written file"))
        report.add_table(*held_table(self.checks, reference="recorded", simulated="written file"))
        report.add_heading("Estimates")
        report.add_table(
            ("number", "value", "sigma, Fisher", "sigma, bootstrap", ""),
            [
                (
                    estimate.key,
                    f"{estimate.value:.4g} {estimate.unit}".rstrip(),
                    f"{estimate.misfit * estimate.fisher:.2g}",
                    f"{estimate.misfit * estimate.bootstrap:.2g}",
                    "" if estimate.is_known else "not known",
                )
                for estimate in self.estimates
            ],
        )
        for name, factor in self._misfits().items():
            report.add_paragraph(
                f"The law of the {name} misses its bins by {factor:.2g} times their sigmas (root of the reduced "
                "chi-square), and its sigmas are that much larger."
            )
        for name, (_, solved) in self.solutions.items():
            if solved.at_limit:
                report.add_paragraph(f"The fit of {name} stopped at its largest number of steps, before it converged.")
        for note in self.notes:  # a sentence of its own, which begins with a capital or with the key of a sensor file
            report.add_paragraph((note if "." in note.split()[0] else note[:1].upper() + note[1:]) + ".")
        if self.null:
            report.add_heading("Undetermined directions")
            report.add_paragraph(
                "If the numbers of a line change together, nothing changes that was recorded. The first number of each "
                "line stays as the file has it."
            )
            report.add_table(("undetermined",), [(direction,) for direction in self.null])
        report.summary = report.as_text()
        if self.products:
            report.add_table(("known", "product"), list(self.products.items()))
        for number, figure in enumerate(self.figures, start=1):
            report.add_figure(figure._replace(number=str(number)))
        report.add_heading("Correlations")
        for name, (names, solved) in self.solutions.items():
            report.add_paragraph(name)
            rows = zip(names, solved.correlation, strict=True)
            report.add_table(("", *names), [(row_name, *(f"{value:.2f}" for value in row)) for row_name, row in rows])
        return report

    def _misfits(self) -> dict[str, float]:
        """Name -> factor on the uncertainties, of the laws that do not hold."""
        return {name: solved.misfit for name, (_, solved) in self.solutions.items() if solved.misfit > 1.0}


def law_rows(
    signal_error: float | None, share_error: float | None, octaves: Iterable[tuple[float, ...]], *, missing: str
) -> list[Held]:
    """Signal, share of returns and scatter of the held-out pulses beside the fitted laws.

    Args:
        signal_error: mean relative error of the signal over the range; None: not known
        share_error: mean difference of the share of returns; None: not known
        octaves: signal, recorded scatter [m], fitted scatter [m]
        missing: note where there is nothing to compare
    """
    rows = [
        Held(quantity="signal, mean error over the range", value=signal_error, limits=LIMITS["signal error"]),
        Held(quantity="kept and lost, mean difference", value=share_error, limits=LIMITS["share of returns"]),
    ]
    rows += [
        Held(
            quantity="range, scatter",
            condition=f"signal {signal / math.sqrt(2.0):.0f} to {signal * math.sqrt(2.0):.0f}",
            reference=1e3 * recorded_m,
            simulated=1e3 * fitted_m,
            value=fitted_m / recorded_m,
            limits=LIMITS["scatter ratio"],
            unit="mm",
        )
        for signal, recorded_m, fitted_m in octaves
    ] or [Held(quantity="range, scatter", limits=LIMITS["scatter ratio"])]
    return [replace(row, note=missing) if row.value is None else row for row in rows]


def check_as_dict(row: Held) -> dict[str, Any]:
    """Check as a dictionary for JSON."""
    name = f"{row.quantity}, {row.condition}" if row.condition else row.quantity
    return {"name": name, "found": value_text(row.value) or row.note, "wanted": str(row.limits), "held": row.verdict}


def _estimate_as_dict(estimate: Estimate) -> dict[str, Any]:
    is_factor = estimate.unit == "times"
    return {
        **({"times": estimate.value} if is_factor else {"value": estimate.value, "unit": estimate.unit}),
        "sigma": estimate.sigma,
        "fisher": estimate.fisher,
        "bootstrap": estimate.bootstrap,
        "known": estimate.is_known,
    }


def law_figure(
    name: str,
    caption: str,
    axes: tuple[str, str],
    curves: Mapping[str, tuple[Numbers, Numbers]],
    table: Mapping[str, Numbers],
    **options: Any,
) -> Figure:
    """Figure of a law beside recorded values, on logarithmic axes.

    Args:
        axes: their labels
        curves: label, as in `STYLES` -> x and y
        table: heading -> column of the data beside the figure
        options: further options of the chart
    """
    chart = Chart(
        lines=tuple(Line(label=label, x=x, y=y, **STYLES[label]) for label, (x, y) in curves.items()),
        x_label=axes[0],
        y_label=axes[1],
        **({"x_log": True, "y_log": True} | options),
    )
    return Figure(name, chart, (tuple(table), list(zip(*table.values(), strict=True))), caption)


def share_figure(name: str, shares: Numbers) -> Figure:
    """Figure of the shares of returns of held-out pulses.

    Args:
        shares: (k, 3) chance of a return by the law, recorded share, number of pulses
    """
    chance, kept, pulses = shares.T
    table = {"chance": chance, "kept": kept, "pulses": pulses.astype(int)}
    caption = "Share of the pulses that were not fitted that was kept, by the chance that the law gives them."
    axes = "chance of a return, by the law", "share with a return"
    limits = {"x_log": False, "y_log": False, "x_limits": (0.0, 1.0), "y_limits": (0.0, 1.0)}
    return law_figure(name, caption, axes, {"recorded": (chance, kept), "law": (chance, chance)}, table, **limits)
