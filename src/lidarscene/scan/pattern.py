"""A user's own pattern: azimuth, elevation and time of every pulse of a frame, from CSV or npz.

Where only measured angles are known, they can be used directly. The mechanism is unknown, so A(theta_r) = A(0). Units
are in the names of the columns.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from ..errors import InputError
from ..files.encodings.csv import read_columns
from ..files.inputs import require_archive, require_file
from ..files.table_model import Number
from ..maths.arrays import Lanes, LookupTable, Numbers, xp
from ..maths.units import si
from .base import Encoder, GivenAngles, Jitter
from .clock import PulseClock
from .scanner_file import ScannerContext, ScannerFile

# What a column may be called, and what takes it to radians and seconds.
COLUMN_NAMES: dict[str, dict[str, float]] = {
    "azimuth": {"azimuth_deg": math.pi / 180.0, "azimuth_rad": 1.0},
    "elevation": {"elevation_deg": math.pi / 180.0, "elevation_rad": 1.0},
    "time": {"time_s": 1.0, "time_ms": 1e-3, "time_us": 1e-6},
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pattern(GivenAngles):
    """The table, in firing order; it repeats in each frame. Made by `create`."""

    pulses: int
    frame_s: float
    emission_s: Numbers
    azimuth_rad: LookupTable
    elevation_rad: LookupTable
    laser: LookupTable | None = None

    @classmethod
    def create(
        cls,
        *,
        azimuth_rad: Numbers,
        elevation_rad: Numbers,
        time_s: Numbers,
        channel: Numbers | None = None,
        frame_s: float,
        jitter_rad: Jitter = None,
        encoder_rad: Encoder = None,
    ) -> Pattern:
        """Build from columns of one length, with times rising from 0 and below ``frame_s``."""
        return cls(
            pulses=len(time_s),
            frame_s=frame_s,
            # Times stay in float64: a frame lasts 0.1 s, and float32 is good to 7 ns of that.
            emission_s=np.asarray(time_s, dtype=np.float64),
            azimuth_rad=LookupTable(np.asarray(azimuth_rad, dtype=np.float32)),
            elevation_rad=LookupTable(np.asarray(elevation_rad, dtype=np.float32)),
            laser=None if channel is None else LookupTable(np.asarray(channel, dtype=np.float32)),
            jitter_rad=jitter_rad,
            encoder_rad=encoder_rad,
        )

    def _row(self, pulse: Lanes) -> Lanes:
        ops = xp(pulse)
        return ops.divmod(pulse, self.pulses)[1]

    def _mechanism(self, pulse: Lanes) -> tuple[Lanes, Lanes]:
        ops, row = xp(pulse), self._row(pulse)
        return ops.take(self.azimuth_rad, row), ops.take(self.elevation_rad, row)

    def channel(self, pulse: Lanes) -> Lanes:
        """Channel from the table, or 0."""
        ops, row = xp(pulse), self._row(pulse)
        return row * 0 if self.laser is None else ops.int32(ops.take(self.laser, row))

    @property
    def channel_elevation_rad(self) -> Numbers | None:
        """Mean elevation of each channel of the table; None if it has none."""
        if self.laser is None:
            return None
        laser = np.asarray(self.laser.values, np.int64)
        with np.errstate(invalid="ignore"):
            return np.bincount(laser, self.elevation_rad.values) / np.bincount(laser)

    @property
    def clock(self) -> PulseClock:
        """Times from the table."""
        return PulseClock(levels=((self.pulses, self.frame_s),), times_s=self.emission_s)


class TableFile(ScannerFile[Pattern]):
    """[scanner] type = "table": a pattern of your choice, CSV or npz."""

    type: Literal["table"]
    file: Annotated[str, Field(min_length=1)] = Field(
        description=(
            "CSV or npz with `azimuth_deg`, `elevation_deg`, `time_s` and perhaps `channel`; beside the sensor file"
        )
    )
    frame_ms: Annotated[float, Number("ms", ge=1e-3, le=1e7)] | None = Field(
        default=None, description="length of a frame; by the times if left out"
    )

    @property
    def files(self) -> tuple[str, ...]:
        """The file of the pattern."""
        return (self.file,)

    def build(self, context: ScannerContext) -> Pattern:
        """Read the pattern's file and convert it to SI units.

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        return read_pattern(context.folder / self.file, frame_s=si(self.frame_ms, "ms"), **self.values_in_si())


def read_pattern(path: Path, *, frame_s: float | None, jitter_rad: float | None, encoder_rad: float | None) -> Pattern:
    """Read a pattern; without ``frame_s`` a frame lasts one mean step longer than its last time.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    columns = _read_npz(path) if path.suffix == ".npz" else read_columns(path, is_wanted=_is_known_column)
    length = len(next(iter(columns.values()), ()))
    for name, values in columns.items():
        if values.ndim != 1 or len(values) != length:
            raise InputError(f"{path}: column {name} must have the shape ({length},), got {values.shape}")
        if not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values))[0]) + 1
            raise InputError(f"{path}: {name} of pulse {row} is not a finite number")
    azimuth, elevation, time_s = (_column(path, columns, kind) for kind in COLUMN_NAMES)
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
    """Column of this kind in SI units.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    names = [name for name in COLUMN_NAMES[kind] if name in columns]
    if len(names) != 1:
        listed = " and ".join(names) or "none"
        raise InputError(f"{path}: must have one column of {', '.join(COLUMN_NAMES[kind])}, got {listed}")
    return np.asarray(columns[names[0]] * COLUMN_NAMES[kind][names[0]], dtype=np.float64)


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
    return name == "channel" or any(name in names for names in COLUMN_NAMES.values())
