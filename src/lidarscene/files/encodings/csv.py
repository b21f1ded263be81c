"""Read numbers from CSV files with a first line of column names.

Patterns, poses and filters come as tables from elsewhere, with more columns than are needed, in any order. The caller
selects columns by name; the others are skipped without being parsed.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...maths.arrays import Numbers
from ..inputs import require_file

SHOWN = 60
"""Choice: letters of a wrong line that are shown."""


def read_columns(path: Path, *, is_wanted: Callable[[str], bool]) -> dict[str, Numbers]:
    """Read (n,) float64 values of each column whose name satisfies ``is_wanted``; n may be 0.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    require_file(path, "a CSV file")
    try:
        with path.open(encoding="utf-8-sig") as file:
            first_line = file.readline().strip()
            names = [name.strip() for name in first_line.split(",")]
            column_indices = [number for number, name in enumerate(names) if is_wanted(name)]
            if not column_indices:
                must = "the first line must name the columns, with commas between them"
                raise InputError(f"{path}: {must}, got {first_line[:SHOWN]!r}")
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of an empty table: the caller has a better message
                values = np.loadtxt(file, delimiter=",", usecols=column_indices, ndmin=2, dtype=np.float64)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as CSV: {getattr(error, 'strerror', None) or error}") from None
    return {
        names[number]: column
        for number, column in zip(column_indices, values.reshape(-1, len(column_indices)).T, strict=True)
    }
