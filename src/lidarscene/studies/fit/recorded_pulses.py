"""Recorded pulses of all frames side by side, and the blocks of columns for bootstrap and checks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ...maths.arrays import Numbers, map_arrays
from ...recordings.sweep import Sweep

BLOCK_COLUMNS = 20
"""Columns in a block: two patches of `scatter`, and some 50 blocks in a turn."""

HELD_OUT_PERIOD = 4
"""Period of the held-out blocks: each fourth block is not fitted but judges the fit."""


def fitted_blocks(block: Numbers) -> Numbers:
    """Mask of the block indices whose pulses are fitted."""
    return np.asarray(block % HELD_OUT_PERIOD != HELD_OUT_PERIOD - 1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedPulses:
    """Pulses of spinning sweeps: (rows, columns) arrays, the columns of all frames side by side.

    Attributes:
        range_m: NaN where nothing came back
        recorded: True if the recording says whether the pulse had a return
        signal: as in `recordings.sweep.Sweep`; None if the recording lacks them
        near_ir: as in `recordings.sweep.Sweep`; None if the recording lacks them
        reflectivity: as in `recordings.sweep.Sweep`; None if the recording lacks them
        azimuth_rad: of the beam, NaN where not known
        frame: (columns,) index of the frame
        block: (columns,) index of the block
    """

    range_m: Numbers
    recorded: Numbers
    signal: Numbers | None
    near_ir: Numbers | None
    reflectivity: Numbers | None
    azimuth_rad: Numbers
    frame: Numbers
    block: Numbers

    @property
    def has_return(self) -> Numbers:
        """Mask of the pulses with a return."""
        return np.isfinite(self.range_m)

    @property
    def fitted(self) -> Numbers:
        """(columns,) mask of the fitted columns; the others judge the fit."""
        return fitted_blocks(self.block)

    @property
    def frames(self) -> int:
        """Number of frames."""
        return int(self.frame.max()) + 1

    def select_columns(self, columns: Numbers) -> RecordedPulses:
        """Select the pulses of a mask of columns."""
        return map_arrays(lambda values: values[..., columns], self)

    def blocks(self, mask: Numbers) -> Numbers:
        """Block index of each pulse of a (rows, columns) mask, (n,), counted from 0 without gaps."""
        block = np.broadcast_to(self.block, self.range_m.shape)[mask]
        return np.asarray(np.unique(block, return_inverse=True)[1])


def gather_pulses(sweeps: Iterable[Sweep]) -> RecordedPulses:
    """Gather the pulses of sweeps of rows and columns; columns without any record are left out.

    Raises:
        ValueError: if there are none, for lists of points, or if the numbers of rows differ
    """
    parts: list[RecordedPulses] = []
    blocks = 0
    for sweep in sweeps:
        if len(sweep.shape) != 2:
            raise ValueError("must have rows and columns, as packets of a spinning sensor do, got a list of points")
        columns = np.flatnonzero(np.asarray(sweep.recorded).any(axis=0))
        if not len(columns):
            continue
        if parts and parts[0].range_m.shape[0] != sweep.shape[0]:
            raise ValueError(f"must have {parts[0].range_m.shape[0]} rows as the first, got {sweep.shape[0]}")
        block = blocks + columns // BLOCK_COLUMNS
        blocks = int(block.max()) + 1
        parts.append(
            RecordedPulses(
                range_m=sweep.range_m[:, columns],
                recorded=np.asarray(sweep.recorded)[:, columns],
                signal=_take_columns(sweep.signal, columns),
                near_ir=_take_columns(sweep.near_ir, columns),
                reflectivity=_take_columns(sweep.reflectivity, columns),
                azimuth_rad=np.arctan2(sweep.direction[..., 1], sweep.direction[..., 0])[:, columns],
                frame=np.full(len(columns), len(parts)),
                block=block,
            )
        )
    if not parts:
        raise ValueError("must have pulses, got none")

    return map_arrays(lambda *values: np.concatenate(values, axis=-1), *parts)


def _take_columns(values: Numbers | None, columns: Numbers) -> Numbers | None:
    return None if values is None else np.asarray(values, np.float64)[:, columns]
