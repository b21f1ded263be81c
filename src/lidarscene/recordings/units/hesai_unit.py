"""Read a Hesai's table of angles (CSV: channel, elevation, azimuth), or an AT128's file of corrections, as a unit.

Azimuths are clockwise seen from above, from the sensor's y axis; sensor files count counter-clockwise from x, forward.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...formats.cloud_description import input_errors
from ...maths.arrays import Numbers
from .unit_beams import Unit, nearest_model, number_of

MODELS = ("pandar40p", "pandar64", "pandarqt", "pandarxt-16", "pandarxt-32", "xt32m2x", "ot128", "at128")
"""The catalogue's sensors. A QT128C2X is not among them: its table says not which lasers fire together."""


CHANNEL = ("laser id", "channel")
"""Names of the column with the number of a channel."""


def read_hesai(path: Path) -> Unit:
    """Read the table of angles of one unit, a line for each channel in any order.

    A line EEFF before the names of the columns, and one with a hash behind the channels, are left out.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    with input_errors(path), path.open(newline="", encoding="utf-8-sig") as file:
        rows = [[cell.strip() for cell in row] for row in csv.reader(file) if any(cell.strip() for cell in row)]
        first = 1 if len(rows) > 1 and rows[0][0].upper() == "EEFF" else 0
        header = [cell.lower() for cell in rows[first]] if rows else []
        columns = [header.index(name) for name in ("elevation", "azimuth") if name in header]
        if len(columns) < 2:
            raise ValueError(
                f"must have columns Elevation and Azimuth, got {', '.join(rows[first]) if rows else 'none'}"
            )
        columns += [header.index(name) for name in CHANNEL if name in header]
        lines = []
        for number, row in enumerate(rows[first + 1 :], first + 2):
            cells = [row[index] if index < len(row) else "" for index in columns]
            if any(cells[:2]):
                lines.append(
                    [number_of(cell, f"line {number}: {header[i]}") for i, cell in zip(columns, cells, strict=True)]
                )
        if not lines:
            raise ValueError("must have a line for each channel, got none")
        angles = [line[:2] for line in sorted(lines, key=lambda line: line[2:])]
    return Unit(
        model=nearest_model(MODELS, [elevation for elevation, _ in angles]),
        name=path.stem,
        lists={
            "elevation_deg": tuple(elevation for elevation, _ in angles),
            "azimuth_offset_deg": tuple(-azimuth for _, azimuth in angles),
        },
    )


def read_corrections(path: Path) -> Unit:
    """Read the file of corrections of an AT128 as a unit, whose elevations have the mean correction ahead."""
    mirror = read_mirror(path)
    ahead_deg = 0.5 * np.linspace(*AHEAD_DEG, 41) + mirror.face_start_deg[:, None]
    elevation = mirror.angles_deg(ahead_deg)[0].mean(axis=(0, 1))
    return Unit(
        model=nearest_model(MODELS, elevation.tolist()),
        name=path.stem,
        lists={
            "elevation_deg": tuple(np.round(elevation, 4).tolist()),
            "azimuth_offset_deg": tuple(np.round(mirror.azimuth_deg, 4).tolist()),
        },
    )


CORRECTIONS_START, CORRECTIONS_VERSION = b"\xee\xff", 5
"""First bytes of a file of corrections, and the minor version that is read."""

UNIT_DEG = 0.01 / 256.0
"""Source: Hesai's format; unit of the angles in a file of corrections. Of the corrections along the sweep it is 0.01
degrees."""

STEP_DEG, STEPS = 2.0, 180
"""Source: Hesai's format; step of the mirror's azimuth from correction to correction, and their number in a turn."""

AHEAD_DEG = (70.0, 110.0)
"""Choice: azimuths of the beams in the middle of a sweep, which goes from 30 to 150 degrees, 90 ahead."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MirrorCorrections:
    """Angles of the beams of an AT128, which a mirror of several faces carries along.

    Layout and formulas: tier4/nebula at 606ac41f, hesai_common.hpp and angle_corrector_correction_based.hpp.

    Attributes:
        face_start_deg: (faces,) azimuths of the mirror at which each face begins, of which the beams turn by twice
        elevation_deg: (lasers,)
        azimuth_deg: (lasers,) counter-clockwise
        elevation_shift_deg: (lasers, STEPS) corrections by the mirror's azimuth; of azimuths clockwise
        azimuth_shift_deg: (lasers, STEPS) corrections by the mirror's azimuth; of azimuths clockwise
    """

    face_start_deg: Numbers
    elevation_deg: Numbers
    azimuth_deg: Numbers
    elevation_shift_deg: Numbers
    azimuth_shift_deg: Numbers

    def face(self, mirror_deg: Numbers) -> Numbers:
        """Number of the face that is at work at azimuths of the mirror, the first at its first start."""
        order = np.argsort(self.face_start_deg)
        return order[np.searchsorted(self.face_start_deg[order], mirror_deg, side="right") - 1]

    def angles_deg(self, mirror_deg: Numbers) -> tuple[Numbers, Numbers]:
        """Return (..., lasers) elevations and azimuths [degrees, counter-clockwise from ahead] at (...) azimuths."""
        place, share = np.divmod(mirror_deg / STEP_DEG, 1.0)
        index = place.astype(np.int64) % STEPS
        following = (index + 1) % STEPS
        share = share[..., None]
        elevation, azimuth = (
            (1.0 - share) * table.T[index] + share * table.T[following]
            for table in (self.elevation_shift_deg, self.azimuth_shift_deg)
        )
        turned_deg = (mirror_deg - self.face_start_deg[self.face(mirror_deg)]) % 360.0
        clockwise_deg = 2.0 * turned_deg[..., None] + azimuth
        return self.elevation_deg + elevation, 90.0 + self.azimuth_deg - clockwise_deg

    def sweeps_of(self, mirror_deg: Numbers) -> list[slice]:
        """Slices of the packets of each sweep, by the azimuth of the mirror at the start of each packet."""
        starts = np.flatnonzero(np.diff(self.face(mirror_deg), prepend=-1))
        return [
            slice(int(start), int(stop)) for start, stop in zip(starts, [*starts[1:], len(mirror_deg)], strict=True)
        ]


def read_mirror(path: Path) -> MirrorCorrections:
    """Read the file of corrections of one AT128.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    with input_errors(path):
        content = path.read_bytes()
        content = content[max(content.find(CORRECTIONS_START), 0) :]
        if content[:2] != CORRECTIONS_START or len(content) < 16:
            raise ValueError("must be a file of corrections of an AT128 (.dat): its first bytes are of none")
        if content[3] != CORRECTIONS_VERSION:
            raise ValueError(f"must be version 1.{CORRECTIONS_VERSION}, got {content[2]}.{content[3]}")
        lasers, faces, unit = content[4], content[5], content[15]
        layout = np.dtype(
            [
                ("face_start", "<u4", faces),
                ("face_end", "<u4", faces),
                ("azimuth", "<i4", lasers),
                ("elevation", "<i4", lasers),
                ("azimuth_shift", "i1", (lasers, STEPS)),
                ("elevation_shift", "i1", (lasers, STEPS)),
            ]
        )
        if not faces or not lasers or len(content) < 16 + layout.itemsize:
            raise ValueError(f"truncated: {lasers} lasers and {faces} faces need {16 + layout.itemsize} bytes")
        numbers = np.frombuffer(content, layout, 1, 16)[0]
        return MirrorCorrections(
            face_start_deg=UNIT_DEG * unit * numbers["face_start"],
            elevation_deg=UNIT_DEG * unit * numbers["elevation"],
            azimuth_deg=UNIT_DEG * unit * numbers["azimuth"],
            elevation_shift_deg=0.01 * unit * numbers["elevation_shift"],
            azimuth_shift_deg=0.01 * unit * numbers["azimuth_shift"],
        )
