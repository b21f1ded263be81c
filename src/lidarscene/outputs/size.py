"""Size: a warning of the time, disk and memory that a run of very many pulses will take, before it begins.

A run of hours that ends on a full disk is lost. The numbers are upper bounds, since a pulse without an echo takes no
room: so the run is not refused.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import OptionWarning, warn
from ..formats.cloud_columns import columns_of
from ..rendering.render_options import TraceOptions
from ..sensor.rig_file import Mounted
from .plan import Plan

LARGE = 100_000_000
"""Least pulses of a run for the warning: some twenty seconds, and up to 10 GB."""

RAYS_A_SECOND = 5e6
"""Source: benchmarks/RESULTS.md; rate of two cores in clear air. A GPU takes less time, fog and several rays more."""

BYTES_OF_TEXT = 3
"""Size of a number as text, relative to binary."""

CHUNK_BYTES = 500
"""Memory for each ray of a chunk: 0.47 GiB for chunks of 2^20."""


def warn_of_size(plan: Plan, sensors: Sequence[Mounted], trace: TraceOptions, chunk: int) -> None:
    """Warn of the time, disk and memory that a run will take, from `LARGE` pulses on."""
    frames = plan.frames or 1
    pulses = frames * sum(mounted.sensor.scanner.pulses for mounted in sensors)
    if pulses < LARGE:
        return
    outputs = plan.outputs
    columns = columns_of(truth=outputs.truth, vectors=trace.vectors)
    point_bytes = sum(np.dtype(column.dtype).itemsize for column in columns)
    cloud_bytes = [mounted.sensor.scanner.pulses * mounted.sensor.tdc.stops * point_bytes for mounted in sensors]
    copies = (2 if outputs.deskew else 1) * (BYTES_OF_TEXT if outputs.ascii else 1)
    disk = float(frames * sum(cloud_bytes) * copies)
    # Formats that cannot be written piece by piece gather all points in memory first.
    is_gathered = plan.format.stream is None or outputs.range_image is not None or outputs.colours is not None
    whole = float(sum(cloud_bytes) if outputs.merge else max(cloud_bytes))
    memory = CHUNK_BYTES * float(chunk) + (2.0 * whole if is_gathered else 0.0)
    free = shutil.disk_usage(_existing_folder(outputs.place)).free
    warn(
        OptionWarning(
            "{path} {0}: {1:,} pulses take some {2} (at 5 million rays a second), up to {3} of disk ({4} are free) and "
            "up to {5} of memory",
            outputs.place,
            pulses,
            duration_text(pulses * trace.rays / RAYS_A_SECOND),
            _bytes(disk),
            _bytes(free),
            _bytes(memory),
        )
    )


def duration_text(seconds: float) -> str:
    """Text of a time to a whole number of s, min, h or days."""
    for unit, length, most in (("s", 1.0, 100.0), ("min", 60.0, 6000.0), ("h", 3600.0, 180_000.0)):
        if seconds < most:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds / 86400.0:.0f} days"


def _bytes(count: float) -> str:
    return f"{count / 1e9:.3g} GB" if count < 1e12 else f"{count / 1e12:.3g} TB"


def _existing_folder(path: Path) -> Path:
    """Nearest folder of a path that exists."""
    real = Path(os.path.realpath(path))
    return next(folder for folder in (real, *real.parents) if os.path.isdir(folder))
