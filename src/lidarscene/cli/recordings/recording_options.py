"""Options of commands that read recordings of real lidars."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from typing import TYPE_CHECKING

from ...rendering.render_options import SEEDS
from ..options import CommandOptions, add_options
from ..words import whole_number

if TYPE_CHECKING:
    from ...recordings.recording import Recording
    from ...recordings.sweep import Sweep


def add_recording(command: argparse.ArgumentParser) -> None:
    """Add `--frame`, `--metadata` and `--sensor-index`."""
    group = command.add_argument_group("recordings")
    group.add_argument(
        "--frame", metavar="N", type=whole_number(SEEDS), default=None, help="number of the frame, from 0"
    )
    add_options(group, CommandOptions, "metadata", "sensor_index")


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
