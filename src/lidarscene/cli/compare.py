"""The command `compare`: the same scene and the same beams, seen by different sensors.

The study does the work (`studies.compare`); this module reads and checks the options.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import catalog
from ..errors import InputError
from ..rendering.render_options import FrameOptions
from .options import StudyOptions, add_options, flag_of, options_from
from .terminal import Answer, progress, save_report
from .words import rising_numbers

if TYPE_CHECKING:
    from ..figures.report import Report
    from ..studies.compare.bench import NamedSensor

COMPARE_HELP = """\
examples:
  lidarscene compare street --sensors apd-905,sipm-905 -o out/compare
  lidarscene compare garage --sensors table1-apd,table1-sipm --illuminance-klux 0.05,1,10,100 -o out/garage
  lidarscene compare car --sensors vlp-16,table1-apd,table1-sipm --same-beams -o out/beams
  lidarscene compare day.ply night.ply -o out/clouds
"""

MOST_SENSORS = 7


def add_compare(commands: Any) -> None:
    """Add `compare`."""
    command = commands.add_parser(
        "compare",
        help="compare what sensors detect in a scene",
        epilog=COMPARE_HELP,
        description="Compare sensors in a scene, or clouds with ground truth: what each sensor detects, range errors "
        "and detection rates. Writes a report, JSON, CSV, pictures and a difference cloud.",
    )
    command.add_argument(
        "inputs",
        metavar="SCENE|CLOUD",
        nargs="+",
        type=Path,
        help="scene (name or file), with --sensors; or two or more clouds",
    )
    add = command.add_argument
    add("--sensors", metavar="A,B,...", help="catalogue names or sensor files; each is compared with the first")
    add_options(command, StudyOptions, "output")
    add(
        "--same-beams", action="store_true", default=None, help="give all sensors the scanner and mounting of the first"
    )
    add(
        "--illuminance-klux",
        metavar="KLUX,KLUX,...",
        type=rising_numbers("illuminances in klux", "0.05,1,10,100"),
        help="illuminances to sweep; finds where one sensor overtakes another",
    )
    add_options(command, StudyOptions, "overrides")
    add_options(command, FrameOptions, "pose", "seed", "chunk")
    # None without the option: it is refused where it would change nothing.
    command.set_defaults(run=run_compare, **dict.fromkeys(_OF_SCENES))


def run_compare(arguments: argparse.Namespace) -> Answer:
    """Run `compare`.

    Raises:
        InputError: before anything is written
        OutputError: before anything is written
    """
    from ..figures.report import require_writable_report

    report_of = _choose(arguments)
    require_writable_report(arguments.output)
    report = report_of(arguments)
    _refuse_inputs(arguments, report)
    return save_report(report, arguments.output)


def _refuse_inputs(arguments: argparse.Namespace, report: Report) -> None:
    """Raise InputError if a file of the report would replace an input."""
    for path in arguments.inputs:
        for file in (arguments.output / name for name in report.file_names):
            if file.exists() and path.exists() and file.samefile(path):
                raise InputError(f"--output {arguments.output}: must not overwrite an input, got {path}")


def _choose(arguments: argparse.Namespace) -> Callable[[argparse.Namespace], Report]:
    """Choose the kind of comparison.

    Raises:
        InputError: for options of another kind
    """
    if arguments.sensors is None:
        alone = [str(path) for path in arguments.inputs if str(path) in catalog.names("sensors")]
        if alone:
            raise InputError(f"sensors go behind --sensors: compare car --sensors {','.join(alone)}, got no scene")
        return _compare_clouds
    if len(arguments.inputs) != 1:
        raise InputError(f"--sensors: needs one scene, got {len(arguments.inputs)} files")
    return _compare_sensors


def _compare_sensors(arguments: argparse.Namespace) -> Report:
    from ..scene.scene_file import changed_scene
    from ..studies.compare.bench import Bench
    from ..studies.compare.comparison_study import compare_sensors
    from ..studies.ranging.conditions import CONDITIONS
    from ..studies.ranging.subjects import subjects

    words = arguments.sensors.split(",")
    if not 2 <= len(words) <= MOST_SENSORS or not all(words):
        raise InputError(
            f"--sensors: must be 2 to {MOST_SENSORS} names or files with commas between them, got {arguments.sensors}"
        )
    for value in arguments.illuminance_klux or ():
        CONDITIONS["illuminance_klux"].check("illuminance_klux", value)
        CONDITIONS["illuminance_klux"].warn_of_unit("illuminance_klux", value)
    scene = changed_scene(arguments.inputs[0])
    sensors: list[NamedSensor] = [
        (subject.name, subject.sensor()) for subject in subjects(words, arguments.overrides or ())
    ]
    bench = Bench(scene, options_from(FrameOptions, arguments))
    with progress("steps") as report:
        return compare_sensors(
            bench,
            sensors,
            same_beams=bool(arguments.same_beams),
            illuminances_klux=arguments.illuminance_klux,
            progress=report,
        )


_OF_SCENES = ("same_beams", "illuminance_klux", "overrides", "pose", "seed", "chunk")
"""Options that only apply to scenes."""


def _compare_clouds(arguments: argparse.Namespace) -> Report:
    from ..studies.compare.comparison_study import compare_clouds

    for option in _OF_SCENES:
        if getattr(arguments, option) is not None:
            raise InputError(f"{flag_of(option)}: needs a scene and --sensors, got clouds")
    if len(arguments.inputs) == 1:
        raise InputError(
            f"{arguments.inputs[0]}: must be a scene with --sensors A,B, or two clouds or more, got one file"
        )
    if len(arguments.inputs) > MOST_SENSORS:
        raise InputError(f"clouds: must be {MOST_SENSORS} at most, got {len(arguments.inputs)}")
    return compare_clouds(arguments.inputs)
