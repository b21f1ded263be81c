"""The commands that trace nothing, `range` and `paper`: arguments in, files and a text to print out.

The studies do the work; this module checks conditions under the names of their options.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from ..files.json_text import json_text
from ..rendering.option_fields import FileName, Whole, options_of
from ..studies.ranging.conditions import CONDITIONS, Conditions
from .options import StudyOptions, add_options, flag_of, options_from
from .terminal import Answer, progress, save_report
from .words import number, whole_number

if TYPE_CHECKING:
    from ..studies.ranging.curves import Curves, Question
    from ..studies.ranging.subjects import Subject
    from ..studies.ranging.sweep_axes import Axis

RANGE_HELP = """\
examples:
  lidarscene range apd-905 sipm-905
  lidarscene range apd-905 sipm-905 --over distance --plot out/snr.png --csv out/snr.csv
  lidarscene range apd-905 sipm-905 --over illuminance --set sipm-905:detector.cells=1600
  lidarscene range table1-apd --over detector.gain --quantity snr --distance 200 --from 1 --to 300
"""

TARGET_OPTIONS = ("distance", "illuminance", "reflectivity", "incidence")
_ONLY_OVER = ("from", "to", "n", "log", "linear", "quantity", "csv", "plot", "aperture_law")


def add_commands(commands: Any) -> None:
    """Add `range` and `paper`."""
    _add_range(commands)
    paper = commands.add_parser(
        "paper",
        help="the paper's figures, its claims and its errata",
        description="Compute Fig. 4(e), 5 and 6 of the paper as pictures and CSV, and a page that checks each "
        "claim of its text.",
    )
    add_options(paper, StudyOptions, "output", "json", "quiet")
    paper.set_defaults(run=paper_text)


def _add_range(commands: Any) -> None:
    command = commands.add_parser(
        "range",
        help="SNR, maximum range or detection probability against anything",
        epilog=RANGE_HELP,
        description="Work out how far sensors see, from the exact signal-to-noise ratio on a Lambertian plane. "
        "Nothing is traced.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_argument("sensors", metavar="SENSOR", nargs="+", help="catalogue name or sensor file")
    add = command.add_argument_group("what is computed").add_argument
    add(
        "--over",
        metavar="AXIS",
        help="distance, illuminance, elevation, azimuth, reflectivity, incidence, or a key such as detector.gain",
    )
    add(
        "--quantity",
        choices=("snr", "range", "pd"),
        help="default: snr over distance, the maximum range over everything else",
    )
    add("--from", metavar="X", type=number, help="start of the axis, in its unit")
    add("--to", metavar="X", type=number, help="end of the axis")
    add("--n", metavar="N", type=whole_number(Whole(2, 100_000)), help="points on the axis (default 200)")
    scale = command.add_mutually_exclusive_group()
    scale.add_argument("--log", action="store_true", help="logarithmic steps")
    scale.add_argument("--linear", action="store_true", help="even steps")
    add("--sensitivities", action="store_true", help="what each parameter of the sensor is worth in range")
    add("--eye-safety", action="store_true", help="class 1 or not; exit code 1: the laser is not known")
    held = command.add_argument_group("conditions")
    add = held.add_argument
    add_options(held, Conditions, "distance", "illuminance", "sun_angle", "reflectivity", "incidence")
    add(
        "--aperture-law",
        choices=("scanner", "constant", "cosine", "mirror"),
        help="receiver off the axis, over elevation or azimuth (default: the sensor's own scanner's)",
    )
    air = command.add_mutually_exclusive_group()
    add_options(air, Conditions, "transmittance", "extinction", "visibility")
    add_options(held, StudyOptions, "overrides")
    written = command.add_argument_group("what is written")
    add = written.add_argument
    add("--csv", metavar="F.csv", type=Path, help="all points of all curves")
    add("--plot", metavar="F.png|svg", type=Path, help="the curves as a picture")
    add_options(written, StudyOptions, "json")
    # None without the option: some do not go together.
    command.set_defaults(run=range_text, **dict.fromkeys(options_of(Conditions)))


def range_text(arguments: argparse.Namespace) -> str | Answer:
    """Run `range`; returns the text to print. Raises InputError and OutputError before anything is written.

    The code is 1 for a report of eye safety on a sensor whose laser is not known.
    """
    from ..sensor.sensor_model import warn_of_doubts
    from ..studies.ranging.subjects import subjects

    _require_sense(arguments)
    conditions = options_from(Conditions, arguments)
    subject_list = subjects(arguments.sensors, arguments.overrides)
    warn_of_doubts(subject.sensor() for subject in subject_list)
    _check_outputs(arguments)
    if arguments.eye_safety:
        return _eye_safety(arguments, subject_list, conditions)
    if arguments.sensitivities:
        if arguments.json:
            return _sensitivities_json(arguments, subject_list, conditions)
        return "\n\n".join(_sensitivities(arguments, subject_list, conditions))
    if arguments.over is None:
        return _summary(arguments, subject_list, conditions)
    return _sweep(arguments, subject_list, conditions)


def _require_sense(arguments: argparse.Namespace) -> None:
    """Refuse options that contradict each other or would be ignored."""
    reports = [name for name in ("sensitivities", "eye_safety") if getattr(arguments, name)]
    if arguments.over is None:
        idle = [name for name in _ONLY_OVER if getattr(arguments, name) not in (None, False)]
        if reports == ["sensitivities"] and len(arguments.sensors) == 1:
            idle = [name for name in idle if name != "plot"]
        if idle:
            raise InputError(f"{flag_of(idle[0])} goes with --over: say what is swept")
        if len(reports) == 2 and arguments.json:
            raise InputError("--json: must go with one of --sensitivities and --eye-safety, got both")
        return
    if reports:
        raise InputError(f"{flag_of(reports[0])} does not go with --over")
    axis, quantity = arguments.over, _quantity(arguments)
    if axis == "distance" and quantity == "range":
        raise InputError("--over distance --quantity range: the quantity must be snr or pd; the range is their limit")
    if axis in TARGET_OPTIONS and getattr(arguments, axis) is not None:
        raise InputError(f"--{axis} does not go with --over {axis}")
    if arguments.distance is not None and quantity == "range":
        raise InputError("--distance goes with --quantity snr or pd, not with the maximum range")
    if arguments.aperture_law and axis not in ("elevation", "azimuth"):
        raise InputError("--aperture-law goes with --over elevation or azimuth")
    swept = [text for text in arguments.overrides if text.partition("=")[0].rpartition(":")[2].strip() == axis]
    if swept:
        raise InputError(f"--set {swept[0]} does not go with --over {axis}")


def _quantity(arguments: argparse.Namespace) -> str:
    return str(arguments.quantity or ("snr" if arguments.over == "distance" else "range"))


def _check_outputs(arguments: argparse.Namespace) -> None:
    """Raise an error for an output that could not be written."""
    from ..files.atomic import require_writable

    for name, suffixes in (("csv", (".csv",)), ("plot", (".png", ".svg"))):
        path = getattr(arguments, name)
        if path is None:
            continue
        FileName(suffixes).check(name, path)
        require_writable(path)


def _question(arguments: argparse.Namespace, subjects: list[Subject], conditions: Conditions) -> Question:
    from ..studies.ranging.curves import Question
    from ..studies.ranging.sweep_axes import require_within_law

    axis = _axis(arguments, subjects)
    law = arguments.aperture_law or "scanner"
    if law in ("cosine", "mirror"):
        require_within_law(axis)
    return Question(
        quantity=_quantity(arguments),
        axis=axis,
        target=conditions.target(),
        law=law,
        distance_m=conditions.distance,
        visibility_m=conditions.visibility_m,
    )


def _axis(arguments: argparse.Namespace, subjects: list[Subject]) -> Axis:
    from ..studies.ranging.aperture_laws import field_of_view_deg
    from ..studies.ranging.sweep_axes import condition_axis, parameter_axis

    name, start, stop = arguments.over, getattr(arguments, "from"), arguments.to
    log = True if arguments.log else False if arguments.linear else None
    count = arguments.n or 200
    if name not in CONDITIONS:
        files = [(subject.where, subject.changed) for subject in subjects]
        return parameter_axis(name, files, start=start, stop=stop, count=count, log=log)
    if name in ("elevation", "azimuth"):
        fields = [field_of_view_deg(subject.sensor().scanner, name) for subject in subjects]
        start = max(low for low, _ in fields) if start is None else start
        stop = min(high for _, high in fields) if stop is None else stop
    return condition_axis(name, start=start, stop=stop, count=count, log=log)


def _sweep(arguments: argparse.Namespace, subjects: list[Subject], held: Conditions) -> str:
    """Write the curves; returns them as a table or JSON."""
    from ..studies.ranging import sweep_report
    from ..studies.ranging.curves import curves

    swept = curves(subjects, _question(arguments, subjects, held))
    sensors = {subject.name: subject.sensor() for subject in subjects}
    conditions = sweep_report.conditions_text(swept, sun_angle_deg=held.sun_angle)
    written = _write(arguments, swept, conditions, {n: s.tdc.threshold_to_noise for n, s in sensors.items()})
    notes = sweep_report.notes(swept, sensors)
    if arguments.json:
        return json_text(sweep_report.as_dict(swept) | {"conditions": conditions, "notes": notes} | written)
    from ..studies.ranging.curves import QUANTITIES

    lines = [f"{QUANTITIES[swept.question.quantity]}: {conditions}", sweep_report.table_text(swept), *notes]
    return "\n".join(lines + ([f"wrote {', '.join(written.values())}"] if written else []))


def _write(arguments: argparse.Namespace, swept: Curves, conditions: str, thresholds: dict[str, Any]) -> dict[str, str]:
    from ..files.atomic import put_text
    from ..studies.ranging import sweep_report

    written = {}
    if arguments.csv is not None:
        put_text(arguments.csv, sweep_report.csv_text(swept))
        written["csv"] = str(arguments.csv)
    if arguments.plot is not None:
        from ..figures import lines as charts

        charts.save(sweep_report.chart_of(swept, conditions, thresholds=thresholds), [arguments.plot])
        written["plot"] = str(arguments.plot)
    return written


def _summary(arguments: argparse.Namespace, subjects: list[Subject], conditions: Conditions) -> str:
    """Text or JSON of each sensor's maximum range, its closed form, and SNR and P_d at one distance."""
    from ..studies.ranging.range_summary import range_report

    report = range_report([(subject.name, subject.sensor()) for subject in subjects], conditions)
    return report.as_json() if arguments.json else str(report)


def _sensitivities(arguments: argparse.Namespace, subjects: list[Subject], conditions: Conditions) -> list[str]:
    """Reports of how the range depends on each parameter of each sensor; writes the plot."""
    from ..studies.ranging import sensitivities as worth
    from ..studies.ranging.curves import with_haze

    texts = []
    for subject in subjects:
        sensor = subject.sensor()
        target = with_haze(sensor, conditions.target(), conditions.visibility_m)
        texts.append(worth.report_text(sensor, target, distance_m=arguments.distance))
        if arguments.plot is not None:
            worth.tornado(arguments.plot, sensor, target, distance_m=arguments.distance)
            texts[-1] += f"\nwrote {arguments.plot}"
    return texts


def _sensitivities_json(arguments: argparse.Namespace, subjects: list[Subject], conditions: Conditions) -> str:
    """JSON of the sensitivities of each sensor by its name, in SI units; writes the plot."""
    from ..studies.ranging import sensitivities as worth
    from ..studies.ranging.curves import with_haze

    tables = {}
    for subject in subjects:
        sensor = subject.sensor()
        target = with_haze(sensor, conditions.target(), conditions.visibility_m)
        entry = asdict(worth.sensitivities(sensor, target, distance_m=arguments.distance))
        tables[subject.name] = {key: value for key, value in entry.items() if key != "sensor"}
        if arguments.plot is not None:
            worth.tornado(arguments.plot, sensor, target, distance_m=arguments.distance)
            tables[subject.name]["plot"] = str(arguments.plot)
    return json_text(tables)


def _eye_safety(arguments: argparse.Namespace, subjects: list[Subject], conditions: Conditions) -> Answer:
    """Report of eye safety for each sensor, after the sensitivities with `--sensitivities`."""
    from ..studies.eye_safety.eye_safety_report import both_reports, not_known, report_text

    sensors = [subject.sensor() for subject in subjects]
    if arguments.json:
        text = json_text([report.as_dict() for sensor in sensors for report in both_reports(sensor)])
    else:
        first = _sensitivities(arguments, subjects, conditions) if arguments.sensitivities else []
        text = "\n\n".join([*first, *(report_text(sensor) for sensor in sensors)])
    return Answer(text, int(any(not_known(sensor) for sensor in sensors)))


def paper_text(arguments: argparse.Namespace) -> str:
    """Run `paper`; returns the text to print."""
    from ..figures.report import require_writable_report
    from ..studies.paper.study import paper_report

    require_writable_report(arguments.output)
    with progress("steps") as show:
        report = paper_report(progress=show)
    return save_report(report, arguments.output, as_json=arguments.json)
