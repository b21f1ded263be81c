"""Pattern files: azimuth, elevation and time of every pulse of a frame, from CSV or npz, to a `Pattern`.

Where a scanner is known only from measured angles, its table is used as it is. Units are in the names of the columns,
as in all files here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..files.encodings.csv import read_columns
from ..files.inputs import require_archive, require_file
from ..maths.arrays import Numbers
from ..scan import Pattern

# What a column may be called, and what takes it to radians and seconds.
NAMES: dict[str, dict[str, float]] = {
    "azimuth": {"azimuth_deg": math.pi / 180.0, "azimuth_rad": 1.0},
    "elevation": {"elevation_deg": math.pi / 180.0, "elevation_rad": 1.0},
    "time": {"time_s": 1.0, "time_ms": 1e-3, "time_us": 1e-6},
}


def read_pattern(path: Path, *, frame_s: float | None, jitter_rad: float | None, encoder_rad: float | None) -> Pattern:
    """Read a pattern; without ``frame_s`` a frame lasts one mean step longer than its last time. Raises InputError."""
    columns = _read_npz(path) if path.suffix == ".npz" else read_columns(path, is_wanted=_is_known_column)
    length = len(next(iter(columns.values()), ()))
    for name, values in columns.items():
        if values.ndim != 1 or len(values) != length:
            raise InputError(f"{path}: column {name} must have the shape ({length},), got {values.shape}")
        if not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values))[0]) + 1
            raise InputError(f"{path}: {name} of pulse {row} is not a finite number")
    azimuth, elevation, time_s = (_column(path, columns, kind) for kind in NAMES)
    if not length:
        raise InputError(f"{path}: must have at least one pulse, got none")
    if length >= 2**31:
        raise InputError(f"{path}: must have fewer than 2^31 pulses, got {length}")
    if np.abs(elevation).max() > 0.5 * math.pi + 1e-9:
        raise InputError(f"{path}: elevations must be from -90 to 90 degrees")
    falls = np.flatnonzero(np.diff(time_s) < 0.0)
    if len(falls):
        raise InputError(f"{path}: times must never fall, got a fall at pulse {falls[0] + 2}")
    channel = columns.get("channel")
    if channel is not None and (np.any(channel != np.rint(channel)) or np.abs(channel).max() >= 2**24):
        raise InputError(f"{path}: channels must be whole numbers below 2^24")
    time_s = time_s - time_s[0]
    if frame_s is None:
        if length < 2 or time_s[-1] == 0.0:
            raise InputError(f"{path}: all pulses are at one time, so scanner.frame_ms must be given")
        frame_s = float(time_s[-1]) * length / (length - 1)
    elif frame_s < time_s[-1]:
        raise InputError(
            f"{path}: scanner.frame_ms must be >= {time_s[-1] * 1e3:g}, the time of the last pulse, "
            f"got {frame_s * 1e3:g}"
        )
    return Pattern.create(
        azimuth_rad=azimuth,
        elevation_rad=elevation,
        time_s=time_s,
        channel=channel,
        frame_s=frame_s,
        jitter_rad=jitter_rad,
        encoder_rad=encoder_rad,
    )


def _column(path: Path, columns: Mapping[str, Numbers], kind: str) -> Numbers:
    """Column of this kind in SI units. Raises InputError."""
    names = [name for name in NAMES[kind] if name in columns]
    if len(names) != 1:
        listed = " and ".join(names) or "none"
        raise InputError(f"{path}: must have one column of {', '.join(NAMES[kind])}, got {listed}")
    return np.asarray(columns[names[0]] * NAMES[kind][names[0]], dtype=np.float64)


def _read_npz(path: Path) -> dict[str, Numbers]:
    require_file(path, "an npz file")
    try:
        with path.open("rb") as raw:
            require_archive(raw)
            file = np.load(raw, allow_pickle=False)
            return {name: np.asarray(file[name], dtype=np.float64) for name in file.files if _is_known_column(name)}
    except Exception as error:  # zipfile, numpy and the disk each have their own
        raise InputError(f"{path}: cannot be read as npz: {error}") from None


def _is_known_column(name: str) -> bool:
    return name == "channel" or any(name in names for names in NAMES.values())
