"""The command `certify`: whether a simulated sensor is the one that recorded."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ...rendering.render_options import FrameOptions
from ..options import CommandOptions, add_options
from ..terminal import Answer, save_report
from .recording_options import add_recording

CERTIFY_HELP = """\
examples:
  lidarscene certify os1.pcap -o out/certificate
  lidarscene certify turns/ --sensor pandar64 -o out/certificate
  lidarscene certify os1.pcap --sensor my-os1.toml --frame 3 -o out/certificate
  lidarscene certify os1.pcap --scene out/twin/scene.toml -o out/certificate --json
"""


def add_certify(commands: Any) -> None:
    """Add `certify`."""
    command = commands.add_parser(
        "certify",
        help="check whether a simulated sensor matches a recording",
        epilog=CERTIFY_HELP,
        description="Make a twin of a recording, simulate the recorded pulses in it, and compare the two. Writes a "
        "report with verdict, limits, losses and noise, and what is not covered. The exit code is 1 if a "
        "limit is missed. Recordings at rest are the most informative.",
    )
    add = command.add_argument
    add("recording", metavar="REC", type=Path, help="recording of a real lidar")
    add(
        "--sensor",
        metavar="NAME",
        help="catalogue name or sensor file (default: the recorded unit, or the scene's sensor)",
    )
    add(
        "--scene",
        metavar="SCENE.toml",
        type=Path,
        help="twin of the recording (default: a temporary one, made from another frame of a sensor at rest, or "
        "else from every second column)",
    )
    add_options(command, FrameOptions, "seed")
    add_options(command, CommandOptions, "output")
    add_recording(command)
    command.set_defaults(run=run_certify)


def run_certify(arguments: argparse.Namespace) -> Answer:
    """Run `certify`.

    Raises:
        InputError: before anything is written
        OutputError: before anything is written
    """
    from ...figures.report import require_writable_report
    from ...studies.api import certify

    require_writable_report(arguments.output)
    report = certify(
        arguments.recording,
        arguments.sensor,
        scene=arguments.scene,
        frame=arguments.frame,
        metadata=arguments.metadata,
        sensor_index=arguments.sensor_index,
        seed=arguments.seed,
    )
    answer = save_report(report, arguments.output)
    return answer._replace(code=max(answer.code, int(report.passed is False)))
