"""A recording: a file of one or many frames, which are read one at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Self, overload

import numpy as np

from ..errors import InputError, OptionWarning, warn
from .sweep import Sweep

FARTHEST_M = 10_000.0
"""Choice: range beyond which a return is a damaged number: no lidar of this kind sees farther."""


FAR_M = 500.0
"""Choice: range beyond which half of a frame's returns come from no road: they are in centimetres or millimetres."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """The frames of a file: `len`, `[frame]` and iteration; a context manager that closes the file.

    Attributes:
        count: number of frames
        read: function from a frame's number to its sweep
        close_file: function that closes the file
        metadata: text by key: format, sensor, mode, ...
        unit_json: the maker's description of the unit, where the recording has its own; "" without
    """

    path: Path
    count: int
    read: Callable[[int], Sweep]
    close_file: Callable[[], None] = lambda: None
    metadata: Mapping[str, str] = field(default_factory=dict)
    unit_json: str = ""

    def __post_init__(self) -> None:
        """Let no frame be read from a closed file: ouster-sdk would end the process."""
        close = self.close_file

        def close_file() -> None:
            object.__setattr__(self, "read", self._read_closed)
            close()

        object.__setattr__(self, "close_file", close_file)

    def __len__(self) -> int:
        return self.count

    @overload
    def __getitem__(self, frame: int) -> Sweep: ...
    @overload
    def __getitem__(self, frame: slice) -> list[Sweep]: ...
    def __getitem__(self, frame: int | slice) -> Sweep | list[Sweep]:
        """Read the sweep of this number, from 0; from the end if negative. Of a slice, read each.

        Returns beyond `FARTHEST_M` are damage: they are left out, with an `OptionWarning`; half of all beyond
        `FAR_M` are points in other units, with another.

        Raises:
            InputError: beyond the recording
        """
        if isinstance(frame, slice):
            return [self[number] for number in range(*frame.indices(self.count))]
        if not -self.count <= frame < self.count:
            raise InputError(f"{self.path}: frame must be 0 to {self.count - 1}, got {frame}")
        return self._plausible(self.read(frame % self.count))

    def __iter__(self) -> Iterator[Sweep]:
        return (self[frame] for frame in range(self.count))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close_file()

    def _read_closed(self, _: int) -> Sweep:
        raise InputError(f"{self.path}: frames must be read before the recording is closed")

    def _plausible(self, sweep: Sweep) -> Sweep:
        """The sweep without returns that are farther than any lidar sees.

        Raises:
            InputError: for places of no number
        """
        second = sweep.second
        has_point = np.isfinite(sweep.range_m) | (False if second is None else np.isfinite(second.range_m))
        places = {"directions of returns": sweep.direction[has_point]}
        if sweep.origin_m is not None:
            places["places that returns count from"] = sweep.origin_m[has_point]
        if sweep.pose is not None:
            places["the sensor's pose"] = np.column_stack([sweep.pose.rotation, sweep.pose.position_m])
        for name, numbers in places.items():
            if not np.isfinite(numbers).all():
                raise InputError(f"{self.path}: {name} must be finite numbers, got others")
        ranges_m = [sweep.range_m] if second is None else [sweep.range_m, second.range_m]
        too_far = [np.abs(range_m) > FARTHEST_M for range_m in ranges_m]
        returns = np.count_nonzero(sweep.has_return)
        if returns and np.count_nonzero(too_far[0]) == returns:
            raise InputError(
                f"{self.path}: must have points in metres in the sensor's frame, got all beyond {FARTHEST_M:g} m"
            )
        if np.count_nonzero(sweep.range_m > FAR_M) > returns / 2:
            must = "must have points in metres, got half beyond {1} m, as if in centimetres or millimetres"
            warn(OptionWarning(f"{{0}}: {must}", self.path, f"{FAR_M:g}"))
        if not any(mask.any() for mask in too_far):
            return sweep
        warn(
            OptionWarning(
                "{0}: {1} of {2} returns are farther than {3} km and left out",
                self.path,
                sum(int(mask.sum()) for mask in too_far),
                sum(int(np.isfinite(range_m).sum()) for range_m in ranges_m),
                f"{1e-3 * FARTHEST_M:g}",
            )
        )
        first_m, *second_m = (np.where(mask, np.nan, range_m) for mask, range_m in zip(too_far, ranges_m, strict=True))
        if second is not None:
            second = replace(second, range_m=second_m[0])
        return replace(sweep, range_m=first_m, recorded=sweep.recorded & ~too_far[0], second=second)
