"""The command `twin`: a scene made from a recording."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from ...errors import InputError
from ..options import CommandOptions, add_options
from ..terminal import Answer
from ..words import frame_numbers

TWIN_HELP = """\
examples:
  lidarscene twin os1.pcap -o out/twin
  lidarscene twin os1.pcap --held-out columns -o out/twin
  lidarscene twin drive.osf --sensor-index 1 --frames 0,1,2,4 --held-out 3 -o out/twin
  lidarscene twin 000000.bin --sensor hdl-64e -o out/kitti
then:
  lidarscene render out/twin/scene.toml -o out/twin.ply
  lidarscene certify os1.pcap --scene out/twin/scene.toml -o out/certificate
"""


def add_twin(commands: Any) -> None:
    """Add `twin`."""
    command = commands.add_parser(
        "twin",
        help="make a scene from a recording",
        epilog=TWIN_HELP,
        description="Make a scene from the recording of a real lidar. Every pixel becomes a small surface with the "
        "measured reflectivity, and the ground is completed. Also writes the sensor file and the poses.",
    )
    command.add_argument("recording", metavar="REC", type=Path, help="recording of a real lidar")
    add = command.add_argument
    add_options(command, CommandOptions, "output")
    add("--frames", metavar="N,N,...", type=frame_numbers, help="frames to use, from 0 (default: all)")
    add(
        "--held-out",
        metavar="K|columns",
        type=_held_out,
        help="leave out this frame, and put the sensor at its pose, or leave out every second column of a "
        "single frame; certify then compares with data that the twin does not contain",
    )
    add_options(command, CommandOptions, "metadata", "sensor_index")
    add("--sensor", metavar="NAME", help="catalogue name or sensor file (default: the recorded unit)")
    command.set_defaults(run=run_twin)


def run_twin(arguments: argparse.Namespace) -> Answer:
    """Run `twin`.

    Raises:
        InputError: if a file, a key or a value cannot be understood
        OutputError: if a result cannot be written
    """
    from ...files.optional import require_together
    from ...recordings.opening import extras_of, open_recording
    from ...studies.twin.twin_files import PROVENANCE, SCENE, build_twin, choose_frames

    registers = ("open3d",) if len(arguments.frames or ()) > 1 else ()  # lays frames on each other
    require_together(*extras_of(arguments.recording, arguments.metadata), *registers)
    index = arguments.sensor_index
    with open_recording(arguments.recording, arguments.metadata, sensor_index=index) as recording:
        choice = choose_frames(recording, arguments.frames, arguments.held_out)
        if len(choice.frames) > 1:
            require_together("open3d")
        text = build_twin(
            recording,
            choice,
            arguments.output,
            metadata=arguments.metadata,
            sensor=arguments.sensor,
            sensor_index=index,
        )
    provenance = json.loads((arguments.output / PROVENANCE).read_text(encoding="utf-8"))
    return Answer(text, numbers={"scene": str(arguments.output / SCENE), **provenance})


def _held_out(text: str) -> int | str:
    if text != "columns" and not text.isdecimal():
        raise InputError(f"--held-out: must be the number of a frame, or columns, got '{text}'")
    return text if text == "columns" else int(text)
