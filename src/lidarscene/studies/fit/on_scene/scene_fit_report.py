"""Report of a fit with a scene: page, JSON and text."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ....figures.lines import Chart, Line
from ....figures.report_page import Page, count_text
from ....maths.arrays import Numbers
from ..estimates import Estimate
from ..recording_fit_report import (
    KEPT_ERROR,
    SCATTER_RATIO,
    SIGNAL_ERROR,
    Figure,
    LawCheck,
    add_checks,
    add_figures,
    add_notes,
    write_page,
)
from .held_out_bins import HeldOutBins
from .likelihood import ParameterFit


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SceneFit:
    """Result of a fit with a scene.

    pulses             number of fitted pulses, and of held-out ones
    evaluations        number of evaluations of the likelihood, over all rounds
    texture, strangers  as in `known_scene.KnownScene`, estimated along with the parameters
    notes              notes for the reader: what the scene was made of, which numbers of the file stay as they were
    """

    recording: str
    scene: str
    sensor: str
    frames: int
    pulses: tuple[int, int]
    parameter_fit: ParameterFit
    held_out_bins: HeldOutBins
    evaluations: int
    texture: float
    strangers: float
    notes: tuple[str, ...] = ()

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """Estimates of the parameters, as factors of the file's values."""
        return self.parameter_fit.estimates

    @property
    def checks(self) -> tuple[LawCheck, ...]:
        """Comparison of signal, kept share and scatter with their limits, on the held-out columns."""
        bins = self.held_out_bins
        signal_error, kept_error, ratios = bins.signal_error, bins.kept_error, bins.ratios
        return (
            LawCheck(
                name="signal over the range",
                wanted=f"mean error <= {SIGNAL_ERROR:.0%}",
                found="too few" if signal_error is None else f"{signal_error:.1%}",
                held=None if signal_error is None else signal_error <= SIGNAL_ERROR,
            ),
            LawCheck(
                name="kept and lost",
                wanted=f"mean difference <= {KEPT_ERROR:g}",
                found="too few" if kept_error is None else f"{kept_error:.3f}",
                held=None if kept_error is None else kept_error <= KEPT_ERROR,
            ),
            LawCheck(
                name="scatter by octave of the signal",
                wanted=f"{1 / SCATTER_RATIO:g} to {SCATTER_RATIO:g} of the law, within 2 sigma",
                found="too few" if not len(ratios) else f"{ratios.min():.2f} to {ratios.max():.2f}",
                held=None if not len(ratios) else not bins.beyond(SCATTER_RATIO),
            ),
        )

    @property
    def passed(self) -> bool:
        """True if no check failed."""
        return all(check.held is not False for check in self.checks)


def as_dict(fit: SceneFit) -> dict[str, Any]:
    """Result as a dictionary for JSON."""
    return {
        "recording": fit.recording,
        "scene": fit.scene,
        "sensor": fit.sensor,
        "frames": fit.frames,
        "pulses": {"fitted": fit.pulses[0], "not fitted": fit.pulses[1]},
        "passed": fit.passed,
        "estimates": {
            estimate.key: {
                "times": estimate.value,
                "sigma": estimate.sigma,
                "fisher": estimate.fisher,
                "bootstrap": estimate.bootstrap,
                "known": estimate.is_known,
            }
            for estimate in fit.estimates
        },
        "checks": [asdict(check) for check in fit.checks],
        "correlations": {
            "names": list(fit.parameter_fit.names),
            "matrix": fit.parameter_fit.solved.correlation.tolist(),
        },
        "not_identified": list(fit.parameter_fit.null),
        "held": list(fit.parameter_fit.held),
        "evaluations": fit.evaluations,
        "texture": fit.texture,
        "strangers": fit.strangers,
        "notes": list(fit.notes),
    }


def as_text(fit: SceneFit) -> str:
    """Result as text for the terminal."""
    text_lines = [f"{fit.recording} on {fit.scene}: {fit.pulses[0]:,} pulses, {fit.evaluations} evaluations"]
    text_lines += [f"  {estimate.key:<28} {_number(estimate)}" for estimate in fit.estimates]
    text_lines += [f"  {check}" for check in fit.checks]
    text_lines += [
        "  cannot be told, held at the values of the file:",
        *(f"    {direction}" for direction in fit.parameter_fit.null),
    ]
    return "\n".join([*text_lines, *(f"  {note}" for note in fit.notes)])


def write_report(fit: SceneFit, folder: Path) -> None:
    """Write page, Markdown, figures with their data, and JSON. Raises OutputError."""
    page = Page(f"{fit.recording} on {fit.scene}: what they say of {fit.sensor}", folder=folder)
    page.paragraph(
        f"{fit.pulses[0]:,} pulses of {count_text(fit.frames, 'frame')} were fitted; {fit.pulses[1]:,} of every fourth "
        "block of columns judge the fit. The light of the scene was traced once, the likelihood of what was kept, "
        f"of signals and ranges evaluated {fit.evaluations} times. Reflectivities are free, patch by patch, within "
        "10 % of the scene's."
    )
    add_notes(page, fit.notes)
    add_checks(page, fit.checks)
    page.heading("Estimates")
    page.table(
        ("number of the file", "times what it was", "sigma, Fisher", "sigma, bootstrap", ""),
        [
            (
                estimate.key,
                f"{estimate.value:.4g}",
                f"{estimate.fisher:.2g}",
                f"{estimate.bootstrap:.2g}",
                "" if estimate.is_known else "not known",
            )
            for estimate in fit.estimates
        ],
    )
    page.paragraph(
        f"Signals scatter by {fit.texture:.0%} more than photons do: texture of the surfaces, and what the scene has "
        f"wrong. {fit.strangers:.1%} of the pulses met something that is not in the scene."
    )
    add_figures(page, folder, _figures(fit.held_out_bins))
    page.heading("Correlations")
    page.table(
        ("", *fit.parameter_fit.names),
        [
            (name, *(f"{value:.2f}" for value in row))
            for name, row in zip(fit.parameter_fit.names, fit.parameter_fit.solved.correlation, strict=True)
        ],
    )
    page.heading("What cannot be told")
    page.paragraph("Along each line nothing changes that was recorded; its first number stays as it was.")
    page.table(("not known",), [(direction,) for direction in fit.parameter_fit.null])
    write_page(page, folder, as_dict(fit))


def _figures(bins: HeldOutBins) -> list[Figure]:
    figures: list[Figure] = []
    if len(bins.signal):
        figures.append(
            (
                "signal",
                "Mean signal by range, of columns that were not fitted.",
                _chart(bins.signal, "range [m]", "SIGNAL [photons]", log=True),
                (("range_m", "recorded", "expected"), bins.signal.tolist()),
            )
        )
    if len(bins.kept_shares):
        expected = np.column_stack([bins.kept_shares[:, 0], bins.kept_shares[:, 1], bins.kept_shares[:, 0]])
        figures.append(
            (
                "kept",
                "Share that was kept, by the chance that the sensor gives it.",
                _chart(expected, "chance of a return, expected", "share with a return", log=False),
                (("chance", "kept", "pulses"), bins.kept_shares.tolist()),
            )
        )
    if len(bins.scatter):
        scaled = bins.scatter[:, :3] * np.array([1.0, 1e3, 1e3])
        figures.append(
            (
                "scatter",
                "Scatter of the range about the scene's surface, by signal.",
                _chart(scaled, "SIGNAL [photons]", "scatter of the range [mm]", log=True),
                (("signal", "recorded_mm", "expected_mm"), scaled.tolist()),
            )
        )
    return figures


def _chart(columns: Numbers, x_label: str, y_label: str, *, log: bool) -> Chart:
    x, recorded, expected = columns.T
    limits = None if log else (0.0, 1.0)
    return Chart(
        lines=(
            Line(label="recorded", x=x, y=recorded),
            Line(label="expected", x=x, y=expected, colour=1, style="dashed"),
        ),
        x_label=x_label,
        y_label=y_label,
        x_log=log,
        y_log=log,
        x_limits=limits,
        y_limits=limits,
    )


def _number(estimate: Estimate) -> str:
    text = f"{estimate.value:.4g} +/- {estimate.sigma:.2g} times"
    return text if estimate.is_known else f"{text} (not known)"
