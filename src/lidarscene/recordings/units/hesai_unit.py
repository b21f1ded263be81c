"""Read a Hesai's table of angles (CSV: channel, elevation, azimuth) as a unit.

Azimuths are clockwise seen from above, from the sensor's y axis; sensor files count counter-clockwise from x, forward.
"""

from __future__ import annotations

import csv
from pathlib import Path

from ...formats.cloud_description import input_errors
from .unit_beams import Unit, nearest_model

MODELS = ("pandar40p", "pandar64", "pandarqt", "pandarxt-16", "pandarxt-32", "xt32m2x", "ot128")
"""The catalogue's sensors. A QT128C2X is not among them: its table says not which lasers fire together."""


def read_hesai(path: Path) -> Unit:
    """Read the table of angles of one unit. Raises InputError."""
    with input_errors(path), path.open(newline="", encoding="utf-8-sig") as file:
        rows = [[cell.strip() for cell in row] for row in csv.reader(file) if any(cell.strip() for cell in row)]
        header = [cell.lower() for cell in rows[0]] if rows else []
        column_index = {name: header.index(name) for name in ("elevation", "azimuth") if name in header}
        if len(column_index) < 2:
            raise ValueError(f"must have columns Elevation and Azimuth, got {', '.join(rows[0]) if rows else 'none'}")
        angles = []
        for number, row in enumerate(rows[1:], 2):
            try:
                angles.append(tuple(float(row[index]) for index in column_index.values()))
            except (ValueError, IndexError):
                raise ValueError(f"line {number}: must be numbers, got '{','.join(row)}'") from None
        if not angles:
            raise ValueError("must have a line for each channel, got none")
    return Unit(
        model=nearest_model(MODELS, [elevation for elevation, _ in angles]),
        name=path.stem,
        lists={
            "elevation_deg": tuple(elevation for elevation, _ in angles),
            "azimuth_offset_deg": tuple(-azimuth for _, azimuth in angles),
        },
    )
