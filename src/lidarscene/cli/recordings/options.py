"""Options of commands that read recordings of real lidars."""

from __future__ import annotations

import argparse
import os
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ...rendering.render_options import SEEDS
from ..words import whole

if TYPE_CHECKING:
    from ...recordings.recording import Recording
    from ...recordings.sweep import Sweep

ONLY_RECORDINGS = (".pcap", ".osf", ".mcap", ".db3", ".bin")
"""Ends of names that no cloud which lidarscene can read back has."""

EITHER = (".ply", ".pcd", ".las", ".laz")
"""Ends of names of clouds: of lidarscene, or of another program, which makes them recordings."""

HEADER_BYTES = 1 << 16
"""In these the formats of `EITHER` say who wrote a file."""


def add_recording(command: argparse.ArgumentParser) -> None:
    """Add `--frame` and `--metadata`."""
    add = command.add_argument_group("of a recording").add_argument
    add("--frame", metavar="N", type=whole(SEEDS), default=None, help="number of the frame, from 0")
    add(
        "--metadata",
        metavar="F",
        type=Path,
        default=None,
        help="what the maker says of the unit: json of an Ouster (default: beside the recording), YAML of a Velodyne, "
        "CSV of a Hesai",
    )


def is_recording(path: Path) -> bool:
    """Whether a path is a recording and no cloud that lidarscene wrote. What cannot be read is told by who reads it."""
    with suppress(OSError):
        return _is_recording(path)
    return False


def _is_recording(path: Path) -> bool:
    name = path.name.lower()
    if os.path.isdir(path):
        inside = [one.name.lower() for one in path.iterdir()]
        return "metadata.yaml" in inside or (
            any(one.endswith(".bin") for one in inside) and not any(one.endswith(EITHER) for one in inside)
        )
    if name.endswith(ONLY_RECORDINGS):
        return True
    if not name.endswith(EITHER) or not os.path.isfile(path):
        return False
    with path.open("rb") as file:
        return b"lidarscene" not in file.read(HEADER_BYTES)


def followed(recording: Recording) -> Recording:
    """The same recording; a terminal is told of each frame that is read."""
    if len(recording) < 2 or not sys.stderr.isatty():
        return recording

    def read(frame: int) -> Sweep:
        last = frame + 1 == len(recording)
        sys.stderr.write(f"\r{recording.path.name}: frame {frame + 1} of {len(recording)}" + "\n" * last)
        sys.stderr.flush()
        return recording.read(frame)

    return replace(recording, read=read)
