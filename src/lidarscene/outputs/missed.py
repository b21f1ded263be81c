"""Missed pulses: those without an echo point and why in, chunk by chunk, an NPZ as `numpy.savez` writes it out.

An archive holds one array after the other, and says first how long each is: the pulses wait in a spool.
"""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from ..detection.outcomes import OUTCOME_TEXT
from ..files.atomic import atomic_output
from ..files.spool import Spool
from ..maths.arrays import Numbers
from ..sensor.model import Sensor


@contextmanager
def missed_stream(path: str | os.PathLike[str], sensor: Sensor) -> Iterator[Callable[[Numbers, Numbers], None]]:
    """Take pulse numbers of one frame and their `Outcome` in the block.

    The file has pulse, reason, time_s (since the start of the frame), channel, azimuth_rad and elevation_rad, and
    reason_names by value.
    """
    with (
        atomic_output(path) as temporary,
        Spool(temporary.parent, [("pulse", np.uint32), ("reason", np.uint8)]) as spool,
    ):
        # Only number and reason are kept while a frame runs, on disk: most of its pulses may be missed.
        yield lambda pulse, reason: spool.append(pulse=pulse, reason=reason)
        with zipfile.ZipFile(temporary, "w") as archive:
            for name, of_rows in _arrays(sensor, _begin_s(sensor, spool)).items():
                _write_array(archive, name, len(spool), map(of_rows, spool.blocks()), of_rows(_none(spool)))
            names = np.array(["kept", *OUTCOME_TEXT.values()])
            _write_array(archive, "reason_names", len(names), [names], names)


def _arrays(sensor: Sensor, begin_s: float) -> dict[str, Callable[[Numbers], Numbers]]:
    """What the file has of each row, by name."""
    return {
        "pulse": lambda rows: rows["pulse"],
        "reason": lambda rows: rows["reason"],
        "time_s": lambda rows: sensor.scanner.time_s(rows["pulse"]) - begin_s,
        "channel": lambda rows: sensor.scanner.channel(rows["pulse"]),
        "azimuth_rad": lambda rows: sensor.scanner.angles(rows["pulse"])[0],
        "elevation_rad": lambda rows: sensor.scanner.angles(rows["pulse"])[1],
    }


def _none(spool: Spool) -> Numbers:
    return np.zeros(0, spool.dtype)


def _begin_s(sensor: Sensor, spool: Spool) -> float:
    """When the frame of these pulses began, by the scanner's clock."""
    # Pulse numbers go on from frame to frame: the first pulse of this frame is a multiple of a frame's.
    first = next(spool.blocks(), _none(spool))["pulse"][:1] // sensor.scanner.pulses * sensor.scanner.pulses
    return float(sensor.scanner.time_s(first).sum())


def _write_array(archive: zipfile.ZipFile, name: str, rows: int, blocks: Any, like: Numbers) -> None:
    """An array of so many rows of the type of ``like``, from its blocks."""
    with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
        # The head of a .npy needs the number of rows before they are written, which np.savez would gather first.
        head = {"descr": np.lib.format.dtype_to_descr(like.dtype), "fortran_order": False, "shape": (rows,)}
        np.lib.format.write_array_header_1_0(file, head)
        for block in blocks:
            file.write(np.ascontiguousarray(block).view(np.uint8).data)
