"""One recorded sweep, pulse by pulse: the returns, and the pulses without a return as far as they are recorded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..maths.arrays import Numbers, frozen
from ..maths.pose import Pose

SCALARS = ("signal", "near_ir", "reflectivity", "intensity")
"""Scalars of a pulse that a recording may have beside range and time."""

SECOND = ("range_m", "signal", "reflectivity", "intensity")
"""Arrays of a second return that it may have."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Second:
    """The second return of each pulse, in the maker's order (Ouster: strongest first); NaN where there is none.

    Attributes:
        range_m: float64, of the sweep's shape; the others float32, None where the recording has no such field
    """

    range_m: Numbers
    signal: Numbers | None = None
    reflectivity: Numbers | None = None
    intensity: Numbers | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sweep:
    """One frame of a recording, read-only. Every array has the sweep's shape, and is None if the recording lacks it.

    The shape is (rows, columns) for a spinning array, whose columns are in order of firing, and (n,) for a list of
    points. The point of a pulse is ``origin_m + range_m * direction``, in the sensor's frame: x forward, y left, z up.

    Attributes:
        range_m: float64, as reported; NaN where nothing came back or nothing was recorded
        recorded: bool, False for pulses of lost packets
        direction: (..., 3) float64 unit vectors; NaN for lost pulses whose direction the format does not give
        origin_m: (..., 3) float64 points from which ranges count; None: the origin of the frame
        time_s: float64, from `start_s`; NaN where nothing was recorded
        signal: float32, photons of the return; of lost pulses the number that the maker reports for them
        near_ir: float32, counts of the background light
        reflectivity: float32, in the maker's scale; Ouster: 100 is a white Lambertian surface
        intensity: float32, as recorded, in an unknown unit
        second: the second return
        ring: int32, as the maker's driver counts it, the column `ring` of clouds
        column: int32, number of the firing within a turn
        return_number: int32, number of a point among its pulse's returns, in a list that has an entry for each return
        start_s: start of the sweep, by the recording's clock; 0 if it has none
        pose: pose of the sensor at the start, in the recording's world
        includes_lost: True if the arrays have the pulses without a return
        metadata: text by key: sensor, format, mode, ...
    """

    range_m: Numbers
    recorded: Numbers
    direction: Numbers
    origin_m: Numbers | None = None
    time_s: Numbers | None = None
    signal: Numbers | None = None
    near_ir: Numbers | None = None
    reflectivity: Numbers | None = None
    intensity: Numbers | None = None
    second: Second | None = None
    ring: Numbers | None = None
    column: Numbers | None = None
    return_number: Numbers | None = None
    start_s: float = 0.0
    pose: Pose | None = None
    includes_lost: bool = False
    metadata: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check shapes and freeze the arrays.

        Raises:
            ValueError: names the field
        """
        shape = np.shape(self.range_m)
        dtypes: dict[str, Any] = {"range_m": np.float64, "recorded": np.bool_, "time_s": np.float64}
        dtypes |= dict.fromkeys(SCALARS, np.float32) | dict.fromkeys(("ring", "column", "return_number"), np.int32)
        dtypes |= dict.fromkeys(("direction", "origin_m"), np.float64)
        for name, dtype in dtypes.items():
            values = getattr(self, name)
            if values is not None:
                array_shape = (*shape, 3) if name in ("direction", "origin_m") else shape
                object.__setattr__(self, name, frozen(values, dtype, array_shape, name=f"Sweep.{name}"))
        for name in SECOND if self.second is not None else ():
            values = getattr(self.second, name)
            if values is not None:
                dtype = np.float64 if name == "range_m" else np.float32
                object.__setattr__(self.second, name, frozen(values, dtype, shape, name=f"Sweep.second.{name}"))

    @property
    def shape(self) -> tuple[int, ...]:
        """(rows, columns), or (n,)."""
        return self.range_m.shape

    @property
    def has_return(self) -> Numbers:
        """Mask of the pulses with a reported return."""
        return np.isfinite(self.range_m)

    @property
    def lost(self) -> Numbers:
        """Mask of the recorded pulses without a return; nowhere True unless `includes_lost`."""
        return np.asarray(self.recorded & ~self.has_return)

    @property
    def xyz_m(self) -> Numbers:
        """(..., 3) float64 points in the sensor's frame, NaN where nothing came back."""
        return self.points(self.range_m)

    def points(self, range_m: Numbers) -> Numbers:
        """(..., 3) float64 points at these ranges [m] along the beams, such as those of the second returns."""
        vectors_m = range_m[..., None] * self.direction
        return np.asarray(vectors_m if self.origin_m is None else self.origin_m + vectors_m)
