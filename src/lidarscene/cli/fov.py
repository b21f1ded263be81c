"""The command `fov`: what scan patterns cover, how densely, how soon and how far.

The study does the work (`studies.field_of_view`); this module reads and checks the options.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from ..rendering.render_options import FrameOptions
from ..studies.field_of_view.study_options import FieldOfViewStudy
from ..studies.ranging.conditions import Conditions
from .options import StudyOptions, add_options, options_from
from .terminal import Answer, progress, save_report

if TYPE_CHECKING:
    from ..sensor.sensor_model import Sensor

FOV_HELP = """\
examples:
  lidarscene fov table1-apd table1-sipm -o out/fov
  lidarscene fov my-risley.toml --time 0.1,0.5,1 --cell 0.28 -o out/fov
  lidarscene fov table1-apd --scene car -o out/fov
  lidarscene fov --rig rig --scene drive -o out/fov
"""


def add_fov(commands: Any) -> None:
    """Add `fov`."""
    command = commands.add_parser(
        "fov",
        help="show what scan patterns cover, how densely and how soon, and how far sensors see",
        epilog=FOV_HELP,
        description="Study fields of view: pattern, coverage over time, density, revisit time, spacing and maximum "
        "range. Writes a report, pictures and CSV. No rays are traced without --scene.",
    )
    command.add_argument("sensors", metavar="SENSOR", nargs="*", help="catalogue name or sensor file")
    add_options(command, StudyOptions, "rig", "output")
    add_options(command, FieldOfViewStudy, "times_s", "cell_deg", "mask")
    command.add_argument(
        "--scene", metavar="SCENE", type=Path, help="also count points on the bodies of this scene; needs a back end"
    )
    add_options(command, FrameOptions, pose="for a rig, the pose of its vehicle (default: the origin); needs --scene")
    add_options(command, Conditions, "reflectivity", "illuminance_klux")
    add_options(command, StudyOptions, overrides="LABEL:KEY=VALUE for one sensor of a rig")
    command.set_defaults(run=run_fov)


def run_fov(arguments: argparse.Namespace) -> Answer:
    """Run `fov`.

    Raises:
        InputError: before anything is written
        OutputError: before anything is written
    """
    from ..figures.report import require_writable_report
    from ..studies.field_of_view.field_of_view_study import field_of_view_study

    if bool(arguments.sensors) == (arguments.rig is not None):
        raise InputError("SENSOR and --rig: one of them must be given, got both or none; see lidarscene fov -h")
    if arguments.pose is not None and arguments.scene is None:
        raise InputError("--pose needs --scene")
    study = options_from(FieldOfViewStudy, arguments)
    study = replace(study, target=options_from(Conditions, arguments).target())
    sensors = _sensors(arguments)
    scene, vehicle = None, arguments.pose
    if arguments.scene is not None:
        from ..maths.pose import Pose
        from ..scene.scene_file import changed_scene

        scene = changed_scene(arguments.scene)
        if arguments.rig is not None:
            vehicle = vehicle or Pose()
    require_writable_report(arguments.output)
    with progress("sensors") as show:
        report = field_of_view_study(sensors, study, scene=scene, vehicle=vehicle, progress=show)
    return save_report(report, arguments.output)


def _sensors(arguments: argparse.Namespace) -> list[tuple[str, Sensor]]:
    """Names and sensors; sensors of a rig have their labels and their poses on the vehicle."""
    if arguments.rig is not None:
        from ..sensor.rig_file import load_rig

        rig = load_rig(arguments.rig, overrides=arguments.overrides)
        return [(mounted.label, mounted.placed) for mounted in rig.sensors]
    from ..studies.ranging.subjects import subjects

    return [(subject.name, subject.sensor()) for subject in subjects(arguments.sensors, arguments.overrides)]
