"""The commands that trace nothing, `range` and `paper`: arguments in, files and a text to print out.

The studies do the work; this module checks conditions under the names of their options.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from ..rendering.option_fields import FileName, options_of
from ..studies.ranging.conditions import Conditions, SweepOptions
from .options import StudyOptions, add_options, flag_of, options_from
from .terminal import Answer, progress, save_report

if TYPE_CHECKING:
    from ..figures.report import Report
    from ..sensor.sensor_model import Sensor

RANGE_HELP = """\
examples:
  lidarscene range apd-905 sipm-905
  lidarscene range apd-905 sipm-905 --over distance --plot out/snr.png --csv out/snr.csv
  lidarscene range apd-905 sipm-905 --over illuminance_klux --set sipm-905:detector.cells=1600
  lidarscene range table1-apd --over detector.gain --quantity snr --distance 200 --from 1 --to 300
"""

_ONLY_OVER = ("start", "stop", "points", "scale", "quantity", "csv", "plot", "aperture_law")


def add_commands(commands: Any) -> None:
    """Add `range` and `paper`."""
    _add_range(commands)
    paper = commands.add_parser(
        "paper",
        help="reproduce the figures, claims and errata of the paper",
        description="Compute Fig. 4(e), 5 and 6 of the paper as pictures and CSV, and write a report that checks each "
        "claim of its text.",
    )
    add_options(paper, StudyOptions, "output")
    paper.set_defaults(run=run_paper)


def _add_range(commands: Any) -> None:
    command = commands.add_parser(
        "range",
        help="compute range, SNR or detection probability over any quantity",
        epilog=RANGE_HELP,
        description="Compute how far sensors see, from the exact signal-to-noise ratio on a Lambertian plane. No rays "
        "are traced.",
    )
    command.add_argument("sensors", metavar="SENSOR", nargs="+", help="catalogue name or sensor file")
    asked = command.add_argument_group("quantities")
    add_options(asked, SweepOptions, "over", "quantity", "start", "stop", "points")
    add = asked.add_argument
    add(
        "--scale",
        choices=("log", "linear"),
        help="scale of the axis: equal ratios or equal steps (default: depends on --over)",
    )
    add("--sensitivities", action="store_true", help="print how the range depends on each parameter of the sensor")
    add(
        "--eye-safety",
        action="store_true",
        help="say whether the sensor is of class 1; exit code 1 if its laser is not known",
    )
    held = command.add_argument_group("conditions")
    add_options(
        held, Conditions, "probability", "distance", "illuminance_klux", "sun_angle", "reflectivity", "incidence"
    )
    add_options(held, SweepOptions, "aperture_law")
    air = command.add_mutually_exclusive_group()
    add_options(air, Conditions, "transmittance", "extinction", "visibility")
    add_options(held, StudyOptions, "overrides")
    written = command.add_argument_group("output files")
    add = written.add_argument
    add("--csv", metavar="F.csv", type=Path, help="write all points of all curves")
    add("--plot", metavar="F.png|svg", type=Path, help="write the curves as a picture")
    # None without the option: some do not go together.
    command.set_defaults(run=run_range, **dict.fromkeys((*options_of(Conditions), "points")))


def run_range(arguments: argparse.Namespace) -> Answer:
    """Run `range`.

    The code is 1 for a report of eye safety on a sensor whose laser is not known.

    Raises:
        InputError: before anything is written
        OutputError: before anything is written
    """
    from ..sensor.sensor_model import warn_of_doubts
    from ..studies.ranging.subjects import subjects

    log = None if arguments.scale is None else arguments.scale == "log"
    sweep = replace(options_from(SweepOptions, arguments), log=log)
    _require_sense(arguments, sweep)
    conditions = options_from(Conditions, arguments)
    subject_list = subjects(arguments.sensors, arguments.overrides)
    warn_of_doubts(subject.sensor() for subject in subject_list)
    _check_outputs(arguments)
    if arguments.over is None:
        return _without_sweep(arguments, [(subject.name, subject.sensor()) for subject in subject_list], conditions)
    from ..studies.ranging.sweep_report import sweep_report

    return _written(arguments, sweep_report(subject_list, sweep, conditions))


def _without_sweep(arguments: argparse.Namespace, sensors: list[tuple[str, Sensor]], conditions: Conditions) -> Answer:
    """Sensitivities, eye safety, both, or the range."""
    answers = []
    if arguments.sensitivities:
        from ..studies.ranging.sensitivities import sensitivity_report

        answers.append(_written(arguments, sensitivity_report(sensors, conditions, distance_m=arguments.distance)))
    if arguments.eye_safety:
        from ..studies.eye_safety.eye_safety_report import class_1_report

        report = class_1_report([sensor for _, sensor in sensors])
        answers.append(Answer(str(report), 1 if report.passed is None else 0, report.numbers))
    if not answers:
        from ..studies.ranging.range_summary import range_report

        report = range_report(sensors, conditions)
        answers.append(Answer(str(report), numbers=report.numbers))
    text = "\n\n".join(answer.text for answer in answers)
    return Answer(text, max(answer.code for answer in answers), answers[0].numbers)


def _require_sense(arguments: argparse.Namespace, sweep: SweepOptions) -> None:
    """Refuse options that contradict each other or would be ignored."""
    reports = [name for name in ("sensitivities", "eye_safety") if getattr(arguments, name)]
    if arguments.over is None:
        idle = [name for name in _ONLY_OVER if getattr(arguments, name) not in (None, False)]
        if reports == ["sensitivities"] and len(arguments.sensors) == 1:
            idle = [name for name in idle if name != "plot"]
        if idle:
            raise InputError(f"{flag_of(idle[0])} needs --over, which names the quantity to sweep")
        if len(reports) == 2 and arguments.json:
            raise InputError("--json: must be combined with one of --sensitivities and --eye-safety, got both")
        return
    if reports:
        raise InputError(f"{flag_of(reports[0])} cannot be combined with --over")
    sweep.require_sense([name for name in options_of(Conditions) if getattr(arguments, name) is not None])
    axis = arguments.over
    swept = [text for text in arguments.overrides if text.partition("=")[0].rpartition(":")[2].strip() == axis]
    if swept:
        raise InputError(f"--set {swept[0]} cannot be combined with --over {axis}")


def _check_outputs(arguments: argparse.Namespace) -> None:
    """Raise an error for an output that could not be written."""
    from ..files.atomic import require_writable

    for name, suffixes in (("csv", (".csv",)), ("plot", (".png", ".svg"))):
        path = getattr(arguments, name)
        if path is None:
            continue
        FileName(suffixes).check(name, path)
        require_writable(path)


def _written(arguments: argparse.Namespace, report: Report) -> Answer:
    """Write the data and the chart of a report's first figure where the options say.

    The code is 1 if the chart could not be drawn.
    """
    figure, written = report.figure_names[0], {}
    for option, suffix in (("csv", ".csv"), ("plot", ".png")):
        path = getattr(arguments, option)
        if path is not None:
            report.write(f"{figure}{suffix}", path)
            if suffix == ".csv" or not report.undrawn:
                written[option] = str(path)
    text = "\n".join([str(report), *([f"wrote {', '.join(written.values())}"] if written else [])])
    return Answer(text, 1 if report.undrawn else 0, report.numbers | written)


def run_paper(arguments: argparse.Namespace) -> Answer:
    """Run `paper`."""
    from ..figures.report import require_writable_report
    from ..studies.paper.study import paper_report

    require_writable_report(arguments.output)
    with progress("steps") as show:
        report = paper_report(progress=show)
    return save_report(report, arguments.output)
