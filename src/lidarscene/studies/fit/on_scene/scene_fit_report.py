"""Report of a fit with a scene: page, JSON and text."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ....figures.lines import Chart, Line
from ....figures.report import Figure, Report, count_text
from ....maths.arrays import Numbers
from ...held import Held, passed
from ..estimates import Estimate
from ..recording_fit_report import (
    MARKDOWN,
    NUMBERS,
    PAGE,
    add_correlations,
    add_notes,
    add_results,
    check_as_dict,
    law_rows,
    uncertainty_as_dict,
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
    def checks(self) -> list[Held]:
        """Comparison of signal, kept share and scatter with their limits, on the held-out columns."""
        bins = self.held_out_bins
        return law_rows(bins.signal_error, bins.kept_error, bins.scatter, missing="too few")


def as_dict(fit: SceneFit) -> dict[str, Any]:
    """Result as a dictionary for JSON."""
    return {
        "recording": fit.recording,
        "scene": fit.scene,
        "sensor": fit.sensor,
        "frames": fit.frames,
        "pulses": {"fitted": fit.pulses[0], "not fitted": fit.pulses[1]},
        "passed": passed(fit.checks),
        "estimates": {
            estimate.key: {"times": estimate.value, **uncertainty_as_dict(estimate)} for estimate in fit.estimates
        },
        "checks": [check_as_dict(check) for check in fit.checks],
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


def write_report(fit: SceneFit, folder: Path) -> str:
    """Write page, Markdown, figures with their data, and JSON; returns the text to print. Raises OutputError."""
    report = Report(f"{fit.recording} on {fit.scene}: what they say of {fit.sensor}", folder)
    report.paragraph(
        f"{fit.recording} on {fit.scene}: {fit.pulses[0]:,} pulses of {count_text(fit.frames, 'frame')} were fitted; "
        f"{fit.pulses[1]:,} of every fourth block of columns judge the fit. The light of the scene was traced once, "
        f"the likelihood of what was kept, of signals and ranges evaluated {fit.evaluations} times. Reflectivities are "
        "free, patch by patch, within 10 % of the scene's."
    )
    add_results(report, fit.checks, fit.estimates)
    report.paragraph(
        f"Signals scatter by {fit.texture:.0%} more than photons do: texture of the surfaces, and what the scene has "
        f"wrong. {fit.strangers:.1%} of the pulses met something that is not in the scene."
    )
    add_notes(report, fit.notes)
    report.heading("What cannot be told")
    report.paragraph("Along each line nothing changes that was recorded; its first number stays as it was.")
    report.table(("not known",), [(direction,) for direction in fit.parameter_fit.null])
    text = report.as_text()
    for number, figure in enumerate(_figures(fit.held_out_bins), start=1):
        report.figure(figure._replace(number=str(number)))
    report.heading("Correlations")
    add_correlations(report, fit.parameter_fit.names, fit.parameter_fit.solved)
    report.write(PAGE, MARKDOWN, NUMBERS, numbers=as_dict(fit))
    return text


def _figures(bins: HeldOutBins) -> list[Figure]:
    figures: list[Figure] = []
    if len(bins.signal):
        figures.append(
            Figure(
                "signal",
                _chart(bins.signal, "range [m]", "SIGNAL [photons]", log=True),
                (("range_m", "recorded", "expected"), bins.signal.tolist()),
                "Mean signal by range, of columns that were not fitted.",
            )
        )
    if len(bins.kept_shares):
        expected = np.column_stack([bins.kept_shares[:, 0], bins.kept_shares[:, 1], bins.kept_shares[:, 0]])
        figures.append(
            Figure(
                "kept",
                _chart(expected, "chance of a return, expected", "share with a return", log=False),
                (("chance", "kept", "pulses"), bins.kept_shares.tolist()),
                "Share that was kept, by the chance that the sensor gives it.",
            )
        )
    if len(bins.scatter):
        scaled = bins.scatter[:, :3] * np.array([1.0, 1e3, 1e3])
        figures.append(
            Figure(
                "scatter",
                _chart(scaled, "SIGNAL [photons]", "scatter of the range [mm]", log=True),
                (("signal", "recorded_mm", "expected_mm"), scaled.tolist()),
                "Scatter of the range about the scene's surface, by signal.",
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
