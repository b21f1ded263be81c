"""Size: how much time, disk and memory a run of very many pulses will take, told before it begins.

A run of hours that ends on a full disk is a run lost. So what can be known is said first: it is not refused, since a
pulse without an echo takes no room.
"""

from __future__ import annotations

import os
import shutil
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import OptionWarning
from ..formats.cloud_columns import COLUMNS, VECTORS
from ..rendering.options import TraceOptions
from ..sensor.rig import Mounted
from .plan import Plan

LARGE = 100_000_000
"""Pulses of which the size is told: some twenty seconds, and up to 10 GB."""

RAYS_A_SECOND = 5e6
"""Two cores in clear air (docs/benchmarks.md); a GPU takes less time, fog and several rays more."""

BYTES_OF_TEXT = 3
"""Times the bytes of a number that it takes as text."""

CHUNK_BYTES = 500
"""Of memory for each ray of a chunk: 0.47 GiB of chunks of 2^20 (docs/benchmarks.md)."""


def warn_of_size(plan: Plan, sensors: Sequence[Mounted], trace: TraceOptions, chunk: int) -> None:
    """Warn with what a run will take, if that is much."""
    frames = plan.frames or 1
    pulses = frames * sum(one.sensor.scanner.pulses for one in sensors)
    if pulses < LARGE:
        return
    outputs = plan.outputs
    columns = COLUMNS + (VECTORS if trace.vectors else ())
    of_point = sum(np.dtype(c.dtype).itemsize for c in columns if outputs.truth or not c.truth)
    clouds = [one.sensor.scanner.pulses * one.sensor.tdc.stops * of_point for one in sensors]
    copies = (2 if outputs.deskew else 1) * (BYTES_OF_TEXT if outputs.ascii else 1)
    disk = float(frames * sum(clouds) * copies)
    # What cannot be written piece by piece waits in memory, and is written from there.
    is_gathered = plan.format.stream is None or outputs.range_image is not None or outputs.colours is not None
    whole = float(sum(clouds) if outputs.merge else max(clouds))
    memory = CHUNK_BYTES * float(chunk) + (2.0 * whole if is_gathered else 0.0)
    free = shutil.disk_usage(_there(outputs.place)).free
    warnings.warn(
        OptionWarning(
            "{path} {0}: {1:,} pulses take some {2} (at 5 million rays a second), up to {3} of disk ({4} are free) and "
            "up to {5} of memory",
            outputs.place,
            pulses,
            in_words(pulses * trace.rays / RAYS_A_SECOND),
            _bytes(disk),
            _bytes(free),
            _bytes(memory),
        ),
        stacklevel=3,
    )


def in_words(seconds: float) -> str:
    """A time to two digits at most, in the unit that suits it."""
    for unit, length, most in (("s", 1.0, 100.0), ("min", 60.0, 6000.0), ("h", 3600.0, 180_000.0)):
        if seconds < most:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds / 86400.0:.0f} days"


def _bytes(count: float) -> str:
    return f"{count / 1e9:.3g} GB" if count < 1e12 else f"{count / 1e12:.3g} TB"


def _there(path: Path) -> Path:
    """The nearest folder that exists."""
    real = Path(os.path.realpath(path))
    return next(folder for folder in (real, *real.parents) if os.path.isdir(folder))
