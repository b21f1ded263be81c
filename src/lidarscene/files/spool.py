"""Spool: rows of points or pulses in, the same rows a block at a time out, as often as wanted, and not from memory.

For what is known only at the end and needs every row once more. The rows lie in a file without a name, which the
system takes away when it is closed or when the process is killed.
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
    """Rows of one dtype, in the folder of the file that is made of them: there is room, or there will be none."""

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
        """All rows in order, as structured arrays."""
        self._file.flush()
        for first in range(0, self._rows, BLOCK_ROWS):
            self._file.seek(first * self.dtype.itemsize)
            yield np.fromfile(self._file, self.dtype, count=min(BLOCK_ROWS, self._rows - first))
        self._file.seek(0, os.SEEK_END)
