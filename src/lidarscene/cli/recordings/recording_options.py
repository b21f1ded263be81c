"""Options of commands that read recordings of real lidars."""

from __future__ import annotations

import argparse
import os
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ...catalog import file_or_example
from ...rendering.render_options import SEEDS
from ..options import CommandOptions, add_options
from ..words import whole_number

if TYPE_CHECKING:
    from ...recordings.recording import Recording
    from ...recordings.sweep import Sweep

ONLY_RECORDINGS = (".pcap", ".osf", ".mcap", ".db3", ".bin")
"""Suffixes of recordings; no cloud that lidarscene can read back has them."""

EITHER = (".ply", ".pcd", ".las", ".laz")
"""Suffixes of clouds; one that another program than lidarscene wrote counts as a recording."""

HEADER_BYTES = 1 << 16
"""Bytes from the start in which the formats of `EITHER` name the program that wrote the file."""


def add_recording(command: argparse.ArgumentParser) -> None:
    """Add `--frame`, `--metadata` and `--sensor-index`."""
    group = command.add_argument_group("of a recording")
    group.add_argument(
        "--frame", metavar="N", type=whole_number(SEEDS), default=None, help="number of the frame, from 0"
    )
    add_options(group, CommandOptions, "metadata", "sensor_index")


def is_recording(path: Path) -> bool:
    """Whether a path, or an example's name, is a recording and no cloud of lidarscene; False if it cannot be read.

    Reading such a file later raises the error.
    """
    with suppress(OSError):
        return _is_recording(file_or_example(path))
    return False


def _is_recording(path: Path) -> bool:
    name = path.name.lower()
    if os.path.isdir(path):
        inside = [entry.name.lower() for entry in path.iterdir()]
        return "metadata.yaml" in inside or (
            any(name.endswith(".bin") for name in inside) and not any(name.endswith(EITHER) for name in inside)
        )
    if name.endswith(ONLY_RECORDINGS):
        return True
    if not name.endswith(EITHER) or not os.path.isfile(path):
        return False
    with path.open("rb") as file:
        return b"lidarscene" not in file.read(HEADER_BYTES)


def with_progress(recording: Recording) -> Recording:
    """Wrap a recording so that a terminal shows each frame as it is read."""
    if len(recording) < 2 or not sys.stderr.isatty():
        return recording

    def read(frame: int) -> Sweep:
        last = frame + 1 == len(recording)
        sys.stderr.write(f"\r{recording.path.name}: frame {frame + 1} of {len(recording)}" + "\n" * last)
        sys.stderr.flush()
        return recording.read(frame)

    return replace(recording, read=read)
