"""Make a sweep of points whose columns have the names that drivers and files give them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..maths.arrays import Numbers
from ..maths.pose import Pose
from .sweep import Sweep

NAMES = {
    "intensity": ("intensity", "i"),
    "signal": ("signal", "signal_photons"),
    "near_ir": ("near_ir", "ambient", "nearir"),
    "reflectivity": ("reflectivity",),
    "ring": ("ring", "line", "channel", "laser_id", "laser_number"),
    "column": ("column",),
    "return_number": ("return_number",),
    "time": ("offset_ns", "time", "t", "timestamp", "time_stamp", "offset_time", "gps_time"),
}
"""Names that drivers and files give to a column of a sweep, the one that counts first; CloudCompare writes `scalar_`
before them."""

LEAST_M = 0.05
"""Choice: least distance of a point: nearer ones are zeros by which drivers fill their rows and columns, or lie on the
sensor's own window, such as the markers of lost pulses in nuScenes' sweeps."""


ACROSS = 10.0
"""Choice: ratio of the lasers' spread in rows to that in columns above which each row is a firing: those are apart by
orders of magnitude, a tilted sensor's elevations are not."""

LARGEST_S = 1e15
"""Choice: stamp above which it must be in nanoseconds: 11 days after 1970 in those."""


def sweep_of(
    columns: Mapping[str, Numbers],
    *,
    shape: tuple[int, ...] | None = None,
    start_s: float = 0.0,
    pose: Pose | None = None,
    metadata: Mapping[str, str],
) -> Sweep:
    """Make a sweep of points by column; ValueError if x, y or z is missing.

    Args:
        shape: (rows, columns) of an array whose lost pulses are points at zero or NaN, or (columns, rows), as drivers
            of Velodyne and RoboSense write it; None: a list, without those
    """
    by_name = {name.lower().removeprefix("scalar_"): np.asarray(values).reshape(-1) for name, values in columns.items()}
    missing_axes = [axis for axis in "xyz" if axis not in by_name]
    if missing_axes:
        raise ValueError(f"must have columns x, y and z, got {', '.join(columns) or 'none'}")
    if "body" in by_name and by_name.get("reflectivity", np.zeros(0, int)).dtype.kind == "f":
        del by_name["reflectivity"]  # of a surface, in clouds of lidarscene with ground truth
    with np.errstate(over="ignore", invalid="ignore"):  # a NaN of damage may be one that signals
        xyz_m = np.stack([by_name[axis].astype(np.float64) for axis in "xyz"], axis=-1)
        distance_m = np.sqrt(np.einsum("ij,ij->i", xyz_m, xyz_m))
    has_point = np.isfinite(distance_m) & (distance_m > LEAST_M)
    in_sweep = has_point if shape is None else np.ones(len(has_point), bool)
    sweep_shape = (-1,) if shape is None else shape
    range_m = np.where(has_point, distance_m, np.nan)[in_sweep]
    with np.errstate(invalid="ignore"):
        direction = xyz_m[in_sweep] / range_m[:, None]
    recorded_columns = {
        key: next((by_name[name][in_sweep] for name in names if name in by_name), None) for key, names in NAMES.items()
    }
    ring = recorded_columns["ring"]
    lasers = np.ma.array(direction[:, 2] if ring is None else ring, mask=~has_point[in_sweep]).reshape(sweep_shape)
    if shape is not None and shape[0] > shape[-1] and _has_rows_of_firings(lasers):
        turned = {name: values.reshape(shape).T for name, values in by_name.items()}
        return sweep_of(turned, shape=shape[::-1], start_s=start_s, pose=pose, metadata=metadata)
    stamps = recorded_columns.pop("time")
    in_ns = "offset_ns" in by_name  # floats too, in a table with gaps
    time_s, first_s = (None, start_s) if stamps is None else _times(stamps, range_m, start_s, in_ns=in_ns)
    scalars = {key: None if values is None else values.reshape(sweep_shape) for key, values in recorded_columns.items()}
    return Sweep(
        range_m=range_m.reshape(sweep_shape),
        recorded=np.ones(len(range_m), bool).reshape(sweep_shape),
        direction=direction.reshape(*sweep_shape, 3),
        time_s=None if time_s is None else time_s.reshape(sweep_shape),
        start_s=first_s,
        pose=pose,
        includes_lost=shape is not None,
        metadata=metadata,
        **scalars,
    )


def _has_rows_of_firings(lasers: Any) -> bool:
    """Whether lasers, by ring or elevation, change along rows and not along columns; masked where there is no point."""
    return bool(lasers.std(axis=1, ddof=1).mean() > ACROSS * lasers.std(axis=0, ddof=1).mean())


def _times(stamps: Numbers, range_m: Numbers, start_s: float, *, in_ns: bool) -> tuple[Numbers, float]:
    """Times from the first point [s], and the time of that. Integers are nanoseconds, as in drivers, floats seconds.

    Floats that would be later than the year 30,000,000 in seconds are nanoseconds, as Livox's driver has them.
    """
    if stamps.dtype.kind == "u":  # of which nothing is before the first point, where lost pulses may be
        stamps = stamps.astype(np.int64)
    in_ns = in_ns or stamps.dtype.kind in "iu" or bool(np.nanmax(stamps, initial=0.0) > LARGEST_S)
    scale = 1e-9 if in_ns else 1.0
    point_stamps = stamps[np.isfinite(range_m) & np.isfinite(stamps)]
    first = point_stamps.min() if len(point_stamps) else stamps.dtype.type(0)
    seconds = scale * (stamps - first).astype(np.float64) if len(stamps) else np.zeros(0)
    absolute = abs(scale * float(first)) > 1e6  # by a clock that started long ago, not from the message's own stamp
    first_s = scale * float(first) if absolute or not start_s else start_s + scale * float(first)
    return seconds, first_s
