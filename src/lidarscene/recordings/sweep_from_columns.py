"""A list of points by the names that drivers and files give their columns in, a sweep out."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..maths.arrays import Numbers
from ..maths.pose import Pose
from .sweep import Sweep

NAMES = {
    "intensity": ("intensity", "i", "scalar_intensity"),
    "signal": ("signal", "signal_photons"),
    "near_ir": ("near_ir", "ambient", "nearir"),
    "reflectivity": ("reflectivity",),
    "ring": ("ring", "channel", "laser_id", "line"),
    "column": ("column",),
    "return_number": ("return_number",),
    "time": ("time", "t", "timestamp", "time_stamp", "offset_time", "gps_time"),
}
"""What a column of a sweep is called elsewhere, the usual name first."""

LEAST_M = 1e-3
"""Nearer points are zeros that stand for nothing (a driver's way to keep rows and columns)."""


def sweep_of(
    columns: Mapping[str, Numbers],
    *,
    shape: tuple[int, ...] | None = None,
    start_s: float = 0.0,
    pose: Pose | None = None,
    metadata: Mapping[str, str],
) -> Sweep:
    """A sweep of points by column; ValueError if x, y or z is missing.

    shape  (rows, columns) of an array whose lost pulses are points at zero or NaN; None: a list, without those
    """
    named = {name.lower(): np.asarray(values).reshape(-1) for name, values in columns.items()}
    missing = [axis for axis in "xyz" if axis not in named]
    if missing:
        raise ValueError(f"must have columns x, y and z, got {', '.join(columns) or 'none'}")
    xyz_m = np.stack([named[axis].astype(np.float64) for axis in "xyz"], axis=-1)
    distance_m = np.sqrt(np.einsum("ij,ij->i", xyz_m, xyz_m))
    there = np.isfinite(distance_m) & (distance_m > LEAST_M)
    taken = there if shape is None else np.ones(len(there), bool)
    laid = (-1,) if shape is None else shape
    range_m = np.where(there, distance_m, np.nan)[taken]
    with np.errstate(invalid="ignore"):
        direction = xyz_m[taken] / range_m[:, None]
    found = {key: next((named[name][taken] for name in names if name in named), None) for key, names in NAMES.items()}
    stamps = found.pop("time")
    time_s, began_s = (None, start_s) if stamps is None else _times(stamps, range_m, start_s)
    scalars = {key: None if values is None else values.reshape(laid) for key, values in found.items()}
    return Sweep(
        range_m=range_m.reshape(laid),
        recorded=np.ones(len(range_m), bool).reshape(laid),
        direction=direction.reshape(*laid, 3),
        time_s=None if time_s is None else time_s.reshape(laid),
        start_s=began_s,
        pose=pose,
        knows_lost=shape is not None,
        metadata=metadata,
        **scalars,
    )


def _times(stamps: Numbers, range_m: Numbers, start_s: float) -> tuple[Numbers, float]:
    """Seconds from the start, and the start. Integers are nanoseconds, as drivers have it; others are seconds."""
    scale = 1e-9 if stamps.dtype.kind in "iu" else 1.0
    kept = stamps[np.isfinite(range_m)]
    first = kept.min() if len(kept) else stamps.dtype.type(0)
    seconds = scale * (stamps - first).astype(np.float64) if len(stamps) else np.zeros(0)
    absolute = abs(scale * float(first)) > 1e6  # by a clock that started long ago, not from the message's own stamp
    began_s = scale * float(first) if absolute or not start_s else start_s + scale * float(first)
    return seconds, began_s
