"""The command `fit`: numbers of a sensor from its recording, as a sensor file and a page."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import InputError
from ..options import CommandOptions, add_options
from ..terminal import Answer, save_report
from ..words import frame_numbers

if TYPE_CHECKING:
    from ...figures.report import Report

FIT_HELP = """\
examples:
  lidarscene fit os1.pcap --sensor os1-128 -o my-os1.toml --report out/fit
  lidarscene fit a.osf b.osf --sensor os2-128 --sensor-index 1 -o my-os2.toml --report out/fit --json
  lidarscene fit drive.osf --frames 0,1,2 --sensor os0-128 -o my-os0.toml --report out/fit
  lidarscene twin os1.pcap --held-out columns -o out/twin
  lidarscene fit os1.pcap --scene out/twin/scene.toml -o my-os1.toml --report out/fit
"""


def add_fit(commands: Any) -> None:
    """Add `fit`."""
    command = commands.add_parser(
        "fit",
        help="numbers of a sensor from its recording, with uncertainties",
        epilog=FIT_HELP,
        description="Fit near field, threshold, scatter of the range and gains of the rows to recordings of one unit. "
        "Writes its sensor file, with value, uncertainty and recording in [sources], and a page. "
        "Ends with 1 if a law fails on pulses that were not fitted.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = command.add_argument
    add("recordings", metavar="REC", nargs="+", type=Path, help="recordings of one unit in one mode")
    add(
        "--sensor",
        metavar="NAME",
        help="the catalogue's sensor of its kind, or a sensor file, for what the recording leaves open "
        "(default: with --scene, the scene's)",
    )
    add("--frames", metavar="N,N,...", type=frame_numbers, help="frames of each recording, from 0 (default: all)")
    add(
        "--scene",
        metavar="SCENE.toml",
        type=Path,
        help="twin of the recording, or the scene that it was recorded in: then signals, ranges and losses are fitted "
        "pulse by pulse",
    )
    add(
        "--poses",
        metavar="F",
        type=Path,
        help="with --scene, where the sensor stood at each frame: CSV, or TUM's format (default: of the twin's frame, "
        "else the scene's sensor)",
    )
    add_options(command, CommandOptions, "metadata", "sensor_index")
    add("-o", "--output", metavar="F.toml", type=Path, required=True, help="sensor file to write")
    add("--report", metavar="DIR", type=Path, required=True, help="folder of the page, its figures and fit.json")
    add_options(command, CommandOptions, "json", "quiet")
    command.set_defaults(run=fit_text)


def fit_text(arguments: argparse.Namespace) -> Answer:
    """Run `fit`; returns the text to print and the code."""
    from ...figures.report import require_writable_report
    from ...files.atomic import put_text, require_writable

    if arguments.output.suffix.lower() != ".toml":
        raise InputError(f"--output {arguments.output}: the name must end in .toml")
    require_writable(arguments.output)
    require_writable_report(arguments.report)
    sensor_text, report = _fit(arguments)
    put_text(arguments.output, sensor_text)
    text = save_report(report, arguments.report, as_json=arguments.json)
    written = "" if arguments.json else f"\nwrote {arguments.output}"
    return Answer(text + written, 1 if report.passed is False else 0)


def _fit(arguments: argparse.Namespace) -> tuple[str, Report]:
    """Text of the fitted sensor file, and the report. Raises InputError."""
    if arguments.scene is not None:
        from ...studies.fit.on_scene.scene_fit import SceneFitInputs, fit_on_scene

        if arguments.frames is not None:
            raise InputError("--frames: goes without --scene, whose twin says which frames are fitted")
        inputs = SceneFitInputs(
            recordings=arguments.recordings,
            scene=arguments.scene,
            sensor=arguments.sensor,
            metadata=arguments.metadata,
            poses=arguments.poses,
            sensor_index=arguments.sensor_index,
        )
        return fit_on_scene(inputs)
    if arguments.poses is not None:
        raise InputError("--poses: goes with --scene")
    if arguments.sensor is None:
        raise InputError("--sensor: must name the sensor of the recording, or --scene one that has it, got neither")
    from ...studies.fit.recording_fit import fit_recordings

    return fit_recordings(
        arguments.recordings,
        arguments.sensor,
        metadata=arguments.metadata,
        sensor_index=arguments.sensor_index,
        frames=arguments.frames,
    )
