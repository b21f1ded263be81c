"""The command `fit`: numbers of a sensor from its recording, as a sensor file and a page."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ...errors import InputError
from ..options import CommandOptions, add_options
from ..terminal import Answer, save_report
from ..words import frame_numbers

FIT_HELP = """\
examples:
  lidarscene fit os1.pcap --sensor os1-128 -o my-os1.toml --report out/fit
  lidarscene fit a.osf b.osf --sensor os2-128 --sensor-index 1 -o my-os2.toml --report out/fit --json
  lidarscene fit drive.osf --frames 0,1,2 --sensor os0-128 -o my-os0.toml --report out/fit
  lidarscene fit turns/ --sensor pandar64 -o my-pandar.toml --report out/fit
  lidarscene twin os1.pcap --held-out columns -o out/twin
  lidarscene fit os1.pcap --scene out/twin/scene.toml -o my-os1.toml --report out/fit
"""


def add_fit(commands: Any) -> None:
    """Add `fit`."""
    command = commands.add_parser(
        "fit",
        help="fit the numbers of a sensor to its recording, with uncertainties",
        epilog=FIT_HELP,
        description="Fit near field, threshold, scatter of the range and gains of the rows to recordings of one unit, "
        "and its noise and losses to frames at rest. "
        "Writes a sensor file, with value, uncertainty and recording in [sources], and a report. The exit "
        "code is 1 if a law fails on pulses that were not fitted.",
    )
    add = command.add_argument
    add("recordings", metavar="REC", nargs="+", type=Path, help="recordings of one unit in one mode")
    add(
        "--sensor",
        metavar="NAME",
        help="catalogue name or sensor file of the same kind, for numbers that the recording does not determine "
        "(default: with --scene, the scene's sensor)",
    )
    add("--frames", metavar="N,N,...", type=frame_numbers, help="frames of each recording, from 0 (default: all)")
    add(
        "--scene",
        metavar="SCENE.toml",
        type=Path,
        help="twin of the recording, or the scene in which it was recorded; signals, ranges and losses are then "
        "fitted pulse by pulse",
    )
    add(
        "--poses",
        metavar="F",
        type=Path,
        help="with --scene, the pose of the sensor at each frame: CSV, or TUM's format (default: the pose in "
        "the twin, or the scene's)",
    )
    add_options(command, CommandOptions, "metadata", "sensor_index")
    add("-o", "--output", metavar="F.toml", type=Path, required=True, help="sensor file to write")
    add("--report", metavar="DIR", type=Path, required=True, help="folder of the report, with figures and fit.json")
    command.set_defaults(run=run_fit)


def run_fit(arguments: argparse.Namespace) -> Answer:
    """Run `fit`."""
    from ...figures.report import require_writable_report
    from ...files.atomic import put_text, require_writable
    from ...studies.api import fit_sensor

    if arguments.output.suffix.lower() != ".toml":
        raise InputError(f"--output {arguments.output}: the name must end in .toml")
    require_writable(arguments.output)
    require_writable_report(arguments.report)
    text, report = fit_sensor(
        arguments.recordings,
        arguments.sensor,
        scene=arguments.scene,
        poses=arguments.poses,
        frames=arguments.frames,
        metadata=arguments.metadata,
        sensor_index=arguments.sensor_index,
    )
    put_text(arguments.output, text)
    answer = save_report(report, arguments.report)
    code = max(answer.code, int(report.passed is False))
    return answer._replace(text=f"{answer.text}\nwrote {arguments.output}", code=code)
