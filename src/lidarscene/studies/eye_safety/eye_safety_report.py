"""Eye-safety report of a sensor: class 1 of IEC 60825-1:2014, each criterion with its margin.

Every criterion of 4.3 f is applied to an eye (condition 3 of table 10) and to an eye behind a telescope (condition
1), with the beam standing still and as the scanner moves it. An aid to design, not a certification.

A verdict needs the energy of the real pulse. There is none if the file's source calls power or width fitted, assumed
or unknown: the margins are then those of the model's pulse, and every form of the report states this first.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from ...errors import InputError
from ...figures.report import PAGE, Report
from ...physics import eye_safety as iec
from ...physics.optics.pulse import pulse_energy_j
from ...sensor.sensor_model import Sensor
from ..held import Held, passed
from .criteria import VIEWERS, ViewerCheck, geometry, margin_of, si_text
from .exposure import PulseTrain, counted_train, scanned_train, stationary_train

NOTICE = "An aid to design, not a certification: docs/eye_safety.md says what it rests on."

TIME_BASE_S = 100.0
"""Source: IEC 60825-1:2014, 4.3 e; time base for light beyond 400 nm without intended long viewing."""

_NEEDED = ("laser.peak_power_w", "laser.pulse_fwhm_ns")
"""Keys that determine the energy of a pulse."""
_GUESSED = re.compile(r"\b(fitted|assumed|unknown)\b")

Verdict = Literal["class 1", "not class 1", "not judged"]


def not_known(sensor: Sensor) -> tuple[str, ...]:
    """Keys that determine the pulse energy and whose source says fitted, assumed or unknown, with that word.

    A number without a source is the user's own and counts as known.
    """
    guesses = ((key, _GUESSED.search(sensor.source_of(key) or "")) for key in _NEEDED)
    return tuple(f"{key} is {word.group()}" for key, word in guesses if word is not None)


@dataclass(frozen=True, slots=True, kw_only=True)
class EyeSafetyReport:
    """All criteria of one sensor in one state of motion ("stationary", "scanned" or "counted").

    Attributes:
        not_known: numbers that are guesses, so that there is no verdict (see `not_known`); () if there are none
    """

    sensor: str
    motion: str
    pulse_energy_j: float
    peak_power_w: float
    not_known: tuple[str, ...]
    assumptions: tuple[str, ...]
    criteria: tuple[Held, ...]

    @property
    def limiting(self) -> Held:
        """The criterion with the smallest margin."""
        return min(self.criteria, key=margin_of)

    @property
    def margin(self) -> float:
        """The smallest margin."""
        return margin_of(self.limiting)

    @property
    def verdict(self) -> Verdict:
        """Verdict: "class 1" if every criterion passes; "not judged" if the pulse energy is a guess."""
        verdicts: dict[bool | None, Verdict] = {None: "not judged", True: "class 1", False: "not class 1"}
        return verdicts[self.is_class_1]

    @property
    def is_class_1(self) -> bool | None:
        """True if every criterion passes; None where not judged."""
        return None if self.not_known else passed(self.criteria)

    @property
    def class_1_peak_power_w(self) -> float:
        """Peak power at which the limiting criterion is just met; emissions are linear in it."""
        return self.peak_power_w * self.margin

    def at_power_w(self, peak_power_w: float) -> EyeSafetyReport:
        """The same report for another peak power: every emission is linear in it, and no limit depends on it."""
        ratio = peak_power_w / self.peak_power_w
        criteria = tuple(
            replace(criterion, simulated=(criterion.simulated or 0.0) * ratio, value=margin_of(criterion) / ratio)
            for criterion in self.criteria
        )
        energy_j = self.pulse_energy_j * ratio
        return replace(self, peak_power_w=peak_power_w, pulse_energy_j=energy_j, criteria=criteria)

    def as_dict(self) -> dict[str, Any]:
        """Fields for JSON."""
        words = {"subject": "viewer", "quantity": "name", "condition": "clause", "note": "detail"}
        words |= {"reference": "limit", "simulated": "emission", "value": "margin"}
        return {
            "verdict": self.verdict,
            **{key: value for key, value in asdict(self).items() if key != "criteria"},
            "notice": NOTICE,
            "is_class_1": self.is_class_1,
            "limiting": self.limiting.quantity,
            "limiting_viewer": self.limiting.subject,
            "margin": self.margin,
            "class_1_peak_power_w": self.class_1_peak_power_w,
            "criteria": [criterion.as_dict(**words) for criterion in self.criteria],
        }


def eye_safety_report(
    sensor: Sensor,
    *,
    scanned: bool = False,
    pulses_in_aperture: int | None = None,
    source_rad: float | None = None,
    time_base_s: float = TIME_BASE_S,
) -> EyeSafetyReport:
    """Apply every criterion to this sensor.

    Args:
        scanned: count the pulses that enter as the beam scans; False: every pulse of a beam that stands still
        pulses_in_aperture: or this many consecutive pulses in each frame
        source_rad: angle of the apparent source; the sensor's own by default
        time_base_s: 100 s, or 30 000 s where long viewing is intended

    Raises:
        InputError: for lasers outside the tables of the standard
    """
    if scanned and pulses_in_aperture is not None:
        raise InputError("must be scanned or pulses_in_aperture, not both")
    laser = sensor.laser
    energy_j = float(pulse_energy_j(peak_power_w=laser.peak_power_w, fwhm_s=laser.pulse_fwhm_s))
    motion = "scanned" if scanned else "stationary" if pulses_in_aperture is None else "counted"
    source = laser.source_rad if source_rad is None else source_rad
    try:
        if float(laser.pulse_fwhm_s) * stationary_train(sensor).mean_rate_hz >= 1.0:
            raise ValueError("the pulses overlap: a pulse must be shorter than the time between two")
        criteria = tuple(
            criterion
            for viewer in VIEWERS
            for criterion in ViewerCheck(
                sensor=sensor,
                viewer=viewer,
                energy_j=energy_j,
                source_rad=source,
                time_base_s=time_base_s,
                train=_train(sensor, viewer, scanned=scanned, pulses_in_aperture=pulses_in_aperture),
            ).criteria()
        )
    except ValueError as error:
        raise InputError(f"{sensor.name}: eye safety: {error}") from None
    return EyeSafetyReport(
        sensor=sensor.name,
        motion=motion,
        pulse_energy_j=energy_j,
        peak_power_w=float(laser.peak_power_w),
        not_known=not_known(sensor),
        assumptions=_assumptions(sensor, motion, source, time_base_s),
        criteria=criteria,
    )


def _train(sensor: Sensor, viewer: str, *, scanned: bool, pulses_in_aperture: int | None) -> PulseTrain:
    """Pulse train that enters this viewer's eye."""
    if pulses_in_aperture is not None:
        return counted_train(sensor, pulses_in_aperture=pulses_in_aperture)
    if not scanned:
        return stationary_train(sensor)
    aperture, distance, beam = geometry(sensor, viewer, TIME_BASE_S)  # the widest
    return scanned_train(sensor, aperture_m=aperture, distance_m=distance, beam_diameter_m=beam)


def _assumptions(sensor: Sensor, motion: str, source_rad: float, time_base_s: float) -> tuple[str, ...]:
    """Assumptions on beam, source, time base and motion, in words."""
    laser = sensor.laser
    if laser.exit_diameter_m is None:
        beam = "the whole beam enters the aperture (laser.exit_diameter_mm is not given)"
    else:
        beam = f"Gaussian beam of {laser.exit_diameter_m * 1e3:g} mm, {laser.divergence_rad * 1e3:g} mrad"
    point = f"{source_rad * 1e3:g} mrad" if source_rad > iec.SMALLEST_SOURCE_RAD else "a point, up to 1.5 mrad"
    moves = {
        "stationary": "the beam stands still: every pulse enters",
        "scanned": "each pulse that touches the aperture counts as if centred; all beams start in one point",
        "counted": "as many pulses in a row as given enter, once in each frame",
    }
    return (beam, f"apparent source: {point}", f"time base {time_base_s:g} s", moves[motion])


_MOTION_TEXT = {
    "stationary": "beam standing still, which a fault of the scanner may cause",
    "scanned": "beam moved by the scanner",
    "counted": "pulses in the aperture as given",
}
_VIEWER_TEXT = {"eye": "eye", "telescope": "eye behind a telescope"}


def as_text(report: EyeSafetyReport) -> str:
    """Text of one report: a table of criteria for each viewer, and the limiting one."""
    lines = [_MOTION_TEXT[report.motion]]
    for viewer, title in _VIEWER_TEXT.items():
        lines.append(f"  {title:<26}{'emitted':>12}{'allowed':>12}{'margin':>10}")
        lines += [_row(criterion) for criterion in report.criteria if criterion.subject == viewer]
    worst = report.limiting
    verdict = {"class 1": "within class 1", "not class 1": "NOT within class 1", "not judged": "NOT JUDGED"}
    margin = "margin" if not report.not_known else "margin of the model's pulse"
    lines.append(
        f"  {verdict[report.verdict]}: {worst.quantity} limits ({_VIEWER_TEXT[worst.subject]}), "
        f"{margin} {report.margin:.3g}; it allows a peak of {si_text(report.class_1_peak_power_w, 'W')}"
    )
    return "\n".join(lines)


def _row(criterion: Held) -> str:
    """Line of the table for one criterion."""
    emission, limit = (si_text(value or 0.0, criterion.unit) for value in (criterion.simulated, criterion.reference))
    name = f"{criterion.quantity:<14}{f'({criterion.condition})':<10}"
    return f"    {name}{emission:>12}{limit:>12}{margin_of(criterion):>10.3g}  {criterion.note}".rstrip()


def both_reports(sensor: Sensor) -> tuple[EyeSafetyReport, EyeSafetyReport]:
    """Reports with the beam scanning, and with the beam standing still."""
    return eye_safety_report(sensor, scanned=True), eye_safety_report(sensor)


def class_1_report(sensors: Sequence[Sensor]) -> Report:
    """Every criterion of each sensor, with the beam scanning and standing still; passed if the scanning beams pass.

    A sensor whose pulse energy is a guess is not judged, and so are all beside it.
    """
    reports_by_sensor = [both_reports(sensor) for sensor in sensors]
    scanned = [reports[0].is_class_1 for reports in reports_by_sensor]
    numbers = [entry.as_dict() for reports in reports_by_sensor for entry in reports]
    verdict = None if None in scanned else all(scanned)
    report = Report("Eye safety", numbers=numbers, passed=verdict, pages=(PAGE, "eye_safety.json"))
    report.add_paragraph(NOTICE)
    for sensor, reports in zip(sensors, reports_by_sensor, strict=True):
        report.add_heading(sensor.name)
        report.add_paragraph(_verdict_text(reports))
        for entry in reports:
            report.add_paragraph(f"{_MOTION_TEXT[entry.motion].capitalize()}:")
            report.add_table(("viewer", "criterion", "clause", "emitted", "allowed", "margin"), _cells(entry))
    columns = ("viewer", "name", "clause", "emission", "limit", "unit", "margin")
    rows = [
        [entry["sensor"], entry["motion"], *(criterion[column] for column in columns)]
        for entry in numbers
        for criterion in entry["criteria"]
    ]
    report.main_table = (("sensor", "motion", *columns), rows)
    report.summary = "\n\n".join(map(report_text, sensors))
    return report


def _cells(report: EyeSafetyReport) -> list[tuple[str, ...]]:
    """Rows of a page's table."""
    return [
        (
            _VIEWER_TEXT[criterion.subject],
            criterion.quantity,
            criterion.condition,
            si_text(criterion.simulated or 0.0, criterion.unit),
            si_text(criterion.reference or 0.0, criterion.unit),
            f"{margin_of(criterion):.3g}",
        )
        for criterion in report.criteria
    ]


def report_text(sensor: Sensor) -> str:
    """Text of both reports of a sensor, with the beam scanning and standing still."""
    laser, reports = sensor.laser, both_reports(sensor)
    rate_hz = stationary_train(sensor).mean_rate_hz  # with all shots of a point
    energy_j = reports[0].pulse_energy_j
    head = (
        f"{sensor.name}: eye safety, class 1 of IEC 60825-1:2014\n{_verdict_text(reports)}\n{NOTICE}\n\n"
        f"laser    {laser.wavelength_m * 1e9:g} nm, {si_text(float(laser.peak_power_w), 'W')} peak, "
        f"{si_text(float(laser.pulse_fwhm_s), 's')}, {rate_hz * 1e-3:g} kHz: "
        f"{si_text(energy_j, 'J')} a pulse, {si_text(energy_j * rate_hz, 'W')} in the mean"
    )
    assumptions = dict.fromkeys(line for report in reports for line in report.assumptions)
    assumed = "\n".join(f"{'assumed' if index == 0 else '':<9}{line}" for index, line in enumerate(assumptions))
    return "\n\n".join([f"{head}\n{assumed}", *(as_text(report) for report in reports)])


def _verdict_text(reports: Sequence[EyeSafetyReport]) -> str:
    """Headline: the verdicts, or the guesses that prevent them."""
    if guesses := reports[0].not_known:
        return (
            f"NOT JUDGED: {', '.join(guesses)} (see its [sources]).\n"
            "What follows is about the model's pulse. It says nothing of the real sensor, which may be safe or not."
        )
    return "; ".join(f"{report.motion}: {report.verdict}" for report in reports)
