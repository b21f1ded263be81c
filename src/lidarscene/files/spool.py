"""Keep rows of points or pulses on disk, to read them again block by block.

Some results are known only at the end and then need every row once more, such as the points inside a box that moves.
Memory must not grow with the frame, so the rows are stored in a file without a name. The system removes it when it is
closed or when the process is killed.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from typing import Any

import numpy as np

from ..maths.arrays import Numbers

BLOCK_ROWS = 1 << 18


class Spool:
    """Rows of one dtype, in a file in ``folder``.

    Args:
        folder: that of the output made of the rows: a disk without room for the rows has none for the output either
    """

    def __init__(self, folder: str | os.PathLike[str], dtype: Any) -> None:
        self.dtype = np.dtype(dtype)
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 closed by __exit__
        self._rows = 0

    def __enter__(self) -> Spool:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def __len__(self) -> int:
        return self._rows

    def append(self, **columns: Numbers) -> None:
        """Add rows: an array for each field, all of one length."""
        rows = np.zeros(len(next(iter(columns.values()))), self.dtype)
        for name in self.dtype.names or ():
            rows[name] = columns[name]
        self._file.write(rows.view(np.uint8).data)
        self._rows += len(rows)

    def blocks(self) -> Iterator[Numbers]:
        """Yield all rows in order, as structured arrays of at most BLOCK_ROWS."""
        self._file.flush()
        for first in range(0, self._rows, BLOCK_ROWS):
            self._file.seek(first * self.dtype.itemsize)
            yield np.fromfile(self._file, self.dtype, count=min(BLOCK_ROWS, self._rows - first))
        self._file.seek(0, os.SEEK_END)
