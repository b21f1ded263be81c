"""The rays of every pulse of a frame, with an echo or without: what is free, as maps of occupancy ask."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..files.arguments import checks_arguments
from ..files.atomic import atomic_output
from ..files.optional import import_optional
from ..maths.arrays import Numbers

SUFFIXES = (".npz", ".parquet", ".ply")

_PLY_TYPES = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int"}
"""Words of PLY for the types of the file's columns."""


@checks_arguments
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PulseRays:
    """Rays of pulses in order of firing, as the sensor reports their directions, in the coordinates of the cloud.

    A point of the cloud is ``origin_m + range_m * direction``. Along a ray there is nothing before ``range_m``, the
    range of its first point; without a point it is infinite, and the outcome says why: only a ray that met no surface
    (1) is free as far as the sensor looks.

    Attributes:
        pulse: (n,) int64, number, counted on through the frames of a run
        origin_m: (n, 3) float64, where each beam leaves the sensor
        direction: (n, 3) float32 unit vectors
        time_s: (n,) float64, emission, from the start of the frame
        channel: (n,) int32, as the cloud's
        ring: (n,) int32, as the cloud's
        outcome: (n,) uint8, `detection.outcomes.Outcome` of the pulse's echo
        range_m: (n,) float32, of the pulse's first point, a false alarm too; inf without a point
    """

    pulse: Numbers
    origin_m: Numbers
    direction: Numbers
    time_s: Numbers
    channel: Numbers
    ring: Numbers
    outcome: Numbers
    range_m: Numbers

    def __len__(self) -> int:
        return len(self.pulse)

    @staticmethod
    def concatenate(parts: Sequence[PulseRays]) -> PulseRays:
        """Join the rays of the parts in order."""
        names = [field.name for field in fields(PulseRays)]
        return PulseRays(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})

    def select(self, mask: Numbers) -> PulseRays:
        """Select pulses by a (n,) mask."""
        return PulseRays(**{field.name: getattr(self, field.name)[mask] for field in fields(PulseRays)})

    def to_numpy(self) -> Numbers:
        """(n,) structured array with the columns of files.

        They are x, y, z (the origin), direction_x, direction_y, direction_z, time, range, pulse, channel, ring,
        outcome.
        """
        columns = {
            **dict(zip("xyz", self.origin_m.T, strict=True)),
            **{f"direction_{axis}": values for axis, values in zip("xyz", self.direction.T, strict=True)},
            "time": self.time_s,
            "range": self.range_m,
            # PLY has no whole numbers of 64 bits; float64 holds these exactly, to 2^53.
            "pulse": self.pulse.astype(np.float64),
            "channel": self.channel,
            "ring": self.ring,
            "outcome": self.outcome,
        }
        rows = np.zeros(len(self), np.dtype([(name, values.dtype) for name, values in columns.items()]))
        for name, values in columns.items():
            rows[name] = values
        return rows

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a file of these columns: .npz, .parquet (needs pyarrow), or binary .ply.

        Raises:
            InputError: for another suffix
        """
        suffix, rows = Path(path).suffix.lower(), self.to_numpy()
        if suffix not in SUFFIXES:
            raise InputError(f"{os.fspath(path)}: the name must end in {', '.join(SUFFIXES)}, got '{suffix}'")
        names = rows.dtype.names or ()
        arrow = import_optional("pyarrow", extra="parquet") if suffix == ".parquet" else None
        with atomic_output(path) as temporary, open(temporary, "wb") as file:
            if suffix == ".npz":
                np.savez_compressed(file, **{name: rows[name] for name in names})  # type: ignore[arg-type]
            elif arrow is not None:
                table = arrow.table({name: np.ascontiguousarray(rows[name]) for name in names})
                import_optional("pyarrow.parquet", extra="parquet").write_table(table, file, compression="zstd")
            else:
                properties = [f"property {_PLY_TYPES[rows.dtype[name].str[1:]]} {name}" for name in names]
                head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}", *properties]
                file.write("\n".join([*head, "end_header\n"]).encode("ascii"))
                file.write(rows.view(np.uint8).data)
